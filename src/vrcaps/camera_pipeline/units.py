"""Camera effects of one unit of a capsule, drawn from the image chain of its model."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from vrcaps.camera_pipeline.effect.lighting import LedBalance
from vrcaps.camera_pipeline.effect.optics import (
    Bloom,
    DepthOfField,
    LateralChromaticAberration,
    Vignetting,
)
from vrcaps.camera_pipeline.effect.processing import (
    MAX_ELEMENT,
    ColorMatrix,
    Denoising,
    Jpeg,
    Sharpening,
    ToneCurve,
    WhiteBalance,
)
from vrcaps.camera_pipeline.effect.sensor import BayerFilter, SensorNoise
from vrcaps.capsule.image_chain import EQUAL_UNITS
from vrcaps.core.rng import stream, truncated_normal

if TYPE_CHECKING:
    from vrcaps.camera_pipeline.effect.base import Effect
    from vrcaps.capsule.image_chain import ImageChain

_SEEDS = 2**31


def unit_effects(chain: ImageChain, seed: int | None) -> dict[str, Effect]:
    """Effects of one unit of a capsule by name; those that change nothing are left out.

    Args:
        chain: Image chain of the model.
        seed: Seed of the unit; None for the nominal values.
    """
    variation = EQUAL_UNITS if seed is None else chain.variation
    rng = stream(seed or 0, "camera/unit")
    leds, sensor = (int(rng.integers(_SEEDS)) for _ in range(2))
    sensor = 0 if seed is None else sensor
    red, blue, shading, focus = (truncated_normal(rng) for _ in range(4))
    matrix = np.array([[truncated_normal(rng) for _ in range(3)] for _ in range(3)])
    balance = variation.white_balance * np.array([red, 0.0, blue])
    coefficients = (1.0 + variation.lens_shading * shading) * np.array(chain.lens_shading)
    sharpening = Sharpening(chain.sharpening, chain.sharpening_radius_px)
    effects: list[Effect | None] = [
        LedBalance(variation.led, variation.led_color, leds) if variation.led else None,
        DepthOfField(chain.aperture, chain.focus_distance * math.exp(variation.focus * focus)),
        LateralChromaticAberration(*chain.lateral_color) if any(chain.lateral_color) else None,
        Vignetting(_triple(coefficients), chain.cosine_power),
        Bloom(chain.bloom_fraction, chain.bloom_angle) if chain.bloom_fraction else None,
        SensorNoise(chain.full_well, chain.read_noise, chain.prnu, chain.dsnu, sensor_seed=sensor),
        BayerFilter(chain.bayer_pattern) if chain.bayer_pattern else None,  # type: ignore[arg-type]
        WhiteBalance(_triple(np.array(chain.white_balance) * np.exp(balance)), chain.response),
        _color_matrix(np.array(chain.color_matrix), variation.color_matrix * matrix),
        ToneCurve(chain.contrast) if chain.contrast != 1.0 else None,
        Denoising(chain.luma_denoising_px, chain.chroma_denoising_px),
        sharpening if chain.sharpening else None,
        Jpeg(chain.jpeg_quality) if chain.jpeg_quality else None,
    ]
    return {effect.name: effect for effect in effects if effect is not None}


def _color_matrix(nominal: np.ndarray, errors: np.ndarray) -> ColorMatrix | None:
    """Matrix with errors off the diagonal, which keep gray; None for the identity.

    Elements are limited to those of `ColorMatrix`.
    """
    errors = errors * (1.0 - np.eye(3))
    matrix = nominal @ (np.eye(3) + errors - np.diag(errors.sum(axis=1)))
    matrix = np.clip(matrix, -MAX_ELEMENT, MAX_ELEMENT)
    if np.array_equal(matrix, np.eye(3)):
        return None
    red, green, blue = (_triple(row) for row in matrix)
    return ColorMatrix((red, green, blue))


def _triple(values: np.ndarray) -> tuple[float, float, float]:
    """Three numbers, rounded to the digits that an episode stores exactly."""
    first, second, third = np.round(values, 6).tolist()
    return first, second, third
