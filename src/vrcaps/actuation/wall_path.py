"""Paths along the wall, and a planner that moves a capsule to a nearby pose on it."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING, Literal

import numpy as np

from vrcaps.actuation.capsule_target import (
    CapsuleTarget,
    centerline_target,
    outward_normals,
    wall_target,
)
from vrcaps.actuation.magnet_controller import CapsuleView, MagnetController
from vrcaps.core.errors import InputError, require
from vrcaps.core.geometry import unit
from vrcaps.core.units import CM, DEG, MM
from vrcaps.world.control import Control

if TYPE_CHECKING:
    from jaxtyping import Float

    from vrcaps.world.model import Model

_SPACING = 1.0 * MM
_SMOOTHING = 4.0 * MM
"""Standard deviation of the smoothing along the path: the size of a fold."""
_BISECTIONS = 16
"""Number of bisections of the distance to the wall, down to a micrometer."""
_CAST_DISTANCE = 2.0 * CM
"""Distance from the wall into the lumen at which the rays of a straight path start."""
_LEVER = 4.0 * CM
"""Distance equivalent to a rotation of 1 rad."""
_BLOCKED = math.cos(20.0 * DEG)
"""Cosine of the angle around the direction to avoid that the capsule does not enter."""
_ROTATION_STEP = 0.02
"""Rotation between samples of a path [rad]."""


@dataclass(frozen=True)
class WallPath:
    """Path of capsule poses on the wall, in the world at rest.

    Attributes:
        positions: Positions of the capsule's origin [m].
        wall_normals: Unit normals out of the lumen.
        directions: Unit viewing directions of the capsule.
    """

    positions: Float[np.ndarray, "n 3"]
    wall_normals: Float[np.ndarray, "n 3"]
    directions: Float[np.ndarray, "n 3"]

    @cached_property
    def arc_length(self) -> Float[np.ndarray, " n"]:
        """Distance of each sample from the first along the path [m]; rotations count by a lever."""
        steps = np.linalg.norm(np.diff(self.positions, axis=0), axis=1)
        rotations = np.linalg.norm(np.diff(self.directions, axis=0), axis=1)
        return np.concatenate([[0.0], np.cumsum(np.maximum(steps, _LEVER * rotations))])

    @property
    def length(self) -> float:
        """Length of the path [m]."""
        return float(self.arc_length[-1])

    def target(self, arc_length: float) -> CapsuleTarget:
        """Target at an arc length [m], clamped to the ends of the path."""
        columns = np.hstack([self.positions, self.wall_normals, self.directions]).T
        row = np.array([np.interp(arc_length, self.arc_length, column) for column in columns])
        return CapsuleTarget(
            row[:3],
            _unit(row[6:]),
            None,
            _unit(row[3:6]),
            parallel_to_wall=True,
            on_planned_wall=True,
        )


class PathFollower:
    """Follower that moves a target along a path ahead of the capsule, and waits for it."""

    def __init__(self, path: WallPath, speed: float, lookahead: float) -> None:
        """Start at the beginning of the path.

        Args:
            path: The path.
            speed: Speed of the target along it [m/s].
            lookahead: Distance from the capsule to the target beyond which the target waits [m].
        """
        self.path = path
        self.speed = speed
        self.lookahead = lookahead
        self.arc_length = 0.0

    @property
    def has_arrived(self) -> bool:
        """Check that the target is at the end of the path."""
        return self.arc_length >= self.path.length

    @property
    def progress(self) -> float:
        """Fraction of the path's samples that the target has passed."""
        passed = np.interp(
            self.arc_length, self.path.arc_length, np.arange(len(self.path.positions))
        )
        return float(passed) / (len(self.path.positions) - 1)

    def target(self, T_world_capsule: Float[np.ndarray, "4 4"], dt: float) -> CapsuleTarget:
        """Target for the next `dt` [s]."""
        now = self.path.target(self.arc_length)
        offset = now.controlled_axes @ (np.asarray(now.position) - T_world_capsule[:3, 3])
        if np.linalg.norm(offset) > self.lookahead:
            return now
        self.arc_length = min(self.arc_length + self.speed * dt, self.path.length)
        return self.path.target(self.arc_length)


