"""Target poses of the capsule: in the lumen, along the centerline, or on the wall."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING, Literal

import numpy as np

from vrcaps.core.errors import InputError, require
from vrcaps.core.geometry import invert, length, rotate_vectors, transform_points
from vrcaps.core.units import MM
from vrcaps.organ.surface import Centerline, polyline_points

if TYPE_CHECKING:
    from jaxtyping import Float

    from vrcaps.world.model import Model

_UP = (0.0, 0.0, 1.0)
_PATCH_RADIUS = 12.0 * MM
"""Radius of the wall patch over which normals are averaged: half the length of a capsule."""


@dataclass(frozen=True)
class CapsuleTarget:
    """Target position and heading of the capsule, in the world frame.

    Attributes:
        position: Target of the capsule's origin [m].
        direction: Target unit direction of the front camera; None leaves it free.
        tangent: Unit vector of the only direction in which the position is controlled, such as that
            of the gut; None controls all directions except `wall_normal`.
        wall_normal: Unit vector out of the lumen, in which the magnet presses the capsule against
            the wall.
        parallel_to_wall: Whether to turn the direction parallel to the wall under the capsule.
        on_planned_wall: Whether the position lies on the wall and `wall_normal` is its normal: the
            controller then relies on them instead of the actual contact of the capsule.
    """

    position: Sequence[float] | Float[np.ndarray, " 3"]
    direction: Sequence[float] | Float[np.ndarray, " 3"] | None = None
    tangent: Sequence[float] | Float[np.ndarray, " 3"] | None = None
    wall_normal: Sequence[float] | Float[np.ndarray, " 3"] = _UP
    parallel_to_wall: bool = False
    on_planned_wall: bool = False

    def __post_init__(self) -> None:
        for name in ("position", "direction", "tangent", "wall_normal"):
            value = getattr(self, name)
            if value is None:
                continue
            vector = np.asarray(value, float)
            size = math.sqrt(vector @ vector) if vector.shape == (3,) else math.nan
            fits = size < math.inf if name == "position" else abs(size - 1.0) < 1e-6
            if not fits:
                allowed = "a position [m]" if name == "position" else "a unit vector"
                raise InputError(f"CapsuleTarget's {name} is {value}. Allowed: {allowed}.")

    @cached_property
    def controlled_axes(self) -> Float[np.ndarray, "3 3"]:
        """Projector onto the directions in which the position is controlled."""
        if self.tangent is not None:
            return np.outer(self.tangent, self.tangent)
        return np.eye(3) - np.outer(self.wall_normal, self.wall_normal)


def centerline_target(
    line: Centerline,
    T_world_patient: Float[np.ndarray, "4 4"],
    arc_length: float,
    *,
    is_backward: bool = False,
    yaw: float = 0.0,
    pitch: float = 0.0,
    wall: Literal["upper", "lower"] = "upper",
) -> CapsuleTarget:
    """Target on the centerline, facing along the gut parallel to the wall, or to the side.

    Args:
        line: Centerline of the gut.
        T_world_patient: Posture of the patient.
        arc_length: Position along the centerline [m].
        is_backward: Whether to face the oral end.
        yaw: Rotation of the view about the frame's second transverse axis [rad].
        pitch: Rotation of the view about its first transverse axis [rad].
        wall: Wall against which the capsule is pressed.

    Raises:
        InputError: If the arc length is not on the centerline.
    """
    allowed = f"0 to {line.length:g} m"
    require(0.0 <= arc_length <= line.length, "arc_length", arc_length, allowed)
    s = line.arc_length
    point = polyline_points(line, arc_length)
    k = min(max(int(np.searchsorted(s, arc_length)) - 1, 0), len(s) - 2)
    fraction = (arc_length - s[k]) / max(s[k + 1] - s[k], 1e-12)
    axes = (1.0 - fraction) * line.frames[k] + fraction * line.frames[k + 1]
    first, second, ahead = (axis / length(axis) for axis in axes.T)
    look = math.cos(yaw) * math.cos(pitch) * (-ahead if is_backward else ahead)
    look = look + math.sin(yaw) * math.cos(pitch) * first - math.sin(pitch) * second
    look, tangent = rotate_vectors(T_world_patient, np.array([look / length(look), ahead]))
    vertical = np.array(_UP) if wall == "upper" else -np.array(_UP)
    normal = vertical - tangent * (vertical @ tangent)
    # A vertical part of the gut has no upper wall: use the frame's first axis, across the gut.
    if length(normal) < 0.3:
        normal = rotate_vectors(T_world_patient, first[None])[0]
        normal = normal - tangent * (normal @ tangent)
    position = transform_points(T_world_patient, point[None])[0]
    normal = normal / length(normal)
    return CapsuleTarget(position, look, tangent, normal, parallel_to_wall=pitch == 0.0)


def project_to_wall(
    model: Model, T_world_patient: Float[np.ndarray, "4 4"], target: CapsuleTarget
) -> CapsuleTarget:
    """Move a target in the lumen along its wall normal to where the capsule touches the wall.

    There its position is also controlled across the gut. The wall is that at rest; if the ray
    does not hit it, the target is unchanged.
    """
    T_rest_now = model.T_world_patient @ invert(T_world_patient)
    normal = np.asarray(target.wall_normal, float)
    origin = transform_points(T_rest_now, np.asarray(target.position, float)[None])
    ray = rotate_vectors(T_rest_now, normal[None])
    distance = float(model.wall.cast(origin, ray)[0][0])
    if not math.isfinite(distance):
        return target
    offset = normal * max(distance - model.device.radius, 0.0)
    return replace(target, position=np.asarray(target.position, float) + offset, tangent=None)


def wall_target(
    model: Model, point: Float[np.ndarray, " 3"], direction: Float[np.ndarray, " 3"]
) -> CapsuleTarget:
    """Target on the wall nearest to a point, facing a direction as closely as possible.

    The wall's slope is the mean over a patch the size of the capsule, without its folds.

    Args:
        model: Organ, device and posture, at rest.
        point: Point in the lumen, in the world [m].
        direction: Viewing direction in the world; it is turned parallel to the wall.

    Raises:
        InputError: If the direction is perpendicular to the wall.
    """
    nearest, faces = model.wall.closest_point(np.asarray(point, float)[None])
    corners = model.vertices_world[model.organ.faces[faces[0]]]
    inward = np.cross(corners[1] - corners[0], corners[2] - corners[0])
    inward = -outward_normals(model, nearest, -inward[None] / np.linalg.norm(inward))[0]
    look = np.asarray(direction, float) - inward * (inward @ np.asarray(direction, float))
    norm = np.linalg.norm(look)
    if norm < 1e-6:
        raise InputError(f"Direction {direction} is perpendicular to the wall. Choose another.")
    position = nearest[0] + model.device.radius * inward
    return CapsuleTarget(position, look / norm, None, -inward)


def outward_normals(
    model: Model, points: Float[np.ndarray, "n 3"], outward: Float[np.ndarray, "n 3"]
) -> Float[np.ndarray, "n 3"]:
    """Unit normals out of the lumen at points of the wall, averaged over patches.

    Args:
        model: Organ, device and posture, at rest.
        points: Points on the wall, in the world [m].
        outward: Approximate unit vectors out of the lumen; returned where there is no wall.
    """
    from scipy.spatial import KDTree  # slow to load

    vertex_normals = -rotate_vectors(model.T_world_patient, model.organ.normals)
    patches = KDTree(model.vertices_world).query_ball_point(points, _PATCH_RADIUS)
    normals = np.array(outward, float)
    for normal, patch in zip(normals, patches, strict=True):
        facing = vertex_normals[patch]
        total = facing[facing @ normal > 0.0].sum(axis=0)
        if total.any():
            normal[:] = total / np.linalg.norm(total)
    return normals
