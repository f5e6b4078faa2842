"""Coils: fields by Biot and Savart's law, rise and heating in closed form, recordings, errors."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from tests.support.scenes import relative
from tests.support.small_envs import GUT, small_settings
from vrcaps.actuation.coil_array import (
    CoilArray,
    CoilState,
    Electromagnet,
    MappedCoil,
    advance_coils,
    coil_array_names,
    coils_at_rest,
    currents_for_wrench,
    read_coil_array,
    unit_wrenches,
)
from vrcaps.actuation.coil_program import CoilSteering, Currents, coil_command_columns
from vrcaps.actuation.steering_program import JoystickCommand, MagnetSteering
from vrcaps.capsule.device_file import read_device
from vrcaps.core.errors import InputError, UnknownNameError
from vrcaps.env.coil_actuation import CoilActuation
from vrcaps.env.simulation import Simulation
from vrcaps.magnet.field import field
from vrcaps.magnet.sources import MAGNETIC_CONSTANT, FieldMap
from vrcaps.motion.dynamics import Dynamics
from vrcaps.motion.rollout import Rollout
from vrcaps.scenario.scenario import Scenario, scenario_from_plain, scenario_to_plain
from vrcaps.world.model import Model, posture_transform

COIL = Electromagnet(
    position=(0.0, 0.0, -0.06), max_current=20.0, radius=0.04, length=0.1, turns=300
)
TWO = CoilArray((COIL, replace(COIL, position=(0.1, 0.0, -0.06), direction=(0.0, 1.0, 0.0))))


def biot_savart(coil: Electromagnet, current: float, points: np.ndarray) -> np.ndarray:
    """∮ μ₀/4π I dl × r/r³ over every winding, 400 pieces each, wound without pitch."""
    pose = coil.pose(np.eye(4))
    angles = 2 * np.pi * (np.arange(400) + 0.5) / 400
    ring = coil.radius * np.stack([np.cos(angles), np.sin(angles), 0 * angles], axis=1)
    pieces = 2 * np.pi * coil.radius / 400 * np.stack([-ring[:, 1], ring[:, 0]], axis=1)
    pieces = np.pad(pieces, ((0, 0), (0, 1))) / coil.radius
    total = np.zeros_like(points)
    for k in range(coil.turns):
        z = ((k + 0.5) / coil.turns - 0.5) * coil.length
        r = points[:, None] - ((ring + np.array([0, 0, z])) @ pose[:3, :3].T + pose[:3, 3])
        cross = np.cross(pieces @ pose[:3, :3].T, r)
        total += (cross / np.linalg.norm(r, axis=2, keepdims=True) ** 3).sum(axis=1)
    return MAGNETIC_CONSTANT / (4 * np.pi) * current * total


def test_an_array_has_the_field_of_its_windings():
    rng = np.random.default_rng(0)
    points = rng.uniform([-0.1, -0.1, 0.03], [0.2, 0.1, 0.2], (20, 3))
    currents = (7.0, -12.0)
    pairs = zip(TWO.coils, currents, strict=True)
    expected = sum(biot_savart(coil, current, points) for coil, current in pairs)
    powered = zip(TWO.sources(np.eye(4)), currents, strict=True)
    sources = [replace(source, strength=current) for source, current in powered]
    assert relative(field(sources, points)[0], expected).max() < 1e-5
    assert not field(TWO.sources(np.eye(4)), points)[0].any()


def test_currents_rise_exponentially_up_to_their_limit():
    """I = I₀ (1 − e^{−t/τ}), in one step as in many; more than the maximum is clipped."""
    state, command = coils_at_rest(TWO), np.array([10.0, -50.0])
    once = advance_coils(TWO, state, command, 0.03).currents
    for _ in range(30):
        state = advance_coils(TWO, state, command, 0.001)
    np.testing.assert_allclose(state.currents, once, rtol=1e-12)
    np.testing.assert_allclose(once, np.array([10.0, -20.0]) * (1 - np.exp(-0.03 / 0.02)))


def test_coils_heat_to_the_temperature_of_their_power_and_are_then_switched_off():
    """T − T_a = R_th R I² (1 − e^{−t/R_th C}) without rise time; the energy is that of R I²."""
    coil = replace(COIL, rise_time=0.0, resistance=0.5, thermal_resistance=0.4, heat_capacity=100.0)
    array = CoilArray((coil,))
    state = advance_coils(array, coils_at_rest(array), np.array([20.0]), 30.0)
    expected = 25.0 + 0.4 * 0.5 * 400.0 * (1 - np.exp(-30.0 / 40.0))
    np.testing.assert_allclose(state.temperatures, expected)
    hot = replace(state, temperatures=np.array([90.0]))
    state = advance_coils(array, hot, np.array([20.0]), 1.0)
    assert state.is_hot.all()
    assert state.currents == 0.0
    np.testing.assert_allclose(state.temperatures, 25.0 + 65.0 * np.exp(-1.0 / 40.0))


def test_heating_over_the_rise_of_the_current_is_its_integral():
    array = CoilArray((replace(COIL, heat_capacity=100.0, thermal_resistance=1e6),))
    start = CoilState(np.array([-8.0]), np.array([25.0]), np.array([False]))
    t = np.linspace(0.0, 0.05, 20001)
    current = 15.0 - 23.0 * np.exp(-t / 0.02)
    heat = np.trapezoid(current**2, t) / 100.0
    state = advance_coils(array, start, np.array([15.0]), 0.05)
    np.testing.assert_allclose(state.temperatures - 25.0, heat, rtol=1e-6)


def test_currents_for_a_wrench_exert_it_within_their_limits():
    array, magnets = read_coil_array("table-3x3"), read_device("magnetic").magnets
    pose = np.eye(4)
    pose[:3, 3] = (0.02, -0.01, 0.05)
    wrenches = unit_wrenches(array.sources(np.eye(4)), magnets, pose)
    target = np.array([0.02, 0.01, 0.05, 2e-4, -1e-4, 0.0])  # no torque about the moment, z
    currents = currents_for_wrench(wrenches, target, array.values("max_current"))
    np.testing.assert_allclose(wrenches @ currents, target, atol=1e-9)
    far = currents_for_wrench(wrenches, 1e4 * target, array.values("max_current"))
    assert np.abs(far).max() == pytest.approx(60.0)


def tube_model() -> Model:
    return Model(GUT, read_device("magnetic"), posture_transform("supine"))


def begun(steering: CoilSteering, frames: int = 4) -> Rollout:
    motion = Dynamics(coils=steering, substep=2e-4, dynamics="quasi-static", settle=0.1)
    return motion.begin(tube_model(), frames=frames, fps=10.0, seed=0)


def test_a_recording_has_currents_temperatures_and_the_coupling():
    ramp = (Currents(0.0, (0.0,) * 9), Currents(0.2, (*(0.0,) * 4, 100.0, *(0.0,) * 4)))
    rollout = begun(CoilSteering(ramp))
    rows = [rollout.columns(step) for step in rollout.steps()]
    assert {*rollout.settings.column_names} == {*rows[0], "capsule_along_gut_m_per_s"}
    assert rows[0]["coil_5_current_a"] == 0.0
    assert 0.0 < rows[1]["coil_5_current_a"] < rows[1]["coil_5_command_a"] == pytest.approx(45.0)
    assert rows[3]["coil_5_current_a"] == pytest.approx(60.0, rel=1e-2)
    assert rows[3]["coil_limit"] == "current"
    assert rows[3]["coil_5_temperature_c"] > rows[1]["coil_5_temperature_c"] > 25.0
    assert abs(rows[3]["magnetic_force_z_n"]) > 1e-3


def test_a_checkpoint_resumes_to_the_same_currents():
    steering = CoilSteering(joystick=(JoystickCommand(0.0, (0.0, 0.5, 0.0)),))
    rollout = begun(steering)
    steps = list(rollout.moments(None, lambda *_: None, lambda: True))
    again = begun(steering)
    resumed = list(again.moments(steps[1].checkpoint, lambda *_: None, lambda: False))
    for one, other in zip(steps[2:], resumed[1:], strict=True):
        assert np.array_equal(one.command.coils.state.currents, other.command.coils.state.currents)
        assert np.array_equal(one.state.T_world_capsule, other.state.T_world_capsule)
    assert (steps[-1].command.coils.state.currents != 0.0).any()


def test_an_environment_follows_and_switches_off():
    actuation = CoilActuation(TWO)
    simulation = Simulation(small_settings(actuation=actuation), 2)
    for index in range(2):
        simulation.reset(index, np.random.default_rng(index))
    actions = np.array([[1.0, -0.5], [0.0, 0.0]], np.float32)
    simulation.step(actions, np.array([True, True]))
    period = simulation.settings.control_period
    expected = np.array([20.0, -10.0]) * (1 - np.exp(-period / 0.02))
    np.testing.assert_allclose(simulation.memory["coils/current"][0], expected)
    coupling = simulation.worlds.batch.worlds[0].coupling
    np.testing.assert_allclose(coupling.strengths, expected)
    assert actuation.space().shape == (2,)
    simulation.memory["coils/temperature"][0] = 95.0
    simulation.step(actions, np.array([True, True]))
    assert actuation.measures(simulation.view)["coil_limit"].tolist() == ["temperature", ""]
    assert np.abs(simulation.memory["coils/current"][0]).max() < 0.1


def test_a_measured_coil_is_its_map_per_ampere(tmp_path):
    axes = (np.linspace(-0.2, 0.2, 21),) * 3
    grid = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1)
    (source,) = CoilArray((replace(COIL, position=(0.0, 0.0, -0.3)),)).sources(np.eye(4))
    values = field([replace(source, strength=5.0)], grid.reshape(-1, 3))[0] * 1e3
    table = np.concatenate([grid.reshape(-1, 3) * 1e3, values], axis=1)
    names = "x_mm,y_mm,z_mm,bx_mT,by_mT,bz_mT"
    np.savetxt(tmp_path / "one.csv", table, delimiter=",", header=names, comments="")
    (tmp_path / "mine.toml").write_text(
        '[[coils]]\nkind = "map"\nmap = "one.csv"\nmap_current_a = 5\nposition_mm = [0, 0, 0]\n'
        "max_current_a = 10\n"
    )
    array = read_coil_array(tmp_path / "mine.toml")
    assert isinstance(array.coils[0], MappedCoil)
    (mapped,) = array.sources(np.eye(4))
    assert isinstance(mapped, FieldMap)
    points = np.array([[0.01, 0.02, 0.05], [-0.05, 0.03, 0.1]])
    ours = field([replace(mapped, strength=2.0)], points)[0]
    assert relative(ours, field([replace(source, strength=2.0)], points)[0]).max() < 1e-3
    text = (tmp_path / "mine.toml").read_text()
    (tmp_path / "mine.toml").write_text(text.replace("one.csv", "../one.csv"))
    with pytest.raises(InputError, match="leads out of"):
        read_coil_array(tmp_path / "mine.toml")


def test_scenarios_hold_the_array():
    scenario = Scenario("stomach", "magnetic", motion=Dynamics(coils=CoilSteering(coils=TWO)))
    assert scenario_from_plain(scenario_to_plain(scenario)).motion.coils.array == TWO
    assert coil_array_names() == ("table-3x3",)


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: CoilSteering(coils="big"), "No coil array named 'big'. Known: table-3x3"),
        (lambda: CoilSteering(coils=3), r"coils is 3\. Allowed: a string or a CoilArray"),
        (lambda: read_coil_array(3), r"coils are of type int\. Allowed: a name \(table-3x3\)"),
        (lambda: CoilSteering((Currents(0.0, (1.0,)),)), r"entry 0 has 1 currents\. Allowed: 9"),
        (lambda: CoilArray(()), r"number of coils is 0\. Allowed: 1 to 64"),
        (lambda: replace(COIL, max_current=-1.0), r"max_current is -1\.0\. Allowed: above 0"),
        (lambda: replace(COIL, direction=(0.0, 0.0, 0.0)), "no zero direction"),
        (lambda: replace(COIL, thickness=0.1), "0 to below twice the radius"),
        (lambda: CoilArray((COIL,), ambient=95.0), r"max_temperature is 90\.0\. Allowed: above"),
        (
            lambda: Dynamics(magnet=MagnetSteering(), coils=CoilSteering()),
            "magnet and coils are both given",
        ),
        (
            lambda: CoilSteering((Currents(0.0, (0.0,) * 9),), command_file="a.csv"),
            "Several of currents, joystick and command_file are given",
        ),
    ],
)
def test_impossible_coils_are_one_line(make, message):
    with pytest.raises((InputError, UnknownNameError), match=message) as raised:
        make()
    assert "\n" not in str(raised.value)


def test_command_files(tmp_path):
    path = tmp_path / "commands.csv"
    path.write_text("time_s,coil_1_a,coil_2_a\n0,0,0\n1,2,4\n")
    rollout = begun(CoilSteering(coils=TWO, command_file=str(path)))
    steps = list(rollout.steps())
    np.testing.assert_allclose(steps[-1].command.coils.commands, [0.58, 1.16])
    assert len(rollout.sources(steps[-1])) == 2
    path.write_text("time_s,a\n0,0\n")
    with pytest.raises(InputError, match="not the header time_s,coil_1_a,coil_2_a or time_s,lin"):
        begun(CoilSteering(coils=TWO, command_file=str(path)))


def test_a_drive_mixes_axes_and_currents(tmp_path):
    path = tmp_path / "drive.csv"
    path.write_text(
        f"{','.join(coil_command_columns(2))}\n"
        "0.0,0.0,0.0,0.0,0.0,0.0,0.0,7.0,-90.0\n0.1,0.0,1.0,0.0,0.0,0.0,0.0,0.0,0.0\n"
    )
    rollout = begun(CoilSteering(coils=TWO, command_file=str(path)))
    program = rollout.coils
    program.control(rollout.world, 0.05, 0.01)
    assert program.status.commands.tolist() == [7.0, -90.0]
    assert program.status.limit == "current"
    program.control(rollout.world, 0.15, 0.01)
    assert program.target[1] == program.settings.joystick_force
    path.write_text(path.read_text().replace("7.0", "nan"))
    with pytest.raises(InputError, match="entry 0 has a current that is not finite"):
        begun(CoilSteering(coils=TWO, command_file=str(path)))
