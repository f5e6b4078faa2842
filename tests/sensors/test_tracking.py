"""Tracking of a capsule: the filter's pose is as good as its covariance says, roll included."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from tests.support.tubes import straight_gut
from vrcaps.capsule.device_file import read_device
from vrcaps.core.errors import InputError
from vrcaps.core.geometry import rotate_by_vector, rotation_vector, transform_from
from vrcaps.magnet.presets import read_magnet
from vrcaps.magnet.sources import magnet_pose
from vrcaps.sensors.pose_filter import PoseBelief, correct, located_magnet, predict
from vrcaps.sensors.sensors import Imu, hall_array
from vrcaps.sensors.tracking import CapsuleTracker, TrackingSensors
from vrcaps.world.control import GRAVITY
from vrcaps.world.model import Model, posture_transform

PERIOD = 0.01
MAGNET = read_magnet("cylinder-76.2", magnet_pose((0.1, 0.0, 0.25), (1.0, 0.0, 0.2)))
TURN = np.array([0.02, 0.05, -0.1])


@pytest.fixture(scope="module")
def model() -> Model:
    gut = straight_gut({"jejunum": 0.2}, radius=0.014, edge=6e-3)
    return Model(gut, read_device("magnetic"), posture_transform("supine"))


def still(model: Model) -> np.ndarray:
    return model.place(0.1).T_world_capsule


def world_at(start: np.ndarray, time: float) -> SimpleNamespace:
    """A capsule that swings by 2 mm along the gut and turns slowly."""
    slow = 2.0 * np.pi * 0.5
    place = start[:3, 3] + [2e-3 * np.sin(slow * time), 0.0, 0.0]
    speed = np.array([2e-3 * slow * np.cos(slow * time), 0.0, 0.0])
    pose = transform_from(rotate_by_vector(time * TURN, start[:3, :3]), place)
    return SimpleNamespace(time=time, T_world_capsule=pose, velocity_world=np.array([speed, TURN]))


def tracked(model: Model, count: int = 100, seed: int = 0) -> tuple[CapsuleTracker, np.ndarray]:
    tracker = CapsuleTracker(model, TrackingSensors(), still(model), period=PERIOD, seed=seed)
    errors = []
    for k in range(count):
        world = world_at(still(model), k * PERIOD)
        tracker.read(world, [MAGNET])
        true, found = world.T_world_capsule, tracker.T_world_capsule
        off = found[:3, 3] - true[:3, 3]
        turn = true[:3, :3].T @ rotation_vector(true[:3, :3], found[:3, :3])
        speed = tracker.velocity_world[0] - world.velocity_world[0]
        errors.append([*off, *turn, *speed])
    return tracker, np.array(errors)


@pytest.mark.slow
def test_finds_position_velocity_and_roll(model):
    """It begins up to a centimeter and 10° off; roll is seen by weight, which Hall sensors miss."""
    for seed in range(3):
        tracker, errors = tracked(model, seed=seed)
        late = np.abs(errors[50:])
        assert np.linalg.norm(late[:, :3], axis=1).max() < 4e-3
        assert np.degrees(late[:, 3:6]).max() < 1.0
        assert np.linalg.norm(late[:, 6:], axis=1).max() < 6e-3
        assert np.linalg.norm(errors[-1, :3]) < 3.0 * tracker.belief.position_sigma
        assert abs(errors[-1, 5]) < 4.0 * tracker.belief.roll_sigma < 4.0 * np.radians(1.0)


def test_goes_on_from_its_state_and_reads_once_at_a_time(model):
    tracker, _ = tracked(model, 5)
    saved = tracker.to_array()
    tracker.read(world_at(still(model), 4 * PERIOD), [MAGNET])
    np.testing.assert_array_equal(tracker.to_array(), saved)
    other, _ = tracked(model, 2)
    other.restore(saved, [MAGNET])
    for one in (tracker, other):
        one.read(world_at(still(model), 5 * PERIOD), [MAGNET])
    np.testing.assert_array_equal(other.to_array(), tracker.to_array())


def test_force_of_the_wall_is_what_the_accelerometer_feels_beside_the_magnet(model):
    start = still(model)
    sensors = TrackingSensors(position_error=1e-6, angle_error=1e-6)
    tracker = CapsuleTracker(model, sensors, start, period=PERIOD, seed=0)
    for k in range(3):
        rest = SimpleNamespace(
            time=k * PERIOD, T_world_capsule=start, velocity_world=np.zeros((2, 3))
        )
        tracker.read(rest, [])
    weight = model.device.mass * GRAVITY
    axis = start[:3, 2]
    across = weight * (np.array([0.0, 0.0, 1.0]) - axis * axis[2])
    np.testing.assert_allclose(tracker.contact_force_world, across, atol=0.02 * weight)


def test_a_correction_undoes_an_error_within_its_linear_range(model):
    """With exact readings the mean comes back, and the covariance shrinks in what is seen."""
    (magnet,) = model.device.magnets
    array = hall_array(TrackingSensors().hall, model).positions_world
    true = PoseBelief(still(model), *np.zeros((3, 3)), np.array([0, 2e-5, -4e-5]), np.eye(18))
    sigma = np.repeat([5e-3, 1e-6, 0.1, 1e-6, 1e-6, 1e-4], 3)
    off = np.zeros(18)
    off[[0, 1, 2, 6, 7]] = 4e-3, -3e-3, 5e-3, 0.1, -0.05
    belief = replace(true.moved(off), covariance=np.diag(sigma**2))
    source, _ = located_magnet(still(model), magnet)
    from vrcaps.magnet.field import field

    readings = field([source], array)[0] + true.background
    readings[0] = np.nan
    found = correct(belief, array, readings, np.full(readings.shape, 1e-8), magnet)
    assert np.linalg.norm(found.error_from(true)[:3]) < 1e-5
    axes = [pose.T_world_capsule[:3, 2] for pose in (found, true)]
    assert np.linalg.norm(axes[0] - axes[1]) < 1e-4
    assert found.position_sigma < 1e-4
    assert np.linalg.eigvalsh(found.covariance).min() > -1e-15


def test_prediction_propagates_errors_as_its_mean_does(model):
    """The covariance's step is the derivative of the mean's, by central differences."""
    rng = np.random.default_rng(0)
    start = PoseBelief(still(model), *(0.1 * rng.normal(size=(3, 3))), np.zeros(3), np.eye(18))
    force, turn, quiet = (
        rng.normal(size=3) * 5.0,
        rng.normal(size=3),
        Imu(
            accelerometer_noise=0.0, gyroscope_noise=0.0, accelerometer_walk=0.0, gyroscope_walk=0.0
        ),
    )
    ahead = predict(start, quiet, force, turn, 1e-3)
    step, h = np.zeros((18, 18)), 1e-6
    for k, axis in enumerate(np.eye(18)):
        ends = [
            predict(start.moved(s * h * axis), quiet, force, turn, 1e-3).error_from(ahead)
            for s in (1.0, -1.0)
        ]
        step[:, k] = (ends[0] - ends[1]) / (2.0 * h)
    np.testing.assert_allclose(ahead.covariance, step @ step.T, atol=2e-5)


def test_a_clipped_reading_is_told_by_the_covariance(model):
    """A capsule turned over faster than the gyroscope reads is off by what the filter states."""
    unit, dt, rate = Imu(gyroscope_range=10.0, accelerometer_range=30.0), 0.01, 17.0
    belief = PoseBelief(still(model), *np.zeros((4, 3)), 1e-12 * np.eye(18))
    rotation = belief.T_world_capsule[:3, :3]
    gravity = rotation.T @ [0.0, 0.0, GRAVITY]
    read = np.array([-unit.gyroscope_range, 0.5, 0.0])
    found = predict(belief, unit, gravity + np.array([0.0, 50.0, 0.0]), read, dt)
    found_within = predict(belief, unit, gravity, np.array([-9.0, 0.5, 0.0]), dt)
    true = rotate_by_vector(rotation @ [-rate, 0.5, 0.0] * dt, rotation)
    off = np.linalg.norm(rotation_vector(true, found.T_world_capsule[:3, :3]))
    sigma = np.sqrt(np.diag(found.covariance))
    assert off == pytest.approx(0.07, rel=1e-2)
    assert np.linalg.norm(sigma[6:9]) == pytest.approx(0.1, rel=1e-2)
    axis = rotation[:, 0] * dt * unit.gyroscope_range
    np.testing.assert_allclose(found.covariance[6:9, 6:9], np.outer(axis, axis), atol=1e-4)
    assert np.linalg.norm(sigma[3:6]) == pytest.approx(0.3, rel=2e-2)
    assert np.sqrt(np.diag(found_within.covariance))[6:9].max() < 1e-3


def test_one_magnet_is_located(model):
    twice = replace(model.device, magnets=model.device.magnets * 2)
    with pytest.raises(InputError, match=r"by one magnet in the capsule; .* has 2\. Give"):
        CapsuleTracker(
            replace(model, device=twice), TrackingSensors(), still(model), period=0.01, seed=0
        )
