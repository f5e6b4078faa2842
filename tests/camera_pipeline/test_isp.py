"""Color matrix, tone curve, denoising and sharpening against formulas, SciPy and Pillow."""

import numpy as np
import pytest
from PIL import Image, ImageFilter
from scipy import ndimage

from tests.support.shapes import make_camera, pinhole
from vrcaps._core import testing
from vrcaps.camera_pipeline.effect.base import CameraSetup
from vrcaps.camera_pipeline.effect.processing import (
    ColorMatrix,
    Denoising,
    Sharpening,
    ToneCurve,
    saturation_matrix,
)
from vrcaps.core.color import LUMINANCE
from vrcaps.core.errors import InputError

SETUP = CameraSetup(make_camera(pinhole(8)))
ONE = (1.0, 1.0, 1.0)


def finished(planes: np.ndarray, *effects, lit: np.ndarray | None = None, gains=ONE) -> np.ndarray:
    """Codes [h w 3] of linear planes after some stages."""
    stages = {effect.name: effect.params(SETUP) for effect in effects}
    lit = np.ones(planes.shape[1:], bool) if lit is None else lit
    return testing.isp(np.ascontiguousarray(planes, np.float32), gains, lit, stages)


def encoded(x: np.ndarray) -> np.ndarray:
    """SRGB encoding of linear values, 0 to 1 (IEC 61966-2-1)."""
    x = np.clip(x, 0.0, 1.0)
    return np.where(x <= 0.0031308, 12.92 * x, 1.055 * x ** (1 / 2.4) - 0.055)


def linear(v: np.ndarray) -> np.ndarray:
    """Linear values of sRGB-encoded ones."""
    return np.where(v <= 0.04045, v / 12.92, ((v + 0.055) / 1.055) ** 2.4)


def smooth_scene(rng: np.random.Generator, height: int = 40, width: int = 53) -> np.ndarray:
    """Encoded planes, 0.2 to 0.8, with detail at several scales."""
    noise = rng.random((3, height, width))
    rough = ndimage.gaussian_filter(noise, (0, 1, 1)) + ndimage.gaussian_filter(
        3 * noise, (0, 3, 3)
    )
    return 0.2 + 0.6 * (rough - rough.min()) / np.ptp(rough)


def test_color_matrix_acts_on_linear_colors_after_the_gains(rng: np.random.Generator) -> None:
    planes = rng.random((3, 9, 70)) * 0.5
    matrix = ((1.2, -0.15, -0.05), (-0.1, 1.3, -0.2), (0.0, -0.3, 1.3))
    gains = (0.9, 1.0, 1.1)
    expected = 255.0 * encoded(
        np.einsum("ij,jhw->hwi", matrix, planes * np.array(gains)[:, None, None])
    )
    seen = finished(planes, ColorMatrix(matrix), gains=gains)
    assert np.abs(seen - expected).max() < 0.52


def test_saturation_keeps_luminance_and_gray() -> None:
    matrix = np.array(saturation_matrix(1.4))
    assert matrix.sum(axis=1) == pytest.approx(1.0, abs=1e-5)
    assert LUMINANCE @ matrix == pytest.approx(LUMINANCE, abs=1e-5)
    color = np.array([0.6, 0.3, 0.2])
    gray = LUMINANCE @ color
    assert matrix @ color - gray == pytest.approx(1.4 * (color - gray), abs=1e-5)


@pytest.mark.parametrize("contrast", [0.6, 1.0, 1.2, 2.5])
def test_tone_curve_is_log_logistic(contrast: float) -> None:
    """logit(out) = a logit(v) + (1 − a) logit(p), so that p stays and has the slope a."""
    curve, v = ToneCurve(contrast, 0.4), np.linspace(0.02, 0.98, 97)
    planes = np.broadcast_to(linear(v), (3, 2, 97))
    odds = np.log(v / (1.0 - v)) - np.log(0.4 / 0.6)
    expected = 255.0 / (1.0 + 0.6 / 0.4 * np.exp(-contrast * odds))
    assert np.abs(finished(planes, curve) - expected[:, None]).max() < 0.55
    ends = np.broadcast_to(np.array([-0.5, 0.0, 1.0, 3.0]), (3, 1, 4))
    assert finished(ends, curve)[0, :, 0].tolist() == [0, 0, 255, 255]


def luma(codes: np.ndarray) -> np.ndarray:
    return codes @ np.array([0.299, 0.587, 0.114])


