"""A camera's figures come back from frames that were made with them."""

from __future__ import annotations

import io
import tomllib
from dataclasses import replace

import numpy as np
import pytest
from PIL import Image

from tests.support.made_frames import CAMERA, CENTER, SIZE, Figures, photos
from vrcaps.capsule.device_file import read_device, read_device_file, write_device
from vrcaps.core.errors import InputError
from vrcaps.scenario.scenario import read_scenario
from vrcaps.tools.photometric_calibration.calibrate import (
    calibrate_photometric,
    photometric_device,
    write_report,
    write_scenario,
)
from vrcaps.tools.photometric_calibration.frames import (
    blockiness,
    jpeg_quality,
    make_frames,
    quality_tables,
)
from vrcaps.tools.photometric_calibration.models import RadialProfile, _fitted
from vrcaps.tools.photos import Photo

TRUE = Figures(
    vignetting=(-0.35, -0.15), gains=(0.8, 1.0, 1.3), light=0.5, full_well=4000.0, read_noise=25.0
)
PLAIN = Figures(light=0.4)


@pytest.fixture(scope="module")
def frames():
    return make_frames(photos(TRUE, 12, seed=1))


@pytest.fixture(scope="module")
def match(frames):
    return calibrate_photometric(frames, CAMERA, reference=make_frames(photos(PLAIN, 12, seed=2)))


@pytest.mark.slow
def test_circle(match) -> None:
    assert match.circle is not None
    assert (match.circle.cx, match.circle.cy) == pytest.approx(CENTER, abs=0.5)
    assert match.circle.radius == pytest.approx(TRUE.circle, abs=1.0)


def test_vignetting_against_a_reference(match) -> None:
    """The fall of light within the circle is right to 6 % of the light on the axis."""
    rho = np.linspace(0.0, 0.9, 50)
    both = ((match.vignetting.k1, match.vignetting.k2), TRUE.vignetting)
    found, true = (1.0 + k1 * rho**2 + k2 * rho**4 for k1, k2 in both)
    np.testing.assert_allclose(found, true, atol=0.06)
    assert match.vignetting.is_clear
    edge = match.profile.radius[-1]
    rim = 1.0 + TRUE.vignetting[0] * edge**2 + TRUE.vignetting[1] * edge**4
    assert abs(match.vignetting.rim - rim) < 3.0 * match.vignetting.deviation < 0.3


def test_falloff_does_not_rise_at_the_rim() -> None:
    """Whatever the rings say: dark at two thirds of the radius, brighter outside."""
    radius = np.linspace(0.05, 1.1, 20)
    dip = 1.0 - 0.5 * np.exp(-(((radius - 0.7) / 0.3) ** 2))
    k1, k2, rim = _fitted(RadialProfile(radius, dip, np.full(20, 1e4)), None)
    edge = radius[-1]
    assert k1 < 0.0
    assert 2.0 * k1 * edge + 4.0 * k2 * edge**3 <= 1e-9
    assert rim == pytest.approx(1.0 + k1 * edge**2 + k2 * edge**4)


@pytest.mark.slow
def test_without_falloff_there_is_no_vignetting() -> None:
    plain = calibrate_photometric(make_frames(photos(PLAIN, 12, seed=4)), CAMERA)
    assert not plain.vignetting.is_clear
    assert plain.vignetting.rim == pytest.approx(1.0, abs=3.0 * plain.vignetting.deviation)


def test_color_and_brightness_against_a_reference(match) -> None:
    assert match.gains == pytest.approx(TRUE.gains, rel=0.02)
    # Scenes differ by 30 % from frame to frame.
    assert match.brightness == pytest.approx(0.5 / 0.4, rel=0.25)


def test_noise_is_that_of_the_photon_transfer_line(match) -> None:
    assert match.noise is not None
    assert match.noise.full_well == pytest.approx(TRUE.full_well, rel=0.15)
    assert match.noise.read_noise == pytest.approx(TRUE.read_noise, rel=0.25)


