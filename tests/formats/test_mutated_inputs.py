"""Readers fed with mutated files (`benchmarks/validation/fuzz_readers.py`)."""

from pathlib import Path

import numpy as np
import pytest

from tests.support.mutations import json_text, mutated
from tests.support.reader_fuzz import InvalidError, Target, fuzz, outcome_of
from tests.support.reader_targets import all_targets, check_poses
from vrcaps.core.errors import InputError

INPUTS = 500


@pytest.fixture(scope="module")
def targets(tmp_path_factory, pinhole_episode) -> list[Target]:
    return all_targets(tmp_path_factory.mktemp("fuzz"), pinhole_episode)


@pytest.mark.slow
def test_whole_inputs_are_read(targets):
    assert len(targets) >= 31
    for target in targets:
        target.read(target.folder)


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore:.*the last line is truncated:UserWarning")
def test_mutated_inputs_are_read_or_refused_in_one_line(targets):
    failures = []
    for k, target in enumerate(targets):
        count = INPUTS // len(targets) + (k < INPUTS % len(targets))
        failures += fuzz(target, seed=7, count=count).failures
    assert not failures


class PanicException(BaseException):
    """Exception with the name of the core's panics."""


@pytest.mark.parametrize(
    ("error", "outcome"),
    [
        (InputError("one line"), "refused"),
        (InvalidError("a NaN"), "invalid"),
        (ZeroDivisionError(), "traceback"),
        (PanicException("index out of bounds"), "panic"),
    ],
)
def test_outcomes_are_told(tmp_path, error, outcome):
    def read(folder: Path) -> None:
        raise error

    assert outcome_of(Target("reader", tmp_path, read))[0] == outcome


def test_an_input_that_takes_too_long_is_a_hang(tmp_path, monkeypatch):
    monkeypatch.setattr("tests.support.reader_fuzz.SECONDS", 0.05)

    def read(folder: Path) -> None:
        while True:
            pass

    assert outcome_of(Target("reader", tmp_path, read))[0] == "hang"


def test_files_are_put_back_and_seeds_repeat(tmp_path):
    path = tmp_path / "a.json"
    path.write_text('{"a": [1, 2]}')
    seen = []
    target = Target("reader", tmp_path, lambda folder: seen.append(path.read_bytes()))
    for _ in range(2):
        assert fuzz(target, seed=3, count=20).counts["read"] == 20
    assert seen[:20] == seen[20:]
    assert len(set(seen)) > 10
    assert path.read_text() == '{"a": [1, 2]}'


@pytest.mark.parametrize("suffix", [".json", ".png", ".txt", ".safetensors", ".npy", ".bin"])
def test_any_bytes_can_be_mutated(suffix):
    rng = np.random.default_rng(0)
    for data in (b"", b"x", b"\x89PNG\r\n\x1a\n" + bytes(40), bytes(range(256)) * 4):
        for _ in range(30):
            assert isinstance(mutated(rng, data, suffix), bytes)
    assert "[[[[" in json_text(["@deep@"])


def test_poses_that_are_not_rigid_are_found():
    check_poses(np.eye(4)[None])
    for factor in (1.01, np.nan, -1.0):
        with pytest.raises(InvalidError):
            check_poses(factor * np.eye(4)[None])