def test_sharpening_is_pillows_unsharp_mask(rng: np.random.Generator) -> None:
    """Unsharp mask of a gray image; Pillow approximates the Gaussian by three boxes."""
    values = smooth_scene(rng)[:1].repeat(3, axis=0)
    codes = np.rint(255.0 * values[0])
    seen = finished(linear(codes / 255.0)[None].repeat(3, axis=0), Sharpening(1.5, 2.0, 0.0))
    gray = Image.fromarray(codes.astype(np.uint8))
    expected = np.asarray(gray.filter(ImageFilter.UnsharpMask(2.0, 150, 0))).astype(float)
    inner = (slice(8, -8), slice(8, -8))  # the edges differ: Pillow repeats the last pixel
    error = np.abs(seen[..., 0] - expected)[inner]
    assert error.mean() < 0.6
    assert error.max() < 4.0
    assert np.abs(codes - expected)[inner].max() > 15.0


def test_sharpening_leaves_differences_below_its_threshold_and_chroma(
    rng: np.random.Generator,
) -> None:
    values = smooth_scene(rng)
    plain = finished(linear(values)).astype(float)
    cored = finished(linear(values), Sharpening(3.0, 1.0, 255.0))
    assert np.abs(cored - plain).max() <= 1.0
    sharp = finished(linear(values), Sharpening(1.0, 1.0, 0.0)).astype(float)
    blurred = ndimage.gaussian_filter(luma(plain), 1.0, truncate=3.0)
    inner = (slice(4, -4), slice(4, -4))
    expected = 2.0 * luma(plain) - blurred
    assert np.abs(luma(sharp) - expected)[inner].max() < 1.5
    chroma = [image[..., 0] - luma(image) for image in (plain, sharp)]
    assert np.abs(chroma[0] - chroma[1])[inner].max() < 1.5


def test_denoising_is_a_gaussian_over_lit_pixels(rng: np.random.Generator) -> None:
    values = smooth_scene(rng)
    lit = np.hypot(*np.ogrid[-20:20, -26:27]) < 18.0
    plain = 255.0 * encoded(linear(values))
    seen = finished(linear(values), Denoising(0.7, 2.0), lit=lit).astype(float)
    assert not seen[~lit].any()

    def low_pass(plane: np.ndarray, sigma: float) -> np.ndarray:
        both = (plane * lit, lit.astype(float))
        top, bottom = (
            ndimage.gaussian_filter(x, sigma, mode="constant", radius=int(np.ceil(3 * sigma)))
            for x in both
        )
        return top / np.maximum(bottom, 1e-9)

    light = luma(np.moveaxis(plain, 0, -1))
    blue, red = 0.564 * (plain[2] - light), 0.713 * (plain[0] - light)
    expected_luma = low_pass(light, 0.7)
    assert np.abs(luma(seen) - expected_luma)[lit].max() < 1.0
    for k, (chroma, factor) in {0: (red, 0.713), 2: (blue, 0.564)}.items():
        measured = factor * (seen[..., k] - luma(seen))
        assert np.abs(measured - low_pass(chroma, 2.0))[lit].max() < 1.2


def test_dark_border_does_not_change_a_flat_image() -> None:
    lit = np.hypot(*np.ogrid[-15:15, -15:15]) < 12.0
    seen = finished(
        np.full((3, 30, 30), 0.3), Denoising(1.0, 2.0), Sharpening(2.0, 1.5, 0.0), lit=lit
    )
    assert np.ptp(seen[lit]) <= 1


@pytest.mark.parametrize(
    ("make", "match"),
    [
        (lambda: ColorMatrix(((9.0, 0, 0), ONE, ONE)), "matrix is .* 3 rows of 3 numbers"),
        (lambda: ColorMatrix((ONE, ONE)), "ColorMatrix's matrix"),  # type: ignore[arg-type]
        (lambda: ToneCurve(0.0), "contrast is 0.0. Allowed: 0.25 to 4"),
        (lambda: ToneCurve(1.0, 1.0), "pivot is 1.0"),
        (lambda: Denoising(-1.0, 0.0), "luma is -1.0"),
        (lambda: Denoising(0.0, 11.0), "chroma is 11.0"),
        (lambda: Sharpening(-0.5), "amount is -0.5"),
        (lambda: Sharpening(1.0, 0.0), "sigma is 0.0. Allowed: 0.3 to 10 px"),
    ],
)
def test_invalid_parameters_are_reported(make, match: str) -> None:
    with pytest.raises(InputError, match=match):
        make()
