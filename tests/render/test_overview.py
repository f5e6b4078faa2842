"""The organ's picture: silhouette and shading of shapes with a known outline."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from vrcaps._core import Wall
from vrcaps.organ.surface import Centerline, OrganSurface, vertex_normals
from vrcaps.render.overview import outside_view, write_overview

RADIUS, LENGTH = 0.02, 0.2


@pytest.fixture(scope="module")
def tube() -> OrganSurface:
    """An open cylinder about z from z = 0, its normals inward."""
    num_around, num_along = 64, 41
    theta = np.linspace(-np.pi, np.pi, num_around, endpoint=False)
    z = np.linspace(0.0, LENGTH, num_along)
    grid_z, grid_theta = (a.ravel() for a in np.meshgrid(z, theta, indexing="ij"))
    vertices = np.stack([RADIUS * np.cos(grid_theta), RADIUS * np.sin(grid_theta), grid_z], axis=1)
    row, column = (a.ravel() for a in np.mgrid[: num_along - 1, :num_around])
    a, b = row * num_around + column, row * num_around + (column + 1) % num_around
    faces = np.concatenate(
        [np.stack([a, a + num_around, b], 1), np.stack([b, a + num_around, b + num_around], 1)]
    )
    frames = np.broadcast_to(np.eye(3), (num_along, 3, 3))
    points = np.outer(z, [0.0, 0.0, 1.0])
    count = len(vertices)
    return OrganSurface(
        name="tube",
        vertices=vertices,
        faces=faces,
        normals=vertex_normals(vertices, faces),
        uv=np.zeros((len(faces), 3, 2)),
        label=np.ones(count, np.uint8),
        label_names=("background", "wall"),
        instance=np.zeros(count, np.uint16),
        arc_length=grid_z,
        theta=grid_theta,
        radius=np.full(count, RADIUS),
        centerline=Centerline(points, z, np.full(num_along, RADIUS), frames),
    )


def test_silhouette_of_a_cylinder_from_the_side_is_a_rectangle(tube: OrganSurface) -> None:
    axes, centre, half = np.eye(3)[[0, 2, 1]], np.array([0.0, 0.0, LENGTH / 2]), 0.12
    image = outside_view(tube, Wall(tube.vertices, tube.faces), axes, centre, half, size_px=240)
    covered = np.mean(np.any(image < 1.0, axis=-1))
    assert covered == pytest.approx(2 * RADIUS * LENGTH / (2 * half) ** 2, rel=0.02)
    brightness = image[120].sum(axis=-1)
    inside = brightness < 3.0
    assert brightness[inside][0] < brightness[inside].max()  # the rim is darker than the middle


def test_the_oral_end_has_the_first_colour(tube: OrganSurface) -> None:
    from matplotlib import colormaps

    axes, centre, half = np.eye(3)[[0, 2, 1]], np.array([0.0, 0.0, LENGTH / 2]), 0.1
    image = outside_view(tube, Wall(tube.vertices, tube.faces), axes, centre, half, size_px=101)
    for row, colour in ((-1, colormaps["viridis"](0.0)), (0, colormaps["viridis"](1.0))):
        np.testing.assert_allclose(image[row, 50], colour[:3], atol=0.03)


@pytest.mark.parametrize("dtype", [np.int32, np.int64])
def test_overview_is_an_image_file(tube: OrganSurface, dtype: type, tmp_path: Path) -> None:
    from PIL import Image

    write_overview(replace(tube, faces=tube.faces.astype(dtype)), tmp_path / "tube.png")
    with Image.open(tmp_path / "tube.png") as image:
        assert image.size == (1200, 950)
