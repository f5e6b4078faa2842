"""Placement of bubbles and chyme on the wall and on the capsule's dome."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest

from tests.support.tubes import straight_gut
from vrcaps import _core
from vrcaps.capsule.device_file import read_device
from vrcaps.core.errors import InputError
from vrcaps.core.geometry import rotation_from_vector, transform_from
from vrcaps.core.units import MM
from vrcaps.lumen.contents import (
    BUBBLE_SEVERITIES,
    CHYME_SEVERITIES,
    CM2,
    LIQUID_SEVERITIES,
    Bubbles,
    Chyme,
    Contents,
    Liquid,
)
from vrcaps.lumen.lumen_contents import dome_sites, populate
from vrcaps.lumen.particles import BUBBLE, FIRST_CLUMP, WHITE, Spheres
from vrcaps.lumen.placement import (
    lifts,
    pack,
    place_bubbles,
    place_chyme,
    sizes,
    smooth_area,
)
from vrcaps.organ.surface import OrganSurface
from vrcaps.world.model import Model

RADIUS, LENGTH = 11.0 * MM, 0.3
AREA = 2.0 * np.pi * RADIUS * LENGTH
UP = np.array([0.0, 0.0, 1.0])


@pytest.fixture(scope="module")
def gut() -> OrganSurface:
    return straight_gut({"bowel": LENGTH}, radius=RADIUS)


@pytest.fixture(scope="module")
def wall(gut: OrganSurface) -> _core.Wall:
    return _core.Wall(gut.vertices, gut.faces.astype(np.int64))


def test_the_smooth_area_of_a_cylinder(gut: OrganSurface) -> None:
    edges, area = smooth_area(gut)
    np.testing.assert_allclose(area, 2.0 * np.pi * RADIUS * edges, rtol=1e-2, atol=1e-6)


@pytest.mark.parametrize("severity", [1, 2, 3, 4])
def test_counts_follow_the_table(gut: OrganSurface, wall: _core.Wall, severity: int) -> None:
    """Poisson counts: within 4 standard deviations of the table's density times the area."""
    for kind, place in (
        (BUBBLE_SEVERITIES[severity], place_bubbles),
        (CHYME_SEVERITIES[severity], place_chyme),
    ):
        expected = kind.per_area * AREA
        count = len(place(gut, wall, kind, UP, np.random.default_rng(severity)))
        assert abs(count - expected) < 4.0 * np.sqrt(expected)


@pytest.mark.parametrize("severities", [BUBBLE_SEVERITIES, CHYME_SEVERITIES])
def test_grades_rise(severities: tuple[Bubbles, ...] | tuple[Chyme, ...]) -> None:
    assert len(severities) == 5 and severities[0].per_area == 0.0
    assert all(a.per_area < b.per_area for a, b in pairwise(severities))
    fills = [liquid.fill for liquid in LIQUID_SEVERITIES]
    assert fills[0] == 0.0 and fills == sorted(set(fills))


def test_radii_are_log_normal(gut: OrganSurface, wall: _core.Wall) -> None:
    kind = Bubbles(per_area=40e4, raft_size=3.0, radius=0.5 * MM, spread=0.4, largest=3.0 * MM)
    radius = place_bubbles(gut, wall, kind, UP, np.random.default_rng(1)).radius
    count = len(radius)
    logarithm = np.log(radius / kind.radius)
    assert abs(logarithm.mean()) < 4.0 * kind.spread / np.sqrt(count) + 0.01
    assert abs(logarithm.std() / kind.spread - 1.0) < 4.0 / np.sqrt(2.0 * count) + 0.02
    assert radius.min() >= kind.smallest and radius.max() <= kind.largest


def test_all_lie_in_the_lumen(gut: OrganSurface, wall: _core.Wall) -> None:
    bubbles = place_bubbles(gut, wall, BUBBLE_SEVERITIES[3], UP, np.random.default_rng(2))
    chyme = place_chyme(gut, wall, CHYME_SEVERITIES[3], UP, np.random.default_rng(2))
    for spheres in (bubbles, chyme):
        assert (wall.signed_distance(spheres.centers) > 0.0).all()
    # All but those in the sharp corners of the ends lie at their height over the wall.
    height = wall.signed_distance(bubbles.centers)
    lift = lifts(BUBBLE_SEVERITIES[3], bubbles.radius)
    assert (np.abs(height - lift) < 0.15 * bubbles.radius).mean() > 0.99
    small, large = lift / bubbles.radius, bubbles.radius > 1.0 * MM
    assert small.max() < 0.851 and (small[large] < 0.55).all() and large.any()


