"""The servo brings a free body to its goal, with inertia and without, within the limits."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from tests.support.small_envs import small_settings
from vrcaps.capsule.device import homogeneous_body
from vrcaps.capsule.device_file import read_device
from vrcaps.core.errors import InputError
from vrcaps.core.geometry import rotation_from_vector, transform_from
from vrcaps.env.actuation import MagnetActuation, Wrench
from vrcaps.env.settings import EnvSettings
from vrcaps.policy.servo import Goal, heading_error, magnet_action, servo_actions

DEVICE = read_device("magnetic")
TAU = 0.1
"""Relaxation time of a free capsule in environments [s]."""


def free_body(settings: EnvSettings) -> Any:
    """Two capsules at rest in empty space."""
    return SimpleNamespace(
        settings=settings,
        actuation=settings.actuation,
        control_period=settings.control_period,
        dynamics=settings.dynamics,
        relaxation_time=settings.relaxation_time,
        device=DEVICE,
        T_world_capsule=np.tile(np.eye(4), (2, 1, 1)),
        velocity_world=np.zeros((2, 2, 3)),
    )


def drift(body: Any, force: np.ndarray, torque: np.ndarray) -> None:
    """Motion over a control period: v = v₀ a + (1 − a) F τ/m, a = exp(−Δt/τ), 0 without inertia."""
    dt, mass = body.settings.control_period, homogeneous_body(DEVICE)
    R = body.T_world_capsule[:, :3, :3]
    inertia = R @ mass.inertia @ np.swapaxes(R, 1, 2)
    before = body.velocity_world.copy()
    change = np.stack([force / mass.mass, np.linalg.solve(inertia, torque[..., None])[..., 0]], 1)
    steady, way = TAU * change, dt * TAU * change
    body.velocity_world = steady
    if body.settings.dynamics == "physics":
        lost = 1.0 - np.exp(-dt / TAU)
        body.velocity_world = before + lost * (steady - before)
        way = way + TAU * lost * (before - steady)
    body.T_world_capsule[:, :3, 3] += way[:, 0]
    body.T_world_capsule[:, :3, :3] = rotation_from_vector(way[:, 1]) @ R


@pytest.mark.parametrize("dynamics", ["physics", "quasi-static"])
@pytest.mark.parametrize("frame", ["world", "capsule"])
def test_it_reaches_a_goal_and_its_heading(dynamics: Any, frame: Any) -> None:
    actuation = Wrench(is_weightless=True, frame=frame)
    body = free_body(small_settings(dynamics=dynamics, actuation=actuation))
    goal = Goal(
        np.array([[0.05, 0.0, 0.0], [0.0, -0.03, 0.02]]), np.array([[1.0, 0, 0], [0, 0, -1.0]])
    )
    fastest = 0.0
    for _ in range(36):
        action = servo_actions(body, goal)
        assert np.abs(action).max() <= 1.0
        force, torque = actuation.force * action[:, :3], actuation.torque * action[:, 3:]
        if frame == "capsule":
            R = body.T_world_capsule[:, :3, :3]
            force, torque = (np.einsum("nij,nj->ni", R, v) for v in (force, torque))
        drift(body, force, torque)
        fastest = max(fastest, np.linalg.norm(body.velocity_world[:, 0], axis=1).max())
    assert np.abs(body.T_world_capsule[:, :3, 3] - goal.position).max() < 1e-4
    assert np.abs(body.T_world_capsule[:, :3, 2] - goal.heading).max() < 0.01
    assert fastest < 1.01 * goal.speed


def test_gravity_is_balanced_where_the_force_is_enough() -> None:
    """F_z = m g at a goal that is reached."""
    body = free_body(small_settings(actuation=Wrench(force=0.2)))
    action = servo_actions(body, Goal(np.zeros((2, 3)), np.array([[0, 0, 1.0]] * 2)))
    assert 0.2 * action[:, 2] == pytest.approx([9.80665 * DEVICE.mass] * 2, rel=1e-6)


def test_actions_in_the_capsules_frame_are_the_same_wrench() -> None:
    body = free_body(small_settings(actuation=Wrench(is_weightless=True)))
    body.T_world_capsule[:, :3, :3] = rotation_from_vector(np.array([0.3, -1.0, 0.5]))
    goal = Goal(np.full((2, 3), 0.02), np.array([[0, 1.0, 0]] * 2))
    world = servo_actions(body, goal).reshape(2, 2, 3)
    actuation = Wrench(is_weightless=True, frame="capsule")
    body.actuation = actuation
    own = servo_actions(body, goal).reshape(2, 2, 3)
    R = body.T_world_capsule[:, :3, :3]
    assert np.einsum("nij,nkj->nki", R, own) == pytest.approx(world, abs=1e-6)


def test_discrete_choices_go_along_the_largest_part() -> None:
    actuation = Wrench("discrete", force=0.005, is_weightless=True)
    body = free_body(small_settings(dynamics="physics", actuation=actuation))
    far = Goal(np.array([[0.1, 0.0, 0.05], [0.0, 0.0, -0.1]]), np.array([[0, 0, 1.0]] * 2), 0.2)
    assert servo_actions(body, far).tolist() == [1, 6]
    near = Goal(np.full((2, 3), 1e-4), far.heading)
    assert servo_actions(body, near).tolist() == [0, 0]


def test_a_goal_right_behind_has_a_way_round() -> None:
    turn = heading_error(np.eye(3)[None], np.array([[0.0, 0.0, -1.0]]))
    assert np.linalg.norm(turn) == pytest.approx(np.pi)


def test_an_actuation_that_it_cannot_drive_is_one_line() -> None:
    body = free_body(small_settings())
    body.actuation = SimpleNamespace(kind="rope")
    with pytest.raises(InputError, match="does not support 'rope'"):
        servo_actions(body, Goal(np.zeros((2, 3)), np.zeros((2, 3))))


def test_the_action_of_a_magnet_arrives_where_it_can_and_else_keeps_its_direction() -> None:
    """In 0.1 s at most 5 mm along each axis and 0.1 rad about each."""
    actuation = MagnetActuation(speed=0.05, angular_speed=1.0)
    now = transform_from(rotation_from_vector(np.array([0.4, 0.1, 0.0])), np.array([0.1, 0.2, 0.3]))
    turn, way = np.array([0.0, 0.05, -0.02]), np.array([0.001, -0.004, 0.002])
    near = transform_from(rotation_from_vector(turn) @ now[:3, :3], now[:3, 3] + way)
    action = magnet_action(actuation, now, near, 0.1)
    assert action == pytest.approx([0.2, -0.8, 0.4, 0.0, 0.5, -0.2])
    far = transform_from(rotation_from_vector(10 * turn) @ now[:3, :3], now[:3, 3] + 10 * way)
    action = magnet_action(actuation, now, far, 0.1)
    assert action == pytest.approx([0.25, -1.0, 0.5, 0.0, 1.0, -0.4])
