"""Ray tables of every camera in the catalog."""

from dataclasses import replace

import numpy as np
import pytest

from vrcaps.camera.camera import camera_rays, pixel_grid, project_points, unproject_pixels
from vrcaps.capsule.device_file import device_names, read_device
from vrcaps.core.errors import InputError

CAMERAS = [
    pytest.param(camera, id=f"{name}-{camera.name}")
    for name in device_names()
    for camera in read_device(name).cameras
]


@pytest.mark.parametrize("camera", CAMERAS)
def test_unproject_then_project_returns_every_valid_pixel(camera):
    pixels = pixel_grid(camera.width, camera.height)
    rays = unproject_pixels(camera, pixels)
    valid = np.isfinite(rays).all(axis=-1)
    assert valid.mean() > 0.7
    np.testing.assert_allclose(project_points(camera, rays)[valid], pixels[valid], atol=1e-9)


@pytest.mark.parametrize("camera", CAMERAS)
def test_rays_are_unit_float32_and_project_back(camera):
    rays = camera_rays(camera)
    valid = np.isfinite(rays).all(axis=-1)
    assert rays.shape == (camera.height, camera.width, 3)
    assert rays.dtype == np.float32
    assert np.isnan(rays[~valid]).all()
    np.testing.assert_allclose(np.linalg.norm(rays[valid], axis=-1), 1.0, atol=2e-7)
    pixels = pixel_grid(camera.width, camera.height)
    np.testing.assert_allclose(camera.lens.project(rays)[valid], pixels[valid], atol=1e-3)


@pytest.mark.parametrize("camera", CAMERAS)
def test_no_valid_pixel_is_outside_the_nominal_field_or_the_image_circle(camera):
    rays = camera_rays(camera)
    pixels = pixel_grid(camera.width, camera.height)
    seen = np.isfinite(rays[..., 0])
    if camera.image_circle_px is not None:
        center = (camera.lens.cx, camera.lens.cy)
        radius = np.linalg.norm(pixels - center, axis=-1)
        assert not seen[radius > camera.image_circle_px].any()
        angle = np.arccos(rays[seen][:, 2])
        assert angle.max() <= 0.5 * camera.nominal_field + 1e-6


def test_pixel_zero_is_the_center_of_the_top_left_pixel():
    grid = pixel_grid(4, 3)
    assert grid.shape == (3, 4, 2)
    np.testing.assert_array_equal(grid[0, 0], [0.0, 0.0])
    np.testing.assert_array_equal(grid[2, 3], [3.0, 2.0])


def test_sub_pixels_share_each_pixel_evenly():
    grid = pixel_grid(4, 3, supersampling=2)
    assert grid.shape == (6, 8, 2)
    np.testing.assert_allclose(grid[0, 0], [-0.25, -0.25])
    blocks = grid.reshape(3, 2, 4, 2, 2).mean(axis=(1, 3))
    np.testing.assert_allclose(blocks, pixel_grid(4, 3), atol=1e-12)


def test_supersampled_rays_average_to_the_pixel_rays():
    camera = read_device("mono").cameras[0]
    fine = camera_rays(camera, supersampling=3)
    assert fine.shape == (960, 960, 3)
    np.testing.assert_array_equal(fine[1::3, 1::3], camera_rays(camera))


def test_image_circle_darkens_the_corners():
    camera = replace(read_device("mono").cameras[0], image_circle_px=100.0)
    seen = np.isfinite(camera_rays(camera)[..., 0])
    assert seen.mean() == pytest.approx(np.pi * 100.0**2 / 320**2, rel=2e-3)
    assert np.isnan(project_points(camera, np.array([0.7, 0.0, 1.0]))).all()


def test_points_beside_the_image_keep_their_pixel():
    camera = read_device("mono").cameras[0]
    pixel = project_points(camera, np.array([2.0, 0.0, 1.0]))
    np.testing.assert_allclose(pixel, [159.5 + 2.0 * 157.55, 159.5])


def test_supersampling_below_one_is_refused():
    with pytest.raises(InputError, match=r"Supersampling is 0\. Allowed: 1, 2, 3"):
        camera_rays(read_device("mono").cameras[0], supersampling=0)
