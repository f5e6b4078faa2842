"""Tubes seen from inside, whose courses and radii are known in closed form."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from vrcaps.core.units import MM
from vrcaps.mesh.mesh import vertex_normals
from vrcaps.organ.centerline import transport_frames
from vrcaps.organ.surface import Appearance, Centerline, OrganSurface

_QUAD = np.array([[0, 0], [0, 1], [1, 1], [1, 0]])
"""Row and column of a quad's corners."""


def tube_about(
    points: np.ndarray,
    radius: float,
    around: int,
    *,
    frames: np.ndarray | None = None,
    start: float = -np.pi,
    capped: bool = False,
) -> OrganSurface:
    """A tube about a course; faces are counter-clockwise seen from inside.

    Its texture coordinates go from 0 to 1 around it from `start`, and along it by rings.

    Args:
        points: Course [n 3] [m].
        radius: [m].
        around: Vertices of a ring.
        frames: Axes [n 3 3] or [3 3] as columns, the first where angles begin, the last along the
            course; None is without twist.
        start: Angle of the first vertex of a ring [rad].
        capped: Whether both ends are closed, by fans about the course's ends.
    """
    steps = np.linalg.norm(np.diff(points, axis=0), axis=1)
    s, rings = np.append(0.0, np.cumsum(steps)), len(points)
    if frames is None:
        tangents = np.gradient(points, axis=0)
        tangents /= np.linalg.norm(tangents, axis=1, keepdims=True)
        frames = transport_frames(points, tangents)
    frames = np.broadcast_to(frames, (rings, 3, 3))
    angle = start + 2.0 * np.pi * np.arange(around) / around
    ring = np.cos(angle)[:, None] * frames[:, None, :, 0]
    ring = ring + np.sin(angle)[:, None] * frames[:, None, :, 1]
    vertices = (points[:, None] + radius * ring).reshape(-1, 3)
    first = np.mgrid[: rings - 1, :around].reshape(2, -1, 1)
    row, column = first + _QUAD.T[:, None]
    quads = row * around + column % around
    place = np.stack([column / around, row / (rings - 1)], axis=-1)
    faces, uv = (np.concatenate([q[:, [0, 2, 1]], q[:, [0, 3, 2]]]) for q in (quads, place))
    arc_length, theta = np.repeat(s, around), np.tile(angle, rings)
    if capped:
        lids = _lids(rings, around)
        vertices = np.concatenate([vertices, points[[0, -1]]])
        faces, uv = np.concatenate([faces, lids]), np.pad(uv, ((0, len(lids)), (0, 0), (0, 0)))
        arc_length, theta = np.append(arc_length, s[[0, -1]]), np.append(theta, [0.0, 0.0])
    count = len(vertices)
    return OrganSurface(
        name="tube",
        vertices=vertices,
        faces=faces,
        normals=vertex_normals(vertices, faces),
        uv=uv,
        label=np.ones(count, np.uint8),
        label_names=("background", "wall"),
        instance=np.zeros(count, np.uint16),
        arc_length=arc_length,
        theta=(theta + np.pi) % (2.0 * np.pi) - np.pi,
        radius=np.full(count, radius),
        centerline=Centerline(points, s, np.full(rings, radius), frames),
    )


def _lids(rings: int, around: int) -> np.ndarray:
    """Faces that close both ends about the last two vertices."""
    j, k, last = np.arange(around), (np.arange(around) + 1) % around, rings * around
    end = last - around
    return np.concatenate(
        [
            np.stack([np.full(around, last), j, k], -1),
            np.stack([np.full(around, last + 1), end + k, end + j], -1),
        ]
    )


def straight_tube(length: float, radius: float, around: int, rings: int) -> OrganSurface:
    """An open tube about z from z = 0."""
    points = np.outer(np.linspace(0.0, length, rings), [0.0, 0.0, 1.0])
    return tube_about(points, radius, around, frames=np.eye(3))


def straight_gut(
    segments: dict[str, float],
    *,
    radius: float = 11.0 * MM,
    edge: float = 2.0 * MM,
    name: str = "gut",
) -> OrganSurface:
    """A closed straight tube along x whose segments have lengths [m], from the oral end."""
    length = sum(segments.values())
    points = np.outer(np.linspace(0.0, length, round(length / edge) + 1), [1.0, 0.0, 0.0])
    around = max(8, round(2.0 * np.pi * radius / edge))
    frame = np.array([[0, 0, 1], [1, 0, 0], [0, 1, 0]], float)
    gut = tube_about(points, radius, around, frames=frame, start=0.0, capped=True)
    ends = np.cumsum(list(segments.values()))
    label = 1 + np.searchsorted(ends[:-1], gut.arc_length, side="right")
    names = ("background", *segments)
    return replace(gut, name=name, label=label.astype(np.uint8), label_names=names)


def bent_tube(radius: float = 0.018, around: int = 40, along: int = 300) -> OrganSurface:
    """A closed tube: 0.1 m straight, half a turn of 45 mm, straight back, lifted like a helix."""
    bend = 0.045
    arc = np.pi * bend
    s = np.linspace(0.0, 0.2 + arc, along)
    turn = np.clip((s - 0.1) / bend, 0.0, np.pi)
    x = np.minimum(s, 0.1) + bend * np.sin(turn) - np.maximum(s - 0.1 - arc, 0.0)
    points = np.stack([x, bend * (1.0 - np.cos(turn)), 0.02 * np.sin(s / 0.05)], axis=1)
    tube = tube_about(points, radius, around, start=0.0, capped=True)
    label = np.where(tube.arc_length < 0.15, 1, 2).astype(np.uint8)
    line = tube.centerline
    clear = np.minimum(radius, np.minimum(line.arc_length, line.length - line.arc_length))
    return replace(
        tube,
        label=label,
        label_names=("background", "first", "second"),
        centerline=replace(line, radius=clear),
    )


def textured(organ: OrganSurface) -> OrganSurface:
    """The organ with a small texture."""
    look = Appearance(
        albedo=np.random.default_rng(0).integers(90, 200, (32, 32, 3), np.uint8),
        roughness=np.full((32, 32), 128, np.uint8),
        height=np.zeros((32, 32), np.float32),
    )
    return replace(organ, appearance=look)
