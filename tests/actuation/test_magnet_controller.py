"""A capsule held and led by a magnet."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from tests.support import reference_twin
from tests.support.tubes import bent_tube, straight_gut
from vrcaps._core import advance_reference
from vrcaps.actuation.capsule_target import CapsuleTarget, centerline_target, wall_target
from vrcaps.actuation.magnet_actuator import FreeActuator
from vrcaps.actuation.magnet_controller import ControllerGains, MagnetController
from vrcaps.actuation.magnet_pose_solver import Workspace
from vrcaps.actuation.steering_program import GENTLE_GAINS
from vrcaps.capsule.device_file import read_device
from vrcaps.core.errors import InputError
from vrcaps.core.geometry import invert, transform_from
from vrcaps.magnet.field import wrench
from vrcaps.magnet.presets import read_magnet
from vrcaps.magnet.sources import UniformField, magnet_pose
from vrcaps.tissue.tissue import Tissue
from vrcaps.world.control import GRAVITY
from vrcaps.world.model import Model, State, posture_transform
from vrcaps.world.world import World

DT = 0.01


@pytest.fixture(scope="module")
def gut_model() -> Model:
    return Model(straight_gut({"jejunum": 0.2}, radius=0.014), read_device("magnetic"), np.eye(4))


def begin(
    model: Model, at: float = 0.1, **options
) -> tuple[MagnetController, World, CapsuleTarget]:
    """A capsule in the middle of a tube, with the magnet above it."""
    line = model.organ.centerline
    target = centerline_target(line, model.T_world_patient, at, wall=options.pop("wall", "upper"))
    k = int(np.argmin(np.abs(line.arc_length - at)))
    pose = model.T_world_patient @ transform_from(line.frames[k], line.points[k])
    actuator = options.pop("actuator", FreeActuator())
    magnet = read_magnet(options.pop("magnet", "cylinder-101.6"))
    controller = MagnetController(model, magnet, actuator, pose, target, **options)
    world = World(model, Tissue(), State(0.0, pose), sources=controller.sources, substep=2e-4)
    return controller, world, target


def run(controller, world, target, seconds, force=None):
    for k in range(round(seconds / DT)):
        control = controller.track(world, target, DT)
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
        target = CapsuleTarget(
            place, direction[looks], aside if along else None, press, level, mapped
        )
        contact = rng.normal(size=3) * (0.1 if touches else 1e-3)
        given = (leader, pose, contact, target, ControllerGains(), DT)
        for ours, twin in zip(
            advance_reference(*given), reference_twin.advance_reference(*given), strict=True
        ):
            np.testing.assert_allclose(ours, twin, rtol=0.0, atol=1e-12)


@pytest.mark.slow
@pytest.mark.parametrize("wall", ["upper", "lower"])
def test_leads_the_capsule_along_and_holds_it(gut_model, wall):
    controller, world, target = begin(gut_model, wall=wall)
    target = centerline_target(gut_model.organ.centerline, np.eye(4), 0.115, wall=wall)
    run(controller, world, target, 4.5)
    assert world.T_world_capsule[0, 3] == pytest.approx(0.115, abs=1e-3)
    assert world.T_world_capsule[0, 2] > np.cos(np.radians(3.0))
    assert (world.contact.force_world[2] < 0.0) == (wall == "upper")
    assert controller.status.lost == ""


@pytest.mark.slow
def test_holds_against_a_push(gut_model):
    """0.1 N along the tube, rising within 2 s: within 2 mm and 3°."""
    controller, world, target = begin(gut_model, gains=ControllerGains(upper_wall_force=0.5))
    run(controller, world, target, 1.0)
    worst = 0.0
    for k in range(300):
        control = controller.track(world, target, DT)
        push = 0.1 * min(1.0, k * DT / 2.0)
        world.step(replace(control, force_world=(push, 0.0, 0.0)), DT)
        worst = max(worst, abs(world.T_world_capsule[0, 3] - target.position[0]))
        assert world.T_world_capsule[0, 2] > np.cos(np.radians(3.0))
    assert worst < 2e-3
    assert world.coupling.force_world[0] == pytest.approx(-0.1, abs=0.02)


@pytest.mark.slow
def test_a_capsule_that_swings_comes_to_rest():
    """Pulled up in a wide tube it slides to and fro; a magnet that follows late would feed that."""
    model = Model(bent_tube(), read_device("magnetic"), np.eye(4))
    gains = replace(GENTLE_GAINS, upper_wall_force=0.15)
    controller, world, target = begin(model, 0.16, gains=gains, magnet="cylinder-76.2")
    along = np.asarray(target.tangent)
    run(controller, world, target, 1.0, lambda t: 0.2 * np.cos(20.0 * t) * along)
    swing = []
    for _ in range(200):
        run(controller, world, target, DT)
        swing.append(along @ (world.T_world_capsule[:3, 3] - target.position))
    assert np.abs(swing[:20]).max() > 5e-3
    assert np.abs(swing[-50:]).max() < 1.5e-3


@pytest.mark.parametrize("aside", [0.0, 0.02])
def test_goes_round_a_capsule_that_is_in_the_way(gut_model, aside):
    """From below, or from beside, the magnet is to get above a capsule that stays where it is.

    Nowhere it pulls with more than four times what it bears; the weight is 42 mN.
    """
    controller, world, target = begin(gut_model, gains=ControllerGains(upper_wall_force=0.1))
    wanted = controller.status.actuator.T_world_magnet
    below = wanted.copy()
    below[:3, 3] = 2.0 * world.T_world_capsule[:3, 3] - wanted[:3, 3] + [0, aside, 0]
    controller.status = replace(
        controller.status, actuator=replace(controller.status.actuator, T_world_magnet=below)
    )
    most = 0.0
    for _ in range(600):
        controller.track(world, target, DT)
        force, _ = wrench(controller.sources, gut_model.device.magnets, world.T_world_capsule)
        most = max(most, float(np.linalg.norm(force)))
    weight = gut_model.device.mass * GRAVITY
    assert most < 4.4 * (weight + 0.1)
    reached = controller.status.actuator.T_world_magnet[:3, 3]
    assert reached[2] > world.T_world_capsule[2, 3] + 0.1


def test_a_run_goes_on_from_its_snapshot(gut_model):
    controller, world, target = begin(gut_model)
    run(controller, world, target, 0.1)
    saved, snapshot = controller.to_array(), world.snapshot()
    run(controller, world, target, 0.1)
    other, again, _ = begin(gut_model)
    other.restore(saved)
    again.restore(snapshot)
    run(other, again, target, 0.1)
    np.testing.assert_array_equal(other.to_array(), controller.to_array())
    np.testing.assert_array_equal(again.T_world_capsule, world.T_world_capsule)


def test_joystick_moves_the_magnet_within_its_room(gut_model):
    actuator = FreeActuator(Workspace(low=(-1, -1, 0.1), high=(1, 1, 0.19)))
    controller, world, _ = begin(gut_model, actuator=actuator, others=[UniformField(5e-5)])
    start = controller.status.actuator.T_world_magnet
    for _ in range(100):
        control = controller.jog((0.5, 0, 1), (0, 0, 0.5), DT, speed=0.1, angular_speed=0.2)
        world.step(control, DT)
    controller.update_status(world)
    moved = invert(start) @ controller.status.actuator.T_world_magnet
    assert np.linalg.norm(moved[:3, 3]) > 0.03
    assert controller.status.actuator.T_world_magnet[2, 3] <= 0.19
    turn = np.arccos((np.trace(moved[:3, :3]) - 1.0) / 2.0)
    assert turn == pytest.approx(0.1, abs=0.03)
    np.testing.assert_allclose(
        world.coupling.Ts_world_magnet[0], controller.status.actuator.T_world_magnet, atol=1e-12
    )


@pytest.mark.slow
def test_a_turning_magnet_turns_the_capsule(gut_model):
    """About the vertical the capsule follows, as far as the tube lets it."""
    controller, world, target = begin(gut_model)
    run(controller, world, target, 0.5)
    for _ in range(100):
        world.step(controller.jog((0, 0, 0), (0, 0, 1), DT, speed=0.1, angular_speed=0.3), DT)
    yaw = np.arctan2(world.T_world_capsule[1, 2], world.T_world_capsule[0, 2])
    assert 0.1 < yaw < 0.4


def test_says_why_the_capsule_is_lost(gut_model):
    """Kept too far off the magnet is too weak and the capsule falls; turned round it is turned."""
    high = FreeActuator(Workspace(low=(-1, -1, 0.6), high=(1, 1, 1)))
    controller, world, target = begin(gut_model, actuator=high)
    run(controller, world, target, 0.4)
    assert controller.status.lost == "wrong_wall"
    assert np.linalg.norm(controller.status.predicted_force) < np.linalg.norm(
        controller.status.required_force
    )
    quick = FreeActuator(max_angular_speed=1e3, max_angular_acceleration=1e6)
    controller, world, target = begin(gut_model, actuator=quick)
    world.step(controller.jog((0, 0, 0), (0, 0, 1), DT, speed=0.1, angular_speed=300.0), 1e-3)
    controller.update_status(world)
    assert controller.status.lost == "misaligned"


def test_goals_along_a_gut_and_on_its_wall(gut_model):
    line = gut_model.organ.centerline
    target = centerline_target(line, np.eye(4), 0.05, yaw=0.3)
    np.testing.assert_allclose(target.position, [0.05, 0, 0], atol=1e-12)
    assert np.asarray(target.direction)[0] == pytest.approx(np.cos(0.3))
    np.testing.assert_allclose(target.wall_normal, [0, 0, 1], atol=1e-12)
    back = centerline_target(line, posture_transform("prone"), 0.05, is_backward=True, wall="lower")
    assert np.asarray(back.tangent) @ np.asarray(back.direction) == pytest.approx(-1.0)
    assert np.asarray(back.wall_normal)[2] == pytest.approx(-1.0)
    standing = centerline_target(line, magnet_pose((0, 0, 0), (-1, 0, 0)), 0.05)  # the gut upright
    assert abs(np.asarray(standing.wall_normal)[2]) < 1e-9
    on_wall = wall_target(gut_model, np.array([0.1, 0, 0.01]), np.array([1.0, 0, 1.0]))
    np.testing.assert_allclose(on_wall.position, [0.1, 0, 0.008], atol=5e-4)
    np.testing.assert_allclose(on_wall.wall_normal, [0, 0, 1], atol=0.2)


def test_what_cannot_be(gut_model):
    with pytest.raises(InputError, match="lookahead is 0"):
        ControllerGains(lookahead=0.0)
    with pytest.raises(InputError, match="arc_length is 1"):
        centerline_target(gut_model.organ.centerline, np.eye(4), 1.0)
    with pytest.raises(InputError, match="CapsuleTarget's direction is"):
        CapsuleTarget((0, 0, 0), (0, 0, 2))
    with pytest.raises(InputError, match="perpendicular to the wall"):
        wall_target(gut_model, np.array([0.1, 0, 0.01]), wall_target(
            gut_model, np.array([0.1, 0, 0.01]), np.array([1.0, 0, 0])).wall_normal)  # fmt: skip
    controller, _, _ = begin(gut_model)
    with pytest.raises(InputError, match="Joystick axes"):
        controller.jog((2, 0, 0), (0, 0, 0), DT, speed=0.1, angular_speed=0.1)
