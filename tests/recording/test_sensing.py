"""Sensors read in each frame: closed forms of motion and field, and the place that is found."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from vrcaps.capsule.device_file import read_device
from vrcaps.core.errors import InputError
from vrcaps.core.geometry import transform_from
from vrcaps.motion.motion import Step, with_neighbors
from vrcaps.recording.episode import read_episode
from vrcaps.recording.recorder import record
from vrcaps.recording.sensing import SensorReadings
from vrcaps.recording.table import FrameTable
from vrcaps.scenario.build import ResolvedScenario, resolve
from vrcaps.scenario.scenario import Scenario, scenario_from_plain, scenario_to_plain
from vrcaps.sensors.sensors import HallPad, Imu, Magnetometer, Sensors, hall_array
from vrcaps.world.model import Model, State

GRAVITY = np.array([0.0, 0.0, -9.80665])
SILENT = Imu(
    accelerometer_noise=0.0, gyroscope_noise=0.0, accelerometer_walk=0.0, gyroscope_walk=0.0
)
ALL = Sensors(Imu(), Magnetometer(), HallPad())
FPS = 4.0


@pytest.fixture(scope="module")
def model(organ) -> Model:
    return Model(organ, read_device("magnetic"))


def scenario_of(sensors: Sensors) -> ResolvedScenario:
    return resolve(Scenario(fps=FPS, seed=3, sensors=sensors))


def steps_along(model: Model, count: int) -> list[Step]:
    """A capsule that turns and speeds up evenly, in the middle of the gut."""
    line = model.organ.centerline
    middle = (model.T_world_patient @ [*line.points[len(line.points) // 2], 1.0])[:3]
    spin, gain = np.array([0.2, -0.1, 0.4]), np.array([0.01, 0.02, -0.01])
    states = []
    for k in range(count):
        t = k / FPS
        pose = transform_from(
            Rotation.from_rotvec(spin * t).as_matrix(), middle + 0.5 * gain * t**2
        )
        states.append(State(t, pose, gain * t, spin))
    moments = enumerate(with_neighbors(states))
    return [Step(k, state, previous, after) for k, (previous, state, after) in moments]


def vector(row: dict[str, float], name: str) -> np.ndarray:
    return np.array([row[name.format(axis)] for axis in "xyz"])


def test_inertial_unit_reads_acceleration_and_weight_in_its_own_frame(model):
    unit = replace(SILENT, position_capsule=(0.0, 0.004, 0.0))
    steps = steps_along(model, 5)
    readings = SensorReadings(model, scenario_of(Sensors(imu=unit)))
    spin, arm = np.array([0.2, -0.1, 0.4]), np.array([0.0, 0.004, 0.0])
    for step in steps:
        row, rotation = readings.read(step), step.state.T_world_capsule[:3, :3]
        turned = rotation @ arm
        swing = np.cross(spin, np.cross(spin, turned))
        expected = rotation.T @ (np.array([0.01, 0.02, -0.01]) + swing - GRAVITY)
        np.testing.assert_allclose(vector(row, "accelerometer_{}_m_per_s2"), expected, atol=1e-12)
        gyroscope = vector(row, "gyroscope_{}_rad_per_s")
        np.testing.assert_allclose(gyroscope, rotation.T @ spin, atol=1e-12)


def test_magnetometer_reads_the_earth_in_its_own_frame(model):
    sensors = Sensors(magnetometer=Magnetometer(noise=0.0))
    readings = SensorReadings(model, scenario_of(sensors))
    for step in steps_along(model, 3):
        rotation = step.state.T_world_capsule[:3, :3]
        read = vector(readings.read(step), "magnetometer_{}_t")
        np.testing.assert_allclose(read, rotation.T @ [0.0, 20e-6, -45e-6], atol=1e-12)


def test_hall_sensors_find_the_magnet(model):
    readings = SensorReadings(model, scenario_of(ALL))
    (magnet,) = model.device.magnets
    for step in steps_along(model, 4):
        row, pose = readings.read(step), step.state.T_world_capsule
        place = pose[:3, :3] @ magnet.position_capsule + pose[:3, 3]
        axis = pose[:3, :3] @ magnet.moment_capsule / np.linalg.norm(magnet.moment_capsule)
        error = np.linalg.norm(vector(row, "localized_{}_m") - place)
        assert error < 5e-3
        assert error < 5.0 * row["localized_sigma_m"] + 1e-4
        assert vector(row, "localized_axis_{}") @ axis > np.cos(np.radians(4.0))


def test_out_of_range_there_is_no_place(model):
    (step,) = steps_along(model, 1)
    deaf = SensorReadings(model, scenario_of(Sensors(hall=HallPad(range=0.2e-6)))).read(step)
    assert np.isnan(deaf["hall_0_z_t"])
    assert np.isnan(vector(deaf, "localized_{}_m")).all()
    assert np.isnan(deaf["localized_sigma_m"])


def test_far_away_the_place_is_uncertain(model):
    (step,) = steps_along(model, 1)
    far = SensorReadings(model, scenario_of(Sensors(hall=HallPad(gap=1.0)))).read(step)
    assert far["localized_sigma_m"] > 5e-3


def test_goes_on_with_the_same_readings(model):
    steps = steps_along(model, 8)
    whole = SensorReadings(model, scenario_of(ALL))
    rows = [whole.read(step) for step in steps]
    table = FrameTable(
        {"frame": np.arange(5)} | {name: np.array([r[name] for r in rows[:5]]) for name in rows[0]}
    )
    later = SensorReadings(model, scenario_of(ALL), table)
    assert [later.read(step) for step in steps[5:]] == rows[5:]


@pytest.mark.slow
def test_an_episode_has_the_readings(tmp_path, monkeypatch, base_scenario, organ):
    from vrcaps.scenario.build import OrganSource

    monkeypatch.setattr(OrganSource, "load_healthy", lambda _: organ)
    asked = replace(base_scenario, capsule="magnetic", sensors=ALL, frames=3, channels=("label",))
    episode = read_episode(record(asked, tmp_path / "episode"))
    columns, places = episode.table.columns, np.array(episode.head["hall_positions_m"])
    assert places.shape == (64, 3)
    assert f"hall_{len(places) - 1}_z_t" in columns
    assert np.isfinite(columns["localized_x_m"]).all()
    assert scenario_from_plain(scenario_to_plain(asked)) == asked


def test_sensors_that_cannot_be(organ, model):
    bare = Model(organ, read_device("mirocam"))
    with pytest.raises(InputError, match=r"mirocam has 0\. Give a capsule with one"):
        SensorReadings(bare, scenario_of(ALL))
    with pytest.raises(InputError, match="gap"):
        hall_array(HallPad(gap=np.inf), model)
