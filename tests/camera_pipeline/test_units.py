"""Units of a capsule: effects from its image chain, drawn by a seed."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from tests.support.shapes import looking, make_camera, make_model, patterned, tube
from vrcaps.camera.camera import led_ring
from vrcaps.camera_pipeline.capsule_cameras import CapsuleCameras
from vrcaps.camera_pipeline.effect.exposure import AutoExposure
from vrcaps.camera_pipeline.effect.optics import DepthOfField, LedBalance
from vrcaps.camera_pipeline.effect.processing import Jpeg, WhiteBalance
from vrcaps.camera_pipeline.effects import Effects, parse_effects, unit_effects
from vrcaps.camera_pipeline.pipeline import CameraPipeline
from vrcaps.capsule.device_file import device_names, read_device, write_device
from vrcaps.capsule.image_chain import EQUAL_UNITS, ImageChain, UnitVariation
from vrcaps.core.errors import InputError
from vrcaps.motion.motion import Step
from vrcaps.render.renderer import Renderer
from vrcaps.render.settings import RenderSettings

CAMERA = make_camera("equidistant", image_circle_px=38.0, exposure=4.0)
NOW = looking((0.002, 0.001, 0.05), (0.1, 0.05, 1.0))
CHAIN = ImageChain(variation=UnitVariation(0.1, 0.05, 0.2, 0.1, 0.2, 0.03, 0.2, 0.25))


def test_nominal_unit_has_the_values_of_its_model() -> None:
    own = unit_effects(replace(CHAIN, contrast=1.2), None)
    assert own["depth_of_field"] == DepthOfField(CHAIN.aperture, CHAIN.focus_distance)
    assert own["white_balance"] == WhiteBalance(CHAIN.white_balance, CHAIN.response)
    assert own["vignetting"].coefficients == CHAIN.lens_shading  # type: ignore[attr-defined]
    assert own["tone_curve"].contrast == 1.2  # type: ignore[attr-defined]
    assert own["jpeg"] == Jpeg(75)
    assert "led_balance" not in own
    assert "color_matrix" not in own
    equal = replace(CHAIN, variation=EQUAL_UNITS)
    assert unit_effects(equal, 5).keys() == unit_effects(CHAIN, None).keys()


def test_effects_that_change_nothing_are_left_out() -> None:
    ideal = ImageChain(
        lateral_color=(0.0, 0.0), bloom_fraction=0.0, bayer_pattern="", sharpening=0.0,
        contrast=1.0, jpeg_quality=0, variation=EQUAL_UNITS,
    )  # fmt: skip
    left = {"depth_of_field", "vignetting", "sensor_noise", "white_balance", "denoising"}
    assert set(unit_effects(ideal, 3)) == left


def test_units_differ_by_seed_and_are_reproducible() -> None:
    units = [unit_effects(CHAIN, seed) for seed in range(4)]
    assert units[0] == unit_effects(CHAIN, 0)
    for name in (
        "white_balance",
        "color_matrix",
        "vignetting",
        "depth_of_field",
        "denoising",
        "led_balance",
    ):
        assert len({str(unit[name]) for unit in units}) == 4, name
    assert len({unit["sensor_noise"].sensor_seed for unit in units}) == 4  # type: ignore[attr-defined]
    assert len({unit["jpeg"] for unit in units}) == 1


def test_variation_has_its_standard_deviation_and_keeps_gray() -> None:
    units = [unit_effects(CHAIN, seed) for seed in range(400)]
    red, green, _ = np.log([unit["white_balance"].gains for unit in units]).T  # type: ignore[attr-defined]
    assert red.std() == pytest.approx(0.1, rel=0.1)
    assert np.abs(red).max() < 0.1 * 2.0 / 0.87  # truncated at two standard deviations
    assert not green.any()
    matrix = np.array([unit["color_matrix"].matrix for unit in units])  # type: ignore[attr-defined]
    assert matrix.sum(axis=2) == pytest.approx(1.0, abs=3e-6)
    assert matrix[:, 0, 1].std() == pytest.approx(0.05, rel=0.1)
    focus = np.log([unit["depth_of_field"].focus_distance for unit in units])  # type: ignore[attr-defined]
    assert focus.std() == pytest.approx(0.1, rel=0.1)
    assert abs(np.corrcoef(red, focus)[0, 1]) < 0.15
    luma = np.array([unit["denoising"].luma for unit in units])  # type: ignore[attr-defined]
    chroma = np.array([unit["denoising"].chroma for unit in units])  # type: ignore[attr-defined]
    assert np.log(luma).std() == pytest.approx(0.25, rel=0.1)
    assert chroma / luma == pytest.approx(CHAIN.chroma_denoising_px / CHAIN.luma_denoising_px, 1e-3)


def test_units_differ_in_their_target_of_exposure() -> None:
    device = replace(read_device("mirocam"), image_chain=CHAIN)
    targets = [
        Effects().of_device(device, seed).auto_exposure.target  # type: ignore[union-attr]
        for seed in range(400)
    ]
    assert np.log(targets).std() == pytest.approx(0.2, rel=0.1)
    assert np.median(targets) == pytest.approx(AutoExposure(0.0).target, rel=0.05)
    nominal = AutoExposure(0.0, tolerance=CHAIN.exposure_tolerance)
    assert Effects().of_device(device).auto_exposure == nominal
    equal = replace(device, image_chain=replace(CHAIN, variation=EQUAL_UNITS))
    assert Effects().of_device(equal, 7).auto_exposure == nominal


def test_a_nominal_camera_is_that_of_the_model() -> None:
    device = read_device("pillcam-sb3")
    nominal = parse_effects("nominal,jpeg=1")
    assert nominal == Effects(jpeg=1, nominal=True)
    of_model = Effects(jpeg=1).of_device(device)
    assert nominal.of_device(device, 7) == nominal.of_device(device, 8) == of_model
    assert Effects(jpeg=1).of_device(device, 7) != of_model
    assert of_model.of_device(device, 7) == of_model
    assert parse_effects("nominal,default") == Effects()


def test_leds_are_unequal_but_give_the_same_light() -> None:
    camera = read_device("mirocam").cameras[0]
    varied = LedBalance(0.3, 0.05, seed=2).on(camera)
    before, after = (np.array([led.intensity for led in c.leds]) for c in (camera, varied))
    assert after.sum(axis=0) == pytest.approx(before.sum(axis=0))
    assert np.log(after[:, 1]).std() > 0.1
    assert np.ptp(after[:, 0] / after[:, 1]) > 0.01
    assert varied.lens == camera.lens
    assert LedBalance(0.3, 0.05, seed=2).on(camera) == varied
    assert LedBalance(0.3, 0.05, seed=3).on(camera) != varied
    dark = replace(camera, leds=(), exposure=1.0)
    assert LedBalance(0.3).on(dark) == dark


def test_every_capsule_of_the_catalog_has_its_image_chain_and_files_keep_it(tmp_path) -> None:
    for name in device_names():
        device = read_device(name)
        assert device.image_chain is not None, name
        write_device(tmp_path / f"{name}.toml", device)
        assert read_device(tmp_path / f"{name}.toml") == device


def test_a_file_keeps_a_chain_without_compression_and_variation(tmp_path) -> None:
    chain = replace(CHAIN, jpeg_quality=0, variation=EQUAL_UNITS)
    device = replace(read_device("mirocam"), name="own", image_chain=chain)
    write_device(tmp_path / "own.toml", device)
    assert read_device(tmp_path / "own.toml") == device


def test_every_allowed_chain_gives_units() -> None:
    """Values at the limits of a chain, with the largest variation, are within those of effects."""
    largest = UnitVariation(*[0.5] * 8)
    rows = ((4.0, 4.0, 4.0), (-4.0, -4.0, -4.0), (0.0, 0.0, 0.0))
    for gain in (0.01, 10.0):
        gains = (gain, gain, gain)
        chain = replace(
            CHAIN, white_balance=gains, response=gains, color_matrix=rows, variation=largest
        )
        for seed in range(20):
            assert {"white_balance", "color_matrix"} <= set(unit_effects(chain, seed))


def test_an_effect_of_a_user_replaces_that_of_the_unit() -> None:
    device = read_device("mirocam")
    assert parse_effects("default") == Effects()
    assert parse_effects("none,noise=2,default") == Effects()
    own = Effects().of_device(device, 7)
    assert own == Effects().of_device(device, 7) != Effects().of_device(device, 8)
    assert own.without_device(device, 7) == Effects()
    given = parse_effects("noise=2,jpeg=0").of_device(device, 7)
    assert (given.sensor_noise, given.jpeg, given.bloom) == (2, 0, own.bloom)
    ideal = parse_effects("none").of_device(device, 7)
    assert ideal == Effects.none()
    assert ideal.is_ideal
    assert Effects().of_device(replace(device, image_chain=None), 7).bloom == 0


@pytest.mark.parametrize(
    ("given", "match"),
    [
        ({"aperture": 0.0}, "ImageChain's aperture is 0.0. Allowed: above 0"),
        ({"bayer_pattern": "rgb"}, "bayer_pattern is 'rgb'. Allowed: rggb"),
        ({"white_balance": (1.0, 0.0, 1.0)}, "white_balance is"),
        ({"response": (1.0, 1.0, -1.0)}, "response is"),
        ({"lens_shading": (np.nan, 0.0, 0.0)}, "lens_shading is"),
        ({"lateral_color": (0.6, 0.0)}, "lateral_color is"),
        ({"color_matrix": ((5.0, 0, 0), (0, 1.0, 0), (0, 0, 1.0))}, "color_matrix is"),
        ({"jpeg_quality": -1}, "jpeg_quality is -1"),
        ({"white_balance": (1e-9, 1.0, 1.0)}, "white_balance is .* from 0.01 to 10"),
    ],
)
def test_invalid_image_chain_is_reported(given: dict, match: str) -> None:
    with pytest.raises(InputError, match=match) as error:
        ImageChain(**given)
    assert "\n" not in str(error.value)


def test_invalid_variation_is_reported() -> None:
    with pytest.raises(InputError, match=r"UnitVariation's led is -0.1. Allowed: 0 to 0.5"):
        UnitVariation(led=-0.1)


@pytest.fixture(scope="module")
def renderer() -> Renderer:
    organ = tube(48, 80, folds=0.3, appearance=patterned(np.random.default_rng(3)))
    model = make_model(organ, CAMERA)
    chained = replace(model.device, image_chain=CHAIN)
    return Renderer(replace(model, device=chained), RenderSettings(light="direct", shadows=False))


def image(renderer: Renderer, effects: Effects | None = None, *, seed: int = 1) -> np.ndarray:
    """Image of one unit of the renderer's capsule."""
    pipeline = CameraPipeline(renderer, CAMERA, effects, seed=seed)
    return np.asarray(pipeline.capture(Step(0, NOW)).rgb)


