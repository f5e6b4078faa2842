"""Mistakes on the command line: said on one line, with what was probably meant, before work."""

from __future__ import annotations

import runpy
import subprocess
import sys
from pathlib import Path
from threading import Event

import pytest

import vrcaps
from tests.support.waiting import WATCHDOG
from vrcaps import cli
from vrcaps.cli import console
from vrcaps.core.errors import InputError, StorageError, reason_of
from vrcaps.data.plan import read_plan


def said(args: list[str], capsys: pytest.CaptureFixture[str]) -> str:
    """The one line of a command that stops with status 2."""
    with pytest.raises(SystemExit, match="2"):
        cli.main(args)
    text = capsys.readouterr().err
    assert text.startswith("vrcaps: ") and text.count("\n") == 1
    return text


@pytest.mark.parametrize(
    ("args", "message"),
    [
        ("recrd", "No command named 'recrd'. Known: bench, "),
        ("recrd", "Did you mean 'record'?"),
        ("export c3dv runs/a --out b", "No format named 'c3dv'. Known: bop, c3vd, "),
        ("export c3dv runs/a --out b", "Did you mean 'c3vd'?"),
        ("predict dept", "No task named 'dept'. Known: classification, depth, "),
        ("evaluate dept --data x", "Did you mean 'depth'?"),
        ("organ mak colon", "No organ command named 'mak'."),
        ("weights list --place x", "No option of vrcaps weights list named '--place'."),
        ("--verison", "No option of vrcaps named '--verison'. Known: --help, --version."),
        ("doctor --all", "No option of vrcaps doctor named '--all'. Known: --help."),
        ("check a b", "'b' is one argument too many. Known options: vrcaps check --help."),
        ("check a --verbos", "No option of vrcaps check named '--verbos'."),
        ("dataset check a --checksum-only", "Did you mean '--checksums-only'?"),
        ("export coco a --out b --spilt=val", "Did you mean '--split'?"),
        ("coverage", "Missing: PATH (Folder of the episode, recorded with --coverage). Known "),
        ("calibrate geometric photos --board 7x8", "Missing: --square, --out. Known options: "),
        ("coverage a --max-depth deep", "--max-depth is 'deep'. Allowed: a number."),
        ("organ texture a --box 1 2 --out b", "--box is '1 2'. Allowed: INT INT INT INT."),
        ("record --light pth", "--light is 'pth'. Allowed: direct, path, radiosity. Did you mean "),
        ("record --frames", "--frames has no value. Known options: vrcaps record --help."),
    ],
)
def test_a_misspelled_word_is_said_with_what_was_meant(args, message, capsys) -> None:
    assert message in said(args.split(), capsys)


def test_the_version_is_printed(capsys) -> None:
    cli.main(["--version"])
    assert capsys.readouterr().out == f"vrcaps {vrcaps.__version__}\n"


def test_the_package_runs_as_a_module(capsys, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sys, "argv", ["vrcaps", "--version"])
    runpy.run_module("vrcaps", run_name="__main__")
    assert capsys.readouterr().out == f"vrcaps {vrcaps.__version__}\n"


@pytest.mark.parametrize("args", [[], ["export"], ["dataset"]])
def test_without_a_verb_the_help_is_shown(args, capsys) -> None:
    with pytest.raises(SystemExit, match="2"):
        cli.main(args)
    text = capsys.readouterr().err
    assert text.startswith(" ".join(["usage: vrcaps", *args]))
    assert ("record" if not args else "coco" if args == ["export"] else "make") in text


def test_a_policy_is_no_misspelled_task() -> None:
    command = cli._parse(["evaluate", "centerline", "--out", "o"])
    assert type(command).__name__ == "Evaluate"


WRONG_PATHS = (
    "record {0} --out {1}",
    "cockpit {0} --out {1}",
    "check {0}",
    "coverage {0}",
    "view {0}",
    "reconstruct {0} --out {1}",
    "reconstruct c3vd:{0} --out {1}",
    "export c3vd {0} --out {1}",
    "export lerobot {0} --out {1}",
    "dataset make {0} --out {1}",
    "dataset check {0}",
    "dataset card {0}",
    "dataset show {0}",
    "train depth --data {0} --out {1}",
    "train segmentation --data coco:{0} --out {1}",
    "train depth --data . --start {0}.safetensors --out {1}",
    "evaluate depth --data . --weights {0}.safetensors",
    "predict depth --images . --weights {0}.safetensors --out {1}",
    "evaluate depth --data {0}",
    "predict segmentation --images {0} --out {1}",
    "weights publish {0}",
    "organ texture {0} --field-width-mm 30 --out {1}",
    "organ from-ct {0} --out organ.glb",
    "calibrate geometric {0} --board 8x6 --square 10mm --out {1}.toml",
    "calibrate photometric {0} --out {1}.toml",
)
HEAVY = ("torch", "trimesh", "skimage", "matplotlib", "SimpleITK", "viser", "cv2", "pyarrow")


