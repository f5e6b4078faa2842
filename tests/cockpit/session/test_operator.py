"""A policy at the joystick leads the capsule, acts in its period, and hands back with a word."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from vrcaps.actuation.steering_program import JoystickCommand, MagnetSteering
from vrcaps.cockpit.session.operator import Operator, PolicyDriver
from vrcaps.core.errors import InputError, UnknownNameError
from vrcaps.motion.rollout import Rollout
from vrcaps.policy.catalog import policy_names
from vrcaps.policy.policy import Requirements
from vrcaps.scenario.build import build
from vrcaps.world.schedule import PostureChange


class Broken:
    """A user's policy with a fault."""

    requires = Requirements()

    def reset(self, indices, seeds):
        pass

    def act(self, observations, env):
        raise ZeroDivisionError("division by zero")


class Wild(Broken):
    def act(self, observations, env):
        return np.full((1, 6), np.nan)


class Pushy(Broken):
    """Twice as fast as the joystick along x."""

    def __init__(self) -> None:
        self.requires = Requirements({"actuation": "magnet", "control_period": 0.1})
        self.count = 0

    def act(self, observations, env):
        self.count += 1
        return np.array([[1.0, 0.5, 0.0, 0.0, 0.0, 0.0]])


class WrenchOnly(Broken):
    requires = Requirements(actuations=("wrench",))


@pytest.fixture(scope="module")
def rollout(drive_scenario) -> Rollout:
    magnet = MagnetSteering(joystick=(JoystickCommand(0.0),))
    motion = replace(drive_scenario.motion, magnet=magnet, settle=0.0)
    _, made = build(replace(drive_scenario, motion=motion, frames=10))
    assert isinstance(made, Rollout)
    return made


def test_those_that_can_move_a_magnet_are_offered():
    assert {"random", "centerline", "next-best-view", "navigator"} <= {*policy_names("magnet")}
    assert "navigator" not in policy_names("wrench")


@pytest.mark.slow
def test_a_policy_leads_the_capsule_along_the_gut(rollout):
    """The navigator wants 2 cm/s towards its goal, the oral end."""
    program = rollout.program
    program.operator = operator = Operator(program)
    operator.start_policy(PolicyDriver("navigator", rollout, posture="supine", goal=0.0))
    walk = rollout.moments(None, lambda *_: None, lambda: False)
    places = [(next(walk), rollout.arc_length)[1] for _ in range(10)]
    assert operator.policy == "navigator"
    assert places[-1] < places[0] - 2e-3
    _, commands = operator.commands()
    assert len(commands) > 10
    operator.push(np.zeros(6))
    assert operator.policy == "navigator"
    operator.push(np.array([0.1, 0, 0, 0, 0, 0]))
    assert operator.policy == ""


def test_it_acts_once_in_its_period_and_no_faster_than_the_joystick(rollout):
    driver = PolicyDriver(f"{__name__}:Pushy", rollout, posture="supine")
    first = driver.axes(0.0)
    np.testing.assert_allclose(first, [1.0, 0.5, 0, 0, 0, 0])
    for time in (0.03, 0.07, 0.0999999):
        assert driver.axes(time) is first
    assert driver.axes(0.1) is not first
    assert driver._policy.count == 2


def test_a_policy_that_fails_hands_back_and_says_why(rollout):
    for name, reason in (
        ("Broken", "ZeroDivisionError: division by zero"),
        ("Wild", "The action is"),
    ):
        told: list[str] = []
        full = f"{__name__}:{name}"
        driver = PolicyDriver(full, rollout, posture="supine", on_message=told.append)
        operator = Operator(rollout.program)
        operator.start_policy(driver)
        assert operator(0.0, 0.01).linear == (0.0, 0.0, 0.0)
        assert operator.policy == ""
        assert told[0].startswith(f"Policy {full} releases control: {reason}")


def test_it_hands_back_when_the_patient_is_turned(rollout, monkeypatch):
    told: list[str] = []
    driver = PolicyDriver("centerline", rollout, posture="supine", on_message=told.append)
    turned = SimpleNamespace(
        posture_changes=(PostureChange("prone", 0.1, 1.0),), magnet=rollout.settings.magnet
    )
    monkeypatch.setattr(rollout, "settings", turned)
    assert driver.axes(0.5) is None
    assert "the policy was started for the posture supine" in told[0]


def test_says_what_cannot_drive(rollout):
    with pytest.raises(InputError, match="acts by wrench; the environment's actuation is magnet"):
        PolicyDriver(f"{__name__}:WrenchOnly", rollout, posture="supine")
    with pytest.raises(UnknownNameError, match="No policy named 'autopilot'"):
        PolicyDriver("autopilot", rollout, posture="supine")


def coil_operator() -> Operator:
    array = SimpleNamespace(values=lambda name: np.array([60.0, 5.0]))
    return Operator(SimpleNamespace(array=array))  # type: ignore[arg-type]


def test_currents_hold_until_axes_or_a_stop_and_are_logged_once():
    operator = coil_operator()
    assert operator.columns[-2:] == ("coil_1_a", "coil_2_a")
    operator.push(np.array([1.0, 0, 0, 0, 0, 0]))
    operator.set_current(2, -5.0)
    assert operator.is_steering
    assert [operator(t, 0.1).currents for t in (-0.1, 0.0, 0.1)] == [(0.0, 0.0)] + [(0.0, -5.0)] * 2
    operator.push(np.zeros(6))  # keys are released
    assert operator(0.2, 0.1).currents == (0.0, -5.0)
    operator.push(np.array([0.5, 0, 0, 0, 0, 0]))
    assert operator(0.3, 0.1).currents == (0.0, 0.0)
    operator.set_current(1, 60.0)
    operator.stop()
    assert not operator.is_steering
    operator(0.4, 0.1)
    _, commands = operator.commands()
    assert [(c.time, c.linear[0], c.currents[1]) for c in commands] == [
        (0.0, 0.0, -5.0),
        (0.3, 0.5, 0.0),
        (0.4, 0.0, 0.0),
    ]


def test_a_current_beyond_its_limit_is_one_line():
    operator = coil_operator()
    for current in (5.1, -6.0, np.nan):
        with pytest.raises(InputError, match=r"current of coil 2 is .* A\. Allowed: -5 to 5 A\.$"):
            operator.set_current(2, current)
    for coil in (0, 3):
        with pytest.raises(InputError, match=rf"^coil is {coil}\. Allowed: 1 to 2\.$"):
            operator.set_current(coil, 1.0)
    assert not operator.currents.any()