def test_bubbles_gather_above_and_chyme_below(gut: OrganSurface, wall: _core.Wall) -> None:
    rising, settled = Bubbles(rising=1.0, raft_size=1.0), Chyme(settled=1.0, clump_size=1.0)
    above = place_bubbles(gut, wall, rising, UP, np.random.default_rng(3)).centers[:, 2]
    below = place_chyme(gut, wall, settled, UP, np.random.default_rng(3)).centers[:, 2]
    assert above.mean() > 0.4 * RADIUS and below.mean() < -0.4 * RADIUS


def test_instances_and_kinds(gut: OrganSurface) -> None:
    spheres = populate(gut, Contents(bubbles=2, chyme=3), np.eye(4)).spheres
    bubbles = spheres.kind == BUBBLE
    assert (spheres.instance[bubbles] == 1 + np.arange(bubbles.sum())).all()
    clumps = spheres.instance[~bubbles]
    assert clumps.min() == FIRST_CLUMP and (np.diff(clumps.astype(int)) <= 1).all()
    for clump in np.unique(clumps)[:50]:
        assert len(np.unique(spheres.kind[spheres.instance == clump])) == 1
    share = (spheres.kind[~bubbles] == WHITE).mean()
    assert 0.1 < share < 0.6


def test_the_same_seed_gives_the_same_bytes(gut: OrganSurface) -> None:
    one, two, other = (
        populate(gut, Contents(2, 2, seed=seed), np.eye(4)).spheres for seed in (4, 4, 5)
    )
    for name in vars(one):
        assert getattr(one, name).tobytes() == getattr(two, name).tobytes()
    assert one.centers.tobytes() != other.centers.tobytes()


def test_clusters_touch_and_do_not_overlap(rng: np.random.Generator) -> None:
    number = np.array([1, 5, 12])
    radius = rng.uniform(0.3, 1.0, 18) * MM
    place = pack(number, radius, rng, dimensions=2, touch=1.0)
    assert (place[:, 2] == 0.0).all()
    for first, last in ((1, 6), (6, 18)):
        p, r = place[first:last], radius[first:last]
        gap = np.linalg.norm(p[:, None] - p[None], axis=-1) - (r[:, None] + r[None])
        np.fill_diagonal(gap, np.inf)
        assert gap.min() > -0.03 * r.max()
        assert (np.abs(gap).min(axis=1) < 1e-9).all()


def test_stretched_clusters_are_long(rng: np.random.Generator) -> None:
    """The second moments of rafts of equal bubbles, along and across."""
    number, radius = np.full(40, 30), np.full(1200, 0.3 * MM)
    for stretch, low, high in ((1.0, 0.8, 1.25), (5.0, 2.5, 6.0)):
        place = pack(number, radius, rng, dimensions=2, touch=0.88, stretch=np.full(40, stretch))
        width, length = np.sqrt((place[:, :2] ** 2).mean(axis=0))
        assert low < length / width < high


def test_large_bubbles_are_in_rafts(gut: OrganSurface, wall: _core.Wall) -> None:
    kind = Bubbles(per_area=20.0 / CM2, raft_size=8.0, radius=0.5 * MM, largest=2.0 * MM)
    spheres = place_bubbles(gut, wall, kind, UP, np.random.default_rng(4))
    raft, count = np.unique(spheres.arc_length, return_counts=True)
    members = count[np.searchsorted(raft, spheres.arc_length)]
    largest = [spheres.radius[members == n].max() for n in (1, 2, 4)]
    assert spheres.radius[members >= 16].max() == pytest.approx(2.0 * MM)
    for n, most in zip((1, 2, 4), largest, strict=True):
        assert most <= 2.0 * MM * np.sqrt(n / 16.0) * (1.0 + 1e-9)


def test_sizes_of_clusters(rng: np.random.Generator) -> None:
    drawn = sizes(30_000, 6.0, rng)
    assert drawn.sum() == 30_000 and drawn.min() >= 1 and drawn.max() <= 24
    assert abs(drawn.mean() / 6.0 - 1.0) < 0.1
    assert len(sizes(0, 6.0, rng)) == 0


