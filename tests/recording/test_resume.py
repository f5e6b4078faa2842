"""One recorder writes into a folder; the others are told which, and a dead one holds nothing."""

from __future__ import annotations

import errno
import json
import os
import platform
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from vrcaps.core.errors import InputError
from vrcaps.recording.recorder import record
from vrcaps.recording.resume import LOCK, recording_lock
from vrcaps.scenario.scenario import Scenario

HOLD = """
import sys
from pathlib import Path
from vrcaps.recording.resume import recording_lock
with recording_lock(Path(sys.argv[1])):
    print("held", flush=True)
    sys.stdin.read()
"""


def _names(folder: Path) -> list[str]:
    return sorted(path.name for path in folder.iterdir())


def test_a_recorder_in_the_same_folder_is_refused(scenario: Scenario, tmp_path: Path) -> None:
    me = f"Process {os.getpid()} on {platform.node()} is writing the episode .*until it finishes"
    with recording_lock(tmp_path):
        with pytest.raises(InputError, match=me):
            record(scenario, tmp_path)
        assert _names(tmp_path) == [LOCK]
        (tmp_path / LOCK).write_text("{")
        with pytest.raises(InputError, match="Another process is writing the episode"):
            record(scenario, tmp_path)
    assert _names(tmp_path) == []


def test_another_process_holds_it_until_it_is_killed(tmp_path: Path) -> None:
    command = [sys.executable, "-c", HOLD, str(tmp_path)]
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE) as other:
        assert other.stdout is not None
        assert other.stdout.readline() == b"held\n"
        with pytest.raises(InputError, match=f"Process {other.pid} on"):
            recording_lock(tmp_path).__enter__()
        other.kill()
    assert _names(tmp_path) == [LOCK]
    with recording_lock(tmp_path):
        assert json.loads((tmp_path / LOCK).read_text())["pid"] == os.getpid()
    assert _names(tmp_path) == []


def test_a_folder_that_stays_empty_is_not_left_behind(tmp_path: Path) -> None:
    out = tmp_path / "runs" / "a"
    with pytest.raises(RuntimeError), recording_lock(out):
        raise RuntimeError
    assert _names(tmp_path) == []
    with recording_lock(out):
        (out / "episode.json").touch()
    assert _names(out) == ["episode.json"]


def test_a_folder_that_cannot_be_written(tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    with pytest.raises(InputError, match=r"Cannot write the episode .*file"):
        recording_lock(tmp_path / "file" / "a").__enter__()


def test_a_file_system_without_locks_is_a_warning(tmp_path: Path, monkeypatch) -> None:
    def refuse(*_: object) -> None:
        raise OSError(errno.ENOLCK, "No locks available")

    monkeypatch.setattr(pytest.importorskip("fcntl"), "flock", refuse)
    with pytest.warns(UserWarning, match="has no locks"), recording_lock(tmp_path):
        assert _names(tmp_path) == [LOCK]


@pytest.mark.parametrize("name", ["front/rgb", "front", ".resume", "organ.glb", "episode.json"])
def test_a_link_that_leads_out_of_the_episode_is_refused(
    recorded: Path, scenario: Scenario, tmp_path: Path, name: str
) -> None:
    """Else a resumed recording would overwrite files that are not its own."""
    out, outside = tmp_path / "episode", tmp_path / "outside"
    shutil.copytree(recorded, out)
    head = json.loads((out / "episode.json").read_text())
    (out / "episode.json").write_text(json.dumps({**head, "status": "recording"}))
    if (out / name).exists():
        (out / name).rename(outside)
    else:
        outside.mkdir()
    (out / name).symlink_to(outside)
    before = sorted(outside.rglob("*"))
    with pytest.raises(InputError, match=rf"{name} leads out of .*Copy them there"):
        record(scenario, out)
    assert sorted(outside.rglob("*")) == before
