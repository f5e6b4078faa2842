import numpy as np
import pytest

from tests.support.shapes import make_camera, pinhole
from tests.support.twin_stages import defocus_twin, motion_twin
from vrcaps._core import testing
from vrcaps.camera.camera import camera_rays
from vrcaps.camera.derive import focal_length_px
from vrcaps.camera_pipeline.effect.base import CameraSetup
from vrcaps.camera_pipeline.effect.exposure import MotionBlur, RollingShutter
from vrcaps.camera_pipeline.effect.optics import (
    Bloom,
    DepthOfField,
    LateralChromaticAberration,
    Vignetting,
)
from vrcaps.capsule.device_file import read_device
from vrcaps.core.errors import InputError
from vrcaps.core.units import MM

CAMERA = make_camera(pinhole(121))
SETUP = CameraSetup(CAMERA)


def spot(at: tuple[int, int], size: int = 121) -> np.ndarray:
    planes = np.zeros((3, size, size), np.float32)
    planes[:, at[0], at[1]] = 1.0
    return planes


def moved(
    image: np.ndarray,
    motion: np.ndarray,
    shutter: float,
    readout: float,
    lit: np.ndarray | None = None,
    pulse: float = np.inf,
) -> np.ndarray:
    """An image [h w 3] that moves, by its motion at every fourth pixel."""
    lit = np.ones(image.shape[:2], bool) if lit is None else lit
    planes = testing.motion_blur(image, lit, motion, (shutter, readout, pulse), 1.0)
    return np.moveaxis(planes, 0, -1)


