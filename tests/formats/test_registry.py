"""Registry of formats: kinds, lazy imports, and a format that a user registers."""

import os
import shutil
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import ClassVar

import numpy as np
import pytest

from vrcaps.cli import main
from vrcaps.core.errors import InputError, UnknownNameError
from vrcaps.data.ledger import PLAN
from vrcaps.formats import FORMATS, Needs, read_sources
from vrcaps.recording.frame_sequence import FrameSequence
from vrcaps.recording.layout import EPISODE_JSON


@pytest.mark.parametrize("kind", FORMATS.built_in)
def test_each_built_in_format_has_its_kind_and_a_summary(kind):
    form = FORMATS[kind]
    assert form.kind == kind
    assert form().read
    assert form().write
    assert FORMATS.summary(kind).endswith(".")


def loaded_modules(code: str) -> set[str]:
    code = f"import sys\n{code}\nprint('loaded', *sys.modules)"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    return set(done.stdout.splitlines()[-1].split())


BUILT_IN = {FORMATS[kind].__module__ for kind in FORMATS.built_in}


def test_the_registry_imports_no_format():
    loaded = loaded_modules("import vrcaps.formats.format")
    assert not BUILT_IN & loaded
    assert not {"numpy", "scipy"} & loaded


@pytest.mark.slow
def test_help_of_export_imports_no_format():
    code = "from vrcaps.cli import main\ntry: main(['export', '--help'])\nexcept SystemExit: pass"
    assert not BUILT_IN & loaded_modules(code)


@dataclass(frozen=True)
class PlainTimes:
    """Times of frames, one file for each sequence.

    Attributes:
        unit: Seconds per stored unit.
    """

    unit: float = 1.0

    kind: ClassVar[str] = "plain-times"
    needs: ClassVar[Needs] = Needs(channels=(), poses=False)

    def write(self, sequences, folder: Path, advance) -> None:
        for sequence in sequences:
            name = sequence.name.replace("/", "_")
            np.savetxt(folder / f"{name}.txt", sequence.times / self.unit)
            for _ in sequence.times:
                advance()

    def read(self, folder: Path) -> tuple[FrameSequence, ...]:
        return tuple(
            FrameSequence(path.stem, (), {"time": np.loadtxt(path) * self.unit}, no_image)
            for path in sorted(folder.glob("*.txt"))
        )


def no_image(channel: str, index: int) -> np.ndarray:
    raise AssertionError


@pytest.fixture
def registered(monkeypatch):
    """Registry with `PlainTimes`, until the end of the test."""
    monkeypatch.setattr(FORMATS, "_added", {})
    FORMATS.register(PlainTimes)


@pytest.mark.usefixtures("registered")
def test_a_registered_format_is_exported_by_command_and_read_as_a_source(pinhole_episode, tmp_path):
    out = tmp_path / "times"
    main(["export", "plain-times", pinhole_episode.url, "--out", str(out), "--unit", "0.5"])
    (found,) = read_sources([f"plain-times:{out}"])
    times = pinhole_episode.sequence("front").times
    np.testing.assert_allclose(found.times, times / 0.5)


@pytest.mark.usefixtures("registered")
def test_help_lists_a_registered_format_and_its_options(capsys):
    with pytest.raises(SystemExit):
        main(["export", "--help"])
    shown = capsys.readouterr().out
    assert "plain-times" in shown
    assert "Times of frames, one file" in shown
    with pytest.raises(SystemExit):
        main(["export", "plain-times", "--help"])
    assert "--unit" in capsys.readouterr().out


def test_an_unknown_format_is_refused():
    with pytest.raises(UnknownNameError, match="plain-times"):
        FORMATS["plain-times"]


def test_a_registered_format_cannot_replace_a_built_in_one():
    class Tum(PlainTimes):
        kind = "tum"

    with pytest.raises(InputError, match="exists already"):
        FORMATS.register(Tum)


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="no pipes in folders")
def test_a_pipe_instead_of_a_file_does_not_stop_the_reader(tmp_path):
    (tmp_path / "a").mkdir()
    for name in (f"a/{EPISODE_JSON}", PLAN):
        os.mkfifo(tmp_path / name)
        with pytest.raises(InputError, match="is a pipe, socket or device"):
            read_sources([str(tmp_path)])


def test_a_folder_of_episodes_is_a_source(pinhole_episode, tmp_path):
    """Their contact sheets are not images of the source."""
    for name in ("b", "a"):
        shutil.copytree(pinhole_episode.path, tmp_path / name)
        (tmp_path / name / "sheet.png").write_bytes(b"no image")
    shown: list[tuple[int, int]] = []
    first, second = read_sources([str(tmp_path)], lambda *counts: shown.append(counts))
    assert shown == [(1, 2), (2, 2)]
    assert len(first) == len(second) == len(pinhole_episode)
    assert np.array_equal(first.image("rgb", 0), pinhole_episode.image("front", "rgb", 0))


def test_a_folder_without_images_is_named_as_such(tmp_path: Path) -> None:
    (tmp_path / "empty").mkdir()
    with pytest.raises(InputError, match=r"empty contains no images, episodes or data set\. Allo"):
        read_sources([str(tmp_path / "empty")])