def straight_wall_path(
    model: Model,
    start: CapsuleTarget,
    end: CapsuleTarget,
    *,
    avoid: Float[np.ndarray, " 3"] | None = None,
) -> WallPath:
    """Path along the wall between two nearby targets on it, with a rotation at each end.

    In between, the capsule moves along its own axis, where the field holds it best: forward or
    backward, whichever needs less rotation.

    Args:
        model: Organ, device and posture, at rest.
        start: Current pose of the capsule; with a direction.
        end: Pose to reach; with a direction.
        avoid: Direction that the capsule cannot pass through, such as the limit of the arm's last
            joint; it then rotates the other way.

    Raises:
        InputError: If a target has no direction.
    """
    for name, target in (("start", start), ("end", end)):
        if target.direction is None:
            raise InputError(f"The {name} has no direction. Give one with it, see wall_target.")
    first, last = (np.asarray(target.position, float) for target in (start, end))
    looks = (np.asarray(start.direction, float), np.asarray(end.direction, float))
    count = max(2, round(float(np.linalg.norm(last - first)) / _SPACING) + 1)
    fraction = np.linspace(0.0, 1.0, count)[:, None]
    normals = unit(
        (1.0 - fraction) * np.asarray(start.wall_normal) + fraction * np.asarray(end.wall_normal)
    )
    points = (1.0 - fraction) * first + fraction * last - _CAST_DISTANCE * normals
    ahead = last - first if np.linalg.norm(last - first) > _SPACING else looks[0]
    path = project_path_to_wall(model, points, normals, np.tile(_unit(ahead), (count, 1)))
    candidates = []
    for sign in (1.0, -1.0):
        led = replace(path, directions=sign * path.directions)
        before = _rotation_in_place(
            led.positions[0], led.wall_normals[0], looks[0], led.directions[0], avoid
        )
        after = _rotation_in_place(
            led.positions[-1], led.wall_normals[-1], led.directions[-1], looks[1], avoid
        )
        if avoid is None or _unit(avoid) @ led.directions[0] < _BLOCKED:
            candidates.append(_concatenate((before, led, after)))
    return min(candidates, key=lambda path: path.length)


def centerline_wall_path(
    model: Model,
    start: float,
    end: float,
    *,
    wall: Literal["upper", "lower"] = "upper",
    is_backward: bool = False,
) -> WallPath:
    """Path along the upper or lower wall between two positions on the centerline.

    Args:
        model: Organ, device and posture, at rest.
        start: Start arc length [m].
        end: End arc length [m]; below `start` the capsule moves back.
        wall: Wall against which the capsule is pressed.
        is_backward: Whether the capsule faces the oral end.

    Raises:
        InputError: If an arc length is not on the centerline, or both are equal.
    """
    line = model.organ.centerline
    require(start != end, "end", end, "another arc length than start")
    count = max(2, round(abs(end - start) / _SPACING) + 1)
    targets = [
        centerline_target(line, model.T_world_patient, s, is_backward=is_backward, wall=wall)
        for s in np.linspace(start, end, count)
    ]
    points = np.array([target.position for target in targets])
    normals = _smooth(np.array([target.wall_normal for target in targets]))
    directions = _smooth(np.array([target.direction for target in targets]))
    return project_path_to_wall(model, points, unit(normals), unit(directions))


def project_path_to_wall(
    model: Model,
    points: Float[np.ndarray, "n 3"],
    rays: Float[np.ndarray, "n 3"],
    directions: Float[np.ndarray, "n 3"],
) -> WallPath:
    """Move a path in the lumen to where the capsule lies on the wall, and smooth it.

    Args:
        model: Organ, device and posture, at rest.
        points: Points in the lumen, in the world [m].
        rays: Unit vectors from there towards the wall.
        directions: Unit viewing directions of the capsule.
    """
    distance = np.asarray(model.wall.cast(points, rays)[0], float)
    distance = np.where(np.isfinite(distance), distance, 0.0)[:, None]
    normals = outward_normals(model, points + distance * rays, rays)
    looks = unit(directions - normals * (directions * normals).sum(axis=1, keepdims=True))
    positions = points + rays * free_distance(model, points, rays, looks)[:, None]
    return WallPath(_smooth(positions), unit(_smooth(normals)), unit(_smooth(looks)))


def free_distance(
    model: Model,
    points: Float[np.ndarray, "n 3"],
    rays: Float[np.ndarray, "n 3"],
    directions: Float[np.ndarray, "n 3"],
) -> Float[np.ndarray, " n"]:
    """Distance [m] that a capsule can move from points along rays until it touches the wall.

    Zero if it already touches, or the ray does not hit the wall.

    Args:
        model: Organ, device and posture, at rest.
        points: Positions of the capsule's origin in the world [m].
        rays: Unit vectors of the motion.
        directions: Unit viewing directions of the capsule.
    """
    high = np.asarray(model.wall.cast(points, rays)[0], float)
    high = np.where(np.isfinite(high), high, 0.0)
    low = np.zeros(len(points))
    radius = model.device.radius
    half_length = 0.5 * model.device.length - radius
    along = np.linspace(-half_length, half_length, 5)[:, None, None] * directions
    for _ in range(_BISECTIONS):
        middle = 0.5 * (low + high)
        axis = along + points + middle[:, None] * rays
        gap = np.asarray(model.wall.signed_distance(axis.reshape(-1, 3))).reshape(len(along), -1)
        is_free = gap.min(axis=0) > radius
        low, high = np.where(is_free, middle, low), np.where(is_free, high, middle)
    return low


