"""A colon's segments follow the course of its centerline."""

from dataclasses import replace

import numpy as np
import pytest

from vrcaps.anatomy.colon import generate_colon
from vrcaps.anatomy.colon.parameters import SEGMENTS
from vrcaps.anatomy.full_tract.patient import draw_patient_anatomy
from vrcaps.organ.surface import OrganSurface
from vrcaps.tools.ct.segments import colon_borders, colon_labels, runs_upwards


@pytest.fixture(scope="module")
def organ() -> OrganSurface:
    """The colon of patient 0, without its mucosa."""
    return generate_colon(draw_patient_anatomy(0).colon, seed=0)


@pytest.mark.slow
def test_a_generated_colon_is_divided_much_as_it_was_made(organ: OrganSurface) -> None:
    """Borders within 5 % of the length; flexures, which have landmarks, within 3 %.

    This colon's transverse part rises as high as its hepatic flexure.
    """
    length = organ.centerline.length
    true = [organ.arc_length[organ.label == n + 1].max() for n in range(len(SEGMENTS) - 1)]
    away = np.abs(colon_borders(organ.centerline) - true) / length
    assert away.max() < 0.05
    assert away[1:5].max() < 0.03
    label, names = colon_labels(organ.centerline, organ.arc_length)
    assert names == ("background", *SEGMENTS)
    assert set(label) == set(range(1, 9))
    assert np.mean(label == organ.label) > 0.9


@pytest.mark.slow
def test_the_rectum_is_the_lower_end(organ: OrganSurface) -> None:
    centerline = organ.centerline
    assert not runs_upwards(centerline)
    assert runs_upwards(replace(centerline, points=centerline.points[::-1]))