def test_camera_as_built_is_the_default_and_none_is_the_renderers_image(renderer: Renderer) -> None:
    plain = np.asarray(renderer.render(NOW, CAMERA, channels=("rgb",)).rgb)
    assert np.array_equal(image(renderer, Effects.none()), plain)
    own = Effects().of_device(renderer.model.device, 1)
    assert np.array_equal(image(renderer), image(renderer, own))
    assert np.abs(image(renderer).astype(int) - plain).mean() > 5.0
    assert not np.array_equal(image(renderer), image(renderer, seed=2))


def test_effects_on_cameras_are_applied_to_the_nominal_capsule_once(renderer: Renderer) -> None:
    device = renderer.model.device
    lit = replace(CAMERA, leds=led_ring(4, radius=3e-3))
    effects = Effects(led_balance=LedBalance(0.3, seed=4))
    named = Renderer(replace(renderer.model, device=replace(device, cameras=(lit,))))
    (changed,) = effects.device(named.model.device).cameras
    pipeline = CameraPipeline(named, lit.name, effects)
    assert pipeline.camera == changed != lit
    assert CameraPipeline(named, changed, effects).camera == changed
    (of_capsule,) = CapsuleCameras(named, effects, fps=1.0).pipelines.values()
    assert of_capsule.camera == changed


@pytest.mark.parametrize("loop", [0, 1])
def test_first_image_of_a_scene_four_times_as_bright_is_as_bright(
    renderer: Renderer, loop: int
) -> None:
    """With settled exposure, and with a loop that has a time constant."""
    effects = Effects(auto_exposure=loop or AutoExposure(0.0))
    levels = []
    for factor in (1.0, 4.0):
        camera = replace(CAMERA, exposure=0.2 * factor * CAMERA.exposure)
        pipeline = CameraPipeline(renderer, camera, effects)
        step = Step(0, NOW)
        levels.append((pipeline.expose(step).luminance, pipeline.capture(step).rgb))
    assert levels[0][0] == pytest.approx(AutoExposure(0.0).target, rel=0.01)
    assert levels[1][0] == pytest.approx(levels[0][0], rel=0.01)
    means = [np.asarray(rgb, float).mean() for _, rgb in levels]
    assert means[1] == pytest.approx(means[0], rel=0.01)
