"""Bubbles sit on the round ends of the capsule as many as the severity says."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest

from tests.support.tubes import straight_gut
from vrcaps.capsule.device_file import read_device
from vrcaps.core.errors import InputError
from vrcaps.core.transforms import rotation_from_vector, transform_from
from vrcaps.core.units import MM
from vrcaps.lumen.contents import BUBBLE_SEVERITIES, Bubbles, Contents
from vrcaps.lumen.placement import dome_sites
from vrcaps.organ.surface import OrganSurface
from vrcaps.world.model import Model


@pytest.fixture(scope="module")
def gut() -> OrganSurface:
    return straight_gut({"bowel": 0.1}, radius=15.0 * MM)


@pytest.mark.parametrize("severity", [0, 1, 2, 3, 4])
def test_as_many_as_the_grade_says_ride_exactly(gut: OrganSurface, severity: int) -> None:
    device = read_device("mirocam")
    model = Model(gut, device, contents=Contents(bubbles=severity, chyme=1, seed=3))
    lumen_contents, count = model.lumen_contents, BUBBLE_SEVERITIES[severity].on_dome
    assert lumen_contents is not None and len(lumen_contents.dome_sites) == 2 * count
    radius = lumen_contents.spheres.radius[len(lumen_contents.spheres) - 2 * count :]
    half = device.length / 2.0 - device.radius
    ahead = lumen_contents.dome_sites[:, 2] > 0.0
    assert ahead.sum() == count
    offset = lumen_contents.dome_sites - np.where(ahead, half, -half)[:, None] * [0.0, 0.0, 1.0]
    np.testing.assert_allclose(np.linalg.norm(offset, axis=1), device.radius + radius, rtol=1e-12)
    assert (np.abs(offset[:, 2]) > 0.3 * device.radius).all()
    T = transform_from(rotation_from_vector(np.array([0.3, -0.2, 0.5])), np.array([0.05, 0, 0]))
    seen = lumen_contents.around_capsule(T, device.length, device.radius).spheres
    assert seen.radius is lumen_contents.spheres.radius
    local = (seen.centers[len(seen) - 2 * count :] - T[:3, 3]) @ T[:3, :3]
    np.testing.assert_allclose(local, lumen_contents.dome_sites, atol=1e-15)
    again = Model(gut, device, contents=Contents(bubbles=severity, chyme=1, seed=3)).lumen_contents
    assert again is not None and again.dome_sites.tobytes() == lumen_contents.dome_sites.tobytes()


def test_higher_grades_have_more() -> None:
    assert BUBBLE_SEVERITIES[0].on_dome == 0
    assert all(a.on_dome < b.on_dome for a, b in pairwise(BUBBLE_SEVERITIES))
    assert not Contents(bubbles=Bubbles(per_area=0.0, on_dome=1)).is_empty


def test_few_do_not_overlap(rng: np.random.Generator) -> None:
    radius = np.full(8, 0.6 * MM)
    places = dome_sites(radius, 24.0 * MM, 5.5 * MM, rng)
    apart = np.linalg.norm(places[:, None] - places, axis=-1)[np.triu_indices(8, 1)]
    assert apart.min() > 1.2 * MM


@pytest.mark.parametrize(
    ("name", "value"), [("on_dome", -1), ("landing_rate", -1.0), ("release_rate", np.inf)]
)
def test_rejects_bad_figures(name: str, value: float) -> None:
    with pytest.raises(InputError, match=f"Bubbles' {name}"):
        replace(Bubbles(), **{name: value})