def moments(plane: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Center and standard deviations of an image (column, row)."""
    grid = np.stack(np.meshgrid(*(np.arange(n) for n in plane.shape[::-1])), axis=-1)
    weight = (plane / plane.sum())[..., None].astype(float)
    mean = (weight * grid).sum(axis=(0, 1))
    return mean, np.sqrt((weight * (grid - mean) ** 2).sum(axis=(0, 1)))


@pytest.mark.parametrize("distance", [0.006, 0.009, 0.1])
def test_circle_of_confusion_is_that_of_the_thin_lens(distance: float) -> None:
    """c = A f |d − s| / (d (s − f)) on the sensor; an even disk of radius c/2 has a variance of
    c²/16 along each axis."""
    aperture, focus, pixel = 0.6 * MM, 15.0 * MM, 5e-6
    image_distance = focal_length_px(CAMERA.lens) * pixel
    focal = 1.0 / (1.0 / focus + 1.0 / image_distance)
    circle = aperture * focal * abs(distance - focus) / (distance * (focus - focal)) / pixel
    stage = DepthOfField(aperture, focus)
    assert 2.0 * stage.radius_px(CAMERA, np.array(distance)) == pytest.approx(circle, rel=1e-6)
    away = np.full((121, 121), distance, np.float32)
    seen = testing.depth_of_field(spot((60, 60)), away, *stage.params(SETUP))
    assert seen[0].sum() == pytest.approx(1.0, rel=1e-5)
    variance = moments(seen[0])[1] ** 2
    assert (variance > circle**2 / 16.0).all()
    assert (variance < 1.05 * circle**2 / 16.0 + 0.15).all()  # pixels have a size
    wide = np.hypot(*(np.argwhere(seen[0] > 0.0) - 60).T).max()
    assert abs(wide - circle / 2.0) <= 1.0


def test_defocus_agrees_with_its_twin(rng: np.random.Generator) -> None:
    planes = rng.random((3, 37, 45), np.float32)
    distance = rng.uniform(0.004, 0.08, (37, 45)).astype(np.float32)
    distance[:10] = 0.015
    distance[rng.random((37, 45)) < 0.1] = np.nan
    reach = 0.03
    signed = np.clip(reach * (1.0 / 0.015 - 1.0 / distance), -15.0, 15.0)
    expected = defocus_twin(planes, signed)
    assert np.abs(testing.depth_of_field(planes, distance, reach, 0.015) - expected).max() < 2e-5


def test_what_is_in_focus_stays_sharp_before_a_blurred_wall(rng: np.random.Generator) -> None:
    planes = rng.random((3, 121, 121), np.float32)
    distance = np.full((121, 121), 0.08, np.float32)
    distance[:, :60] = 0.015
    stage = DepthOfField(0.8 * MM, 15.0 * MM)
    seen = testing.depth_of_field(planes, distance, *stage.params(SETUP))
    assert np.array_equal(seen[:, :, :60], planes[:, :, :60])
    assert seen[:, :, 80:].std() < 0.5 * planes.std()


@pytest.mark.parametrize(("red", "blue"), [(0.01, -0.015), (-0.02, 0.005)])
def test_lateral_shift_is_the_radius_times_the_magnification(red: float, blue: float) -> None:
    place = (100, 21)
    stage = LateralChromaticAberration(red, blue)
    planes = np.zeros((3, 121, 121), np.float32)
    soft = np.exp(-0.5 * ((np.arange(121) - place[0]) / 2.0) ** 2)
    across = np.exp(-0.5 * ((np.arange(121) - place[1]) / 2.0) ** 2)
    planes[:] = np.outer(soft, across)
    seen = testing.chromatic_aberration(planes, *stage.params(SETUP))
    assert np.array_equal(seen[1], planes[1])
    center = np.array([CAMERA.lens.cx, CAMERA.lens.cy])
    offset = np.array(place[::-1]) - center
    for plane, shift in ((0, red), (2, blue)):
        assert moments(seen[plane])[0] - center == pytest.approx((1.0 + shift) * offset, abs=0.01)


def test_vignetting_follows_its_polynomial_and_the_cosine() -> None:
    camera = read_device("mirocam").cameras[0]
    rows, columns = np.mgrid[:320, :320]
    rho = np.hypot(columns - camera.lens.cx, rows - camera.lens.cy) / 160.0
    expected = np.maximum(1.0 - 0.4 * rho**2 + 0.05 * rho**4, 0.0)
    profile = Vignetting((-0.4, 0.05, 0.0)).params(CameraSetup(camera))
    lit = np.isfinite(camera_rays(camera)).all(axis=-1)
    assert np.abs(profile - expected)[lit].max() < 1e-6
    cosine = Vignetting((0.0, 0.0, 0.0), cosine_power=4.0).params(CameraSetup(camera))
    assert np.abs(cosine - camera_rays(camera)[..., 2] ** 4)[lit].max() < 1e-6
    assert not cosine[~lit].any()
    planes = np.ones((3, 320, 320), np.float32)
    assert np.array_equal(testing.vignetting(planes, profile), np.stack([profile] * 3))


def test_bloom_has_its_fraction_and_widths() -> None:
    """Variance of the scattered light: (σ² + 16 σ²) / 2; no light is lost inside the image."""
    camera, stage = make_camera(pinhole(481)), Bloom(0.2, 0.02)
    sigma = stage.angle * focal_length_px(camera.lens)
    seen = testing.bloom(spot((240, 242), 481), *stage.params(CameraSetup(camera)))[1]
    assert seen.sum() == pytest.approx(1.0, rel=1e-3)
    halo = seen.copy()
    halo[240, 242] -= 0.8
    assert halo.sum() == pytest.approx(0.2, rel=5e-3)
    mean, width = moments(np.maximum(halo, 0.0))
    assert mean == pytest.approx((242, 240), abs=0.02)
    assert width == pytest.approx(sigma * np.sqrt(8.5), rel=0.05)


@pytest.mark.parametrize("speed", [(40.0, 0.0), (0.0, -60.0), (24.0, 18.0)])
def test_blur_length_is_the_motion_while_the_shutter_is_open(speed: tuple[float, float]) -> None:
    """An even streak of length L has a variance of L²/12 along each axis' share of it; bilinear
    interpolation adds up to 1/4 px²."""
    shutter = 0.25
    image = np.ascontiguousarray(np.moveaxis(spot((60, 60)), 0, -1))
    motion = np.broadcast_to(np.float32(speed), (31, 31, 2)).copy()
    seen = moved(image, motion, shutter, 0.0)[..., 0]
    assert seen.sum() == pytest.approx(1.0, rel=1e-3)
    mean, width = moments(seen)
    streak = shutter * np.abs(speed)
    assert mean == pytest.approx((60, 60), abs=0.01)
    assert width**2 == pytest.approx(streak**2 / 12.0, rel=0.03, abs=0.3)


def test_rows_of_a_rolling_shutter_are_late_in_order() -> None:
    """A column that moves at v is seen at row y shifted by v · readout · ((y + ½)/h − ½)."""
    image = np.zeros((120, 120, 3), np.float32)
    image[:, 60] = 1.0
    motion = np.broadcast_to(np.float32([30.0, 0.0]), (30, 30, 2)).copy()
    seen = moved(image, motion, 0.0, 0.8)[..., 1]
    middle = (seen * np.arange(120)).sum(axis=1) / seen.sum(axis=1)
    expected = 60.0 + 30.0 * 0.8 * ((np.arange(120) + 0.5) / 120.0 - 0.5)
    assert np.abs(middle - expected).max() < 1e-3


def test_a_late_row_sees_what_has_moved_there() -> None:
    """In a zoom v = a (x − c) what is at x a time τ later was at c + (x − c) / (1 + a τ)."""
    place = np.arange(120, dtype=np.float32)
    image = np.broadcast_to(place[None, :, None], (120, 120, 3)).copy()
    known = np.arange(30) * 4.0 + 2.0
    motion = np.zeros((30, 30, 2), np.float32)
    motion[..., 0] = 0.4 * (known - 59.5)
    seen = moved(image, motion, 0.0, 0.9)
    time = 0.9 * ((np.arange(120) + 0.5) / 120.0 - 0.5)
    expected = 59.5 + (place - 59.5) / (1.0 + 0.4 * time[:, None])
    inside = (expected > 2.0) & (expected < 117.0) & (place >= 2.0) & (place <= 118.0)
    assert np.abs(seen[..., 0] - expected)[inside].max() < 0.25  # of shifts up to 10 px


def test_motion_agrees_with_its_twin(rng: np.random.Generator) -> None:
    image = rng.random((24, 28, 3), np.float32)
    lit = rng.random((24, 28)) < 0.9
    motion = np.broadcast_to(np.float32([13.0, -7.0]), (6, 7, 2)).copy()
    full = np.broadcast_to(motion[0, 0], (24, 28, 2))
    expected = motion_twin(image, lit, full, 0.5, 0.3)
    assert np.abs(moved(image, motion, 0.5, 0.3, lit) - expected).max() < 1e-4


def test_unknown_motion_is_that_of_its_neighbors() -> None:
    image = np.zeros((40, 40, 3), np.float32)
    image[:, 20] = 1.0
    motion = np.broadcast_to(np.float32([8.0, 0.0]), (10, 10, 2)).copy()
    whole = moved(image, motion, 0.5, 0.0)
    motion[4:6, 3:7] = np.nan
    assert np.abs(moved(image, motion, 0.5, 0.0) - whole).max() < 1e-6


@pytest.mark.parametrize(
    ("make", "match"),
    [
        (lambda: DepthOfField(0.0), "aperture is 0.0. Allowed: above 0"),
        (lambda: DepthOfField(1e-3, focus_distance=-1.0), "focus_distance is -1.0"),
        (lambda: MotionBlur(0.0), "exposure_time is 0.0"),
        (lambda: RollingShutter(-1.0), "readout_time is -1.0"),
        (lambda: LateralChromaticAberration(0.9, 0.0), "red is 0.9"),
        (lambda: LateralChromaticAberration(0.0, -0.5), "blue is -0.5"),
        (lambda: Vignetting((np.nan, 0.0, 0.0)), "coefficients"),
        (lambda: Vignetting((0.0, 0.0, 0.0), -1.0), "cosine_power is -1.0"),
        (lambda: Bloom(1.0), "fraction is 1.0"),
        (lambda: Bloom(0.1, 0.0), "angle is 0.0"),
    ],
)
def test_what_cannot_be(make, match: str) -> None:
    with pytest.raises(InputError, match=match):
        make()


def still_line(pulse: float, readout: float = 0.4, shutter: float = 0.2) -> np.ndarray:
    """Rows of an even image that stands still, under LEDs lit for a part of a frame's time."""
    image, motion = np.ones((64, 8, 3), np.float32), np.zeros((16, 2, 2), np.float32)
    return moved(image, motion, shutter, readout, pulse=pulse)[:, 4, 1]


def test_rows_take_as_much_of_a_pulse_as_falls_into_their_time() -> None:
    """A row open from a to b takes of a pulse about 0 its overlap, over the shorter of the two."""
    middle = 0.4 * ((np.arange(64) + 0.5) / 64 - 0.5)
    for pulse in (0.1, 0.2, 0.3):
        overlap = np.minimum(middle + 0.1, 0.5 * pulse) - np.maximum(middle - 0.1, -0.5 * pulse)
        expected = np.clip(overlap, 0.0, None) / min(0.2, pulse)
        np.testing.assert_allclose(still_line(pulse), expected, atol=1e-6)
    assert still_line(0.1).min() == 0.0  # rows that are not open in the pulse
    np.testing.assert_array_equal(still_line(1.0), 1.0)


def test_a_pulse_while_all_rows_are_open_is_a_global_shutter() -> None:
    """An upright edge stays upright under a rolling shutter, and blurs by the pulse alone."""
    image = np.zeros((64, 64, 3), np.float32)
    image[:, 32] = 1.0
    motion = np.broadcast_to(np.float32([40.0, 0.0]), (16, 16, 2)).copy()
    seen = moved(image, motion, 0.6, 0.4, pulse=0.2)[..., 1]
    middle = (seen * np.arange(64)).sum(axis=1) / seen.sum(axis=1)
    np.testing.assert_allclose(middle, 32.0, atol=1e-3)
    length = np.sqrt(12.0 * (seen * (np.arange(64) - 32.0) ** 2).sum(axis=1) / seen.sum(axis=1))
    np.testing.assert_allclose(length, 8.0, rtol=0.05)
    rolled = moved(image, motion, 0.6, 0.4)[..., 1]
    assert np.ptp((rolled * np.arange(64)).sum(axis=1) / rolled.sum(axis=1)) > 15.0


def test_a_pulse_must_last() -> None:
    with pytest.raises(InputError, match="MotionBlur's led_pulse"):
        MotionBlur(0.01, led_pulse=0.0)
