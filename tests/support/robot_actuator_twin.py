"""A readable twin of the core's arm that leads a magnet, in NumPy.

Poses out of reach and gaps are asked of `nearest` and `clearances`, which have tests of their own.
"""

from __future__ import annotations

import numpy as np
from scipy.spatial.transform import Rotation

from vrcaps.actuation.arm.arm import nearest
from vrcaps.actuation.arm.arm_with_payload import clearances, flange_pose_at, magnet_pose_at
from vrcaps.actuation.magnet_actuator import ActuatorState, RobotActuator

NEARER = ((8e-3, 0.08), (2e-3, 0.02))
UPRIGHT, FARTHEST, MAX_TURN, SLACK, JUMP = 0.2, 0.03, 0.3, 5e-3, 0.5


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


def rolled(actuator: RobotActuator, pose: np.ndarray, now: np.ndarray) -> np.ndarray:
    """The pose turned about the magnet's axis, so that the flange points where it is to."""
    axis, along = pose[:3, 2], np.linalg.inv(actuator.robot.mount)[:3, 2]
    across = np.eye(3) - np.outer(axis, axis)
    flange, wanted = across @ pose[:3, :3] @ along, across @ actuator.flange_direction
    if np.linalg.norm(wanted) < UPRIGHT:
        wanted = across @ now[:3, :3] @ along
    if min(np.linalg.norm(flange), np.linalg.norm(wanted)) < 1e-9:
        return pose
    return turned(pose, np.arctan2(axis @ np.cross(flange, wanted), flange @ wanted) * axis)


def part_way(start: np.ndarray, target: np.ndarray) -> np.ndarray:
    """The target, or where the way there begins if it is far."""
    turn = turn_between(start, target)
    part = turned(start, cut(turn, MAX_TURN)) if np.linalg.norm(turn) > MAX_TURN else target.copy()
    part[:3, 3] = start[:3, 3] + cut(target[:3, 3] - start[:3, 3], FARTHEST)
    return part


def velocity_of(
    actuator: RobotActuator,
    way: np.ndarray,
    velocity: np.ndarray,
    dt: float,
    most_share: float = np.inf,
) -> np.ndarray:
    """Joint speeds [rad/s]: all joints keep step and can stop in time, v dt + v²/2a = way."""
    speed, acceleration = limits(actuator, dt)
    a = acceleration * dt
    most = np.minimum(speed, np.sqrt(a * a + 2.0 * acceleration * np.abs(way)) - a)
    share = min(1.0 / dt, most_share, (most / np.maximum(np.abs(way), 1e-12)).min())
    return velocity + np.clip(share * way - velocity, -a, a)


def limits(actuator: RobotActuator, dt: float) -> tuple[np.ndarray, np.ndarray]:
    """Speeds, and accelerations that may turn round within a step, for their jerk's sake."""
    joints = actuator.robot.arm.joints
    accelerations = [min(joint.acceleration, 0.5 * joint.jerk * dt) for joint in joints]
    return np.array([joint.velocity for joint in joints]), np.array(accelerations)


def outside(actuator: RobotActuator, pose: np.ndarray) -> float:
    """Distance of a magnet from the workspace [m]."""
    place = pose[:3, 3]
    return float(
        np.linalg.norm(place - np.clip(place, actuator.workspace.low, actuator.workspace.high))
    )


def nearer(now: np.ndarray, target: np.ndarray, most: tuple[float, float]) -> np.ndarray:
    """A pose on the way to a target, by [m, rad] at most; about no more than the magnet's axis."""
    axis = np.cross(now[:3, 2], target[:3, 2])
    sine = np.linalg.norm(axis)
    angle = np.arctan2(sine, now[:3, 2] @ target[:3, 2])
    part = turned(now, axis / max(sine, 1e-12) * min(angle, most[1]))
    part[:3, 3] += cut(target[:3, 3] - now[:3, 3], most[0])
    return part


def move(
    actuator: RobotActuator, state: ActuatorState, asked: np.ndarray, dt: float
) -> ActuatorState:
    """The magnet a time `dt` [s] later, on its way to a pose or, out of reach, to nearer ones."""
    moved = step(actuator, state, asked, dt)
    for most in NEARER:
        if moved.limit == "unreachable":
            moved = step(actuator, state, nearer(state.T_world_magnet, asked, most), dt)
    return moved


def step(
    actuator: RobotActuator, state: ActuatorState, asked: np.ndarray, dt: float
) -> ActuatorState:
    """The magnet a time `dt` [s] later, on its way to a pose."""
    robot, now, at = actuator.robot, state.T_world_magnet, state.joint_angles
    target = asked.copy()
    target[:3, 3] = np.clip(asked[:3, 3], actuator.workspace.low, actuator.workspace.high)
    limit = "" if np.array_equal(target, asked) else "workspace"
    target = part_way(now, rolled(actuator, target, now))
    wanted = nearest(robot.arm, flange_pose_at(robot, target), at)
    if np.isnan(wanted[0]) or np.abs(wanted - at).max() > JUMP:
        wanted, limit = at, "unreachable"
    way, turn = (
        np.linalg.norm(target[:3, 3] - now[:3, 3]),
        np.linalg.norm(turn_between(now, target)),
    )
    share = min(actuator.max_speed / max(way, 1e-9), actuator.max_angular_speed / max(turn, 1e-9))
    velocity = velocity_of(actuator, wanted - at, state.velocity, dt, share)
    angles = at + dt * velocity
    stop = angles + 0.5 * velocity * np.abs(velocity) / limits(actuator, dt)[1]
    for q in (angles, stop):
        out = outside(actuator, magnet_pose_at(robot, q))
        touches = clearances(robot, q[None]).min() < 0.0
        if touches or (out > SLACK and out > outside(actuator, now)):
            velocity = velocity_of(actuator, np.zeros_like(at), state.velocity, dt)
            angles, limit = at + dt * velocity, "collision" if touches else "workspace"
            break
    if not limit and np.abs(wanted - angles).max() > 1e-3:
        limit = "speed"
    return ActuatorState(magnet_pose_at(robot, angles), velocity, angles, limit)
