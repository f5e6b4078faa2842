"""Straight guts of named segments, for tests of the muscle."""

from __future__ import annotations

import numpy as np

from vrcaps.organ.surface import Centerline, OrganSurface, vertex_normals
from vrcaps.units import MM


def straight_gut(
    segments: dict[str, float],
    *,
    radius: float = 11.0 * MM,
    edge: float = 2.0 * MM,
    name: str = "gut",
) -> OrganSurface:
    """A closed straight tube along x whose segments have lengths [m], from the oral end."""
    length = sum(segments.values())
    x = np.linspace(0.0, length, round(length / edge) + 1)
    around = max(8, round(2.0 * np.pi * radius / edge))
    angle = 2.0 * np.pi * np.arange(around) / around
    ring = radius * np.stack([np.zeros(around), np.cos(angle), np.sin(angle)], -1)
    axis = np.stack([x, np.zeros_like(x), np.zeros_like(x)], -1)
    vertices = np.concatenate([(axis[:, None] + ring).reshape(-1, 3), axis[[0, -1]]])
    arc_length = np.concatenate([np.repeat(x, around), x[[0, -1]]])
    ends = np.cumsum(list(segments.values()))
    label = 1 + np.searchsorted(ends[:-1], arc_length, side="right")
    frames = np.broadcast_to(np.array([[0, 0, 1], [1, 0, 0], [0, 1, 0]], float), (len(x), 3, 3))
    faces = _faces(len(x), around)
    return OrganSurface(
        name=name,
        vertices=vertices,
        faces=faces,
        normals=vertex_normals(vertices, faces),
        uv=np.zeros((len(faces), 3, 2)),
        label=label.astype(np.uint8),
        label_names=("background", *segments),
        instance=np.zeros(len(vertices), np.uint16),
        arc_length=arc_length,
        theta=np.zeros(len(vertices)),
        radius=np.full(len(vertices), radius),
        centerline=Centerline(axis, x, np.full(len(x), radius), frames),
    )


def _faces(rings: int, around: int) -> np.ndarray:
    """Counter-clockwise seen from inside, with a cap at either end."""
    i, j = np.meshgrid(np.arange(rings - 1), np.arange(around), indexing="ij")
    k = (j + 1) % around
    a, b, c, d = (r * around + q for r, q in ((i, j), (i, k), (i + 1, k), (i + 1, j)))
    wall = np.concatenate([np.stack([a, c, b], -1), np.stack([a, d, c], -1)]).reshape(-1, 3)
    j, k = np.arange(around), (np.arange(around) + 1) % around
    last, end = rings * around, (rings - 1) * around
    caps = [
        np.stack([np.full(around, last), j, k], -1),
        np.stack([np.full(around, last + 1), end + k, end + j], -1),
    ]
    return np.concatenate([wall, *caps])
