"""Placement that differs along the gut, between folds, with the wall, and with travel."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from tests.support.tubes import straight_gut
from vrcaps import _core
from vrcaps.capsule.device_file import read_device
from vrcaps.core.geometry import transform_from
from vrcaps.core.units import MM
from vrcaps.lumen.contents import CM2, Bubbles, Chyme, Contents
from vrcaps.lumen.placement import place_bubbles, place_chyme
from vrcaps.organ.surface import OrganSurface
from vrcaps.world.model import Model, State

UP = np.array([0.0, 0.0, 1.0])
RADIUS = 11.0 * MM


@pytest.fixture(scope="module")
def long_gut() -> OrganSurface:
    return straight_gut({"bowel": 4.0}, radius=RADIUS, edge=4.0 * MM)


@pytest.mark.parametrize(
    ("kind", "place"), [(Bubbles(4.0 / CM2), place_bubbles), (Chyme(4.0 / CM2), place_chyme)]
)
def test_a_fraction_of_the_gut_has_contents(long_gut: OrganSurface, kind, place) -> None:
    wall = _core.Wall(long_gut.vertices, long_gut.faces.astype(np.int64))
    patchy = replace(kind, prevalence=0.3)
    seen = place(long_gut, wall, patchy, UP, np.random.default_rng(1))
    everywhere = place(long_gut, wall, kind, UP, np.random.default_rng(1))
    bins = np.linspace(0.0, 4.0, 201)
    share = [
        (np.histogram(spheres.arc_length, bins)[0] > 0).mean() for spheres in (seen, everywhere)
    ]
    assert share[0] == pytest.approx(0.3, abs=0.12)
    assert share[1] > 0.9
    assert (
        len(place(long_gut, wall, replace(kind, prevalence=0.0), UP, np.random.default_rng(1))) == 0
    )


def test_rafts_lie_in_creases() -> None:
    """On a corrugated tube, rafts gather where it is wide; evenly placed chyme does not."""
    gut = straight_gut({"bowel": 0.3}, radius=RADIUS, edge=1.0 * MM)
    deep = 1.0 + 0.2 * np.cos(2.0 * np.pi * gut.arc_length / (6.0 * MM))
    off_axis = gut.vertices * (0.0, 1.0, 1.0)
    gut = replace(gut, vertices=gut.vertices * (1.0, 0.0, 0.0) + deep[:, None] * off_axis)
    wall = _core.Wall(gut.vertices, gut.faces.astype(np.int64))
    bubbles = Bubbles(10.0 / CM2, raft_size=1.0, radius=0.1 * MM, spread=0.0, rising=0.0)
    chyme = Chyme(10.0 / CM2, clump_size=1.0, radius=0.1 * MM, spread=0.0, settled=0.0)
    spheres = place_bubbles(gut, wall, bubbles, UP, np.random.default_rng(3))
    others = place_chyme(gut, wall, chyme, UP, np.random.default_rng(3))
    depth, even = (
        np.hypot(each.centers[:, 1], each.centers[:, 2]).mean() / RADIUS
        for each in (spheres, others)
    )
    assert even == pytest.approx(1.0, abs=0.05)
    assert depth > 1.08


def test_contents_move_with_the_wall() -> None:
    gut = straight_gut({"bowel": 0.3}, radius=RADIUS)
    model = Model(gut, read_device("mirocam"), contents=Contents(bubbles=3, chyme=1, seed=2))
    moved = gut.vertices * (1.0, 0.7, 0.7)
    far = transform_from(np.eye(3), np.array([10.0, 0.0, 0.0]))
    vertices = moved @ model.T_world_patient[:3, :3].T
    rest = model.resting_contents(State(0.0, far))
    seen = model.resting_contents(State(0.0, far, vertices_world=vertices))
    assert rest is not None and seen is not None
    assert model.lumen_contents is not None
    on_wall = len(rest.spheres) - len(model.lumen_contents.dome_sites)
    before, after = (
        np.linalg.norm((each.spheres.centers @ model.T_world_patient[:3, :3])[:on_wall, 1:], axis=1)
        for each in (rest, seen)
    )
    shift = before - after
    assert np.median(shift) == pytest.approx(0.3 * RADIUS, rel=0.05)
    assert np.quantile(shift, 0.05) > 0.2 * RADIUS  # others cling to the ends
    assert seen.spheres.radius is rest.spheres.radius


def test_bubbles_on_the_dome_differ_between_distant_views_only() -> None:
    gut = straight_gut({"bowel": 0.3}, radius=RADIUS)
    device = read_device("mirocam")
    model = Model(gut, device, contents=Contents(bubbles=Bubbles(0.0, on_dome=4), seed=2))
    rest = model.lumen_contents
    assert rest is not None

    def sites(arc_length: float) -> np.ndarray:
        return rest.on_dome(arc_length, device.length, device.radius).dome_sites

    assert sites(0.1).tobytes() == sites(0.1).tobytes() == sites(0.1001).tobytes()
    one_later = (sites(0.1) != sites(0.1 + 2.5 * MM)).any(axis=1)
    assert one_later.sum() == 1
    assert (sites(0.1) != sites(0.15)).any(axis=1).all()
    poses = [model.place(s) for s in (0.1, 0.15)]
    local = [
        (model.resting_contents(state).spheres.centers - state.T_world_capsule[:3, 3])
        @ state.T_world_capsule[:3, :3]
        for state in poses
    ]
    assert np.abs(local[0] - local[1]).max() > 1.0 * MM
