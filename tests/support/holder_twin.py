"""A readable twin of the core's arm that leads a magnet, in NumPy.

Poses out of reach and gaps are asked of `nearest` and `clearances`, which have tests of their own.
"""

from __future__ import annotations

import numpy as np
from scipy.spatial.transform import Rotation

from vrcaps.actuation.arm.arm_with_payload import clearances, flange_at, magnet_at
from vrcaps.actuation.arm.kinematics import nearest
from vrcaps.actuation.magnet_actuator import Held
from vrcaps.actuation.robot_actuator import ArmHolder

NEARER = ((8e-3, 0.08), (2e-3, 0.02))
UPRIGHT, FARTHEST, MOST_TURN, SLACK, JUMP = 0.2, 0.03, 0.3, 5e-3, 0.5


def cut(vector: np.ndarray, most: float) -> np.ndarray:
    """A vector, cut to a length."""
    return vector * min(1.0, most / max(float(np.linalg.norm(vector)), 1e-300))


def turn_between(start: np.ndarray, end: np.ndarray) -> np.ndarray:
    """Rotation vector [rad] from one pose to another, in the world."""
    return Rotation.from_matrix(end[:3, :3] @ start[:3, :3].T).as_rotvec()


def turned(pose: np.ndarray, vector: np.ndarray) -> np.ndarray:
    """A pose turned where it is, by a rotation vector [rad] in the world."""
    result = pose.copy()
    result[:3, :3] = Rotation.from_rotvec(vector).as_matrix() @ pose[:3, :3]
    return result


def rolled(holder: ArmHolder, pose: np.ndarray, now: np.ndarray) -> np.ndarray:
    """The pose turned about the magnet's axis, so that the flange points where it is to."""
    axis, along = pose[:3, 2], np.linalg.inv(holder.carrier.mount)[:3, 2]
    across = np.eye(3) - np.outer(axis, axis)
    flange, wanted = across @ pose[:3, :3] @ along, across @ holder.reach_along
    if np.linalg.norm(wanted) < UPRIGHT:
        wanted = across @ now[:3, :3] @ along
    if min(np.linalg.norm(flange), np.linalg.norm(wanted)) < 1e-9:
        return pose
    return turned(pose, np.arctan2(axis @ np.cross(flange, wanted), flange @ wanted) * axis)


def part_way(start: np.ndarray, goal: np.ndarray) -> np.ndarray:
    """The goal, or where the way there begins if it is far."""
    turn = turn_between(start, goal)
    part = turned(start, cut(turn, MOST_TURN)) if np.linalg.norm(turn) > MOST_TURN else goal.copy()
    part[:3, 3] = start[:3, 3] + cut(goal[:3, 3] - start[:3, 3], FARTHEST)
    return part


def velocity_of(
    holder: ArmHolder, way: np.ndarray, velocity: np.ndarray, dt: float, most_share: float = np.inf
) -> np.ndarray:
    """Joint speeds [rad/s]: all joints keep step and can stop in time, v dt + v²/2a = way."""
    speed, acceleration = limits(holder, dt)
    a = acceleration * dt
    most = np.minimum(speed, np.sqrt(a * a + 2.0 * acceleration * np.abs(way)) - a)
    share = min(1.0 / dt, most_share, (most / np.maximum(np.abs(way), 1e-12)).min())
    return velocity + np.clip(share * way - velocity, -a, a)


def limits(holder: ArmHolder, dt: float) -> tuple[np.ndarray, np.ndarray]:
    """Speeds, and accelerations that may turn round within a step, for their jerk's sake."""
    joints = holder.carrier.arm.joints
    accelerations = [min(joint.acceleration, 0.5 * joint.jerk * dt) for joint in joints]
    return np.array([joint.velocity for joint in joints]), np.array(accelerations)


def outside(holder: ArmHolder, pose: np.ndarray) -> float:
    """How far a magnet is out of the room [m]."""
    place = pose[:3, 3]
    return float(np.linalg.norm(place - np.clip(place, holder.room.low, holder.room.high)))


def nearer(now: np.ndarray, goal: np.ndarray, most: tuple[float, float]) -> np.ndarray:
    """A pose on the way to a goal, by [m, rad] at most; about no more than the magnet's axis."""
    axis = np.cross(now[:3, 2], goal[:3, 2])
    sine = np.linalg.norm(axis)
    angle = np.arctan2(sine, now[:3, 2] @ goal[:3, 2])
    part = turned(now, axis / max(sine, 1e-12) * min(angle, most[1]))
    part[:3, 3] += cut(goal[:3, 3] - now[:3, 3], most[0])
    return part


def move(holder: ArmHolder, held: Held, asked: np.ndarray, dt: float) -> Held:
    """The magnet a time `dt` [s] later, on its way to a pose or, out of reach, to nearer ones."""
    moved = step(holder, held, asked, dt)
    for most in NEARER:
        if moved.limit == "reach":
            moved = step(holder, held, nearer(held.T_world_magnet, asked, most), dt)
    return moved


def step(holder: ArmHolder, held: Held, asked: np.ndarray, dt: float) -> Held:
    """The magnet a time `dt` [s] later, on its way to a pose."""
    carrier, now, at = holder.carrier, held.T_world_magnet, held.angles
    goal = asked.copy()
    goal[:3, 3] = np.clip(asked[:3, 3], holder.room.low, holder.room.high)
    limit = "" if np.array_equal(goal, asked) else "room"
    goal = part_way(now, rolled(holder, goal, now))
    wanted = nearest(carrier.arm, flange_at(carrier, goal), at)
    if np.isnan(wanted[0]) or np.abs(wanted - at).max() > JUMP:
        wanted, limit = at, "reach"
    way, turn = np.linalg.norm(goal[:3, 3] - now[:3, 3]), np.linalg.norm(turn_between(now, goal))
    share = min(holder.speed / max(way, 1e-9), holder.turn_speed / max(turn, 1e-9))
    velocity = velocity_of(holder, wanted - at, held.velocity, dt, share)
    angles = at + dt * velocity
    stop = angles + 0.5 * velocity * np.abs(velocity) / limits(holder, dt)[1]
    for q in (angles, stop):
        out = outside(holder, magnet_at(carrier, q))
        touches = clearances(carrier, q[None]).min() < 0.0
        if touches or (out > SLACK and out > outside(holder, now)):
            velocity = velocity_of(holder, np.zeros_like(at), held.velocity, dt)
            angles, limit = at + dt * velocity, "touch" if touches else "room"
            break
    if not limit and np.abs(wanted - angles).max() > 1e-3:
        limit = "speed"
    return Held(magnet_at(carrier, angles), velocity, angles, limit)
