"""Friction of a capsule of real mass: it sticks below the limit and slides by the law above it."""

from __future__ import annotations

import pytest

from tests.support.walls import capsule, tube, world_on
from vrcaps import _core
from vrcaps.core.units import MM
from vrcaps.tissue.tissue import Drag, WinklerFoundation

FREE, STILL = (0.0,) * 6, (0.0,) * 3
SUBSTEPS = [5e-5, 2e-4, 1e-3]
"""The default, the one for gentle forces, and the longest that is allowed [s]."""


def gripped(
    drag: Drag, speed: float = 0.0, mass: float = 3e-3, edge: float = 2.0 * MM
) -> _core.World:
    """A capsule 26 mm long in a tube 8.4 mm wide, which grips it with 5.7 N."""
    return world_on(
        tube(4.2 * MM, 50.0 * MM, edge),
        position=(0, 0, 25 * MM),
        wxyz=(1, 0, 0, 0),
        velocity=(0, 0, speed),
        body=capsule(mass=mass),
        foundation=WinklerFoundation(),
        drag=drag,
    )


def mean_speed(world: _core.World, pull: float, substep: float, duration: float) -> float:
    """Speed along the tube under a pull [N], once it is steady [m/s]."""
    count = round(duration / substep)
    world.step(substep, count, (0.0, 0.0, pull, 0.0, 0.0, 0.0), STILL)
    before = world.pose[0][2]
    world.step(substep, count, (0.0, 0.0, pull, 0.0, 0.0, 0.0), STILL)
    return (world.pose[0][2] - before) / (count * substep)


@pytest.mark.parametrize("substep", SUBSTEPS)
@pytest.mark.parametrize("law", ["physical", "continuous", "incetan2021"])
def test_sticks_below_the_limit(law: str, substep: float) -> None:
    """At 0.6 and 0.94 of the limit it creeps by 0.01 mm/s at most, also after it has slid."""
    world = gripped(Drag(law=law), speed=5.0 * MM)
    world.step(substep, 5, FREE, STILL)
    limit = 0.018 * world.contact()[2] if law == "physical" else 100e-3
    for share in (0.6, 0.94):
        assert 0.0 < mean_speed(world, share * limit, substep, 10e-3) <= 0.01 * MM


@pytest.mark.parametrize("substep", SUBSTEPS)
@pytest.mark.parametrize(
    ("law", "pull"), [("physical", 0.12), ("physical", 0.16), ("continuous", 0.16)]
)
def test_slides_above_the_limit_as_a_heavy_one(law: str, pull: float, substep: float) -> None:
    """At the steady speed of a pull, a capsule too heavy to be slowed down meets the same drag."""
    light = gripped(Drag(law=law), edge=1.2 * MM)
    speed = mean_speed(light, pull, substep, 0.01)
    heavy = gripped(Drag(law=law), speed, mass=1e6, edge=1.2 * MM)
    heavy.step(1e-5, 100, FREE, STILL)
    assert 0.5 * MM < speed < 30.0 * MM
    assert -heavy.contact()[0][2] == pytest.approx(pull, rel=0.03)
