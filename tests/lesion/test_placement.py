import re
from dataclasses import replace

import numpy as np
import pytest

from vrcaps.core.errors import InputError, UnknownNameError
from vrcaps.core.geometry import wall_of
from vrcaps.core.units import MM
from vrcaps.lesion import (
    Bleeding,
    Diverticulum,
    Location,
    Polyp,
    Stricture,
    Tumor,
    Ulcer,
    add_lesions,
)
from vrcaps.lesion.placement import require_locations, require_possible


def add(tube, *lesions):
    bare = replace(tube, appearance=None)
    return add_lesions(bare, lesions, np.random.default_rng(0)).organ


@pytest.mark.slow
def test_stated_place(tube):
    organ = add(tube, Polyp(size=3 * MM, location=Location(arc_length=50 * MM, theta=-2.0)))
    record = organ.metadata["lesions"][0]
    assert record["arc_length_m"] == pytest.approx(50 * MM, abs=1 * MM)
    assert record["theta_rad"] == pytest.approx(-2.0, abs=0.06)


@pytest.mark.slow
@pytest.mark.parametrize("segment", ["upper", "lower"])
def test_stated_segment(tube, segment):
    lesion = Polyp(size=4 * MM, location=Location(segment=segment))
    assert add(tube, lesion).metadata["lesions"][0]["segment"] == segment


@pytest.mark.parametrize(
    ("lesion", "match"),
    [
        (
            Tumor(size=50 * MM, location=Location(arc_length=80 * MM, theta=0.0)),
            "larger than the lumen",
        ),
        (Polyp(shape="Ip", size=28 * MM, location=Location(arc_length=80 * MM)), "mm are free"),
        (Ulcer(size=20 * MM, location=Location(arc_length=4 * MM)), "beyond the organ's end"),
        (Polyp(location=Location(arc_length=0.5)), "Allowed: 0.0 to 16.0 cm"),
        (Polyp(location=Location(segment="lower", arc_length=20 * MM)), "is not in lower"),
        (Stricture(location=Location(arc_length=4 * MM)), "beyond the organ's end"),
        (Diverticulum(size=15 * MM, location=Location(arc_length=80 * MM)), "the wall is folded"),
        (Bleeding(severity=3, location=Location(arc_length=9.0)), "is not in tube"),
    ],
)
def test_what_does_not_fit(tube, lesion, match):
    with pytest.raises(InputError, match=match):
        add(tube, lesion)


@pytest.mark.slow
def test_overlap(tube):
    location = Location(arc_length=80 * MM, theta=0.0)
    with pytest.raises(InputError, match="overlaps lesion 1, polyp Is of 8 mm"):
        add(tube, Polyp(location=location), Polyp(location=location))


def test_unknown_segment(tube):
    with pytest.raises(UnknownNameError, match=r"No segment named 'sigmoid'\. Known: lower"):
        add(tube, Polyp(location=Location(segment="sigmoid")))


@pytest.mark.parametrize("arc_length", [80 * MM, None])
def test_the_largest_size_that_fits_is_stated_and_fits(tube, arc_length):
    """In steps of 0.5 mm: the size stated is placed there, the next one is not."""
    location = Location(arc_length=arc_length, theta=None if arc_length is None else 0.5)
    lesion = Polyp(shape="Ip", size=30 * MM, location=location)
    with pytest.raises(InputError, match="Largest size that fits there: ") as error:
        add(tube, lesion)
    size = float(re.search(r"fits there: ([0-9.]+) mm\.$", str(error.value))[1]) * MM
    wall = wall_of(tube.vertices, tube.faces)
    fits, does_not = (replace(lesion, size=size + more) for more in (0.0, 0.5 * MM))
    require_locations(tube, wall, [fits], [np.random.default_rng(0)])
    if arc_length is not None:
        with pytest.raises(InputError, match="No location for polyp Ip"):
            require_locations(tube, wall, [does_not], [np.random.default_rng(0)])


def test_no_size_is_stated_where_none_fits_or_lesions_have_none(tube):
    location = Location(arc_length=0.5 * MM, theta=0.0)
    for lesion in (Polyp(location=location), Ulcer(size=20 * MM, location=location)):
        with pytest.raises(InputError, match=r"\(length 16\.0 cm\)\.$"):
            add(tube, lesion)


def test_all_focal_lesions_are_checked_before_any_work(tube, monkeypatch):
    monkeypatch.setattr("vrcaps.lesion.add._Work", lambda *args: pytest.fail("work"))
    with pytest.raises(InputError, match="No location for tumor"):
        add(tube, Stricture(), Polyp(size=4 * MM), Tumor(size=50 * MM))


def test_lesions_larger_than_a_lumen_are_refused_before_it_is_made():
    """In a lumen of 20 mm, 30 mm where it bulges, a tumor spans up to 1.3 radii of the wall."""
    require_possible([Tumor(size=39 * MM), Stricture(), Polyp(size=8 * MM)], 20 * MM)
    require_possible([Diverticulum(size=15 * MM)], 15 * MM)  # out of the lumen
    with pytest.raises(
        InputError,
        match=r"tumor.* of 45 mm: it is 45\.0 mm wide and 18\.0 mm high, but the lumen is 20\.0 mm "
        r"wide at most\. Largest size that may fit: 39\.0 mm\.$",
    ):
        require_possible([Tumor(size=45 * MM)], 20 * MM)
    with pytest.raises(InputError, match=r"the lumen is 0\.5 mm wide at most\.$"):
        require_possible([Polyp(size=8 * MM)], 0.5 * MM)
