"""Every device of the catalog is a capsule that could be built."""

import numpy as np
import pytest

from vrcaps.camera.camera import camera_rays, project_points
from vrcaps.capsule.device_file import device_names, read_device
from vrcaps.core.errors import InputError, UnknownNameError
from vrcaps.core.transforms import invert, rotate_vectors, transform_points
from vrcaps.core.units import MM

NAMES = (
    *("dual", "magnetic", "mirocam", "mono"),
    *("panoramic", "pillcam-colon2", "pillcam-sb3", "stereo"),
)
COLONOSCOPE = "colonoscope"  # no capsule: its tip is wider


def test_catalog_names():
    assert device_names() == tuple(sorted((*NAMES, COLONOSCOPE)))


@pytest.mark.parametrize("name", NAMES)
def test_device_is_plausible(name):
    device = read_device(name)
    assert device.name == name
    assert device.title and device.source
    assert 20 * MM < device.length < 35 * MM
    assert 5 * MM < device.radius < 6.5 * MM
    assert 1e-3 < device.mass < 10e-3
    volume = np.pi * device.radius**2 * (device.length - 2.0 / 3.0 * device.radius)
    most = 4000 if device.magnets else 2000
    assert 900 < device.mass / volume < most  # about as dense as water but for a magnet [kg/m³]


@pytest.mark.parametrize("name", NAMES)
def test_lenses_and_leds_are_inside_the_body(name):
    device = read_device(name)
    straight = 0.5 * device.length - device.radius
    for camera in device.cameras:
        assert len(camera.leds) >= 4
        leds = np.array([led.position_camera for led in camera.leds])
        inside = np.vstack([leds, np.zeros(3)])
        x, y, z = transform_points(camera.T_capsule_camera, inside).T
        radius = np.hypot(np.hypot(x, y), np.maximum(np.abs(z) - straight, 0.0))
        assert np.all(radius < device.radius)


def test_the_colonoscope_sees_as_it_says():
    device = read_device(COLONOSCOPE)
    (camera,) = device.cameras
    assert device.length - 2.0 * device.radius > 0.0
    rays = camera_rays(camera)
    valid = np.isfinite(rays[..., 0])
    assert not valid[0, 0] and valid[0, 160] and valid[144, 0]  # corners are cut, edges are not
    angle = np.degrees(np.arccos(rays[..., 2][valid].min()))
    assert 84.0 < angle <= 85.0


@pytest.mark.parametrize(("name", "expected"), [*((n, 0.4) for n in NAMES), (COLONOSCOPE, 0.416)])
def test_exposure_gives_a_matt_wall_at_20_mm_the_value_stated(name, expected):
    """L = (ρ/π) Σ I cosᵐφ cosα / d², on the axis, with albedo ρ = 0.5."""
    for camera in read_device(name).cameras:
        wall = np.array([0.0, 0.0, 20 * MM])
        irradiance = 0.0
        for led in camera.leds:
            offset = wall - led.position_camera
            distance = np.linalg.norm(offset)
            lobe = max(offset @ led.direction_camera / distance, 0.0) ** led.lobe_exponent
            irradiance += np.array(led.intensity) * lobe * offset[2] / distance**3
        value = camera.exposure * 0.5 / np.pi * irradiance
        np.testing.assert_allclose(value, expected, rtol=1e-3)


@pytest.mark.parametrize("name", ("pillcam-colon2", "dual"))
def test_second_head_looks_back(name):
    front, back = read_device(name).cameras
    ahead = np.array([[0.0, 0.0, 1.0]])
    np.testing.assert_allclose(rotate_vectors(front.T_capsule_camera, ahead), ahead)
    np.testing.assert_allclose(rotate_vectors(back.T_capsule_camera, ahead), -ahead)
    assert back.T_capsule_camera[2, 3] == -front.T_capsule_camera[2, 3]


def test_colon2_has_a_calibration_for_each_head():
    front, back = read_device("pillcam-colon2").cameras
    assert front.lens != back.lens


def test_stereo_baseline_is_along_the_rows_of_both_images():
    left, right = read_device("stereo").cameras
    baseline = right.T_capsule_camera[:3, 3] - left.T_capsule_camera[:3, 3]
    np.testing.assert_allclose(baseline, [3.85 * MM, 0.0, 0.0], atol=1e-12)
    lit = [
        transform_points(c.T_capsule_camera, np.array([led.position_camera for led in c.leds]))
        for c in (left, right)
    ]
    np.testing.assert_allclose(lit[0], lit[1], atol=1e-12)


def test_panorama_has_no_gap_around_the_capsule():
    """Each point on a ring 9 mm about the axis is in the image of a side camera."""
    angle = np.radians(np.arange(360.0))
    ring = np.stack([9 * MM * np.cos(angle), 9 * MM * np.sin(angle), 0 * angle], axis=-1)
    seen = np.zeros(360, int)
    for camera in read_device("panoramic").cameras:
        pixels = project_points(camera, transform_points(invert(camera.T_capsule_camera), ring))
        seen += np.all((pixels > -0.5) & (pixels < 319.5), axis=-1)
        up = invert(camera.T_capsule_camera)[:3, 2]
        np.testing.assert_allclose(up, [0.0, -1.0, 0.0])  # capsule's front is up in the image
    assert seen.min() >= 1
    assert seen.max() == 2


@pytest.mark.parametrize(
    ("name", "share", "across"),
    [("mirocam", 0.862, 126.8), ("pillcam-colon2", 0.737, 142.6), ("pillcam-sb3", 0.786, 155.5)],
)
def test_field_across_the_middle_row(name, share, across):
    """Valid share of the image and angle from the first to the last valid pixel [deg]."""
    rays = camera_rays(read_device(name).cameras[0])
    row = rays[rays.shape[0] // 2]
    row = row[np.isfinite(row[:, 0])]
    ends = np.degrees(np.arccos(row[[0, -1], 2]))
    assert np.isfinite(rays[..., 0]).mean() == pytest.approx(share, abs=1e-3)
    assert ends.sum() == pytest.approx(across, abs=0.1)


def test_unknown_name():
    with pytest.raises(
        UnknownNameError, match=r"No capsule named 'mirocan'\. Known: colonoscope, dual, magnetic"
    ):
        read_device("mirocan")


def test_missing_file(tmp_path):
    with pytest.raises(InputError, match=r"No capsule file at .*mine\.toml.* one of: colonoscope"):
        read_device(tmp_path / "mine.toml")