def test_contents_take_grades_or_figures() -> None:
    own = Bubbles(per_area=3.0)
    assert Contents(bubbles=own).resolved == (own, CHYME_SEVERITIES[0], LIQUID_SEVERITIES[0])
    assert Contents().is_empty and not Contents(liquid=1).is_empty


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: Contents(bubbles=5), "Contents' bubbles is 5. Allowed: a severity, 0 to 4"),
        (lambda: Contents(liquid=-1), "Contents' liquid is -1. Allowed: a severity"),
        (lambda: Contents(seed=-1), "Contents' seed is -1"),
        (lambda: Contents(drift=1.0), "Contents' drift is 1.0"),
        (lambda: Contents(reach=-1.0), "Contents' reach is -1.0"),
        (lambda: Bubbles(per_area=-1.0), "Bubbles' per_area is -1.0. Allowed: 0 or more"),
        (lambda: Bubbles(rising=2.0), "Bubbles' rising is 2.0. Allowed: 0 to 1"),
        (lambda: Bubbles(raft_size=0.5), "Bubbles' raft_size is 0.5"),
        (lambda: Bubbles(ior=0.9), "Bubbles' ior is 0.9"),
        (lambda: Bubbles(border=0.0), "Bubbles' border is 0.0"),
        (lambda: Bubbles(roughness=0.0), "Bubbles' roughness is 0.0"),
        (lambda: Bubbles(smallest=2.0 * MM), "Bubbles' smallest, radius, largest"),
        (
            lambda: Bubbles(stain=(np.nan, 0.0, 0.0)),
            "Bubbles' stain is .*: 3 numbers, 0 or more",
        ),
        (
            lambda: Bubbles(stain=(-5.0, 0.0, 0.0)),
            "Bubbles' stain is .*: 3 numbers, 0 or more",
        ),
        (
            lambda: Bubbles(stain=(np.inf, 0.0, 0.0)),
            "Bubbles' stain is .*: 3 numbers, 0 or more",
        ),
        (lambda: Bubbles(stain=(0.1, 0.1)), "Bubbles' stain is .*Allowed: 3 numbers"),
        (lambda: Bubbles(color=(-1.0, 0.0, 0.0)), "Bubbles' color is .*: 3 numbers, 0 to 1"),
        (lambda: Bubbles(color=(0.5, 0.5, 1.5)), "Bubbles' color is .*: 3 numbers, 0 to 1"),
        (
            lambda: Chyme(white_color=(np.nan, 0.0, 0.0)),
            "Chyme's white_color is .*: 3 numbers, 0 to 1",
        ),
        (lambda: Chyme(per_area=np.nan), "Chyme's per_area is nan"),
        (lambda: Chyme(white=-0.1), "Chyme's white is -0.1"),
        (lambda: Chyme(clump_size=0.0), "Chyme's clump_size is 0.0"),
        (lambda: Chyme(density=0.0), "Chyme's density is 0.0"),
        (lambda: Chyme(radius=9.0), "Chyme's smallest, radius, largest"),
        (lambda: Liquid(fill=1.0), "Liquid's fill is 1.0. Allowed: 0 to below 1"),
        (lambda: Liquid(viscosity=0.0), "Liquid's viscosity is 0.0"),
        (lambda: Liquid(ior=1.0), "Liquid's ior is 1.0"),
        (lambda: Liquid(absorption=(-1.0, 0.0, 0.0)), "Liquid's absorption"),
        (lambda: Liquid(roughness=2.0), "Liquid's roughness is 2.0"),
    ],
)
def test_refuses_what_cannot_be(make: object, message: str) -> None:
    with pytest.raises(InputError, match=message):
        make()  # type: ignore[operator]


def test_an_empty_kind_places_nothing(gut: OrganSurface, wall: _core.Wall) -> None:
    rng = np.random.default_rng(0)
    none = place_bubbles(gut, wall, replace(Bubbles(), per_area=0.0), UP, rng)
    assert isinstance(none, Spheres) and len(none) == 0
    assert (populate(gut, Contents(1, 0), np.eye(4)).spheres.kind == BUBBLE).all()


@pytest.mark.parametrize("kind", [Bubbles(per_area=1e30), Chyme(per_area=1e12)])
def test_more_than_memory_holds_is_one_line(
    gut: OrganSurface, wall: _core.Wall, kind: Bubbles | Chyme
) -> None:
    place = place_bubbles if isinstance(kind, Bubbles) else place_chyme
    with pytest.raises(InputError, match=r"number of .*Allowed: up to 10,000,000\. Give"):
        place(gut, wall, kind, UP, np.random.default_rng(0))  # type: ignore[arg-type]


@pytest.fixture(scope="module")
def short_gut() -> OrganSurface:
    return straight_gut({"bowel": 0.1}, radius=15.0 * MM)


@pytest.mark.parametrize("severity", [0, 1, 2, 3, 4])
def test_as_many_as_the_grade_says_ride_exactly(short_gut: OrganSurface, severity: int) -> None:
    device = read_device("mirocam")
    model = Model(short_gut, device, contents=Contents(bubbles=severity, chyme=1, seed=3))
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
    again = Model(
        short_gut, device, contents=Contents(bubbles=severity, chyme=1, seed=3)
    ).lumen_contents
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
