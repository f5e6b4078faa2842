"""A colon's segments follow the course of its centerline."""

from dataclasses import replace

import numpy as np
import pytest

from vrcaps.anatomy.catalog import generate_organ
from vrcaps.anatomy.colon.parameters import SEGMENTS
from vrcaps.tools.ct.segments import colon_borders, colon_labels, runs_upwards


@pytest.mark.slow
def test_a_generated_colon_is_divided_much_as_it_was_made() -> None:
    """Borders within 5 % of the length; flexures, which have landmarks, within 3 %.

    This colon's transverse part rises as high as its hepatic flexure.
    """
    organ = generate_organ("colon", seed=0)
    length = organ.centerline.length
    true = [organ.arc_length[organ.label == n + 1].max() for n in range(len(SEGMENTS) - 1)]
    away = np.abs(colon_borders(organ.centerline) - true) / length
    assert away.max() < 0.05
    assert away[1:5].max() < 0.03
    label, names = colon_labels(organ.centerline, organ.arc_length)
    assert names == ("background", *SEGMENTS)
    assert set(label) == set(range(1, 9))
    assert np.mean(label == organ.label) > 0.9


def test_the_rectum_is_the_lower_end() -> None:
    centerline = generate_organ("colon", seed=0).centerline
    assert not runs_upwards(centerline)
    assert runs_upwards(replace(centerline, points=centerline.points[::-1]))
