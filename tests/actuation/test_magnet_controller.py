"""A capsule held and led by a magnet."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import lead_twin
from tubes import straight_gut
from vrcaps._core import lead_on
from vrcaps.actuation.capsule_target import Goal, gut_goal, wall_goal
from vrcaps.actuation.magnet_actuator import FreeHolder
from vrcaps.actuation.magnet_controller import Pilot, Steering
from vrcaps.actuation.magnet_pose_solver import Room
from vrcaps.capsule.catalog import read_device
from vrcaps.errors import InputError
from vrcaps.magnet.field import wrench
from vrcaps.magnet.presets import load_magnet
from vrcaps.magnet.sources import Uniform, magnet_pose
from vrcaps.tissue.tissue import Tissue
from vrcaps.transforms import invert, transform_from
from vrcaps.world.model import Model, State, posture_transform
from vrcaps.world.world import GRAVITY, World

DT = 0.01


@pytest.fixture(scope="module")
def gut_model() -> Model:
    return Model(straight_gut({"jejunum": 0.2}, radius=0.014), read_device("magnetic"), np.eye(4))


def begin(model: Model, at: float = 0.1, **options) -> tuple[Pilot, World, Goal]:
    """A capsule in the middle of a tube, with the magnet above it."""
    line = model.organ.centerline
    goal = gut_goal(line, model.T_world_patient, at, side=options.pop("side", "up"))
    k = int(np.argmin(np.abs(line.arc_length - at)))
    pose = model.T_world_patient @ transform_from(line.frames[k], line.points[k])
    holder = options.pop("holder", FreeHolder())
    pilot = Pilot(model, load_magnet("cylinder-101.6"), holder, pose, goal, **options)
    world = World(model, Tissue(), State(0.0, pose), sources=pilot.sources, substep=2e-4)
    return pilot, world, goal


def run(pilot, world, goal, seconds, force=None):
    for k in range(round(seconds / DT)):
        control = pilot.hold(world, goal, DT)
        if force is not None:
            control = replace(control, force_world=force(k * DT))
        world.step(control, DT)


@pytest.mark.parametrize("looks", ["somewhere", "nowhere", "ahead", "back", "along the side"])
def test_the_leading_point_is_that_of_its_twin(looks):
    """Goals of all kinds, capsules near and far, in touch and not; the leader looks back or not."""
    rng = np.random.default_rng(0)
    for k in range(64):
        along, mapped, level, touches, back = (bool(k >> bit & 1) for bit in range(5))
        pose = transform_from(Rotation.random(random_state=rng).as_matrix(), rng.normal(size=3))
        aside, press, side, lag = rng.normal(size=(4, 3))
        aside, press, side = (v / np.linalg.norm(v) for v in (aside, press, side))
        sign = -1.0 if back else 1.0
        look = [aside, sign * pose[:3, 2]][k % 3 > 0]
        leader = np.array([pose[:3, 3] + 0.01 * rng.uniform() * lag, look, side])
        direction = {"nowhere": None, "somewhere": aside, "along the side": side}
        direction |= {"ahead": pose[:3, 2], "back": -pose[:3, 2]}
        place = pose[:3, 3] + rng.choice([1e-5, 0.01]) * rng.normal(size=3)
        goal = Goal(place, direction[looks], aside if along else None, press, level, mapped)
        contact = rng.normal(size=3) * (0.1 if touches else 1e-3)
        given = (leader, pose, contact, goal, Steering(), DT)
        for ours, twin in zip(lead_on(*given), lead_twin.lead_on(*given), strict=True):
            np.testing.assert_allclose(ours, twin, rtol=0.0, atol=1e-12)


@pytest.mark.parametrize("side", ["up", "down"])
def test_leads_the_capsule_along_and_holds_it(gut_model, side):
    pilot, world, goal = begin(gut_model, side=side)
    goal = gut_goal(gut_model.organ.centerline, np.eye(4), 0.115, side=side)
    run(pilot, world, goal, 4.5)
    assert world.T_world_capsule[0, 3] == pytest.approx(0.115, abs=1e-3)
    assert world.T_world_capsule[0, 2] > np.cos(np.radians(3.0))
    assert (world.contact.force_world[2] < 0.0) == (side == "up")
    assert pilot.steered.lost == ""


def test_holds_against_a_push(gut_model):
    """0.1 N along the tube, rising within 2 s: within 2 mm and 3°."""
    pilot, world, goal = begin(gut_model, steering=Steering(press=0.5))
    run(pilot, world, goal, 1.0)
    worst = 0.0
    for k in range(300):
        control = pilot.hold(world, goal, DT)
        push = 0.1 * min(1.0, k * DT / 2.0)
        world.step(replace(control, force_world=(push, 0.0, 0.0)), DT)
        worst = max(worst, abs(world.T_world_capsule[0, 3] - goal.position[0]))
        assert world.T_world_capsule[0, 2] > np.cos(np.radians(3.0))
    assert worst < 2e-3
    assert world.coupling.force_world[0] == pytest.approx(-0.1, abs=0.02)


@pytest.mark.parametrize("aside", [0.0, 0.02])
def test_goes_round_a_capsule_that_is_in_the_way(gut_model, aside):
    """From below, or from beside, the magnet is to get above a capsule that stays where it is.

    Nowhere it pulls with more than four times what it bears; the weight is 42 mN.
    """
    pilot, world, goal = begin(gut_model, steering=Steering(press=0.1))
    wanted = pilot.steered.held.T_world_magnet
    below = wanted.copy()
    below[:3, 3] = 2.0 * world.T_world_capsule[:3, 3] - wanted[:3, 3] + [0, aside, 0]
    pilot.steered = replace(pilot.steered, held=replace(pilot.steered.held, T_world_magnet=below))
    most = 0.0
    for _ in range(600):
        pilot.hold(world, goal, DT)
        force, _ = wrench(pilot.sources, gut_model.device.magnets, world.T_world_capsule)
        most = max(most, float(np.linalg.norm(force)))
    weight = gut_model.device.mass * GRAVITY
    assert most < 4.4 * (weight + 0.1)
    reached = pilot.steered.held.T_world_magnet[:3, 3]
    assert reached[2] > world.T_world_capsule[2, 3] + 0.1


def test_a_run_goes_on_from_its_snapshot(gut_model):
    pilot, world, goal = begin(gut_model)
    run(pilot, world, goal, 0.1)
    saved, snapshot = pilot.to_array(), world.snapshot()
    run(pilot, world, goal, 0.1)
    other, again, _ = begin(gut_model)
    other.restore(saved)
    again.restore(snapshot)
    run(other, again, goal, 0.1)
    np.testing.assert_array_equal(other.to_array(), pilot.to_array())
    np.testing.assert_array_equal(again.T_world_capsule, world.T_world_capsule)


def test_joystick_moves_the_magnet_within_its_room(gut_model):
    holder = FreeHolder(Room(low=(-1, -1, 0.1), high=(1, 1, 0.19)))
    pilot, world, _ = begin(gut_model, holder=holder, others=[Uniform(5e-5)])
    start = pilot.steered.held.T_world_magnet
    for _ in range(100):
        control = pilot.drive((0.5, 0, 1), (0, 0, 0.5), DT, speed=0.1, rate=0.2)
        world.step(control, DT)
    pilot.judge(world)
    moved = invert(start) @ pilot.steered.held.T_world_magnet
    assert np.linalg.norm(moved[:3, 3]) > 0.03
    assert pilot.steered.held.T_world_magnet[2, 3] <= 0.19
    turn = np.arccos((np.trace(moved[:3, :3]) - 1.0) / 2.0)
    assert turn == pytest.approx(0.1, abs=0.03)
    np.testing.assert_allclose(
        world.coupling.Ts_world_magnet[0], pilot.steered.held.T_world_magnet, atol=1e-12
    )


def test_a_turning_magnet_turns_the_capsule(gut_model):
    """About the vertical the capsule follows, as far as the tube lets it."""
    pilot, world, goal = begin(gut_model)
    run(pilot, world, goal, 0.5)
    for _ in range(100):
        world.step(pilot.rotate((0, 0, 2.0), 0.3, DT), DT)
    yaw = np.arctan2(world.T_world_capsule[1, 2], world.T_world_capsule[0, 2])
    assert 0.1 < yaw < 0.4


def test_says_why_the_capsule_is_lost(gut_model):
    """Kept too far off the magnet is too weak and the capsule falls; turned round it is turned."""
    high = FreeHolder(Room(low=(-1, -1, 0.6), high=(1, 1, 1)))
    pilot, world, goal = begin(gut_model, holder=high)
    run(pilot, world, goal, 0.4)
    assert pilot.steered.lost == "other-wall"
    assert np.linalg.norm(pilot.steered.offered) < np.linalg.norm(pilot.steered.needed)
    quick = FreeHolder(turn_speed=1e3, turn_acceleration=1e6)
    pilot, world, goal = begin(gut_model, holder=quick)
    world.step(pilot.rotate((0, 0, 1), 300.0, DT), 1e-3)
    pilot.judge(world)
    assert pilot.steered.lost == "turned"


def test_goals_along_a_gut_and_on_its_wall(gut_model):
    line = gut_model.organ.centerline
    goal = gut_goal(line, np.eye(4), 0.05, yaw=0.3)
    np.testing.assert_allclose(goal.position, [0.05, 0, 0], atol=1e-12)
    assert np.asarray(goal.direction)[0] == pytest.approx(np.cos(0.3))
    np.testing.assert_allclose(goal.press, [0, 0, 1], atol=1e-12)
    back = gut_goal(line, posture_transform("prone"), 0.05, backwards=True, side="down")
    assert np.asarray(back.along) @ np.asarray(back.direction) == pytest.approx(-1.0)
    assert np.asarray(back.press)[2] == pytest.approx(-1.0)
    standing = gut_goal(line, magnet_pose((0, 0, 0), (-1, 0, 0)), 0.05)  # the gut upright
    assert abs(np.asarray(standing.press)[2]) < 1e-9
    on_wall = wall_goal(gut_model, np.array([0.1, 0, 0.01]), np.array([1.0, 0, 1.0]))
    np.testing.assert_allclose(on_wall.position, [0.1, 0, 0.008], atol=5e-4)
    np.testing.assert_allclose(on_wall.press, [0, 0, 1], atol=0.2)


def test_what_cannot_be(gut_model):
    with pytest.raises(InputError, match="Steering's lead is 0"):
        Steering(lead=0.0)
    with pytest.raises(InputError, match="arc_length is 1"):
        gut_goal(gut_model.organ.centerline, np.eye(4), 1.0)
    with pytest.raises(InputError, match="Goal's direction is"):
        Goal((0, 0, 0), (0, 0, 2))
    with pytest.raises(InputError, match="at right angles to the wall"):
        wall_goal(gut_model, np.array([0.1, 0, 0.01]), wall_goal(
            gut_model, np.array([0.1, 0, 0.01]), np.array([1.0, 0, 0])).press)  # fmt: skip
    pilot, _, _ = begin(gut_model)
    with pytest.raises(InputError, match="Joystick axes"):
        pilot.drive((2, 0, 0), (0, 0, 0), DT, speed=0.1, rate=0.1)
