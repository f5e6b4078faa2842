"""A readable twin of the core's leading point, in NumPy."""

from __future__ import annotations

import numpy as np
from scipy.spatial.transform import Rotation

from vrcaps.actuation.capsule_target import CapsuleTarget
from vrcaps.actuation.magnet_controller import ControllerGains

AFTER, STEEP, TOUCH = 0.5, 0.1, 0.01


def cut(vector: np.ndarray, most: float) -> np.ndarray:
    """A vector, cut to a length."""
    return vector * min(1.0, most / max(float(np.linalg.norm(vector)), 1e-300))


def between(start: np.ndarray, end: np.ndarray, about: np.ndarray) -> np.ndarray:
    """Rotation vector [rad] from a direction to another; about an axis where they are opposite."""
    axis = np.cross(start, end)
    sine = np.linalg.norm(axis)
    return np.arctan2(sine, start @ end) * (axis / sine if sine > 1e-9 else about)


def towards(start: np.ndarray, end: np.ndarray, most: float, about: np.ndarray) -> np.ndarray:
    """A direction turned towards another by an angle at most."""
    return Rotation.from_rotvec(cut(between(start, end, about), most)).apply(start)


def advance_reference(
    leader: np.ndarray,
    capsule: np.ndarray,
    contact: np.ndarray,
    target: CapsuleTarget,
    s: ControllerGains,
    dt: float,
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray, float, bool]:
    """Expected result of `vrcaps._core.advance_reference`."""
    (place, look, side), at, axis = leader, capsule[:3, 3], capsule[:3, 2]
    free, press, share = (
        target.controlled_axes,
        np.asarray(target.wall_normal, float),
        min(1.0, dt / AFTER),
    )
    lag = free @ (place - at)
    across = (place - at - lag) * (1.0 if target.on_planned_wall else 1.0 - share)
    place = at + lag + across - cut(lag - cut(lag, s.lookahead), s.speed * dt)
    way = np.asarray(target.position) - place
    place = place + cut(way if target.on_planned_wall else free @ way, s.speed * dt)
    ahead = axis if target.direction is None else np.asarray(target.direction, float)
    flat = ahead - side * (side @ ahead)
    if target.parallel_to_wall and np.linalg.norm(flat) > STEEP:
        ahead = flat / np.linalg.norm(flat)
    led = towards(axis, look, s.lookahead_angle, press)
    look = towards(led, ahead, s.angular_speed * dt, press)
    force = np.linalg.norm(contact)
    touched = -contact / force if force > TOUCH and not target.on_planned_wall else press
    side = side + share * (touched - side)
    pose = capsule.copy()
    turn = Rotation.from_rotvec(between(axis, look, press))
    pose[:3, :3], pose[:3, 3] = turn.as_matrix() @ capsule[:3, :3], place
    leader = np.array([place, look, side / np.linalg.norm(side)])
    bend = np.cross(axis, look)
    angle = np.arctan2(np.linalg.norm(bend), axis @ look)
    return leader, pose, free @ (place - at), bend, float(angle), bool(contact @ press > TOUCH)