def _rotation_in_place(
    position: np.ndarray,
    wall_normal: np.ndarray,
    first: np.ndarray,
    last: np.ndarray,
    avoid: np.ndarray | None,
) -> WallPath:
    """Rotation between two directions: the shorter way, but not through `avoid`."""
    first = _unit(first - wall_normal * (wall_normal @ first))
    side = np.cross(wall_normal, first)
    angle = math.atan2(last @ side, last @ first)
    if avoid is not None:
        between = math.atan2(avoid @ side, avoid @ first)
        if 0.0 < between < angle or angle < between < 0.0:
            angle -= math.copysign(2.0 * math.pi, angle)
    angles = np.linspace(0.0, angle, math.ceil(abs(angle) / _ROTATION_STEP) + 1)[:, None]
    directions = np.cos(angles) * first + np.sin(angles) * side
    return WallPath(np.tile(position, angles.shape), np.tile(wall_normal, angles.shape), directions)


def _concatenate(paths: Sequence[WallPath]) -> WallPath:
    return WallPath(
        np.concatenate([path.positions for path in paths]),
        np.concatenate([path.wall_normals for path in paths]),
        np.concatenate([path.directions for path in paths]),
    )


def _smooth(rows: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "n 3"]:
    """Gaussian smoothing along the path with fixed ends."""
    from scipy.ndimage import gaussian_filter1d  # slow to load

    # Point reflection at the ends keeps them fixed.
    padded = np.concatenate([2 * rows[:1] - rows[:0:-1], rows, 2 * rows[-1:] - rows[-2::-1]])
    smoothed = gaussian_filter1d(padded, _SMOOTHING / _SPACING, axis=0, mode="nearest")
    return smoothed[len(rows) - 1 : 2 * len(rows) - 1]


def _unit(vector: Float[np.ndarray, " 3"]) -> Float[np.ndarray, " 3"]:
    return vector / max(float(np.linalg.norm(vector)), 1e-12)


_TOLERANCE = 3.0 * MM
"""Distance from the reference, at the target, within which a capsule has arrived."""
_SETTLING_TIME = 1.0
"""Time [s] for which a capsule must stay at the target. A capsule that is on another wall for this
long is brought back."""
_RECOVERY_TIMEOUT = 8.0
"""Maximum time [s] for bringing back a capsule from another wall."""


class PointToPointPlanner:
    """Planner that moves one capsule to one target, and replans where the capsule stalls."""

    def __init__(
        self,
        controller: MagnetController,
        T_world_capsule: Float[np.ndarray, "4 4"],
        target: CapsuleTarget,
        *,
        avoid: Float[np.ndarray, " 3"] | None = None,
        attempts: int = 2,
        timeout: float = 10.0,
    ) -> None:
        """Plan the path.

        Args:
            controller: Steers the capsule; its model is that of the organ at rest.
            T_world_capsule: Pose of the capsule, which lies on the wall.
            target: Nearby pose to reach, see `wall_target`.
            avoid: Direction that the capsule cannot pass through, see `straight_wall_path`.
            attempts: Maximum number of planned paths, 1 or more.
            timeout: Time in addition to that of the path after which an attempt has failed [s].

        Raises:
            InputError: If the target has no direction, or `attempts` is 0.
        """
        require(attempts >= 1, "attempts", attempts, "1 or more")
        self._controller = controller
        self._target = target
        self._avoid = avoid
        self.attempts = attempts
        self.timeout = timeout
        self._settled_time = 0.0
        self._off_wall_time = 0.0
        self._plan(T_world_capsule)

    @property
    def is_settled(self) -> bool:
        """Check that the capsule is at the target and has been for a second."""
        return self._settled_time >= _SETTLING_TIME

    @property
    def has_failed(self) -> bool:
        """Check for failure: no attempt left, or off the wall; see the controller's status."""
        is_over = self.attempts == 0 and self._time > self._limit
        return not self.is_settled and (is_over or self._off_wall_time > _RECOVERY_TIMEOUT)

    def control(self, capsule: CapsuleView, dt: float) -> Control:
        """Command for the next `dt` [s]."""
        T = capsule.T_world_capsule
        if self._time > self._limit and self.attempts:
            self._plan(T)
        target = self._follower.target(T, dt)
        # Off the planned wall, the magnet holds the capsule where it is, and so draws it back.
        target = replace(target, on_planned_wall=self._off_wall_time < _SETTLING_TIME)
        control = self._controller.track(capsule, target, dt)
        self._time += dt
        status = self._controller.status
        error = float(np.linalg.norm(status.position_error))
        is_off_wall = status.lost == "wrong_wall"
        self._off_wall_time = self._off_wall_time + dt if is_off_wall else 0.0
        is_there = self._follower.has_arrived and error < _TOLERANCE
        self._settled_time = self._settled_time + dt if is_there else 0.0
        return control

    def _plan(self, T_world_capsule: Float[np.ndarray, "4 4"]) -> None:
        model = self._controller.model
        gains = self._controller.gains
        here = wall_target(model, T_world_capsule[:3, 3], T_world_capsule[:3, 2])
        path = straight_wall_path(model, here, self._target, avoid=self._avoid)
        self._follower = PathFollower(path, gains.speed, gains.lookahead)
        self._time = 0.0
        self._limit = path.length / gains.speed + self.timeout
        self.attempts -= 1
