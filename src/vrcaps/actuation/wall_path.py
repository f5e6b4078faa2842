"""A way for a capsule along a wall, and a goal that goes ahead of it there."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING, Literal

import numpy as np

from vrcaps.actuation.capsule_target import Goal, gut_goal, wall_presses
from vrcaps.errors import InputError, require
from vrcaps.units import CM, DEG, MM

if TYPE_CHECKING:
    from jaxtyping import Float

    from vrcaps.world.model import Model

_SPACING = 1.0 * MM
_BLUR = 4.0 * MM
"""Standard deviation along the way: of the size of a fold."""
_ROUNDS = 16
"""Halvings of the way to the wall: to a micrometre."""
_FAR = 2.0 * CM
"""From the wall into the lumen, where a straight way is cast from."""
_LEVER = 4.0 * CM
"""A turn of 1 rad counts as much as this way."""
_BLOCKED = math.cos(20.0 * DEG)
"""Cosine of an angle from a direction to avoid within which the capsule is not led."""
_TURNED = 0.02
"""Turn from one place of a way to the next [rad]."""


@dataclass(frozen=True)
class WallPath:
    """Where a capsule lies along a wall, in the world at rest.

    Attributes:
        places: Of the capsule's origin [m].
        presses: Unit vectors out of the lumen, square to the wall.
        directions: Unit vectors along which the capsule looks.
    """

    places: Float[np.ndarray, "n 3"]
    presses: Float[np.ndarray, "n 3"]
    directions: Float[np.ndarray, "n 3"]

    @cached_property
    def arc_length(self) -> Float[np.ndarray, " n"]:
        """Distance along the way of each place from the first [m]; turns count by a lever."""
        steps = np.linalg.norm(np.diff(self.places, axis=0), axis=1)
        turns = np.linalg.norm(np.diff(self.directions, axis=0), axis=1)
        return np.concatenate([[0.0], np.cumsum(np.maximum(steps, _LEVER * turns))])

    @property
    def length(self) -> float:
        """Length of the way [m]."""
        return float(self.arc_length[-1])

    def goal(self, along: float) -> Goal:
        """The goal a distance [m] along the way; its ends beyond them."""
        columns = np.hstack([self.places, self.presses, self.directions]).T
        row = np.array([np.interp(along, self.arc_length, column) for column in columns])
        place, press, direction = row[:3], _unit(row[3:6]), _unit(row[6:])
        return Goal(place, direction, None, press, level=True, mapped=True)


class Follower:
    """Goes ahead of a capsule along a way, and waits for it."""

    def __init__(self, path: WallPath, speed: float, lead: float) -> None:
        """Begins at the way's start.

        Args:
            path: The way.
            speed: Along it [m/s].
            lead: How far the capsule may stay behind before it waits [m].
        """
        self.path, self.speed, self.lead, self.along = path, speed, lead, 0.0

    @property
    def arrived(self) -> bool:
        """Whether the goal is at the way's end."""
        return self.along >= self.path.length

    @property
    def share(self) -> float:
        """How much of the way the goal has gone, by the number of places on it."""
        passed = np.interp(self.along, self.path.arc_length, np.arange(len(self.path.places)))
        return float(passed) / (len(self.path.places) - 1)

    def goal(self, T_world_capsule: Float[np.ndarray, "4 4"], dt: float) -> Goal:
        """The goal for the next `dt` [s]."""
        now = self.path.goal(self.along)
        off = now.controlled @ (np.asarray(now.position) - T_world_capsule[:3, 3])
        if np.linalg.norm(off) > self.lead:
            return now
        self.along = min(self.along + self.speed * dt, self.path.length)
        return self.path.goal(self.along)


def straight_wall_path(
    model: Model, start: Goal, end: Goal, *, avoid: Float[np.ndarray, " 3"] | None = None
) -> WallPath:
    """Along the wall from one goal on it to another near by, turned at both to go along its axis.

    Along its axis the field holds a capsule best. It goes ahead or back, whatever turns it less.

    Args:
        model: Organ, device and posture, at rest.
        start: Where the capsule is; its direction must be given.
        end: Where it is to be; so too.
        avoid: Direction through which it cannot be turned, such as that at which the arm's last
            joint ends; it is turned the other way round.

    Raises:
        InputError: If a goal has no direction.
    """
    for name, goal in (("start", start), ("end", end)):
        if goal.direction is None:
            raise InputError(f"The {name} has no direction. Give a goal with one, see wall_goal.")
    first, last = (np.asarray(goal.position, float) for goal in (start, end))
    looks = (np.asarray(start.direction, float), np.asarray(end.direction, float))
    count = max(2, round(float(np.linalg.norm(last - first)) / _SPACING) + 1)
    share = np.linspace(0.0, 1.0, count)[:, None]
    presses = _units((1.0 - share) * np.asarray(start.press) + share * np.asarray(end.press))
    points = (1.0 - share) * first + share * last - _FAR * presses
    ahead = last - first if np.linalg.norm(last - first) > _SPACING else looks[0]
    way = lay(model, points, presses, np.tile(_unit(ahead), (count, 1)))
    turned = []
    for sense in (1.0, -1.0):
        led = replace(way, directions=sense * way.directions)
        before = _turn(led.places[0], led.presses[0], looks[0], led.directions[0], avoid)
        after = _turn(led.places[-1], led.presses[-1], led.directions[-1], looks[1], avoid)
        if avoid is None or _unit(avoid) @ led.directions[0] < _BLOCKED:
            turned.append(_joined((before, led, after)))
    return min(turned, key=lambda path: path.length)