@pytest.mark.parametrize("command", WRONG_PATHS)
def test_a_wrong_path_is_named(command: str, tmp_path: Path, capsys) -> None:
    missing, out = tmp_path / "gone", tmp_path / "out"
    text = said(command.format(missing, out).split(), capsys)
    assert str(missing) in text and "Give " in text
    assert not out.exists()


@pytest.mark.slow
def test_a_wrong_path_is_reported_before_anything_heavy_is_loaded(tmp_path: Path) -> None:
    """In one new process: none of the verbs loads a heavy package or a part of SciPy."""
    commands = [line.format(tmp_path / "gone", tmp_path / "out") for line in WRONG_PATHS]
    code = (
        "import sys\nfrom vrcaps import cli\n"
        f"for line in {commands!r}:\n"
        "    try: cli.main(line.split())\n"
        "    except SystemExit: pass\n"
        f"heavy = {(*HEAVY, 'scipy.ndimage', 'scipy.spatial', 'scipy.sparse')!r}\n"
        "print(*[name for name in heavy if name in sys.modules])"
    )
    run = [sys.executable, "-c", code]
    found = subprocess.run(run, capture_output=True, text=True, check=True, timeout=WATCHDOG)
    assert found.stdout.split() == []
    assert found.stderr.count("\n") == len(commands)


def test_errors_of_the_system_have_no_number() -> None:
    error = FileNotFoundError(2, "No such file or directory", "/a/b.txt")
    assert reason_of(error) == "No such file or directory"
    assert str(InputError(f"Cannot read /a: {error}.")) == (
        "Cannot read /a: No such file or directory."
    )
    moved = OSError(18, "Invalid cross-device link", "/a", None, "/b")
    assert str(StorageError(f"Cannot write: {moved}")) == "Cannot write: Invalid cross-device link"
    assert reason_of(ValueError("no number")) == "no number"


def test_progress_is_told_in_lines_where_there_is_no_terminal(capsys) -> None:
    """Every 30 s at most: at 30, 61 and 95 s, and not between."""
    times = iter([0.0, 10.0, 30.0, 59.0, 61.0, 95.0])
    lines = console._Lines("recording", clock=lambda: next(times))
    for done in range(1, 6):
        lines.report(f"{done}/5")
    assert capsys.readouterr().err == (
        "recording: 2/5 after 30 s\nrecording: 4/5 after 61 s\nrecording: 5/5 after 95 s\n"
    )


def test_progress_is_told_while_nothing_is_driven(capsys, monkeypatch) -> None:
    """An organ is generated before the first frame: the lines come from a thread."""
    monkeypatch.setattr(console, "PERIOD", 0.0)
    monkeypatch.setattr(console, "_TICK", 1e-3)
    reported, report = Event(), console._Lines.report
    monkeypatch.setattr(console._Lines, "report", lambda *a: (report(*a), reported.set()))
    with console.progress_bar("recording"):
        assert reported.wait(WATCHDOG)
    assert "recording: none done after 0 s\n" in capsys.readouterr().err


def test_a_plan_may_hold_its_scenario_in_a_table(tmp_path: Path) -> None:
    head = '[dataset]\nname = "a"\n'
    flat, nested, both = (tmp_path / f"{name}.toml" for name in ("flat", "nested", "both"))
    flat.write_text(f"frames = 3\n{head}[motion]\nspeed = 0.01\n")
    nested.write_text(f"{head}[scenario]\nframes = 3\n[scenario.motion]\nspeed = 0.01\n")
    assert read_plan(nested) == read_plan(flat)
    both.write_text(f"frames = 3\n{head}[scenario]\nframes = 4\n")
    with pytest.raises(InputError, match=r"has frames both in \[scenario\] and outside it"):
        read_plan(both)
    both.write_text(f"scenario = 3\n{head}")
    with pytest.raises(InputError, match=r"scenario is 3\. Allowed: a table \[scenario\]"):
        read_plan(both)
