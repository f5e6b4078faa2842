"""Magnet and arm as actuation: where the magnet begins, how actions move it, and what stops it."""

from types import SimpleNamespace

import numpy as np
import pytest

from tests.support.small_envs import simulation_of, small_settings
from vrcaps.actuation.arm.arm_with_payload import clearances, magnet_pose_at
from vrcaps.core.errors import InputError, UnknownNameError
from vrcaps.core.geometry import rotation_from_vector
from vrcaps.env.actuation import ArmActuation, MagnetActuation, Wrench
from vrcaps.env.episode import Episode
from vrcaps.env.simulation import Simulation
from vrcaps.magnet.field import wrench
from vrcaps.magnet.presets import read_magnet
from vrcaps.world.control import GRAVITY

PERIOD = 1.0 / 6.0


def started(actuation: MagnetActuation | ArmActuation, count: int = 1) -> Episode:
    episode = Episode(small_settings(actuation=actuation), count)
    for index in range(count):
        episode.begin(index, np.random.default_rng(index))
    return episode


def moved(simulation: Simulation, action: np.ndarray, times: int = 1) -> np.ndarray:
    """Pose of the magnet after an action was given some times, without stepping worlds."""
    numbers = np.array([0])
    for _ in range(times):
        controls = simulation.settings.actuation.controls(simulation.view, action[None], numbers)
    pose = simulation.memory["magnet/T"][0]
    assert (controls[0].Ts_world_magnet[0] == pose).all()
    return pose


@pytest.mark.parametrize("actuation", [MagnetActuation(), ArmActuation()])
def test_the_magnet_begins_where_it_carries_the_capsule_but_does_not_lift_it(actuation) -> None:
    simulation = Simulation(small_settings(actuation=actuation), 1)
    model = simulation.worlds.enter(0, 0)
    start, _ = simulation.settings.start.draw(model, np.random.default_rng(0))
    (source,) = actuation.begin(simulation.view, 0, start)
    device = simulation.worlds.device
    force, torque = wrench([source], device.magnets, start.T_world_capsule)
    assert 0.3 < force[2] / (device.mass * GRAVITY) < 1.0
    assert np.linalg.norm(force[:2]) < 0.01
    assert np.linalg.norm(torque) < 1e-3
    assert (source.T_world_magnet == simulation.memory["magnet/T"][0]).all()


def test_a_twist_moves_the_magnet_at_its_speed_and_turns_it_about_the_worlds_axes() -> None:
    simulation = started(MagnetActuation(speed=0.03, angular_speed=0.5)).simulation
    before = simulation.memory["magnet/T"][0].copy()
    after = moved(simulation, np.array([1.0, 0.0, -0.0, 0.0, 0.0, 0.0]))
    assert after[:3, 3] - before[:3, 3] == pytest.approx([0.03 * PERIOD, 0.0, 0.0])
    turned = moved(simulation, np.array([0.0, 0.0, 0.0, 0.0, 0.0, -1.0]))
    angle = -0.5 * PERIOD
    spin = [[np.cos(angle), -np.sin(angle), 0.0], [np.sin(angle), np.cos(angle), 0.0], [0, 0, 1]]
    assert turned[:3, :3] == pytest.approx(np.array(spin) @ before[:3, :3])


def test_the_magnet_stays_in_its_box_and_off_the_skin() -> None:
    actuation = MagnetActuation(speed=0.5, reach=0.1)
    simulation = started(actuation).simulation
    top = simulation.worlds.patient(0).model.vertices_world.max(axis=0)
    down = moved(simulation, np.array([1.0, 1.0, -1.0, 1.0, 1.0, 1.0]), 20)
    assert down[2, 3] == pytest.approx(top[2] + 0.04 + 0.5 * read_magnet(actuation.magnet).diameter)
    assert down[:2, 3] == pytest.approx(top[:2] + 0.1)
    assert down[:3, :3] @ down[:3, :3].T == pytest.approx(np.eye(3), abs=1e-12)


