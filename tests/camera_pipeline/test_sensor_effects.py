import io

import numpy as np
import pytest
from PIL import Image
from scipy import ndimage, stats

from tests.support.shapes import make_camera, pinhole
from tests.support.twin_stages import demosaic_twin
from vrcaps import _core
from vrcaps._core import testing
from vrcaps.camera_pipeline.effect.base import CameraSetup
from vrcaps.camera_pipeline.effect.processing import Jpeg, WhiteBalance
from vrcaps.camera_pipeline.effect.sensor import BayerFilter, SensorNoise
from vrcaps.core.errors import InputError, UnknownNameError

MONO = (1.0, 1.0, 1.0)


def readout(
    noise: SensorNoise, gain: float, response: tuple[float, float, float]
) -> dict[str, object]:
    """Parameters by which the core reads the sensor."""
    params = noise.params(CameraSetup(make_camera(pinhole(8))))
    return params | {"gain": gain, "response": response, "light": 1.0}


def numbers(
    noise: SensorNoise, value: float, *, gain: float = 1.0, frame: int = 0, size: int = 256
):
    """Converter numbers of a flat field in three colors."""
    planes = np.full((3, size, size), value, np.float32)
    pattern = noise.fixed_pattern((3 * size, size), 0)
    readings = testing.read_sensor(planes, pattern, readout(noise, gain, MONO), None, (5, frame))
    return readings * (2**noise.bits - 1 - noise.black_level) + noise.black_level


@pytest.mark.parametrize("gain", [1.0, 3.0])
def test_photon_transfer_curve_returns_gain_and_read_noise(gain: float) -> None:
    """var = K (mean − black) + K² σ² + 1/12 from pairs of flat fields (EMVA 1288, 4.0, 2.4)."""
    noise = SensorNoise(4000.0, 9.0, prnu=0.02, dsnu=3.0, bits=14, black_level=400)
    values = np.linspace(0.0, 0.6, 13) / gain
    mean, variance = [], []
    for k, value in enumerate(values):
        one, other = (numbers(noise, value, gain=gain, frame=2 * k + j) for j in (0, 1))
        mean.append((one + other).mean() / 2.0 - noise.black_level)
        variance.append((one - other).var() / 2.0)
    slope = np.polyfit(mean[1:], np.array(variance[1:]) - variance[0], 1)[0]
    assert slope == pytest.approx(noise.system_gain(gain), rel=0.03)
    read = np.sqrt(variance[0] - 1.0 / 12.0) / noise.system_gain(gain)
    assert read == pytest.approx(noise.read_noise, rel=0.03)
    expected = values * gain * (2**14 - 1 - 400)
    assert np.array(mean) == pytest.approx(expected, rel=2e-3, abs=1.0)


@pytest.mark.parametrize("mean", [0.3, 2.0, 11.9, 12.1, 60.0])
def test_counts_of_electrons_are_poisson(mean: float) -> None:
    """Without read noise and at one number an electron, the numbers are the counts."""
    noise = SensorNoise(65535.0, 0.0, bits=16, black_level=0)
    counts = np.rint(numbers(noise, mean / 65535.0)).astype(int).ravel()
    lowest, highest = stats.poisson.ppf([1e-4, 1.0 - 1e-4], mean).astype(int)
    cells = np.arange(lowest, highest + 1)
    seen = np.array([(counts == k).sum() for k in cells])
    expected = stats.poisson.pmf(cells, mean) * counts.size
    chi_square = ((seen - expected) ** 2 / expected).sum()
    # Above a mean of 12 the series leaves the kurtosis out: less than 1 % of a standard deviation.
    allowed = stats.chi2.ppf(0.9999, len(cells)) * (1.0 if mean < 12.0 else 4.0)
    assert chi_square < allowed
    assert counts.mean() == pytest.approx(mean, rel=0.01)
    assert counts.var() == pytest.approx(mean, rel=0.02)
    assert stats.skew(counts) == pytest.approx(mean**-0.5, abs=0.02)


