"""Smears on the dome."""

from __future__ import annotations

from dataclasses import dataclass
from statistics import NormalDist
from typing import TYPE_CHECKING, Annotated, Literal

import numpy as np

from vrcaps.camera_pipeline.dome import (
    DOME_NAMES,
    dome_lens,
    dome_rng,
    flatten,
    lit_rays,
    pupil_disk_radius,
)
from vrcaps.camera_pipeline.effect.base import CameraSetup, ImageEffect, Stage
from vrcaps.config.limits import Range
from vrcaps.core.units import MM

if TYPE_CHECKING:
    from jaxtyping import Bool, Float, UInt8

Substance = Literal["mucus", "bile", "blood"]

SUBSTANCES: dict[str, tuple[tuple[float, float, float], float]] = {
    "mucus": ((150.0, 200.0, 400.0), 9e3),
    "bile": ((600.0, 1.5e3, 9e3), 3e3),
    "blood": ((150.0, 1.1e4, 1.4e4), 1.2e3),
}
"""Absorption for red, green and blue, and transport scattering [1/m]. About 0.4 of the hemoglobin
of blood is oxygenated (Bosschaart et al., Lasers Med. Sci. 29, 2014); the others are chosen by
eye."""

_WAVES = 64
_MARKED = 0.1
"""Fraction of light absorbed or scattered by a smear from which `dome_label` marks it."""


@dataclass(frozen=True)
class Smears(ImageEffect):
    """Streaks of mucus, bile or blood on the dome that tint and scatter the light.

    Through a smear of thickness t with absorption a and transport scattering s, a fraction
    ``exp(−(a + s) t)`` of the light is transmitted unscattered; ``exp(−a t) (1 − exp(−s t))`` comes
    evenly from the whole image.

    Attributes:
        thickness: One standard deviation of the smear's relief above the edge of a streak [m].
        coverage: Fraction of the dome that it covers.
        substance: Substance of the smear.
        width: Width of a streak [m].
        aspect_ratio: Length of a streak over its width.
        distance: Distance of the dome from the entrance pupil [m].
    """

    thickness: Annotated[float, Range(above=0.0, below=0.01, unit="m")]
    coverage: Annotated[float, Range(above=0.0, below=1.0)] = 0.4
    substance: Substance = "mucus"
    width: Annotated[float, Range(above=0.0, below=1.0, unit="m")] = 1.2 * MM
    aspect_ratio: Annotated[float, Range(min=1.0)] = 4.0
    distance: Annotated[float, Range(above=0.0, below=1.0, unit="m")] = 5.0 * MM

    name = "smears"
    severities = (
        None,
        {"thickness": 0.015 * MM, "coverage": 0.25},
        {"thickness": 0.03 * MM, "coverage": 0.4},
        {"thickness": 0.06 * MM, "coverage": 0.55},
        {"thickness": 0.12 * MM, "coverage": 0.7},
    )

    def relief(
        self, points: Float[np.ndarray, "*n 2"], blur: float, rng: np.random.Generator
    ) -> Float[np.ndarray, "*n"]:
        """Thickness at points of the dome in the planar projection [m].

        Args:
            points: Points [m].
            blur: Radius of the disk that a pixel sees [m]; a wave k loses
                exp(−(k · blur)² / 8) of its height, as in a Gaussian with the variance of the disk.
            rng: Random number generator.
        """
        angle = rng.uniform(0.0, np.pi)
        size = self.width * np.array([self.aspect_ratio, 1.0])
        waves = 2.0 * rng.standard_normal((_WAVES, 2)) / size
        axes = np.array([[np.cos(angle), np.sin(angle)], [-np.sin(angle), np.cos(angle)]])
        waves, phases = waves @ axes, rng.uniform(0.0, 2.0 * np.pi, _WAVES)
        amplitude = np.exp(-((waves**2).sum(axis=1)) * blur**2 / 8.0)
        height = np.zeros(points.shape[:-1])
        for wave, phase, scale in zip(waves, phases, amplitude, strict=True):
            height += scale * np.cos(points @ wave + phase)
        height *= np.sqrt(2.0 / _WAVES)
        edge = NormalDist().inv_cdf(1.0 - self.coverage)
        return self.thickness * np.maximum(height - edge, 0.0)

    def stage(self, setup: CameraSetup) -> SmearsStage:
        """Create the smears on the dome of one camera."""
        return SmearsStage(self, setup)


class SmearsStage(Stage):
    """Smears on the dome of one camera.

    Attributes:
        params: Transmittance of each color [3 h w], fraction that is not scattered [h w], number
            of lit pixels.
    """

    def __init__(self, smears: Smears, setup: CameraSetup) -> None:
        """Distribute the streaks."""
        rays, lit = lit_rays(setup)
        blur = pupil_disk_radius(dome_lens(setup), smears.distance)
        points = smears.distance * flatten(np.nan_to_num(rays))
        thickness = np.where(lit, smears.relief(points, blur, dome_rng(setup, "smear")), 0.0)
        absorption, scattering = SUBSTANCES[smears.substance]
        transmittance = np.exp(-np.array(absorption)[:, None, None] * thickness)
        transmittance = transmittance.astype(np.float32)
        unscattered = np.exp(-scattering * thickness).astype(np.float32)
        super().__init__((transmittance, unscattered, float(np.count_nonzero(lit))))
        is_marked = transmittance.mean(axis=0) * unscattered < 1.0 - _MARKED
        self._is_marked: Bool[np.ndarray, "h w"] = is_marked

    def mark_dome(self, label: UInt8[np.ndarray, "h w"], time: float) -> None:
        """Mark the smears where there is no drop."""
        label[self._is_marked & (label == 0)] = DOME_NAMES.index("smear")
