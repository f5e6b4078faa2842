"""Random streams: repeatable, each purpose its own, independent of each other."""

from __future__ import annotations

import ast
from collections import Counter
from functools import cache
from pathlib import Path

import numpy as np
import pytest

import vrcaps
from vrcaps.core.rng import stream

SOURCES = sorted(Path(vrcaps.__file__).parent.rglob("*.py"))


@cache
def purposes() -> tuple[str, ...]:
    """Purposes of all calls of `stream` in the package; fails where one cannot be read off."""
    found = []
    texts = [(path, path.read_text()) for path in SOURCES]
    for path, text in texts:
        for node in ast.walk(ast.parse(text if "stream" in text else "")):
            if isinstance(node, ast.Call) and ast.unparse(node.func).endswith("rng.stream"):
                purpose = node.args[1]
                if isinstance(purpose, ast.JoinedStr):  # a family: its members follow a slash
                    purpose = purpose.values[0]
                    assert ast.unparse(purpose).endswith("/'"), ast.unparse(node)
                assert isinstance(purpose, ast.Constant), f"{path.name}: {ast.unparse(node)}"
                found.append(str(purpose.value))
    return tuple(found)


@pytest.mark.slow
def test_each_purpose_is_drawn_for_in_one_place() -> None:
    counts = Counter(purposes())
    assert len(counts) > 20
    assert {name: count for name, count in counts.items() if count > 1} == {}


@pytest.mark.slow
def test_no_two_purposes_share_a_stream() -> None:
    """64 random bits each: by chance two are alike once in 10¹⁶ times."""
    first = [int(stream(3, name).integers(2**63)) for name in purposes()]
    assert len(set(first)) == len(first)


def test_seeds_become_generators_in_one_place() -> None:
    others = [path for path in SOURCES if path.name != "rng.py"]
    assert [path.name for path in others if "default_rng(" in path.read_text()] == []


def test_same_arguments_same_numbers() -> None:
    np.testing.assert_array_equal(stream(7, "a", 2).random(9), stream(7, "a", 2).random(9))
    assert stream(0, "colon").integers(2**32) == 1616628295


def test_seed_purpose_and_index_all_count() -> None:
    keys = [(7, "a"), (8, "a"), (7, "b"), (7, "a", 0), (7, "a", 1), (7, "a", 1, 0)]
    first = {int(stream(*key).integers(2**63)) for key in keys}
    assert len(first) == len(keys)


@pytest.mark.parametrize("other", ["fly-through", "tissue/muscle", "colon/dimensions"])
def test_course_of_a_colon_and_other_draws_are_independent(other: str) -> None:
    """Correlation of 10,000 pairs: 0 ± 0.01, so within 0.05 but for once in a million times."""
    pairs = np.array(
        [
            np.concatenate([stream(seed, name).normal(size=10) for seed in range(1000)])
            for name in ("colon", other)
        ]
    )
    assert abs(np.corrcoef(pairs)[0, 1]) < 0.05