def test_noise_is_white_and_another_in_each_frame_and_camera() -> None:
    one = _core.standard_normal((512, 512), 7, 0).astype(float)
    others = [_core.standard_normal((512, 512), *key) for key in ((7, 1), (8, 0))]
    assert stats.kstest(one.ravel(), "norm").pvalue > 1e-3
    for other in (*others, np.roll(one, 1, axis=0), np.roll(one, 1, axis=1), one**2 - 1.0):
        assert abs(np.corrcoef(one.ravel(), np.ravel(other))[0, 1]) < 0.01
    assert np.array_equal(one, _core.standard_normal((512, 512), 7, 0))


def test_fixed_pattern_stays_and_has_its_spread() -> None:
    noise = SensorNoise(1e5, 0.0, prnu=0.05, dsnu=50.0, bits=16, black_level=1000, sensor_seed=3)
    response, offset = noise.fixed_pattern((300, 256), 0)
    assert response.std() == pytest.approx(0.05, rel=0.02)
    assert offset.std() == pytest.approx(50.0, rel=0.02)
    assert abs(np.corrcoef(response.ravel(), offset.ravel())[0, 1]) < 0.02
    mean = np.mean([numbers(noise, 0.5, frame=k, size=64) for k in range(64)], axis=0)
    expected = 0.5e5 * noise.fixed_pattern((192, 64), 0)[0] + noise.fixed_pattern((192, 64), 0)[1]
    measured = (mean.reshape(192, 64) - noise.black_level) / noise.system_gain()
    assert np.abs(measured - expected).std() < 1.2 * np.sqrt(0.5e5 / 64)
    assert not np.array_equal(noise.fixed_pattern((8, 8), 1)[0], noise.fixed_pattern((8, 8), 0)[0])


def test_numbers_are_whole_and_within_the_converter() -> None:
    noise = SensorNoise(500.0, 30.0, bits=8, black_level=10)
    for value in (0.0, 0.5, 3.0):
        read = numbers(noise, value, size=64)
        assert np.abs(read - np.rint(read)).max() < 1e-3
        assert read.min() > -1e-3
        assert read.max() < 255.001
    assert (numbers(noise, 3.0, size=64) > 254.9).all()


@pytest.mark.parametrize("pattern", ["rggb", "bggr", "grbg", "gbrg"])
def test_demosaic_agrees_with_its_twin_and_keeps_flat_colors(
    pattern, rng: np.random.Generator
) -> None:
    colors = BayerFilter(pattern).params(CameraSetup(make_camera(pinhole(8))))
    raw = rng.random((21, 34), np.float32)
    assert np.abs(testing.demosaic(raw[None], colors) - demosaic_twin(raw, colors)).max() < 1e-5
    flat = np.array([0.7, 0.4, 0.2], np.float32)
    index = np.array(colors).reshape(2, 2)
    raw = np.tile(flat[index], (10, 16))
    seen = testing.demosaic(np.ascontiguousarray(raw[None]), colors)
    assert np.abs(seen - flat[:, None, None]).max() < 0.14  # colors of the filter's curvature
    gray = testing.demosaic(np.full((1, 20, 32), 0.37, np.float32), colors)
    assert np.abs(gray - 0.37).max() < 1e-6


def test_balance_makes_up_for_the_response(rng: np.random.Generator) -> None:
    """A gray field stays gray, and the colors amplified most are the noisiest."""
    noise, balance = SensorNoise(2000.0, 5.0), WhiteBalance(response=(0.5, 1.0, 0.25))
    planes = np.full((3, 200, 200), 0.4, np.float32)
    pattern = noise.fixed_pattern((600, 200), 0)
    seen = testing.read_sensor(planes, pattern, readout(noise, 1.0, balance.response), None, (1, 0))
    assert seen.mean(axis=(1, 2)) == pytest.approx(0.4, rel=0.01)
    electrons = 0.4 * 2000.0 * np.array(balance.response)
    expected = np.sqrt(electrons + 25.0) / electrons * 0.4
    assert seen.std(axis=(1, 2)) == pytest.approx(expected, rel=0.03)