def test_joints_move_at_a_fraction_of_their_limits_and_carry_the_magnet() -> None:
    actuation = ArmActuation(fraction=0.05)
    simulation = started(actuation).simulation
    memory, arm = simulation.memory, actuation._robot.arm
    before, action = memory["arm/joints"][0].copy(), np.linspace(-1.0, 1.0, 7)
    pose = moved(simulation, action)
    steps = memory["arm/joints"][0] - before
    limits = np.array([joint.velocity for joint in arm.joints])
    assert steps == pytest.approx(0.05 * PERIOD * limits * action)
    expected = magnet_pose_at(actuation._robot, memory["arm/joints"][0])
    expected[:3, 3] += memory["arm/base"][0]
    assert pose == pytest.approx(expected)


@pytest.mark.parametrize("sign", [-1.0, 1.0])
@pytest.mark.parametrize("joint", range(7))
def test_the_arm_stops_at_the_end_of_a_joint_and_before_it_touches(joint: int, sign: float) -> None:
    episode = started(ArmActuation(fraction=1.0))
    simulation, actuation = episode.simulation, episode.settings.actuation
    moved(simulation, sign * np.eye(7)[joint], 40)
    arm, angles = actuation._robot.arm, simulation.memory["arm/joints"]
    assert episode.measures()["arm_limit"][0] in ("joint", "collision")
    assert (angles >= arm.lower).all() and (angles <= arm.upper).all()
    assert clearances(actuation._robot, angles).min() >= 0.0


def test_an_arm_that_does_not_reach_begins_at_rest(monkeypatch: pytest.MonkeyPatch) -> None:
    actuation = ArmActuation()

    def fails(self, T_world_magnet, near=None) -> None:
        raise InputError("out of reach")

    monkeypatch.setattr("vrcaps.actuation.magnet_actuator.RobotActuator.start", fails)
    simulation = started(actuation).simulation
    assert simulation.memory["arm/joints"][0] == pytest.approx(actuation._robot.arm.home)


def test_bad_settings_are_one_clear_line() -> None:
    with pytest.raises(UnknownNameError, match="No magnet named 'horseshoe'"):
        MagnetActuation(magnet="horseshoe")
    with pytest.raises(UnknownNameError, match="No arm named 'tentacle'"):
        ArmActuation(arm="tentacle")
    with pytest.raises(InputError, match="ArmActuation's standoff is 1 m"):
        ArmActuation(standoff=1.0)
    with pytest.raises(InputError, match="speed"):
        MagnetActuation(speed=0.0)
    with pytest.raises(InputError, match="The capsule contains no magnet"):
        episode = Episode(small_settings(actuation="magnet", capsule="pillcam-sb3"), 1)
        episode.begin(0, np.random.default_rng(0))


def test_a_wrench_in_the_capsules_frame_turns_with_it() -> None:
    action = np.array([[0.5, -0.25, 1.0, 0.1, 0.2, -0.3]])
    R = rotation_from_vector(np.array([0.3, -0.4, 1.2]))
    pose = np.eye(4)[None].copy()
    pose[0, :3, :3] = R
    worlds = SimpleNamespace(T_world_capsule=pose)
    numbers = np.array([0])
    (fixed,) = Wrench().controls(worlds, action, numbers)  # type: ignore[arg-type]
    (turned,) = Wrench(frame="capsule").controls(worlds, action, numbers)  # type: ignore[arg-type]
    assert np.allclose(turned.force_world, R @ fixed.force_world)
    assert np.allclose(turned.torque_world, R @ fixed.torque_world)


def test_momentum_lasts_as_long_under_both_dynamics() -> None:
    """A weightless capsule that F pushes ends at v = F τ/m; nothing spins it up further."""
    for dynamics in ("quasi-static", "physics"):
        actuation = Wrench(force=1e-3, torque=2e-8, is_weightless=True)
        simulation = simulation_of(1, dynamics=dynamics, actuation=actuation)
        for _ in range(6):
            simulation.step(np.array([[1.0, 0, 0, 0, 1.0, 0]]), np.ones(1, bool))
        speed, spin = np.linalg.norm(simulation.worlds.velocity_world[0], axis=1)
        body = simulation.worlds.batch.worlds[0].body
        assert speed == pytest.approx(1e-3 * 0.1 / body.mass, rel=1e-3)
        assert spin == pytest.approx(2e-8 * 0.1 / body.inertia[1, 1], rel=0.01)
