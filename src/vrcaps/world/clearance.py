"""Clearance between capsule and wall: poses corrected into the lumen, narrow walls displaced."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np

from vrcaps.core.errors import InputError
from vrcaps.core.geometry import invert, rotation_from_vector, transform_from, transform_points
from vrcaps.core.units import MM
from vrcaps.organ.measure import lumen_diameters, unit_question
from vrcaps.world.closure import LumenClosure, closure_of
from vrcaps.world.model import Model

if TYPE_CHECKING:
    from jaxtyping import Float, Int

_PROBE = 0.2 * MM
_PUSH = 0.3 * MM
_LEVER = 10.0 * MM  # distance equivalent to a rotation of 1 rad
_MAX_PUSHES = 80


def capsule_clearance(model: Model, poses: Float[np.ndarray, "n 4 4"]) -> Float[np.ndarray, "n p"]:
    """Distance to the wall [m] of the origin, each camera, and both ends of the body's axis."""
    axis = model.device.length / 2.0 - model.device.radius
    points = [np.zeros(3)]
    points += [np.array(camera.position, float) for camera in model.device.cameras]
    points += [np.array([0.0, 0.0, axis]), np.array([0.0, 0.0, -axis])]
    points_world = transform_points(poses, np.array(points)[None])
    distance = model.wall.signed_distance(points_world.reshape(-1, 3))
    return np.asarray(distance, float).reshape(points_world.shape[:2])


def vital_clearance(model: Model, poses: Float[np.ndarray, "n 4 4"]) -> Float[np.ndarray, " n"]:
    """Minimum distance to the wall [m] of origin and cameras, which must be positive."""
    return capsule_clearance(model, poses)[:, : 1 + len(model.device.cameras)].min(axis=1)


def require_inside(model: Model, poses: Float[np.ndarray, "n 4 4"]) -> None:
    """Check that every camera stays inside the lumen at all poses ``Ts_world_capsule``.

    Raises:
        InputError: If a camera is outside in any frame; states the first and their number.
    """
    clearance = capsule_clearance(model, poses)[:, 1 : 1 + len(model.device.cameras)]
    outside = np.argwhere(~(clearance > 0.0))
    if len(outside) == 0:
        return
    frame, camera = outside[0]
    raise InputError(
        f"Camera {model.device.cameras[camera].name!r} is {-clearance[frame, camera] / MM:.1f} mm "
        f"outside the lumen of {model.organ.name!r} at frame {frame} "
        f"({len(np.unique(outside[:, 0]))} of {len(poses)} frames are outside). Check the "
        "path's unit, handedness and placement, or accept them: allow_outside, on the command "
        "line motion.allow_outside=true."
    )


def fit_text(model: Model) -> str:
    """Sentence on the widths of lumen and capsule, and on the unit of the organ's file."""
    organ = model.organ
    least, median, most = lumen_diameters(organ.centerline)
    unit = organ.metadata.get("unit")
    question = unit_question(unit, median) if isinstance(unit, str) else ""
    return (
        f"the lumen is {least / MM:.1f} to {most / MM:.1f} mm wide, the capsule "
        f"{2.0 * model.device.radius / MM:.1f} mm thick.{question}"
    )


def corrected(
    poses: Float[np.ndarray, "n 4 4"], correction: Float[np.ndarray, "n 6"]
) -> Float[np.ndarray, "n 4 4"]:
    """Shift [m] and rotate [rad] poses in their own frames."""
    return poses @ transform_from(rotation_from_vector(correction[:, 3:]), correction[:, :3])


def push_inside(
    model: Model, poses: Float[np.ndarray, "n 4 4"], *, need: float, blur: float
) -> Float[np.ndarray, "n 6"]:
    """Smooth corrections of neighboring poses that move origin and cameras into the lumen.

    Alternates between moving poses too close to the wall along the gradient of their clearance, and
    blurring all corrections along the path. May fail where the lumen is too narrow.

    Args:
        model: The lumen and the capsule.
        poses: Poses along a path, close to each other.
        need: Clearance to reach [m].
        blur: Standard deviation of the blur [poses].

    Returns:
        Shift [m] and rotation [rad] of each pose, for `corrected`.
    """
    from scipy.ndimage import binary_dilation, gaussian_filter1d  # slow to load

    correction = np.zeros((len(poses), 6))
    unit = np.array([1.0] * 3 + [1.0 / _LEVER] * 3)
    blocked = vital_clearance(model, poses) < need
    if not blocked.any():
        return correction
    # A push affects its neighbors only through the blur, so the window is limited to its reach.
    window = np.flatnonzero(binary_dilation(blocked, iterations=int(10.0 * blur)))
    for _ in range(_MAX_PUSHES):
        clearance = vital_clearance(model, corrected(poses[window], correction[window]))
        near, clearance = window[clearance < need], clearance[clearance < need]
        if len(near) == 0:
            break
        gradient = np.empty((len(near), 6))
        for axis in range(6):
            probe = correction[near]
            probe[:, axis] += _PROBE * unit[axis]
            moved = vital_clearance(model, corrected(poses[near], probe))
            gradient[:, axis] = moved - clearance
        gradient /= np.maximum(np.linalg.norm(gradient, axis=1, keepdims=True), 1e-12)
        correction[near] += _PUSH * gradient * unit
        correction = gaussian_filter1d(correction, blur, axis=0, mode="constant")
    return correction


