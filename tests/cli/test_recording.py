"""Recordings from the command line, end to end, on a small phantom stored in millimeters."""

from __future__ import annotations

import signal
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import trimesh

from tests.support.coarse_organs import COARSE
from tests.support.waiting import WATCHDOG, wait_until
from vrcaps import cli
from vrcaps.recording.episode import read_episode

FLAGS = "--unit mm --frames 3 --channels rgb depth label --seed 5 --effects none --whole"


@pytest.fixture(scope="module")
def phantom(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A straight lumen with round ends, 40 mm wide and 190 mm long."""
    path = tmp_path_factory.mktemp("organ") / "phantom.ply"
    trimesh.creation.capsule(height=150.0, radius=20.0, count=(32, 32)).export(path)
    return path


@pytest.fixture(scope="module")
def episode(phantom: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("runs") / "first"
    cli.main(f"record --organ {phantom} --out {out} {FLAGS}".split())
    return out


@pytest.mark.slow
def test_recording_says_where_and_what_to_open(
    phantom: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    cli.main(f"record --organ {phantom} --out {tmp_path / 'o'} {FLAGS}".split())
    text = " ".join(capsys.readouterr().out.split())
    assert "Recorded 3 frames of front into" in text
    assert f"First image: {tmp_path / 'o' / 'front' / 'rgb' / '000000'}" in text
    assert "Channels: rgb, depth, label." in text
    assert "sheet.png" in text
    assert (tmp_path / "o" / "sheet.png").is_file()
    cli.main(f"record --organ {phantom} --out {tmp_path / 'o'} {FLAGS}".split())
    again = " ".join(capsys.readouterr().out.split())
    assert f"{tmp_path / 'o'} is complete: 3 frames of front." in again
    assert "Recorded" not in again


@pytest.mark.slow
def test_flags_are_in_the_episode(episode: Path) -> None:
    recorded = read_episode(episode)
    assert (len(recorded), recorded.channels) == (3, ("rgb", "depth", "label"))
    assert recorded.scenario.seed == 5


@pytest.mark.slow
def test_check_passes_and_finds_a_fault(episode: Path, capsys: pytest.CaptureFixture[str]) -> None:
    cli.main(["check", str(episode)])
    assert "is complete and consistent" in capsys.readouterr().out
    image = episode / "front" / "depth" / "000001.png"
    whole = image.read_bytes()
    image.unlink()
    with pytest.raises(SystemExit, match="1"):
        cli.main(["check", str(episode)])
    image.write_bytes(whole)
    assert "front/depth/000001.png" in capsys.readouterr().out


@pytest.mark.slow
def test_the_episode_s_own_scenario_makes_the_same_files(episode: Path, tmp_path: Path) -> None:
    out = tmp_path / "again"
    cli.main(f"record {episode / 'episode.json'} --out {out} --threads 1".split())
    names = sorted(p.relative_to(episode) for p in episode.rglob("*") if p.is_file())
    assert names == sorted(p.relative_to(out) for p in out.rglob("*") if p.is_file())
    for name in names:
        assert (out / name).read_bytes() == (episode / name).read_bytes(), name


@pytest.mark.slow
def test_indirect_light_is_recorded(phantom: Path, episode: Path, tmp_path: Path) -> None:
    out = tmp_path / "direct"
    cli.main(f"record --organ {phantom} --out {out} {FLAGS} --light direct".split())
    glowing, plain = read_episode(episode), read_episode(out)
    assert glowing.scenario.render.light == "radiosity"
    for channel in ("depth", "label"):
        np.testing.assert_array_equal(
            glowing.image("front", channel, 1), plain.image("front", channel, 1)
        )
    bright, dim = (e.image("front", "rgb", 1).astype(int) for e in (glowing, plain))
    assert (bright >= dim).all()
    assert bright.mean() > 1.05 * dim.mean()


@pytest.mark.slow
def test_inspection_prints_the_phantom_s_own_measures(
    phantom: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    picture = tmp_path / "picture.png"
    cli.main(["organ", "inspect", str(phantom), "--unit", "mm", "--picture", str(picture)])
    text = " ".join(capsys.readouterr().out.split())
    assert "size 4.0 × 4.0 × 19.0 cm" in text
    assert "lumen volume 22" in text  # π r² h + 4/3 π r³ = 222 ml
    assert "turned to face into the lumen" in text
    assert picture.stat().st_size > 0


@pytest.mark.slow
@pytest.mark.skipif(sys.platform == "win32", reason="signals differ")
def test_interrupted_recording_ends_in_one_line_and_goes_on(phantom: Path, tmp_path: Path) -> None:
    out = tmp_path / "o"
    flags = f"record --organ {phantom} --unit mm --frames 400 --out {out}".split()
    # A shell's background job ignores Ctrl-C, and its children inherit that.
    listen = "import signal; signal.signal(signal.SIGINT, signal.default_int_handler)"
    code = f"{listen}{COARSE}from vrcaps.cli import main; main()"
    script = [sys.executable, "-c", code, *flags]
    process = subprocess.Popen(script, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    wait_until(lambda: list(out.glob("front/rgb/0000*.png")) or process.poll() is not None)
    assert process.poll() is None, process.communicate()[1]
    process.send_signal(signal.SIGINT)
    _, text = process.communicate(timeout=WATCHDOG)
    assert process.returncode == cli.EXIT_INTERRUPTED
    assert text.splitlines()[-1] == "vrcaps: Interrupted. Files written so far are complete."
    assert "Traceback" not in text
    unfinished = read_episode(out, unfinished=True)
    assert unfinished.head["status"] == "recording"
    assert unfinished.image("front", "rgb", 0).shape == (160, 160, 3)
