"""Smooth curve with arc length, clearance and frames through given points."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import scipy

from vrcaps.core.errors import InputError
from vrcaps.organ.centerline.distance import wall_distance
from vrcaps.organ.surface import Centerline

if TYPE_CHECKING:
    from jaxtyping import Float, Int

_STEPS_PER_RADIUS = 16.0
_MAX_SAMPLES = 20_000


def centerline_from_points(
    points: Float[np.ndarray, "k 3"],
    vertices: Float[np.ndarray, "n 3"],
    faces: Int[np.ndarray, "m 3"],
    *,
    step: float | None = None,
) -> Centerline:
    """Smooth curve through points along a lumen, from the oral to the anal end.

    Args:
        points: Points along the lumen [m]; a cubic spline passes through all of them.
        vertices: Vertices of the wall [m], same frame.
        faces: Faces of the wall.
        step: Distance between samples [m]; by default 1/16 of the median radius.

    Raises:
        InputError: If the points form no curve, or the curve crosses or touches the wall.
    """
    points = np.asarray(points, float)
    if points.ndim != 2 or points.shape[1:] != (3,) or not np.isfinite(points).all():
        raise InputError(f"Centerline points have shape {points.shape}. Give finite points [n 3].")
    keep = np.append(True, np.linalg.norm(np.diff(points, axis=0), axis=1) > 0.0)
    if np.count_nonzero(keep) < 2:
        raise InputError("A centerline needs at least 2 different points.")
    chord = np.append(0.0, np.cumsum(np.linalg.norm(np.diff(points[keep], axis=0), axis=1)))
    spline = scipy.interpolate.CubicSpline(chord, points[keep])
    if step is None:
        coarse = spline(np.linspace(0.0, chord[-1], 50))
        step = float(np.median(wall_distance(coarse, vertices, faces))) / _STEPS_PER_RADIUS
    num = int(np.clip(np.ceil(chord[-1] / max(step, chord[-1] / _MAX_SAMPLES)), 8, _MAX_SAMPLES))
    at = _uniform(spline, chord[-1], num)
    samples, tangents = spline(at), spline(at, 1)
    tangents /= np.linalg.norm(tangents, axis=1, keepdims=True)
    gaps = np.linalg.norm(np.diff(samples, axis=0), axis=1)
    radius = wall_distance(samples, vertices, faces)
    _check_clear(samples, radius, gaps)
    arc_length = np.append(0.0, np.cumsum(gaps))
    return Centerline(samples, arc_length, radius, transport_frames(samples, tangents))


def _uniform(
    spline: scipy.interpolate.CubicSpline, stop: float, num: int
) -> Float[np.ndarray, " n"]:
    """Parameters of `num` + 1 evenly spaced points along a spline."""
    dense = np.linspace(0.0, stop, 8 * num + 1)
    length = np.append(0.0, np.cumsum(np.linalg.norm(np.diff(spline(dense), axis=0), axis=1)))
    return np.interp(np.linspace(0.0, length[-1], num + 1), length, dense)


def _check_clear(
    points: Float[np.ndarray, "n 3"], radius: Float[np.ndarray, " n"], gaps: Float[np.ndarray, " g"]
) -> None:
    """Reject a curve that crosses the wall: each step must lie in the free balls of its ends."""
    blocked = np.flatnonzero(radius[1:] + radius[:-1] <= gaps)
    if len(blocked):
        at = points[blocked[0]]
        raise InputError(
            f"The centerline touches the wall at {at.round(6).tolist()} m and in "
            f"{len(blocked) - 1} other places. The lumen must be open from end to end."
        )


def transport_frames(
    points: Float[np.ndarray, "n 3"], tangents: Float[np.ndarray, "n 3"]
) -> Float[np.ndarray, "n 3 3"]:
    """Rotation-minimizing frames along a curve (Wang et al. 2008, double reflection).

    Args:
        points: Samples of the curve.
        tangents: Unit tangents at the samples.

    Returns:
        Rotations; columns are two transverse axes and the tangent. The first transverse axis
        of the first frame is as close as possible to the axis least aligned with the tangent.
    """
    nearest = np.eye(3)[np.argmin(np.abs(tangents[0]))]
    x = nearest - (nearest @ tangents[0]) * tangents[0]
    axes = [x / np.linalg.norm(x)]
    steps = np.diff(points, axis=0)
    for step, tangent, following in zip(steps, tangents[:-1], tangents[1:], strict=True):
        scale = 2.0 / (step @ step)
        x = axes[-1] - scale * (step @ axes[-1]) * step
        reflected = tangent - scale * (step @ tangent) * step
        bend = following - reflected
        if (square := bend @ bend) > 0.0:
            x = x - 2.0 / square * (bend @ x) * bend
        x = x - (x @ following) * following
        axes.append(x / np.linalg.norm(x))
    first = np.array(axes)
    return np.stack([first, np.cross(tangents, first), tangents], axis=-1)


def polyline_points(
    centerline: Centerline, arc_length: Float[np.ndarray, "*batch"] | float
) -> Float[np.ndarray, "*batch 3"]:
    """Points [m] at arc lengths [m], interpolated linearly between the samples.

    Much faster than `interpolate`. Arc lengths are clamped to the ends.
    """
    knots = centerline.arc_length
    return np.stack([np.interp(arc_length, knots, axis) for axis in centerline.points.T], axis=-1)


def interpolate(
    centerline: Centerline, arc_length: Float[np.ndarray, "*batch"]
) -> tuple[
    Float[np.ndarray, "*batch 3"], Float[np.ndarray, "*batch 3 3"], Float[np.ndarray, "*batch"]
]:
    """Points [m], frames and radius [m] at any arc lengths along a centerline.

    Points lie on the cubic Hermite curve through the samples and their tangents; frames rotate
    at a constant rate between samples; the radius is linear. Arc lengths are clamped to the ends.

    Args:
        centerline: The curve.
        arc_length: Arc lengths [m]; any shape.
    """
    at = np.clip(arc_length, 0.0, centerline.length)
    knots = centerline.arc_length
    below = np.clip(np.searchsorted(knots, at, side="right") - 1, 0, len(knots) - 2)
    gap = knots[below + 1] - knots[below]
    t = (at - knots[below]) / gap
    start, stop = centerline.points[below], centerline.points[below + 1]
    frames, following = centerline.frames[below], centerline.frames[below + 1]
    pull = (t * (1.0 - t) ** 2 * gap)[..., None] * frames[..., 2]
    pull -= (t**2 * (1.0 - t) * gap)[..., None] * following[..., 2]
    points = start + (t**2 * (3.0 - 2.0 * t))[..., None] * (stop - start) + pull
    relative = np.swapaxes(frames, -1, -2) @ following
    turn = (
        scipy.spatial.transform.Rotation.from_matrix(relative.reshape(-1, 3, 3))
        .as_rotvec()
        .reshape(*t.shape, 3)
    )
    partial = scipy.spatial.transform.Rotation.from_rotvec(
        (t[..., None] * turn).reshape(-1, 3)
    ).as_matrix()
    frames = frames @ partial.reshape(*t.shape, 3, 3)
    return points, frames, np.interp(at, knots, centerline.radius)