def test_developed_image_is_srgb() -> None:
    values = np.linspace(-0.1, 1.3, 3 * 64 * 5, dtype=np.float32).reshape(3, 64, 5)
    x = np.clip(values * np.array([1.0, 0.5, 2.0])[:, None, None], 0.0, 1.0)
    curve = np.where(x <= 0.0031308, 12.92 * x, 1.055 * x ** (1 / 2.4) - 0.055)
    lit = np.ones((64, 5), bool)
    lit[7, 3] = False
    seen = testing.develop(values, (1.0, 0.5, 2.0), lit)
    assert not seen[7, 3].any()
    assert np.abs(seen - 255.0 * np.moveaxis(curve, 0, -1))[lit].max() < 0.51


def picture(rng: np.random.Generator, height: int, width: int) -> np.ndarray:
    rough = ndimage.gaussian_filter(rng.random((height, width, 3)), (3, 3, 0))
    rough = (rough - rough.min()) / np.ptp(rough) * 220 + rng.normal(0, 4, rough.shape)
    return np.clip(rough, 0, 255).astype(np.uint8)


@pytest.mark.parametrize("quality", [95, 75, 30, 10])
@pytest.mark.parametrize("size", [(96, 112), (77, 93)])
def test_jpeg_is_that_of_the_common_library(
    quality: int, size: tuple[int, int], rng: np.random.Generator
) -> None:
    """Pillow's JPEG: the same pixels but for rounding, the same number of bytes but for
    those that the file repeats as markers (up to 2 %)."""
    image, buffer = picture(rng, *size), io.BytesIO()
    Image.fromarray(image).save(buffer, "JPEG", quality=quality, subsampling="4:2:0")
    expected = np.asarray(Image.open(buffer)).astype(int)
    difference = np.abs(testing.jpeg(image, quality).astype(int) - expected)
    assert difference.mean() < 0.7
    assert np.percentile(difference, 95) <= 3
    size_bytes = len(buffer.getvalue())
    assert testing.jpeg_bytes(image, quality) == pytest.approx(size_bytes, rel=0.02, abs=8)


def test_jpeg_keeps_to_a_number_of_bytes(rng: np.random.Generator) -> None:
    image = picture(rng, 128, 128)
    for most in (2000, 4000, 7000):
        quality = testing.jpeg_quality(image, 95, most)
        assert testing.jpeg_bytes(image, quality) <= most < testing.jpeg_bytes(image, quality + 1)
    assert testing.jpeg_quality(image, 95, 10) == 1


@pytest.mark.parametrize(
    ("make", "match"),
    [
        (lambda: SensorNoise(0.0, 1.0), "full_well is 0.0"),
        (lambda: SensorNoise(100.0, -1.0), "read_noise is -1.0. Allowed: 0 electrons or more"),
        (lambda: SensorNoise(100.0, 1.0, prnu=-0.1), "prnu is -0.1"),
        (lambda: SensorNoise(100.0, 1.0, dsnu=-2.0), "dsnu is -2.0"),
        (lambda: SensorNoise(100.0, 1.0, bits=0), "bits is 0"),
        (
            lambda: SensorNoise(100.0, 1.0, bits=8, black_level=255),
            "black_level is 255. Allowed: 0 to 254",
        ),
        (lambda: SensorNoise(100.0, 1.0, sensor_seed=-1), "sensor_seed is -1"),
        (lambda: WhiteBalance((0.0, 1.0, 1.0)), "gains"),
        (lambda: WhiteBalance(response=(1.0, -1.0, 1.0)), "response"),
        (lambda: BayerFilter("rgb"), "No pattern named 'rgb'. Known: bggr"),
        (lambda: Jpeg(0), "quality is 0"),
        (lambda: Jpeg(50, 0), "max_bytes is 0"),
    ],
)
def test_what_cannot_be(make, match: str) -> None:
    with pytest.raises((InputError, UnknownNameError), match=match):
        make()