def gut_wall_path(
    model: Model,
    start: float,
    end: float,
    *,
    side: Literal["up", "down"] = "up",
    backwards: bool = False,
) -> WallPath:
    """Along the upper or lower wall between two places on the gut's centreline.

    Args:
        model: Organ, device and posture, at rest.
        start: Arc length [m].
        end: Arc length [m]; below `start` the capsule goes back.
        side: The wall that the capsule is pressed against.
        backwards: The capsule looks towards the oral end.

    Raises:
        InputError: If an arc length is not on the centreline, or both are the same.
    """
    line = model.organ.centerline
    require(start != end, "end", end, "another arc length than start")
    count = max(2, round(abs(end - start) / _SPACING) + 1)
    goals = [
        gut_goal(line, model.T_world_patient, place, backwards=backwards, side=side)
        for place in np.linspace(start, end, count)
    ]
    points = np.array([goal.position for goal in goals])
    presses = _smooth(np.array([goal.press for goal in goals]))
    directions = _smooth(np.array([goal.direction for goal in goals]))
    return lay(model, points, _units(presses), _units(directions))


def lay(
    model: Model,
    points: Float[np.ndarray, "n 3"],
    presses: Float[np.ndarray, "n 3"],
    directions: Float[np.ndarray, "n 3"],
) -> WallPath:
    """A way in the lumen, moved to where the capsule lies on the wall; smooth along the way.

    Args:
        model: Organ, device and posture, at rest.
        points: In the lumen, in the world [m].
        presses: Unit vectors along which the wall is sought from there.
        directions: Unit vectors along which the capsule looks.
    """
    far = np.asarray(model.wall.cast(points, presses)[0], float)
    met = np.where(np.isfinite(far), far, 0.0)[:, None]
    normals = wall_presses(model, points + met * presses, presses)
    looks = _units(directions - normals * (directions * normals).sum(axis=1, keepdims=True))
    places = points + presses * free_way(model, points, presses, looks)[:, None]
    return WallPath(_smooth(places), _units(_smooth(normals)), _units(_smooth(looks)))


def free_way(
    model: Model,
    points: Float[np.ndarray, "n 3"],
    presses: Float[np.ndarray, "n 3"],
    directions: Float[np.ndarray, "n 3"],
) -> Float[np.ndarray, " n"]:
    """How far a capsule can go from points until it touches the wall, along unit vectors [m].

    Zero where it touches already, or there is no wall.
    """
    far = np.asarray(model.wall.cast(points, presses)[0], float)
    far = np.where(np.isfinite(far), far, 0.0)
    radius, half = model.device.radius, 0.5 * model.device.length - model.device.radius
    along = np.linspace(-half, half, 5)[:, None, None] * directions
    low, high = np.zeros(len(points)), far
    for _ in range(_ROUNDS):
        middle = 0.5 * (low + high)
        axis = along + points + middle[:, None] * presses
        gap = np.asarray(model.wall.signed_distance(axis.reshape(-1, 3))).reshape(len(along), -1)
        free = gap.min(axis=0) > radius
        low, high = np.where(free, middle, low), np.where(free, high, middle)
    return low


def _turn(
    place: np.ndarray,
    press: np.ndarray,
    first: np.ndarray,
    last: np.ndarray,
    avoid: np.ndarray | None,
) -> WallPath:
    """A turn on the spot from one direction to another, the shorter way round but through one."""
    first = _unit(first - press * (press @ first))
    side = np.cross(press, first)
    angle = math.atan2(last @ side, last @ first)
    if avoid is not None:
        between = math.atan2(avoid @ side, avoid @ first)
        if 0.0 < between < angle or angle < between < 0.0:
            angle -= math.copysign(2.0 * math.pi, angle)
    angles = np.linspace(0.0, angle, math.ceil(abs(angle) / _TURNED) + 1)[:, None]
    directions = np.cos(angles) * first + np.sin(angles) * side
    return WallPath(np.tile(place, angles.shape), np.tile(press, angles.shape), directions)


def _joined(ways: Sequence[WallPath]) -> WallPath:
    places, presses, directions = zip(
        *((way.places, way.presses, way.directions) for way in ways), strict=True
    )
    return WallPath(np.concatenate(places), np.concatenate(presses), np.concatenate(directions))


def _smooth(rows: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "n 3"]:
    """Blurred along the way; its ends stay."""
    from scipy.ndimage import gaussian_filter1d  # slow to load

    # Mirrored through its ends, so that they stay where they are.
    padded = np.concatenate([2 * rows[:1] - rows[:0:-1], rows, 2 * rows[-1:] - rows[-2::-1]])
    blurred = gaussian_filter1d(padded, _BLUR / _SPACING, axis=0, mode="nearest")
    return blurred[len(rows) - 1 : 2 * len(rows) - 1]


def _units(vectors: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "n 3"]:
    return vectors / np.maximum(np.linalg.norm(vectors, axis=1, keepdims=True), 1e-12)


def _unit(vector: Float[np.ndarray, " 3"]) -> Float[np.ndarray, " 3"]:
    return vector / max(float(np.linalg.norm(vector)), 1e-12)
