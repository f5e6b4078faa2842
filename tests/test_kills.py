"""Runs killed by SIGKILL between the bytes of a file and its name, then repeated.

Deterministic: the process kills itself at a given rename.
`benchmarks/validation/kill_runs.py` kills at moments of the clock, and more verbs.
"""

from __future__ import annotations

import contextlib
import os
import signal
import sys
from pathlib import Path

import numpy as np
import pytest

from tests.support.programs import run_program
from tests.support.tiny_dataset import write_tiny_plan
from vrcaps.cli import main
from vrcaps.cockpit.session.drive import COMMANDS_CSV, DRIVE_JSON, make_folder
from vrcaps.core.errors import InputError
from vrcaps.core.files import file_sha256, files_in
from vrcaps.mucosa.texture import MucosaTexture, write_texture
from vrcaps.scenario.scenario import SOURCE_ORGAN
from vrcaps.training import begin_training

pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(os.name != "posix", reason="sends SIGKILL"),
]

KILLED = """
import os, signal, sys
rename, left = os.replace, [int(sys.argv[1])]

def killing(*paths):
    left[0] -= 1
    if left[0] == 0:
        os.kill(os.getpid(), signal.SIGKILL)
    rename(*paths)

os.replace = killing
sys.path.insert(0, sys.argv[2])
import test_kills
getattr(test_kills, sys.argv[3])(*sys.argv[4:])
"""


def run_cli(*words: str) -> None:
    with contextlib.redirect_stdout(None):
        main(words)


def run_train(out: str) -> None:
    begin_training(Path(out), {"steps": 3}, ())


def run_texture(out: str) -> None:
    flat = np.full((8, 8), 200, np.uint8)
    texture = MucosaTexture(np.stack([flat] * 3, -1), flat, np.full((8, 8), 32768, np.uint16), 1e-4)
    write_texture(Path(out), texture)


def killed(at: int, function: str, *words: str) -> None:
    """Run a function of this module in a process that kills itself at a rename."""
    environment = {"PYTHONPATH": os.pathsep.join(sys.path)}
    folder = str(Path(__file__).parent)
    done = run_program(
        KILLED, str(at), folder, function, *words, environment=environment, is_loaded=True
    )
    assert done.returncode == -signal.SIGKILL, done.stderr


def checksums(folder: Path) -> dict[str, str]:
    """Checksums of all files, including hidden ones."""
    return {p.relative_to(folder).as_posix(): file_sha256(p) for p in files_in(folder)}


def require_repeated(
    tmp_path: Path, at: int, function: str, words: tuple[str, ...] = ("OUT",)
) -> None:
    """Kill a run, repeat it, and compare with an undisturbed one."""
    out, whole = tmp_path / "killed" / "out", tmp_path / "whole" / "out"
    for path in (out, whole):
        path.parent.mkdir()
    killed(at, function, *(str(out) if word == "OUT" else word for word in words))
    assert checksums(out.parent)
    for path in (out, whole):
        globals()[function](*(str(path) if word == "OUT" else word for word in words))
    assert checksums(out.parent) == checksums(whole.parent)


@pytest.fixture(scope="module")
def inputs(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Organ and capsule of a recording."""
    folder = tmp_path_factory.mktemp("inputs")
    write_tiny_plan(folder, 2)
    return folder


def record_words(inputs: Path) -> tuple[str, ...]:
    files = ("--organ", str(inputs / "tube.glb"), "--capsule", str(inputs / "tiny.toml"))
    return ("record", *files, "--frames", "2", "--channels", "rgb", "depth", "--out", "OUT")


@pytest.mark.parametrize("at", [1, 4])
def test_a_recording(inputs: Path, tmp_path: Path, at: int) -> None:
    """At `episode.json`, and at a table or picture."""
    require_repeated(tmp_path, at, "run_cli", record_words(inputs))


def test_an_export(inputs: Path, tmp_path: Path) -> None:
    episode = str(tmp_path / "episode")
    run_cli(*(episode if word == "OUT" else word for word in record_words(inputs)))
    require_repeated(tmp_path, 1, "run_cli", ("export", "webdataset", episode, "--out", "OUT"))


def test_the_settings_of_a_training(tmp_path: Path) -> None:
    require_repeated(tmp_path, 1, "run_train")


@pytest.mark.parametrize("at", [1, 3])
def test_a_texture(tmp_path: Path, at: int) -> None:
    require_repeated(tmp_path, at, "run_texture")


def test_a_drive_of_which_nothing_is_kept_does_not_block_its_folder(tmp_path: Path) -> None:
    """The scenario is written after the organ and the commands; only with it is there a drive."""
    for name in (COMMANDS_CSV, SOURCE_ORGAN, f".{DRIVE_JSON}.{'0' * 32}.tmp"):
        (tmp_path / name).touch()
    make_folder(tmp_path)
    assert list(tmp_path.iterdir()) == []
    (tmp_path / COMMANDS_CSV).touch()
    (tmp_path / DRIVE_JSON).touch()
    (tmp_path / f".{DRIVE_JSON}.{'0' * 32}.tmp").touch()
    with pytest.raises(
        InputError, match=r"contains a drive\. Record it with `vrcaps record .*json"
    ):
        make_folder(tmp_path)
    assert {path.name for path in tmp_path.iterdir()} == {COMMANDS_CSV, DRIVE_JSON}
