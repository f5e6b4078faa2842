import errno
import hashlib
import json
import os
import pickle
import shutil
import sys
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from tests.support.programs import run_program
from vrcaps import _core
from vrcaps.camera_pipeline.capsule_cameras import CapsuleCameras
from vrcaps.core import build_info
from vrcaps.core.errors import InputError
from vrcaps.core.files import file_sha256, is_temporary
from vrcaps.recording.check import check_episode
from vrcaps.recording.episode import read_episode
from vrcaps.recording.recorder import record
from vrcaps.scenario.scenario import read_scenario, scenario_to_plain


def _digests(folder: Path) -> dict[str, str]:
    files = sorted(path for path in folder.rglob("*") if path.is_file())
    return {
        str(path.relative_to(folder)): hashlib.sha256(path.read_bytes()).hexdigest()
        for path in files
    }


def test_layout(recorded, scenario):
    names = {str(path.relative_to(recorded)) for path in recorded.rglob("*") if path.is_file()}
    fixed = {"episode.json", "frames.parquet", "organ.glb", "sheet.png", "preview.mp4"}
    assert fixed <= names
    images = names - fixed
    assert len(images) == 2 * 5 * len(scenario.channels)
    assert {"front/rgb/000000.png", "rear/depth/000004.png", "front/position/000003.npy"} <= images
    head = json.loads((recorded / "episode.json").read_text())
    assert (head["format"], head["status"], head["frames"]) == ("vrcaps-episode/1", "complete", 5)
    assert head["scenario"]["organ"]["path"]["sha256"]
    assert head["fps"] == 4.0


@pytest.mark.slow
def test_same_scenario_same_bytes(recorded, scenario, tmp_path):
    again = record(scenario, tmp_path / "again")
    assert _digests(again) == _digests(recorded)


@pytest.mark.slow
def test_episode_json_is_a_scenario(recorded, scenario, tmp_path):
    again = record(read_scenario(recorded / "episode.json"), tmp_path / "again")
    assert _digests(again) == _digests(recorded)


@pytest.mark.slow
def test_progress_counts_whole_frames(scenario, tmp_path):
    calls = []

    def progress(done, total):
        whole = [(tmp_path / "e/rear/occlusion" / f"{i:06d}.png").exists() for i in range(done)]
        calls.append((done, total, all(whole)))

    record(scenario, tmp_path / "e", progress=progress)
    assert [done for done, _, _ in calls] == sorted(done for done, _, _ in calls)
    assert calls[-1] == (5, 5, True)
    assert all(whole for _, _, whole in calls)


def test_recording_again_into_a_whole_episode_changes_nothing(recorded, scenario, tmp_path):
    before = {path: path.stat().st_mtime_ns for path in recorded.rglob("*.png")}
    record(scenario, recorded)
    assert {path: path.stat().st_mtime_ns for path in recorded.rglob("*.png")} == before


