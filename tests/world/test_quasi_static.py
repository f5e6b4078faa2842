"""Quasi-static dynamics against closed forms and against the physics."""

from __future__ import annotations

import numpy as np
import pytest

from tests.support.fem_shapes import straight_tube
from tests.support.made_worlds import as_bytes, worlds_in
from tests.support.walls import RADIUS, creased, floor, world_on
from vrcaps import _core
from vrcaps.capsule.device_file import read_device
from vrcaps.core.errors import InputError, UnknownNameError
from vrcaps.core.geometry import rotation_from_vector, transform_from
from vrcaps.core.units import MM
from vrcaps.lumen.contents import Contents
from vrcaps.magnet.sources import Cylinder, UniformField
from vrcaps.tissue.fem.deformation import FemDeformation
from vrcaps.tissue.fem.wall import FemWall
from vrcaps.tissue.motility.motility import Motility, Propulsion
from vrcaps.tissue.tissue import Drag, SpringWall, Tissue, WinklerFoundation
from vrcaps.world.batch import WorldBatch
from vrcaps.world.control import Control
from vrcaps.world.mechanics import RELAXATION_TIME
from vrcaps.world.model import Model
from vrcaps.world.world import World

FREE, STILL, GRAVITY = (0.0,) * 6, (0.0,) * 3, 9.81
DOWN = (0.0, 0.0, -GRAVITY)
MASS, FRICTION, FRAME = 3e-3, 0.3, 1.0 / 30.0
ALONG_X = (np.sqrt(0.5), 0.0, np.sqrt(0.5), 0.0)


def pulled(force: float) -> _core.World:
    """A capsule that lies along a pull on a floor with friction, and has gone on for 0.5 s."""
    world = world_on(
        floor(2.0 * MM),
        position=(-25 * MM, 0.0, RADIUS),
        wxyz=ALONG_X,
        foundation=WinklerFoundation(),
        drag=Drag(friction=FRICTION),
        is_quasi_static=True,
    )
    for pull in (0.0, force):
        world.step(FRAME, 15, (pull, *STILL, 0.0, 0.0), DOWN)
    return world


def test_friction_holds_below_its_limit() -> None:
    world = pulled(0.9 * FRICTION * MASS * GRAVITY)
    assert np.linalg.norm(world.pose[2]) < 0.02 * MM


def test_above_the_limit_drag_balances_the_pull() -> None:
    """v = (F − f) τ / m, where the wall's resistance f is a little more than μ m g."""
    force = FRICTION * MASS * GRAVITY + 1.5e-3
    world = pulled(force)
    before = world.pose[0][0]
    world.step(FRAME, 6, (force, *STILL, 0.0, 0.0), DOWN)
    resistance = -world.contact()[0][0]
    assert FRICTION * MASS * GRAVITY < resistance < 1.05 * FRICTION * MASS * GRAVITY
    speed = (world.pose[0][0] - before) / (6 * FRAME)
    assert speed == pytest.approx((force - resistance) * RELAXATION_TIME / MASS, rel=1e-3)


def test_a_capsule_sinks_at_a_bounded_speed() -> None:
    world = world_on(floor(8.0 * MM), position=(0.0, 0.0, 1.0), is_quasi_static=True)
    world.step(FRAME, 1, FREE, DOWN)
    assert world.pose[2] == pytest.approx((0.0, 0.0, -GRAVITY * RELAXATION_TIME))


@pytest.mark.parametrize("spring_wall", [None, SpringWall()])
@pytest.mark.parametrize("force", [0.0, 0.4])
def test_it_rests_as_deep_as_in_the_physics(spring_wall: SpringWall | None, force: float) -> None:
    """Under its weight and under a push, on a rigid base and on springs."""
    found = []
    for is_quasi_static in (True, False):
        world = world_on(
            floor(2.0 * MM),
            position=(0.3 * MM, 0.1 * MM, RADIUS - 0.2 * MM),
            foundation=WinklerFoundation(),
            drag=Drag(),
            spring_wall=spring_wall,
            is_quasi_static=is_quasi_static,
        )
        dt = FRAME if is_quasi_static else 2e-4
        world.step(dt, round(1.0 / dt), (0.0, 0.0, -force, *STILL), DOWN)
        found.append((RADIUS - world.pose[0][2], world.contact()[6], world.contact()[0][2]))
    assert found[0] == pytest.approx(found[1], rel=0.01)


def test_it_aligns_with_a_field_without_overshoot(model: Model) -> None:
    """From 40° to less than 1°; the wall is in the way, the field never lets go."""
    steered = Model(model.organ, read_device("magnetic"))
    start = steered.place(0.1)
    axis = start.T_world_capsule[:3, :3] @ rotation_from_vector(np.array([0.0, 0.7, 0.0]))
    field = UniformField(50e-3, transform_from(axis, np.zeros(3)))
    world = World(
        steered, Tissue(deformation=None), start, sources=[field], dynamics="quasi-static"
    )
    angles = [world.field_angle(world.T_world_capsule)]
    for _ in range(30):
        world.step(Control(), FRAME)
        angles.append(world.field_angle(world.T_world_capsule))
    assert angles[0] == pytest.approx(0.7, abs=0.01)
    assert max(np.diff(angles)) < np.radians(0.2)
    assert angles[-1] < np.radians(1.0)


