"""Coverage against closed forms, against the renderer, and under motion of the wall."""

import math

import numpy as np
import pytest
import trimesh

from tests.support.seen_walls import HALF_FIELD, POSE, camera, tube
from vrcaps.camera.camera import camera_rays
from vrcaps.core.errors import InputError
from vrcaps.core.geometry import triangle_areas, wall_of
from vrcaps.metrics.coverage import (
    CoverageCriteria,
    CoverageMap,
    pixel_solid_angles,
    readable_pixels,
    resolved_pixels,
    seen_faces,
    vertices_in_frustum,
)
from vrcaps.metrics.view_coverage import ViewCoverage


def test_solid_angles_add_up_to_that_of_the_field() -> None:
    angles = pixel_solid_angles(camera())
    field = 2.0 * math.pi * (1.0 - math.cos(HALF_FIELD))
    assert np.nansum(angles) == pytest.approx(field, rel=2e-3)


@pytest.mark.slow
def test_visible_part_of_a_sphere_is_a_cap() -> None:
    mesh = trimesh.creation.icosphere(subdivisions=7, radius=0.03)
    wall = wall_of(np.array(mesh.vertices), np.array(mesh.faces))
    seen = ViewCoverage(camera(900)).seen([wall], POSE[None], len(mesh.faces))["visible"]
    share = mesh.area_faces[seen].sum() / mesh.area
    assert share == pytest.approx((1.0 - math.cos(HALF_FIELD)) / 2.0, abs=5e-3)


def test_resolved_part_of_a_cylinder_is_a_band() -> None:
    radius = 0.02
    vertices, faces = tube(radius)
    area = triangle_areas(vertices[faces])
    criteria = CoverageCriteria(min_pixel_density=0.0, max_incidence=math.radians(70.0))
    views = ViewCoverage(camera(512), criteria)
    seen = views.seen([wall_of(vertices, faces)], POSE[None], len(faces))
    low, high = radius / math.tan(HALF_FIELD), radius * math.tan(math.radians(70.0))
    band = 2.0 * math.pi * radius * (high - low)
    assert area[seen["resolved"]].sum() == pytest.approx(band, rel=2e-2)
    assert area[seen["resolved"]].sum() / area.sum() == pytest.approx(band / area.sum(), abs=5e-3)
    assert not (seen["resolved"] & ~seen["visible"]).any()


def test_density_bounds_the_distance_at_which_a_wall_is_resolved() -> None:
    """On the axis of an equidistant lens Ω = 1/f², so that density = f² / d²."""
    view = camera()
    normal = np.zeros((256, 256, 3))
    normal[..., 2] = -1.0
    middle = 127
    for distance, resolved in ((0.9, True), (1.1, False)):
        limit = view.lens.focal / math.sqrt(4e6)
        found = resolved_pixels(
            view, np.full((256, 256), distance * limit), normal, CoverageCriteria()
        )
        assert found[middle, middle] == resolved


def test_views_agree_with_pixels_and_their_union_with_single_views() -> None:
    vertices, faces = tube(step=2e-3)
    wall, rng = wall_of(vertices, faces), np.random.default_rng(0)
    view = camera(96)
    poses = np.tile(np.eye(4), (5, 1, 1))
    poses[:, :3, 3] = rng.uniform((-0.01, -0.01, 0.02), (0.01, 0.01, 0.1), (5, 3))
    flags = np.zeros((5, len(faces)), np.uint8)
    views = ViewCoverage(view)
    views.mark([wall], poses, flags)
    rays = camera_rays(view).reshape(-1, 3)
    for pose, row in zip(poses, flags, strict=True):
        lit = rays[np.isfinite(rays[:, 0])]
        _, face = wall.cast(np.tile(pose[:3, 3], (len(lit), 1)), lit.astype(float))
        assert (seen_faces(face, len(faces)) != ((row & 1) != 0)).mean() < 1e-3
    union = np.bitwise_or.reduce(flags)
    assert ((union & 1) != 0).tolist() == views.seen([wall], poses, len(faces))["visible"].tolist()
    each = np.zeros_like(flags)
    views.mark([wall] * 5, poses, each)
    assert (each == flags).all()


def test_a_wall_that_moves_keeps_what_was_seen() -> None:
    vertices, faces = tube(step=2e-3)
    area = triangle_areas(vertices[faces])
    turned = vertices @ np.array([[0.0, 1.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 0.0, 1.0]]) + 0.01
    pose = np.eye(4)
    pose[:3, :3] = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    pose[:3, 3] = 0.01
    views, shares = ViewCoverage(camera(128)), []
    for points, T in ((vertices, np.eye(4)), (turned, pose)):
        coverage = CoverageMap(area, len(vertices))
        coverage.add(views.seen([wall_of(points, faces)], T[None], len(faces)), 0)
        shares.append(coverage.fraction("visible"))
    assert shares[0] == pytest.approx(shares[1], rel=2e-3)


def test_frustum_ignores_walls_but_not_range_and_image() -> None:
    points = np.array([[0, 0, 0.02], [0, 0, 0.08], [0, 0, -0.02], [0.1, 0, 0.02], [0.01, 0, 0.02]])
    found = vertices_in_frustum(camera(), POSE, points, 0.05)
    assert found.tolist() == [True, False, False, False, True]


def test_dark_bright_covered_and_blurred_pixels_are_not_readable() -> None:
    rgb = np.array(
        [[[120, 90, 80], [5, 5, 5], [255, 255, 255], [120, 90, 80], [120, 90, 80]]], "u1"
    )
    label = np.array([[0, 0, 0, 2, 0]], "u1")
    blur = np.array([[0.5, 0.5, 0.5, 0.5, 9.0]])
    found = readable_pixels(rgb, CoverageCriteria(), foreground_label=label, blur_px=blur)
    assert found.tolist() == [[True, False, False, False, False]]


def test_map_remembers_the_first_view_and_grows() -> None:
    coverage = CoverageMap(np.array([1.0, 1.0, 2.0]), num_vertices=4)
    coverage.add({"visible": np.array([True, False, False])}, 0)
    coverage.add({"visible": np.array([True, False, True])}, 2)
    assert coverage.first_seen["visible"].tolist() == [0, -1, 2]
    assert coverage.over_views("visible", 4).tolist() == [0.25, 0.25, 0.75, 0.75]
    assert coverage.fraction("visible", np.array([True, True, False])) == 0.5
    assert coverage.fraction("frustum") == 0.0


def test_bad_input_is_one_clear_line() -> None:
    with pytest.raises(InputError, match="shows triangle 7 of a wall of 3"):
        seen_faces(np.array([[7]]), 3)
    with pytest.raises(InputError, match=r"min_gray is 0\.99"):
        CoverageCriteria(min_gray=0.99)
    with pytest.raises(InputError, match="max_incidence"):
        CoverageCriteria(max_incidence=3.0)
    vertices, faces = tube(step=2e-2)
    with pytest.raises(ValueError, match="finite"):
        ViewCoverage(camera(16)).seen([wall_of(vertices, faces)], POSE[None] * np.nan, len(faces))
    with pytest.raises(ValueError, match="a flag for each triangle"):
        ViewCoverage(camera(16)).seen([wall_of(vertices, faces)], POSE[None], 3)
