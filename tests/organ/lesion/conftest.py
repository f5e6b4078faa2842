"""A straight tube with a mucosa, on which geodesics, masks and streams have closed forms."""

from dataclasses import replace

import numpy as np
import pytest

from vrcaps.organ.appearance import bake_appearance
from vrcaps.organ.surface import Centerline, OrganSurface, vertex_normals
from vrcaps.units import MM

RADIUS, LENGTH, COLUMNS, ROWS = 18.0 * MM, 160.0 * MM, 72, 104


def make_tube() -> OrganSurface:
    """Open at both ends, seen from inside; its texture wraps around it."""
    angle = np.arange(COLUMNS) * (2.0 * np.pi / COLUMNS) - np.pi
    along = np.linspace(0.0, LENGTH, ROWS + 1)
    grid_s, grid_angle = (part.ravel() for part in np.meshgrid(along, angle, indexing="ij"))
    vertices = np.stack([RADIUS * np.cos(grid_angle), RADIUS * np.sin(grid_angle), grid_s], axis=-1)
    row, column = (part.ravel() for part in np.mgrid[:ROWS, :COLUMNS])
    nodes = np.array([[0, 0], [1, 0], [1, 1], [0, 1]])
    rows, columns = row[:, None] + nodes[:, 0], column[:, None] + nodes[:, 1]
    quads = rows * COLUMNS + columns % COLUMNS
    quad_uv = np.stack([columns / COLUMNS, rows / ROWS], axis=-1)
    faces = np.concatenate([quads[:, [0, 1, 2]], quads[:, [0, 2, 3]]])
    uv = np.concatenate([quad_uv[:, [0, 1, 2]], quad_uv[:, [0, 2, 3]]])
    frames = np.tile(np.eye(3), (len(along), 1, 1))
    axis = np.stack([0.0 * along, 0.0 * along, along], axis=-1)
    return OrganSurface(
        name="tube",
        vertices=vertices,
        faces=faces,
        normals=vertex_normals(vertices, faces),
        uv=uv,
        label=np.where(grid_s < 0.5 * LENGTH, 1, 2).astype(np.uint8),
        label_names=("background", "upper", "lower"),
        instance=np.zeros(len(vertices), np.uint16),
        arc_length=grid_s,
        theta=grid_angle,
        radius=np.full(len(vertices), RADIUS),
        centerline=Centerline(axis, along, np.full(len(along), RADIUS), frames),
    )


@pytest.fixture(scope="session")
def tube() -> OrganSurface:
    plain = make_tube()
    assert (plain.normals[:, :2] * plain.vertices[:, :2]).sum(axis=1).max() < 0.0
    return replace(plain, appearance=bake_appearance(plain, seed=1, texels_per_mm=3.0))