@pytest.mark.slow
@pytest.mark.parametrize("fail_at", [0, 2, 4])
def test_full_disk_then_resume(recorded, scenario, tmp_path, monkeypatch, fail_at):
    """One line; every file there is whole; going on gives the bytes of an unbroken run."""
    out, write = tmp_path / "episode", _core.write_pngs

    def full(items):
        if any(f"{fail_at:06d}" in path for path, _ in items):
            write(items[: len(items) // 2])
            raise OSError(errno.ENOSPC, "No space left on device", items[-1][0])
        write(items)

    with monkeypatch.context() as patch:
        patch.setattr(_core, "write_pngs", full)
        with pytest.raises(InputError, match=r"The disk is full .* run the same command again"):
            record(scenario, out)
    assert json.loads((out / "episode.json").read_text())["status"] == "recording"
    with pytest.raises(InputError, match=r"was interrupted\. To resume it: vrcaps record \S"):
        read_episode(out)
    written, whole = _digests(out), _digests(recorded)
    assert all(whole[name] == digest for name, digest in written.items() if name != "episode.json")
    record(scenario, out)
    assert _digests(out) == whole


@pytest.mark.slow
@pytest.mark.parametrize("name", ["sheet.png", "preview.mp4", "organ.glb", "frames.parquet"])
def test_missing_files_are_made_again(recorded, scenario, tmp_path, name):
    out = Path(shutil.copytree(recorded, tmp_path / "episode"))
    (out / name).unlink()
    (out / "front/rgb/000002.png").unlink()
    stale = out / f"front/rgb/.000002.png.{'0' * 16}.tmp"
    stale.write_bytes(b"left by a run that was killed")
    record(scenario, out)
    assert _digests(out) == _digests(recorded)


DAMAGED = (
    *("frames.parquet", "organ.glb", "sheet.png", "preview.mp4"),
    *("front/rgb/000001.png", "rear/depth/000004.png", "front/position/000003.npy"),
)


@pytest.mark.slow
def test_damaged_files_are_made_again(recorded, scenario, tmp_path):
    """As a loss of power leaves them: the name is there, and the first half of the bytes."""
    out = Path(shutil.copytree(recorded, tmp_path / "episode"))
    for name in DAMAGED:
        whole = (out / name).read_bytes()
        (out / name).write_bytes(whole[: len(whole) // 2])
    found = {problem.where for problem in check_episode(out)}
    assert found == set(DAMAGED)
    record(scenario, out)
    assert _digests(out) == _digests(recorded)


@pytest.mark.slow
def test_an_organ_file_that_cannot_be_written_is_reported(
    recorded, scenario, tmp_path, monkeypatch
):
    def full(*args):
        raise OSError(errno.ENOSPC, "No space left on device", "organ.glb")

    with monkeypatch.context() as patch:
        patch.setattr("vrcaps.recording.recorder._write_organ", full)
        with pytest.raises(InputError, match=r"The disk is full .* run the same command again"):
            record(scenario, tmp_path / "again")
    record(scenario, tmp_path / "again")
    assert _digests(tmp_path / "again") == _digests(recorded)


@pytest.mark.slow
def test_other_write_errors(scenario, tmp_path, monkeypatch):
    def refuse(items):
        raise OSError(errno.EACCES, "Permission denied", items[0][0])

    monkeypatch.setattr(_core, "write_pngs", refuse)
    with pytest.raises(InputError, match=r"Cannot write the episode .*Permission denied"):
        record(scenario, tmp_path / "episode")


def test_folder_that_holds_something_else(scenario, tmp_path):
    (tmp_path / "thesis.txt").write_text("mine")
    with pytest.raises(InputError, match=r"contains other files \('thesis.txt'"):
        record(scenario, tmp_path)
    assert [path.name for path in tmp_path.iterdir()] == ["thesis.txt"]


def test_out_is_a_file(scenario, tmp_path):
    (tmp_path / "file").write_text("mine")
    with pytest.raises(InputError, match=r"is a file\. Give a new or empty folder"):
        record(scenario, tmp_path / "file")
    assert (tmp_path / "file").read_text() == "mine"


def test_folder_with_a_foreign_episode_json(scenario, tmp_path):
    (tmp_path / "episode.json").write_text('{"title": "Episode IV"}')
    with pytest.raises(InputError, match=r"has the format None\. Allowed: 'vrcaps-episode/1'"):
        record(scenario, tmp_path)
    assert (tmp_path / "episode.json").read_text() == '{"title": "Episode IV"}'


def test_different_scenario_is_refused(recorded, scenario):
    before = _digests(recorded)
    with pytest.raises(InputError, match=r"different scenario: seed is \d+, not 2\. Give"):
        record(replace(scenario, seed=2), recorded)
    assert _digests(recorded) == before


@pytest.mark.slow
def test_different_device_or_version_is_refused(scenario, tmp_path):
    out = record(replace(scenario, frames=1, channels=("rgb",)), tmp_path / "episode")
    head = json.loads((out / "episode.json").read_text())
    other = {**head["made_with"], "numpy": "1.0"}
    for key, value, match in (
        ("vrcaps_version", "0.0.0", r"another vrcaps_version, vrcaps 0\.0\.0 \(here "),
        ("made_with", other, r"another made_with, numpy 1\.0 \(here \d.*\): bytes may differ"),
        ("made_with", None, r"another made_with, core_sha256 unknown \(here "),
        ("cameras", [], r"another cameras\. Give a new"),
        ("extra", 1, r"another set of keys\."),
    ):
        (out / "episode.json").write_text(json.dumps({**head, key: value}))
        with pytest.raises(InputError, match=match):
            record(replace(scenario, frames=1, channels=("rgb",)), out)
    assert head["made_with"]["core_sha256"] == file_sha256(Path(_core.__file__))


def test_empty_folder_and_single_channel(scenario, tmp_path):
    """An existing empty folder is fine; without rgb the preview is left out."""
    out = record(replace(scenario, frames=2, channels=("depth",)), tmp_path)
    assert check_episode(out) == []
    assert not (out / "preview.mp4").exists()


def test_without_pyav_a_recording_has_no_preview_and_is_complete(scenario, tmp_path, monkeypatch):
    for name in ("av", "matplotlib", "skimage", "tifffile", "trimesh"):
        monkeypatch.setitem(sys.modules, name, None)
    known = build_info._version
    monkeypatch.setattr(build_info, "_version", lambda name: "" if name == "av" else known(name))
    out = record(replace(scenario, frames=2, channels=("rgb", "depth")), tmp_path)
    assert not (out / "preview.mp4").exists()
    assert read_episode(out).head["made_with"]["av"] == ""
    assert check_episode(out) == []
    record(read_episode(out).scenario, out)


def test_no_flow_beyond_the_ends_of_the_run(recorded):
    episode = read_episode(recorded)
    for camera in ("front", "rear"):
        assert np.isnan(episode.image(camera, "flow_backward", 0)).all()
        assert np.isnan(episode.image(camera, "flow_forward", 4)).all()
        assert episode.image(camera, "occlusion", 4).all()
        assert np.isfinite(episode.image(camera, "flow_forward", 0)).any()
        assert np.isfinite(episode.image(camera, "flow_backward", 4)).any()


# A shell's background job ignores Ctrl-C, and its children inherit that.
RUN = """
import os
import pickle
import shutil
import signal
import sys
from pathlib import Path
from vrcaps.core.errors import VrcapsError
from vrcaps.scenario.build import OrganSource
from vrcaps.recording.recorder import record
from vrcaps.scenario.scenario import read_scenario
{setup}
signal.signal(signal.SIGINT, signal.default_int_handler)
organ = pickle.loads(Path(sys.argv[3]).read_bytes())
OrganSource.load_healthy = lambda _: organ
def progress(done, total):
    if done == {interrupt}:
        os.kill(os.getpid(), signal.SIGINT)
try:
    record(read_scenario(sys.argv[1]), sys.argv[2], progress=progress)
except VrcapsError as error:
    sys.exit(f"error: {{error}}")
"""


def _program(scenario, tmp_path, name, setup="", interrupt=None):
    """Code and arguments of a recording in a separate process."""
    path = tmp_path / "scenario.json"
    path.write_text(json.dumps(scenario_to_plain(scenario)))
    arguments = [str(path), str(tmp_path / name), str(tmp_path / "organ.pickle")]
    return [RUN.format(setup=setup, interrupt=interrupt), *arguments]


def _recorded(*given, threads="2", **options):
    """A recording that has ended."""
    return run_program(*_program(*given, **options), environment={"RAYON_NUM_THREADS": threads})


@pytest.mark.slow
@pytest.mark.skipif(os.name != "posix", reason="sends SIGINT")
def test_interrupt_threads_and_file_limit(scenario, organ, tmp_path):
    """Same bytes on 1 and 2 threads, after Ctrl-C, and after a write that the system refused."""
    (tmp_path / "organ.pickle").write_bytes(pickle.dumps(organ))
    scenario = replace(scenario, frames=16, channels=("rgb", "depth", "normal"))
    limit = "import resource; resource.setrlimit(resource.RLIMIT_FSIZE, (20000, 20000))"
    one = _recorded(scenario, tmp_path, "one", threads="1")
    refused = _recorded(scenario, tmp_path, "refused", setup=limit)
    stopped = _recorded(scenario, tmp_path, "stopped", interrupt=5)
    assert (one.returncode, one.stderr) == (0, "")
    assert stopped.returncode != 0
    assert "KeyboardInterrupt" in stopped.stderr
    assert refused.returncode == 1
    assert refused.stderr.startswith("error: The disk is full")
    assert refused.stderr.count("\n") == 1
    whole = _digests(tmp_path / "one")
    for name in ("stopped", "refused"):
        out = tmp_path / name
        assert json.loads((out / "episode.json").read_text())["status"] == "recording"
        # The thread that writes the organ ends with the process, in the middle of a file or not.
        written = {
            file: d for file, d in _digests(out).items() if not is_temporary(Path(file).name)
        }
        assert len(written) < len(whole)
        same = [whole.get(file) == digest for file, digest in written.items()]
        assert same.count(False) == 1  # episode.json, by its status
        assert _recorded(scenario, tmp_path, name).stderr == ""
        assert _digests(out) == whole


@pytest.mark.slow
def test_speed_of_the_writer_is_bounded_by_the_queue(scenario, tmp_path, monkeypatch):
    """Rendering never runs more than a few frames ahead of a slow disk."""
    write, written, ahead = _core.write_pngs, [], []

    def slow(items):
        time.sleep(0.02)
        write(items)
        written.append(items)

    render = CapsuleCameras.begin_capture

    def counted(*args):
        ahead.append(len(ahead) - len(written))
        return render(*args)

    monkeypatch.setattr(_core, "write_pngs", slow)
    monkeypatch.setattr(CapsuleCameras, "begin_capture", counted)
    record(replace(scenario, frames=20, channels=("rgb",)), tmp_path / "episode")
    assert max(ahead) <= 6
    assert np.mean(ahead) > 1.0
