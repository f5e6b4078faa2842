"""Servo controller: actions that bring each capsule to a goal, for several actuations."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from vrcaps.actuation.magnet_pose_solver import MagnetPoseSolver, Workspace, WrenchTarget
from vrcaps.capsule.device import homogeneous_body
from vrcaps.core.errors import InputError
from vrcaps.core.geometry import rotation_from_vector, vector_from_rotation
from vrcaps.core.units import MM
from vrcaps.env.actuation import MagnetActuation, Wrench
from vrcaps.magnet.field import SourceSet
from vrcaps.magnet.presets import read_magnet
from vrcaps.world.control import GRAVITY

if TYPE_CHECKING:
    from jaxtyping import Float

    from vrcaps.env.parts import EnvView

SERVO_ACTUATIONS = ("wrench", "magnet")
"""Supported kinds of actuation."""

_RATE = 2.0
"""Fraction of the remaining distance that is covered per second."""

_REST = 0.05
"""Force with which a capsule under a magnet still rests on the wall below it [N]."""

_MAGNET_FORCE = 0.02
"""Maximum horizontal force of a magnet [N]."""

_WALL_RESISTANCE, _CREEP = 3e-3, 5.0 * MM
"""Resistance of the wall to a capsule that rests on it [N], from this speed on [m/s]."""

_LEAD = 0.4
"""Lead time of the field's direction relative to the capsule's [s]."""


@dataclass(frozen=True)
class Goal:
    """Target position and viewing direction, a row for each world, in the world frame.

    Attributes:
        position: Position of the center of mass [m].
        heading: Direction of the front, unit vectors.
        speed: Maximum speed on the way [m/s].
        turn: Maximum angular speed [rad/s].
    """

    position: Float[np.ndarray, "n 3"]
    heading: Float[np.ndarray, "n 3"]
    speed: float = 30.0 * MM
    turn: float = 1.5


def servo_actions(view: EnvView, goal: Goal) -> np.ndarray:
    """Return the actions of all worlds for the next control period.

    Raises:
        InputError: If it does not support the environment's actuation.
    """
    actuation = view.actuation
    twist = wanted_twist(view, goal)
    if isinstance(actuation, Wrench):
        return _wrench(view, actuation, *twist)
    if isinstance(actuation, MagnetActuation):
        return _magnet(view, actuation, *twist)
    raise InputError(
        f"The servo does not support {actuation.kind!r}. Allowed: {', '.join(SERVO_ACTUATIONS)}."
    )


def wanted_twist(
    view: EnvView, goal: Goal
) -> tuple[Float[np.ndarray, "n 3"], Float[np.ndarray, "n 3"]]:
    """Velocities [m/s] and angular velocities [rad/s] that lead to a goal without overshoot."""
    T = view.T_world_capsule
    velocity = _limited(_RATE * (goal.position - T[:, :3, 3]), goal.speed)
    turn = heading_error(T[:, :3, :3], goal.heading)
    return velocity, _limited(_RATE * turn, goal.turn)


def heading_error(
    R_world_capsule: Float[np.ndarray, "n 3 3"], heading: Float[np.ndarray, "n 3"]
) -> Float[np.ndarray, "n 3"]:
    """Axis times angle [rad] of the shortest rotation of each front to its heading."""
    front = R_world_capsule[:, :, 2]
    axis = np.cross(front, heading)
    sine = np.linalg.norm(axis, axis=1, keepdims=True)
    cosine = np.sum(front * heading, axis=1, keepdims=True)
    # If the goal is right behind, any perpendicular axis is valid.
    axis = np.where(sine > 1e-6, axis / np.maximum(sine, 1e-6), R_world_capsule[:, :, 0])
    return np.arctan2(sine, cosine) * axis


def _limited(vectors: Float[np.ndarray, "n 3"], most: float) -> Float[np.ndarray, "n 3"]:
    """Limit vectors to a maximum length."""
    length = np.linalg.norm(vectors, axis=1, keepdims=True)
    return vectors * np.minimum(1.0, most / np.maximum(length, 1e-12))


def _loads(
    view: EnvView, velocity: Float[np.ndarray, "n 3"], spin: Float[np.ndarray, "n 3"]
) -> tuple[Float[np.ndarray, "n 3"], Float[np.ndarray, "n 3"]]:
    """Forces [N] and torques [N·m] that give a twist at the end of a control period Δt.

    With inertia and drag, v = v₀ a + (1 − a) F τ/m with a = exp(−Δt/τ); in quasi-static motion,
    a = 0. Torques are analogous.
    """
    body = homogeneous_body(view.device)
    linear, angular = view.velocity_world[:, 0], view.velocity_world[:, 1]
    tau = view.relaxation_time
    lasting, time = 0.0, tau
    if view.dynamics == "physics":
        lasting = math.exp(-view.control_period / tau)
        time = (1.0 - lasting) * tau if math.isfinite(tau) else view.control_period
    R = view.T_world_capsule[:, :3, :3]
    inertia = R @ body.inertia @ np.swapaxes(R, 1, 2)
    torque = np.einsum("nij,nj->ni", inertia, spin - lasting * angular) / time
    return body.mass * (velocity - lasting * linear) / time, torque


def _wrench(
    view: EnvView,
    actuation: Wrench,
    velocity: Float[np.ndarray, "n 3"],
    spin: Float[np.ndarray, "n 3"],
) -> np.ndarray:
    """Wrench that gives the twist and balances gravity, within the limits."""
    force, torque = _loads(view, velocity, spin)
    if not actuation.is_weightless:
        force[:, 2] += view.device.mass * GRAVITY
    if actuation.frame == "capsule":
        R = view.T_world_capsule[:, :3, :3]
        force, torque = (np.einsum("nji,nj->ni", R, load) for load in (force, torque))
    if actuation.mode == "discrete":
        return _choices(force, actuation.force)
    shares = [_share(force, actuation.force), _share(torque, actuation.torque)]
    return np.concatenate(shares, axis=1).astype(np.float32)


def _magnet(
    view: EnvView,
    actuation: MagnetActuation,
    velocity: Float[np.ndarray, "n 3"],
    spin: Float[np.ndarray, "n 3"],
) -> np.ndarray:
    """Twist of the magnet towards a pose that exerts the desired force and torque on the capsule.

    It supports all but a small part of the weight, so that the capsule rests on the wall below it:
    a capsule that hangs freely under a magnet has no stable position.
    """
    force, _ = _loads(view, velocity, spin)
    force += (
        _WALL_RESISTANCE
        * velocity
        / _CREEP
        / np.maximum(1.0, np.linalg.norm(velocity, axis=1, keepdims=True) / _CREEP)
    )
    force[:, 2] = 0.0
    force = _limited(force, _MAGNET_FORCE)
    force[:, 2] = max(view.device.mass * GRAVITY - _REST, 0.0)
    sources = SourceSet([read_magnet(actuation.magnet)])
    dt, memory = view.control_period, view.memory
    actions = np.zeros((view.num_worlds, 6), np.float32)
    for index, T_world_capsule in enumerate(view.T_world_capsule):
        (x0, y0, z0), (x1, y1, z1) = memory["magnet/box"][index].tolist()
        solver = MagnetPoseSolver(
            sources, view.device.magnets, Workspace((x0, y0, z0), (x1, y1, z1))
        )
        ahead = T_world_capsule.copy()
        ahead[:3, :3] = rotation_from_vector(_LEAD * spin[index]) @ ahead[:3, :3]
        now = memory["magnet/T"][index]
        wanted = solver.solve(WrenchTarget(force[index].tolist()), ahead, now).T_world_magnet
        actions[index] = magnet_action(actuation, now, wanted, dt)
    return actions


def magnet_action(
    actuation: MagnetActuation,
    now: Float[np.ndarray, "4 4"],
    wanted: Float[np.ndarray, "4 4"],
    dt: float,
) -> Float[np.ndarray, " 6"]:
    """Action that moves a magnet towards a pose, on a straight line and by the shortest rotation.

    Args:
        actuation: Actuation whose maximum speeds scale the action.
        now: Current pose of the magnet in the world.
        wanted: Target pose.
        dt: Control period [s].
    """
    way = (wanted[:3, 3] - now[:3, 3]) / (actuation.speed * dt)
    turn = vector_from_rotation(wanted[:3, :3] @ now[:3, :3].T) / (actuation.angular_speed * dt)
    return np.concatenate([_share(part[None], 1.0)[0] for part in (way, turn)])


def _share(wanted: Float[np.ndarray, "n 3"], most: float) -> Float[np.ndarray, "n 3"]:
    """Fraction of the maximum in each direction; vectors beyond it are scaled down as a whole."""
    strength = np.abs(wanted).max(axis=1, keepdims=True)
    return wanted / np.maximum(strength, most) if most > 0.0 else np.zeros_like(wanted)


def _choices(force: Float[np.ndarray, "n 3"], strength: float) -> np.ndarray:
    """Nearest discrete action of each force: its dominant axis, or none if it is small."""
    axis = np.abs(force).argmax(axis=1)
    largest = force[np.arange(len(force)), axis]
    action = 1 + axis + np.where(largest < 0.0, 3, 0)
    return np.where(np.abs(largest) > 0.5 * strength, action, 0)
