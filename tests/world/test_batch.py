"""Several worlds side by side."""

from __future__ import annotations

import hashlib

import numpy as np
import pytest

from tests.support.made_worlds import as_bytes, worlds_in
from tests.support.threads import digests_by_threads
from tests.support.tubes import bent_tube
from vrcaps.capsule.device_file import read_device
from vrcaps.core.errors import InputError
from vrcaps.core.geometry import rotation_from_vector, transform_from
from vrcaps.magnet.sources import Cylinder
from vrcaps.tissue.motility.motility import Motility, Propulsion
from vrcaps.tissue.tissue import Tissue
from vrcaps.world.batch import WorldBatch
from vrcaps.world.control import Control
from vrcaps.world.mechanics import DynamicsKind
from vrcaps.world.model import Model
from vrcaps.world.world import World

CONTROLS = [Control(force_world=(0.2 * k, 0.0, -0.3)) for k in range(4)]


@pytest.mark.parametrize("dynamics", ["physics", "quasi-static"])
def test_the_same_bytes_as_alone(model: Model, dynamics: DynamicsKind) -> None:
    together, alone = worlds_in(model, dynamics), worlds_in(model, dynamics)
    for _ in range(2):
        WorldBatch(together).step(CONTROLS, 0.01)
        for world, control in zip(alone, CONTROLS, strict=True):
            world.step(control, 0.01)
    for a, b in zip(together, alone, strict=True):
        assert as_bytes(a.snapshot()) == as_bytes(b.snapshot())


def digest() -> str:
    model = Model(bent_tube(), read_device("mirocam"))
    worlds = [*worlds_in(model), *worlds_in(model, "quasi-static")]
    WorldBatch(worlds).step(2 * CONTROLS, 0.01)
    return hashlib.sha256(b"".join(as_bytes(world.snapshot()) for world in worlds)).hexdigest()


@pytest.mark.slow
def test_the_same_bytes_on_any_number_of_threads() -> None:
    counts, digests = digests_by_threads(digest, (1, 2))
    assert counts == [1, 2]
    assert len(digests) == 1


def test_worlds_of_all_kinds_step_together(model: Model) -> None:
    """One on a rigid wall, one with muscle, one whose steps are in pieces, one steered."""
    propelled = Motility(fallback_segment="ileum", propulsion=Propulsion(beta=0.5))
    tissues = (
        Tissue(deformation=None),
        Tissue(motility=Motility(fallback_segment="ileum")),
        Tissue(motility=propelled),
        Tissue(),
    )
    steered = Model(model.organ, read_device("magnetic"))

    def made() -> list[World]:
        pose = steered.place(0.1).T_world_capsule
        above = transform_from(np.eye(3), pose[:3, 3] + (0.0, 0.0, 0.12))
        worlds = [World(model, tissue, model.place(0.1), substep=2e-4) for tissue in tissues[:3]]
        magnet = Cylinder(0.05, 0.05, 1.3, above)
        return [*worlds, World(steered, tissues[3], steered.place(0.1), sources=[magnet])]

    together, alone = made(), made()
    turned = transform_from(rotation_from_vector(np.array([0.1, 0.2, 0.3])), np.zeros(3))
    magnet = alone[3].coupling
    assert magnet is not None
    controls = [
        Control(insufflation=0.99),
        Control(force_world=(0.01, 0.0, 0.0)),
        Control(torque_world=(0.0, 1e-4, 0.0)),
        Control(T_world_patient=turned @ model.T_world_patient, strengths=np.array([0.9])),
        Control(Ts_world_magnet=magnet.Ts_world_magnet @ turned),
    ]
    for three in (controls[:4], [*controls[1:3], controls[0], controls[4]]):
        WorldBatch(together).step(three, 0.01)
        for world, control in zip(alone, three, strict=True):
            world.step(control, 0.01)
    for a, b in zip(together, alone, strict=True):
        assert as_bytes(a.snapshot()) == as_bytes(b.snapshot())
    read = WorldBatch(together).state()
    for k, world in enumerate(alone):
        assert np.array_equal(read.Ts_world_capsule[k], world.T_world_capsule)
        velocity = [read.linear_velocity_world[k], read.angular_velocity_world[k]]
        assert np.array_equal(velocity, world.velocity_world)
        for name, value in vars(world.contact).items():
            key = f"contact_{name}" if name in ("force_world", "torque_world") else name
            assert np.array_equal(getattr(read, key)[k], value)
    assert WorldBatch(together).are_inside().tolist() == [world.is_inside() for world in alone]


def test_a_hierarchy_refitted_in_part_is_that_refitted_whole(model: Model) -> None:
    """A capsule presses into the wall and lets go; queries beside a wall made anew."""
    world, rng = worlds_in(model)[0], np.random.default_rng(0)
    points = world._center + rng.uniform(-0.1, 0.1, (300, 3))
    for force in (0.5, 0.0):
        for _ in range(2):
            world.step(Control(force_world=(0.0, 0.0, -force)), 0.02)
        wall = world.wall
        moved = world._core.vertices(np.eye(4))
        whole = model.wall_in_patient.copy()
        whole.refit(moved)
        assert np.array_equal(wall.signed_distance(points), whole.signed_distance(points))


def test_a_small_wall_is_moved_by_the_same_sums_on_one_thread(model: Model) -> None:
    """Bit by bit what the core's threads make of it, in a patient who lies askew."""
    world = worlds_in(model)[0]
    turn = rotation_from_vector(np.array([0.4, -0.2, 1.1]))
    lying = transform_from(turn @ model.T_world_patient[:3, :3], np.array([0.1, 0.2, -0.3]))
    for insufflation in (1.0, 1.05):
        control = Control((0.0, 0.0, -0.5), T_world_patient=lying, insufflation=insufflation)
        world.step(control, 0.02)
        assert np.abs(world._core.wall_displacement).max() > 0.0
        expected = world._core.vertices(np.asarray(world._T_world_patient, float))
        assert world.state.vertices_world is not None
        np.testing.assert_array_equal(world.state.vertices_world, expected, strict=True)


def test_a_bad_world_does_not_hold_up_the_others(model: Model) -> None:
    worlds = worlds_in(model)
    before = [as_bytes(world.snapshot()) for world in worlds]
    controls = [*CONTROLS[:2], Control(force_world=(500.0, 0.0, 0.0)), CONTROLS[3]]
    with pytest.raises(
        InputError, match=r"World 2: Control's force_world is 500 strong.* 3 other worlds have"
    ):
        WorldBatch(worlds).step(controls, 0.01)
    same = [as_bytes(w.snapshot()) == b for w, b in zip(worlds, before, strict=True)]
    assert same == [False, False, True, False]


def test_rejects_controls_that_do_not_match(model: Model) -> None:
    worlds = worlds_in(model)
    with pytest.raises(InputError, match=r"Number of controls is 1. Allowed: 4"):
        WorldBatch(worlds).step(CONTROLS[:1], 0.01)
    with pytest.raises(InputError, match="A world is given twice"):
        WorldBatch([worlds[0], worlds[0]])
