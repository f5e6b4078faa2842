"""A capsule in a lumen that contracts: what the muscle's waves do to it through contact."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from tests.support.tubes import straight_gut
from vrcaps.capsule.device_file import read_device
from vrcaps.core.errors import InputError, UnknownNameError
from vrcaps.core.units import CM, MM
from vrcaps.organ.surface import OrganSurface
from vrcaps.tissue.motility.motility import Motility, Propulsion
from vrcaps.tissue.motility.segment import SegmentMotility, segment_motilities
from vrcaps.tissue.tissue import Tissue
from vrcaps.world.control import Control
from vrcaps.world.model import Model, State
from vrcaps.world.snapshot import read_snapshot, write_snapshot
from vrcaps.world.world import World

RADIUS = 11.0 * MM
RINGS = SegmentMotility(
    amplitude=segment_motilities()["jejunum"].amplitude,
    rates=(0.19, 0.19),
    speeds=(1.5 * CM, 1.5 * CM),
    duration=2.5,
    extent=6.0 * CM,
    activity=1.0,
)
MMHG = 133.322


@pytest.fixture(scope="module")
def gut() -> OrganSurface:
    return straight_gut({"bowel": 0.3}, radius=RADIUS, edge=2.5 * MM)


def world_in(
    gut: OrganSurface, segment: SegmentMotility = RINGS, start: float = 0.1, **motility: object
) -> World:
    """A capsule lying along the gut, its front towards the anal end."""
    device = read_device("mirocam")
    pose = np.eye(4)
    pose[:3, :3] = [[0, 0, 1], [1, 0, 0], [0, 1, 0]]
    pose[:3, 3] = [start, 0.0, -RADIUS + device.radius + 0.2 * MM]
    law = Motility(segments={"bowel": segment}, complex=None, giant=None, **motility)
    model = Model(gut, device, np.eye(4))
    return World(model, Tissue(motility=law), State(0.0, pose), substep=1e-3)


def travel(world: World, seconds: float, dt: float = 0.02) -> float:
    begin = world.state.T_world_capsule[0, 3]
    for _ in range(round(seconds / dt)):
        world.step(Control(), dt)
    assert world.is_inside()
    return world.state.T_world_capsule[0, 3] - begin


@pytest.mark.slow
@pytest.mark.parametrize(("start", "back"), [(0.08, 0.0), (0.22, 1.0)])
def test_a_ring_carries_the_capsule_at_its_speed(
    gut: OrganSurface, start: float, back: float
) -> None:
    world = world_in(gut, replace(RINGS, retrograde=back), start)
    travel(world, 3.0)  # up to a ring that takes it along
    speed = travel(world, 2.0) / 2.0
    assert speed == pytest.approx(-1.5 * CM if back else 1.5 * CM, rel=0.03)


def test_the_wall_follows_the_commanded_wave(gut: OrganSurface) -> None:
    """Radius of the wall at places far from the capsule, over time."""
    world = world_in(gut)
    far = np.flatnonzero(np.abs(gut.arc_length - 0.25) < 1e-9)
    for _ in range(60):
        world.step(Control(), 0.05)
        vertices, time = world.state.vertices_world, world.state.time
        assert vertices is not None
        assert world.muscle is not None
        radius = np.linalg.norm(vertices[far, 1:], axis=1)
        commanded = 1.0 - min(1.0, time) * (1.0 - world.muscle.lumen_scale(time)[250])
        np.testing.assert_allclose(radius, RADIUS * commanded, atol=1e-9)


@pytest.mark.slow
def test_a_standing_contraction_squeezes_as_measured(gut: OrganSurface) -> None:
    """Phase III presses with 18 to 62 mmHg (Adv. Funct. Mater. 31:2009289, 2021, table 7)."""
    world = world_in(gut, replace(RINGS, standing=1.0), start=0.15)
    contacts = []
    for _ in range(200):
        world.step(Control(), 0.02)
        contacts.append(world.state.contact)
    tightest = max(contacts, key=lambda contact: contact.normal_force_total)
    assert tightest.area > 5e-4  # most of the capsule
    assert 18.0 < tightest.normal_force_total / tightest.area / MMHG < 62.0


def test_wall_does_not_depend_on_the_step(gut: OrganSurface) -> None:
    ends = []
    for dt in (0.1, 0.02):
        world = world_in(gut)
        travel(world, 0.4, dt)
        ends.append(world.snapshot().active_wall)
    np.testing.assert_allclose(ends[0], ends[1], atol=1e-12)


@pytest.mark.parametrize("propulsion", [None, Propulsion(alpha=1.0 * CM)])
def test_restored_world_goes_on_to_the_same_bytes(
    gut: OrganSurface, propulsion: Propulsion | None, tmp_path: Path
) -> None:
    segment = replace(RINGS, activity=0.6)
    world = world_in(gut, segment, propulsion=propulsion)
    travel(world, 0.4)
    write_snapshot(tmp_path / "world.npz", world.snapshot())
    travel(world, 0.5)
    twin = world_in(gut, segment, start=0.2, propulsion=propulsion)
    twin.restore(read_snapshot(tmp_path / "world.npz"))
    travel(twin, 0.5)
    for name, value in vars(world.snapshot()).items():
        assert np.asarray(value).tobytes() == np.asarray(vars(twin.snapshot())[name]).tobytes()


def test_propulsion_carries_the_capsule_at_alpha() -> None:
    """β (v_p − u) against the friction of a capsule that lies in a still, wide gut."""
    gut = straight_gut({"bowel": 0.3}, radius=RADIUS, edge=2.5 * MM)
    still = replace(RINGS, amplitude=0.0)
    world = world_in(gut, still, propulsion=Propulsion(beta=4.6, alpha=1.0 * CM))
    travel(world, 0.5)
    speed = travel(world, 0.5) / 0.5
    assert speed == pytest.approx(1.0 * CM, rel=0.03)
    contact = world.state.contact
    assert contact is not None
    assert -contact.force_world[0] == pytest.approx(4.6 * (1.0 * CM - speed), abs=2e-4)


def test_failed_step_leaves_the_world(gut: OrganSurface) -> None:
    """Also when it fails after some of the pieces in which propulsion acts."""

    class Failing:
        def __init__(self, core: object) -> None:
            self.core, self.left = core, 5

        def __getattr__(self, name: str) -> object:
            return getattr(self.core, name)

        def __setattr__(self, name: str, value: object) -> None:
            vars(self)[name] = value
            if name in ("active_wall", "wall_displacement", "pose"):
                setattr(self.core, name, value)
                del vars(self)[name]

        def step(self, *arguments: object) -> None:
            self.left -= 1
            if self.left == 0:
                raise ValueError("The step is too large.")
            self.core.step(*arguments)

    world = world_in(gut, propulsion=Propulsion())
    travel(world, 0.1)
    before, core = world.snapshot(), world._core
    world._core = Failing(core)
    with pytest.raises(InputError, match="step is too large"):
        world.step(Control(), 0.02)
    world._core = core
    for name, value in vars(world.snapshot()).items():
        np.testing.assert_array_equal(value, vars(before)[name])


def test_rejects_a_negative_seed(gut: OrganSurface) -> None:
    model = Model(gut, read_device("mirocam"), np.eye(4))
    with pytest.raises(InputError, match=r"seed is -1. Allowed: 0 to"):
        World(model, Tissue(), State(0.0, np.eye(4)), seed=-1)


def test_rejects_a_snapshot_of_another_seed(gut: OrganSurface) -> None:
    world = world_in(gut)
    with pytest.raises(InputError, match=r"seed is 3. Allowed: this world's, 0"):
        world.restore(replace(world.snapshot(), seed=3))


def test_rejects_a_wall_without_known_muscle(gut: OrganSurface) -> None:
    model = Model(gut, read_device("mirocam"), np.eye(4))
    with pytest.raises(UnknownNameError, match="No segment with muscle named 'bowel'"):
        World(model, Tissue(motility=Motility()), State(0.0, np.eye(4)))
