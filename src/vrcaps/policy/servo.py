"""Servo: actions that bring each capsule to a goal, by whatever actuation an environment has."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from vrcaps.capsule.body import homogeneous_body
from vrcaps.env.actuation.wrench import Wrench
from vrcaps.errors import InputError
from vrcaps.units import MM
from vrcaps.world.control import GRAVITY

if TYPE_CHECKING:
    from jaxtyping import Float

    from vrcaps.env.simulation import Simulation

SERVO_ACTUATIONS = ("wrench",)
"""Kinds of actuation that it can drive."""

_RATE = 2.0
"""Share of what is left of the way that is made in a second."""

_MOMENTUM_TIME = 1.0 / 30.0
"""Time in which quasi-static motion loses its momentum [s], see `vrcaps.world.dynamics`."""


@dataclass(frozen=True)
class Goal:
    """Where capsules shall go and look, a row for each world, in the world frame.

    Attributes:
        position: Of the center of mass [m].
        heading: Of the front, unit vectors.
        speed: Not to be exceeded on the way [m/s].
        turn: Rate of turning not to be exceeded [rad/s].
    """

    position: Float[np.ndarray, "n 3"]
    heading: Float[np.ndarray, "n 3"]
    speed: float = 30.0 * MM
    turn: float = 1.5


def servo_actions(simulation: Simulation, goal: Goal) -> np.ndarray:
    """Actions of all worlds for the next control period.

    Raises:
        InputError: If it cannot drive the environment's actuation.
    """
    actuation = simulation.settings.actuation
    if isinstance(actuation, Wrench):
        return _wrench(simulation, actuation, *wanted_twist(simulation, goal))
    raise InputError(
        f"The servo cannot drive {actuation.kind!r}. Allowed: {', '.join(SERVO_ACTUATIONS)}."
    )


def wanted_twist(
    simulation: Simulation, goal: Goal
) -> tuple[Float[np.ndarray, "n 3"], Float[np.ndarray, "n 3"]]:
    """Velocities [m/s] and angular velocities [rad/s] that lead to a goal without overshoot."""
    T = simulation.T_world_capsule
    velocity = _limited(_RATE * (goal.position - T[:, :3, 3]), goal.speed)
    turn = heading_error(T[:, :3, :3], goal.heading)
    return velocity, _limited(_RATE * turn, goal.turn)


def heading_error(
    R_world_capsule: Float[np.ndarray, "n 3 3"], heading: Float[np.ndarray, "n 3"]
) -> Float[np.ndarray, "n 3"]:
    """Axis times angle [rad] of the shortest turn that brings each front to its heading."""
    front = R_world_capsule[:, :, 2]
    axis = np.cross(front, heading)
    sine = np.linalg.norm(axis, axis=1, keepdims=True)
    cosine = np.sum(front * heading, axis=1, keepdims=True)
    # Where the goal is right behind, any axis across will do.
    axis = np.where(sine > 1e-6, axis / np.maximum(sine, 1e-6), R_world_capsule[:, :, 0])
    return np.arctan2(sine, cosine) * axis


def _limited(vectors: Float[np.ndarray, "n 3"], most: float) -> Float[np.ndarray, "n 3"]:
    """Vectors shortened to a length."""
    length = np.linalg.norm(vectors, axis=1, keepdims=True)
    return vectors * np.minimum(1.0, most / np.maximum(length, 1e-12))


def _wrench(
    simulation: Simulation,
    actuation: Wrench,
    velocity: Float[np.ndarray, "n 3"],
    spin: Float[np.ndarray, "n 3"],
) -> np.ndarray:
    """Wrench that gives the twist at the end of a control period.

    With inertia, F = m (v − v₀) / Δt; quasi-static, F = m v / τ. Torques alike.
    """
    settings, body = simulation.settings, homogeneous_body(simulation.device)
    linear, angular = simulation.velocity_world[:, 0], simulation.velocity_world[:, 1]
    lasting, time = 1.0, settings.control_period
    if settings.dynamics == "quasi-static":
        lasting, time = 0.0, _MOMENTUM_TIME
    force = body.mass * (velocity - lasting * linear) / time
    if not actuation.is_weightless:
        force[:, 2] += body.mass * GRAVITY
    R = simulation.T_world_capsule[:, :3, :3]
    inertia = R @ body.inertia @ np.swapaxes(R, 1, 2)
    torque = np.einsum("nij,nj->ni", inertia, spin - lasting * angular) / time
    if actuation.frame == "capsule":
        force, torque = (np.einsum("nji,nj->ni", R, v) for v in (force, torque))
    if actuation.mode == "discrete":
        return _choices(force, actuation.force)
    shares = [_share(force, actuation.force), _share(torque, actuation.torque)]
    return np.concatenate(shares, axis=1).astype(np.float32)


def _share(wanted: Float[np.ndarray, "n 3"], most: float) -> Float[np.ndarray, "n 3"]:
    """Part of what is possible in each direction; in the wanted direction where that is less."""
    strength = np.abs(wanted).max(axis=1, keepdims=True)
    return wanted / np.maximum(strength, most) if most > 0.0 else np.zeros_like(wanted)


def _choices(force: Float[np.ndarray, "n 3"], strength: float) -> np.ndarray:
    """Discrete action nearest to each force: along its largest part, none where that is small."""
    axis = np.abs(force).argmax(axis=1)
    largest = force[np.arange(len(force)), axis]
    action = 1 + axis + np.where(largest < 0.0, 3, 0)
    return np.where(np.abs(largest) > 0.5 * strength, action, 0)


def turning_time(
    front: Float[np.ndarray, "n 3"], heading: Float[np.ndarray, "n 3"], turn: float
) -> Float[np.ndarray, " n"]:
    """Time to turn from one heading to others at a rate [s]."""
    return np.arccos(np.clip(heading @ front, -1.0, 1.0)) / max(turn, 1e-3 * math.pi)
