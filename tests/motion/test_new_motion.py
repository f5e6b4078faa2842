"""The motion that docs/how-to/extending.md adds, run as it stands there."""

import re
from pathlib import Path

import numpy as np
import pytest

from vrcaps.recording.table import make_table

PAGE = Path(__file__).parents[2] / "docs" / "how-to" / "extending.md"


@pytest.fixture
def names(model):
    """Names that the section defines, given a model."""
    text = PAGE.read_text(encoding="utf-8")
    section = re.search(r"^## A motion\n(.*?)(?=^## |\Z)", text, re.DOTALL | re.MULTILINE)
    assert section is not None
    names = {"model": model, "__name__": __name__}
    for code in re.findall(r"```python\n(.*?)```", section[1], re.DOTALL):
        exec(code, names)
    return names


def test_it_rolls_in_its_place(names):
    steps = list(names["motion"].steps())
    assert [step.index for step in steps] == [0, 1, 2, 3, 4]
    assert steps[0].previous is None
    assert steps[2].next is steps[3].state
    axis = steps[0].state.T_world_capsule[:3, 2]
    for step in steps:
        np.testing.assert_allclose(step.state.T_world_capsule[:3, 2], axis, atol=1e-12)
        np.testing.assert_allclose(step.state.angular_velocity_world, axis, atol=1e-9)


def test_its_table_is_made_like_any_other(names):
    table = make_table(names["model"], names["motion"])
    assert len(table) == 5
    np.testing.assert_allclose(table.columns["arc_length_m"], 0.03, rtol=0.02)