def test_noise_below_rounding_is_not_told() -> None:
    quiet = make_frames(photos(Figures(), 6, seed=5))
    assert calibrate_photometric(quiet, CAMERA).noise is None


@pytest.mark.parametrize("quality", [30, 50, 75, 94, 95])
def test_quality_of_jpeg_files_and_their_blocks(tmp_path, frames, quality: int) -> None:
    for k in range(3):
        Image.fromarray(frames.rgb[k]).save(tmp_path / f"{k}.jpg", quality=quality)
    Image.fromarray(frames.rgb[0]).save(tmp_path / "other.png")
    assert jpeg_quality([tmp_path]) == quality
    assert jpeg_quality([tmp_path / "other.png"]) is None


def test_quality_100_keeps_all() -> None:
    np.testing.assert_array_equal(quality_tables()[99], 1.0)


def test_blocks_show_as_steps_over_their_borders(frames) -> None:
    field = np.ones(frames.luminance.shape, bool)
    assert blockiness(frames.luminance, field) < 1.1
    stored = []
    for image in photos(Figures(), 3, seed=7):
        file = io.BytesIO()
        Image.fromarray(image.rgb).save(file, "JPEG", quality=30)
        stored.append(np.asarray(Image.open(file)).astype(float)[..., 1])
    assert blockiness(np.stack(stored), field[:3]) > 1.5


@pytest.mark.slow
def test_device_and_effects_hold_what_was_found(match, frames, tmp_path) -> None:
    """The circle is scaled to the device's images; a scenario with the effects can be read."""
    pattern = replace(read_device("mirocam"), cameras=(CAMERA,))
    large = replace(CAMERA, width=2 * SIZE, height=2 * SIZE)
    device = photometric_device(replace(pattern, cameras=(large,)), match)
    assert device.cameras[0].image_circle_px == pytest.approx(2.0 * match.circle.radius)
    device = photometric_device(pattern, match)
    (camera,) = device.cameras
    for led, old in zip(camera.leds, CAMERA.leds, strict=True):
        assert led.intensity == pytest.approx(np.multiply(old.intensity, match.gains))
    assert camera.exposure == pytest.approx(CAMERA.exposure * match.brightness)
    path = tmp_path / "mine.toml"
    write_device(path, device)
    assert read_device_file(path).cameras[0].lens == CAMERA.lens
    write_scenario(tmp_path / "effects.toml", replace(match, jpeg_quality=80), path)
    scenario = read_scenario(tmp_path / "effects.toml")
    assert scenario.capsule == str(path)
    effects = scenario.effects
    assert effects.vignetting.coefficients == pytest.approx(
        (match.vignetting.k1, match.vignetting.k2, 0.0), rel=1e-4
    )
    assert effects.sensor_noise.full_well == pytest.approx(match.noise.full_well, rel=1e-4)
    assert effects.jpeg.quality == 80
    bare = replace(match, vignetting=replace(match.vignetting, rim=1.0), noise=None)
    write_scenario(tmp_path / "bare.toml", bare, path)
    assert set(tomllib.loads((tmp_path / "bare.toml").read_text())) == {"capsule"}
    write_report(tmp_path / "report.png", match, frames)
    assert (tmp_path / "report.png").stat().st_size > 50_000


@pytest.mark.slow
def test_frames_that_cannot_be_used_are_an_error() -> None:
    made = photos(PLAIN, 3, seed=0)
    with pytest.raises(InputError, match=r"2 frames are given\. Allowed: 3 or more"):
        make_frames(made[:2])
    with pytest.raises(InputError, match=r"2 has 224 × 223 px, 0 224 × 224\. Allowed: frames of"):
        make_frames([*made[:2], replace(made[2], rgb=made[2].rgb[:-1])])
    black = Photo("black", np.zeros((64, 64, 3), np.uint8))
    with pytest.raises(InputError, match="The frames are black"):
        make_frames([black] * 3)
    wide = [replace(photo, rgb=photo.rgb[:150]) for photo in made]
    with pytest.raises(InputError, match=r"camera front 224 × 224\. Allowed: frames of the same"):
        calibrate_photometric(make_frames(wide), CAMERA)