def test_two_newtons_do_not_drive_it_through_the_wall(model: Model) -> None:
    rng = np.random.default_rng(1)
    for tissue in (Tissue(), Tissue(deformation=None)):
        world = World(model, tissue, model.place(0.1), dynamics="quasi-static")
        for _ in range(10):
            push = rng.normal(size=3)
            world.step(Control(force_world=2.0 * push / np.linalg.norm(push)), FRAME)
            assert world.is_inside()


@pytest.mark.parametrize("spring_wall", [None, SpringWall()])
def test_no_fold_cuts_through_the_axis(spring_wall: SpringWall | None) -> None:
    """Pushed about with 2 N among folds with crests sharper than any pressed area."""
    rng = np.random.default_rng(3)
    world = world_on(
        creased(40.0 * MM, 15.0 * MM),
        position=(0.0, 0.0, 0.0),
        foundation=WinklerFoundation(),
        drag=Drag(),
        spring_wall=spring_wall,
        is_quasi_static=True,
    )
    for _ in range(15):
        push = rng.normal(size=3)
        world.step(FRAME, 1, (*(2.0 * push / np.linalg.norm(push)), *STILL), DOWN)
        assert world.inside()


def test_it_goes_on_from_a_snapshot_to_the_same_bytes(model: Model) -> None:
    worlds = worlds_in(model, "quasi-static")[:2]
    control = Control(force_world=(0.05, 0.0, -0.2), insufflation=0.99)
    for _ in range(3):
        worlds[0].step(control, FRAME)
    worlds[1].restore(worlds[0].snapshot())
    for world in worlds:
        world.step(control, FRAME)
    assert as_bytes(worlds[0].snapshot()) == as_bytes(worlds[1].snapshot())


def test_worlds_of_all_kinds_step_together(model: Model) -> None:
    """Muscle, a propulsive force, a magnet; beside a world with inertia; each as alone."""
    steered = Model(model.organ, read_device("magnetic"))
    propelled = Motility(fallback_segment="ileum", propulsion=Propulsion())

    def made() -> list[World]:
        pose = steered.place(0.1).T_world_capsule
        above = transform_from(np.eye(3), pose[:3, 3] + (0.0, 0.0, 0.12))
        magnet = Cylinder(0.05, 0.05, 1.3, above)
        return [
            World(model, Tissue(motility=propelled), model.place(0.1), dynamics="quasi-static"),
            World(steered, None, steered.place(0.1), sources=[magnet], dynamics="quasi-static"),
            World(model, Tissue(), model.place(0.1), substep=2e-4),
        ]

    together, alone = made(), made()
    controls = [Control(insufflation=0.98), Control(strengths=np.array([0.9])), Control()]
    for _ in range(2):
        WorldBatch(together).step(controls, FRAME)
        for world, control in zip(alone, controls, strict=True):
            world.step(control, FRAME)
    for a, b in zip(together, alone, strict=True):
        assert as_bytes(a.snapshot()) == as_bytes(b.snapshot())
    assert np.linalg.norm(together[0].velocity_world[0]) < 0.1


def test_the_wall_and_the_sources_carry_what_the_capsule_weighs(model: Model) -> None:
    """Forces of wall, sources and gravity are in balance where a capsule has come to rest."""
    steered = Model(model.organ, read_device("magnetic"))
    start = steered.place(0.1)
    above = transform_from(start.T_world_capsule[:3, :3], start.T_world_capsule[:3, 3])
    above[2, 3] += 0.15
    magnet = Cylinder(0.05, 0.05, 1.3, above)
    world = World(steered, None, start, sources=[magnet], dynamics="quasi-static")
    for _ in range(60):
        world.step(Control(), FRAME)
    coupling, weight = world.coupling, steered.device.mass * 9.80665
    assert coupling is not None
    total = world.contact_force_world + coupling.force_world - (0.0, 0.0, weight)
    assert np.linalg.norm(total) < 0.02 * weight


def test_refuses_what_has_inertia(model: Model) -> None:
    contents = Contents(bubbles=2)
    with pytest.raises(
        InputError, match=r"quasi-static, but matter in the lumen.*or choose physics"
    ):
        World(Model(model.organ, model.device, contents=contents), dynamics="quasi-static")
    with pytest.raises(InputError, match=r"quasi-static, but a layer of finite elements"):
        World(model, Tissue(deformation=FemDeformation()), dynamics="quasi-static")
    with pytest.raises(UnknownNameError, match=r"No dynamics named 'static'. Known: physics"):
        World(model, dynamics="static")  # type: ignore[arg-type]
    layer = FemWall(straight_tube(20e-3, 80e-3, 10e-3), FemDeformation(edge=20e-3, fix_ends=True))
    world = world_on(floor(8e-3), position=(0.0, 0.0, 5e-3), is_quasi_static=True)
    with pytest.raises(ValueError, match="it takes no quasi-static world"):
        world.set_layer(layer._core, 1e-6)


@pytest.mark.parametrize("dt", [np.nan, np.inf, 0.0, -1.0, 1e300])
def test_an_impossible_time_is_an_error(dt: float) -> None:
    world = world_on(floor(8e-3), position=(0.0, 0.0, 5e-3), is_quasi_static=True)
    before = world.pose
    with pytest.raises(ValueError, match="steps of above 0 to 1000 s"):
        world.step(dt, 1, FREE, DOWN)
    assert world.pose == before
