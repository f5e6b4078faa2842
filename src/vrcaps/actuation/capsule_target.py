"""Where a capsule is to be and look."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING, Literal

import numpy as np

from vrcaps.actuation import vectors
from vrcaps.errors import InputError, require
from vrcaps.organ.surface import Centerline
from vrcaps.transforms import invert, rotate_vectors, transform_points
from vrcaps.units import MM

if TYPE_CHECKING:
    from jaxtyping import Float

    from vrcaps.world.model import Model

_UP = (0.0, 0.0, 1.0)
_PATCH = 12.0 * MM
"""Radius of the patch of wall whose mean normal counts: the capsule's half length."""


@dataclass(frozen=True)
class Goal:
    """A place and a direction in the world.

    Attributes:
        position: Where the capsule's origin is to be [m].
        direction: Unit vector along which the front camera is to look; None leaves it.
        along: Unit vector of the only direction in which the place counts, such as the gut's; None:
            in all directions but that of `press`.
        press: Unit vector in which the magnet presses the capsule against the wall.
        level: Make the direction level with the wall that the capsule lies on.
        mapped: The place is on the wall and `press` square to it: the magnet goes by them and not
            by what the capsule touches.
    """

    position: Sequence[float] | Float[np.ndarray, " 3"]
    direction: Sequence[float] | Float[np.ndarray, " 3"] | None = None
    along: Sequence[float] | Float[np.ndarray, " 3"] | None = None
    press: Sequence[float] | Float[np.ndarray, " 3"] = _UP
    level: bool = False
    mapped: bool = False

    def __post_init__(self) -> None:
        for name in ("position", "direction", "along", "press"):
            value = getattr(self, name)
            if value is None:
                continue
            vector = np.asarray(value, float)
            size = math.sqrt(vector @ vector) if vector.shape == (3,) else math.nan
            fits = size < math.inf if name == "position" else abs(size - 1.0) < 1e-6
            if not fits:
                allowed = "a place [m]" if name == "position" else "a unit vector"
                raise InputError(f"Goal's {name} is {value}. Allowed: {allowed}.")

    @cached_property
    def controlled(self) -> Float[np.ndarray, "3 3"]:
        """Projects on the directions in which the place counts."""
        if self.along is not None:
            return np.outer(self.along, self.along)
        return np.eye(3) - np.outer(self.press, self.press)


def gut_goal(
    line: Centerline,
    T_world_patient: Float[np.ndarray, "4 4"],
    arc_length: float,
    *,
    backwards: bool = False,
    yaw: float = 0.0,
    pitch: float = 0.0,
    side: Literal["up", "down"] = "up",
) -> Goal:
    """A place along the gut, where the capsule looks along it, level with the wall, or aside.

    Args:
        line: The gut's centreline.
        T_world_patient: How the patient lies.
        arc_length: Where [m].
        backwards: Look towards the oral end.
        yaw: Turn of the look about the frame's second transverse axis [rad].
        pitch: About its first [rad].
        side: The wall that the capsule is pressed against: the upper or the lower.

    Raises:
        InputError: If the arc length is not on the centreline.
    """
    allowed = f"0 to {line.length:g} m"
    require(0.0 <= arc_length <= line.length, "arc_length", arc_length, allowed)
    s = line.arc_length
    point = np.array([np.interp(arc_length, s, axis) for axis in line.points.T])
    k = min(max(int(np.searchsorted(s, arc_length)) - 1, 0), len(s) - 2)
    share = (arc_length - s[k]) / max(s[k + 1] - s[k], 1e-12)
    axes = (1.0 - share) * line.frames[k] + share * line.frames[k + 1]
    first, second, ahead = (axis / vectors.length(axis) for axis in axes.T)
    look = math.cos(yaw) * math.cos(pitch) * (-ahead if backwards else ahead)
    look = look + math.sin(yaw) * math.cos(pitch) * first - math.sin(pitch) * second
    look, tangent = rotate_vectors(T_world_patient, np.array([look / vectors.length(look), ahead]))
    above = np.array(_UP) if side == "up" else -np.array(_UP)
    up = above - tangent * (above @ tangent)
    # In an upright stretch nothing is above: across the gut, towards the frame's first axis.
    if vectors.length(up) < 0.3:
        up = rotate_vectors(T_world_patient, first[None])[0]
        up = up - tangent * (up @ tangent)
    place = transform_points(T_world_patient, point[None])[0]
    return Goal(place, look, tangent, up / vectors.length(up), level=pitch == 0.0)


def onto_wall(model: Model, T_world_patient: Float[np.ndarray, "4 4"], goal: Goal) -> Goal:
    """A goal in the lumen, moved to where the capsule lies on the wall at its side.

    There its place counts across the gut too. The wall is that at rest; where none is met the goal
    stays as it is.
    """
    T_rest_now = model.T_world_patient @ invert(T_world_patient)
    place = transform_points(T_rest_now, np.asarray(goal.position, float)[None])
    way = rotate_vectors(T_rest_now, np.asarray(goal.press, float)[None])
    distance = float(model.wall.cast(place, way)[0][0])
    if not math.isfinite(distance):
        return goal
    moved = np.asarray(goal.press, float) * max(distance - model.device.radius, 0.0)
    return replace(goal, position=np.asarray(goal.position, float) + moved, along=None)


def wall_goal(
    model: Model, point: Float[np.ndarray, " 3"], direction: Float[np.ndarray, " 3"]
) -> Goal:
    """The capsule lying on the wall nearest to a point, looking as nearly along a direction.

    The wall's slope is that of a patch as large as the capsule, without its folds.

    Args:
        model: Organ, device and posture, at rest.
        point: In the lumen, in the world [m].
        direction: In the world; made level with the wall.

    Raises:
        InputError: If the direction is at right angles to the wall.
    """
    nearest, faces = model.wall.closest_point(np.asarray(point, float)[None])
    corners = model.vertices_world[model.organ.faces[faces[0]]]
    inwards = np.cross(corners[1] - corners[0], corners[2] - corners[0])
    inwards = -wall_presses(model, nearest, -inwards[None] / np.linalg.norm(inwards))[0]
    look = np.asarray(direction, float) - inwards * (inwards @ np.asarray(direction, float))
    length = np.linalg.norm(look)
    if length < 1e-6:
        raise InputError(f"Direction {direction} is at right angles to the wall. Choose another.")
    place = nearest[0] + model.device.radius * inwards
    return Goal(place, look / length, None, -inwards)


def wall_presses(
    model: Model, points: Float[np.ndarray, "n 3"], toward: Float[np.ndarray, "n 3"]
) -> Float[np.ndarray, "n 3"]:
    """Unit vectors out of the lumen, square to the wall about points on it, without its folds.

    Args:
        model: Organ, device and posture, at rest.
        points: On the wall, in the world [m].
        toward: Unit vectors, roughly out of the lumen; what they are where there is no wall.
    """
    from scipy.spatial import KDTree  # slow to load

    outwards = -rotate_vectors(model.T_world_patient, model.organ.normals)
    patches = KDTree(model.vertices_world).query_ball_point(points, _PATCH)
    presses = np.array(toward, float)
    for press, patch in zip(presses, patches, strict=True):
        facing = outwards[patch]
        total = facing[facing @ press > 0.0].sum(axis=0)
        if total.any():
            press[:] = total / np.linalg.norm(total)
    return presses