_LOOKS = 17
"""Number of points of the axis at which the distance to the wall is measured."""

_MIN_DISTANCE = 1e-6
"""Distance from the axis below which the direction is undefined [m]."""


@dataclass(frozen=True)
class WallDisplacement:
    """Kinematic displacement: a narrow wall gives way to the capsule's shell, without forces.

    Within two radii of the body's axis, space is stretched away from it: a point at a distance d
    moves to d' = R + R ((d - d₀) / (2R - d₀))^p, where d₀ is the wall's minimum distance from the
    axis and p = (2R - d₀) / R, with which the map is smooth at its boundary. It is one to one, so
    the wall never self-intersects, touches the shell where it was nearest, and is unchanged where
    the capsule has clearance. `vrcaps.world.world` contains the mechanics.

    Attributes:
        model: The lumen and the capsule that moves in it.
        shown: Model whose wall is displaced; has the same triangles, such as a clean twin.
    """

    model: Model
    shown: Model

    def vertices_world(
        self, T_world_capsule: Float[np.ndarray, "4 4"]
    ) -> Float[np.ndarray, "n 3"] | None:
        """Vertices of the displaced wall [m]; None for a wall at rest."""
        low, high, least = self._axis(T_world_capsule)
        if self._closure is not None:
            vertices = self.shown.vertices_world.copy()
            moved, closed = self._closure.close(
                T_world_capsule,
                self.model.device.length / 2.0,
                self.model.device.radius,
            )
            vertices[moved] = closed
            return self._yielding((vertices, moved), T_world_capsule, (low, high), None)
        if least >= self.model.device.radius:
            return None
        vertices, moved = self.shown.vertices_world.copy(), np.empty(0, int)
        return self._yielding((vertices, moved), T_world_capsule, (low, high), least)

    @cached_property
    def _closure(self) -> LumenClosure | None:
        return closure_of(self.shown)

    @cached_property
    def _rows_at_rest(self) -> Float[np.ndarray, "3 n"]:
        """Coordinates of the vertices at rest, each in a contiguous row [m]."""
        return np.ascontiguousarray(self.shown.vertices_world.T)

    def _yielding(
        self,
        wall: tuple[Float[np.ndarray, "n 3"], Int[np.ndarray, " k"]],
        T_world_capsule: Float[np.ndarray, "4 4"],
        ends: tuple[float, float],
        least: float | None,
    ) -> Float[np.ndarray, "n 3"]:
        """Move vertices off the shell.

        Args:
            wall: Vertices, changed in place, and which of them are not at rest.
            T_world_capsule: Pose of the capsule.
            ends: Part of the body's axis in the lumen [m].
            least: Distance of the vertices to the axis if known [m].
        """
        (vertices, displaced), radius, (low, high) = wall, self.model.device.radius, ends
        reach = 2.0 * radius
        box = T_world_capsule[:3, 3], max(high, -low) + reach
        is_candidate = np.zeros(len(vertices), bool)
        is_candidate[_near(self._rows_at_rest, *box)] = True
        is_candidate[displaced] = True
        near = np.flatnonzero(is_candidate)
        near = near[_near(vertices[near].T, *box)]
        local = transform_points(invert(T_world_capsule), vertices[near])
        local[:, 2] -= np.clip(local[:, 2], low, high)
        distance = np.linalg.norm(local, axis=1)
        moved = (distance < reach) & (distance > _MIN_DISTANCE)
        near, distance = near[moved], distance[moved]
        if least is None:
            least = float(distance.min(initial=reach))
        if least >= radius:
            return vertices
        fraction = np.clip((distance - least) / (reach - least), 0.0, 1.0)
        further = radius + radius * fraction ** ((reach - least) / radius) - distance
        outward = local[moved] @ T_world_capsule[:3, :3].T / distance[:, None]
        vertices[near] += further[:, None] * outward
        return vertices

    def _axis(self, T_world_capsule: Float[np.ndarray, "4 4"]) -> tuple[float, float, float]:
        """Part of the body's axis in the lumen, and its minimum distance to the wall [m].

        An end of the axis may be outside in a bend too sharp for the body.
        """
        device = self.model.device
        half = device.length / 2.0 - device.radius
        along = np.linspace(-half, half, _LOOKS)
        points = T_world_capsule[:3, 3] + along[:, None] * T_world_capsule[:3, 2]
        free = np.asarray(self.model.wall.signed_distance(points), float)
        middle = _LOOKS // 2
        outside = np.flatnonzero(free <= 0.0)
        first = max((k + 1 for k in outside if k < middle), default=0)
        last = min((k - 1 for k in outside if k > middle), default=_LOOKS - 1)
        least = max(float(free[first : last + 1].min()), 0.0)
        return float(along[first]), float(along[last]), least


def _near(
    rows: Float[np.ndarray, "3 n"], center: Float[np.ndarray, " 3"], reach: float
) -> Int[np.ndarray, " k"]:
    """Indices of the points, given by coordinate, in a box around a center, in order."""
    near = np.flatnonzero(np.abs(rows[0] - center[0]) < reach)
    for row, middle in zip(rows[1:], center[1:], strict=True):
        near = near[np.abs(row[near] - middle) < reach]
    return near
