"""Residue in colons of each Boston score."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest

from vrcaps.core.errors import InputError
from vrcaps.lumen.preparation import PREPARATIONS, prepared


def test_the_better_the_score_the_less_is_left():
    for worse, better in pairwise(PREPARATIONS):
        for kind, other in zip(worse.resolved, better.resolved, strict=True):
            amount = "fill" if hasattr(kind, "fill") else "per_area"
            assert getattr(kind, amount) > getattr(other, amount) > 0.0


def test_stool_hides_of_the_wall_what_the_scale_says():
    """Shadows of the particles, none behind another, as a share of the wall: E[π r²] per area."""
    hidden = []
    for score in range(4):
        stool = prepared(score).resolved[1]
        square = stool.radius**2 * np.exp(2.0 * stool.spread**2)
        hidden.append(np.pi * square * stool.per_area)
    unprepared, parts, fragments, clean = hidden
    assert unprepared > 0.8
    assert 0.1 < parts < 0.5
    assert 0.001 < fragments < 0.03
    assert clean < 0.001


@pytest.mark.parametrize("score", [-1, 4])
def test_there_is_no_such_score(score):
    with pytest.raises(InputError, match=f"Preparation is {score}"):
        prepared(score)
