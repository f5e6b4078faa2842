"""Effects of matter on the dome: water droplets and smears."""

from __future__ import annotations

from dataclasses import dataclass
from statistics import NormalDist
from typing import TYPE_CHECKING, Annotated, Literal

import numpy as np

from vrcaps.camera_pipeline.effect.base import CameraSetup, FrameContext, ImageEffect, Stage
from vrcaps.camera_pipeline.effect.optics import (
    DOME_NAMES,
    disk_points,
    dome_lens,
    dome_rng,
    flatten,
    lateral_axes,
    lit_rays,
    pupil_disk_radius,
    unflatten,
)
from vrcaps.core.errors import require
from vrcaps.core.fields import Range
from vrcaps.core.geometry import unit
from vrcaps.core.units import DEG, MM

if TYPE_CHECKING:
    from jaxtyping import Bool, Float, Int, UInt8

_SAMPLES = 9
"""Rays through the pupil per pixel affected by a drop."""
_TRIES = 12


@dataclass(frozen=True)
class Droplets(ImageEffect):
    """Water drops on the dome: plano-convex lenses a few millimeters in front of the pupil.

    A drop is a cap of a sphere of radius ``R = a / sin γ`` with base radius a and contact angle γ.
    A ray at distance r from its axis meets the cap at the angle α with sin α = r/R and leaves it at
    β with sin β = n sin α, refracted by β − α towards the axis; rays with n sin α > 1 are totally
    reflected, and the rim is dark. A pixel sees the part of the dome covered by the pupil's cone,
    ``A |1 − D/s|`` wide (A the aperture, D the distance of the dome, s that of focus).

    Attributes:
        count: Number of drops in the camera's field of view.
        radius: Median base radius [m].
        spread: Standard deviation of the logarithm of the radius.
        contact_angle: γ [rad]. On wet plastic about 30 to 70 degrees.
        ior: n, refractive index.
        distance: D, distance of the dome from the entrance pupil [m].
        speed: Speed at which all drops slide across the dome [m/s]; drops that leave re-enter.
    """

    count: Annotated[int, Range(min=1, max=200)]
    radius: float = 0.5 * MM
    spread: Annotated[float, Range(min=0.0, max=1.0)] = 0.4
    contact_angle: Annotated[float, Range(above=0.0, below=0.5 * np.pi, unit="rad")] = 50.0 * DEG
    ior: Annotated[float, Range(above=1.0, below=3.0)] = 1.333
    distance: Annotated[float, Range(above=0.0, below=1.0, unit="m")] = 5.0 * MM
    speed: Annotated[float, Range(min=0.0, below=0.1, unit="m/s")] = 0.0

    name = "droplets"
    severities = (
        None,
        {"count": 3, "radius": 0.4 * MM},
        {"count": 6, "radius": 0.45 * MM},
        {"count": 11, "radius": 0.5 * MM},
        {"count": 18, "radius": 0.6 * MM},
    )

    def __post_init__(self) -> None:
        super().__post_init__()
        is_valid = 0.0 < self.radius <= 0.5 * self.distance
        require(is_valid, "Droplets' radius", self.radius, "above 0 to D/2")

    def refract(
        self, offset: Float[np.ndarray, "*n"], base: Float[np.ndarray, "*n"]
    ) -> tuple[Float[np.ndarray, "*n"], Float[np.ndarray, "*n"]]:
        """Angle by which rays turn towards the axis [rad], and the transmittance.

        Args:
            offset: Distance from the axis [m], at most the base radius.
            base: Base radius of the drop [m].
        """
        sine = np.sin(self.contact_angle) * np.minimum(offset / base, 1.0)
        outside = np.minimum(self.ior * sine, 1.0)
        cos_in, cos_out = np.sqrt(1.0 - sine**2), np.sqrt(1.0 - outside**2)
        across = (self.ior * cos_in - cos_out) / (self.ior * cos_in + cos_out)
        along = (cos_in - self.ior * cos_out) / (cos_in + self.ior * cos_out)
        return np.arcsin(outside) - np.arcsin(sine), 1.0 - 0.5 * (across**2 + along**2)

    def place(
        self, field: float, rng: np.random.Generator
    ) -> tuple[Float[np.ndarray, " d"], Float[np.ndarray, "d 2"], Float[np.ndarray, " 2"]]:
        """Radii [m], positions in the planar projection [rad] and unit direction of sliding.

        Positions are uniform over the field; of a few candidates each drop takes the one with the
        largest clearance.

        Args:
            field: Half the camera's angle of view [rad].
            rng: Random number generator.
        """
        radius = self.radius * np.exp(self.spread * rng.standard_normal(self.count))
        radius = np.minimum(radius, 0.5 * self.distance)
        positions = np.empty((self.count, 2))
        for k in range(self.count):
            # Uniform on the sphere: the cosine of the angle to the axis is uniform.
            angle = np.arccos(1.0 - rng.random(_TRIES) * (1.0 - np.cos(field)))
            azimuth = rng.uniform(0.0, 2.0 * np.pi, _TRIES)
            tries = np.column_stack([angle * np.cos(azimuth), angle * np.sin(azimuth)])
            gaps = np.linalg.norm(tries[:, None] - positions[None, :k], axis=-1)
            gaps -= (radius[:k] + radius[k]) / self.distance
            positions[k] = tries[gaps.min(axis=1, initial=np.inf).argmax()]
        azimuth = rng.uniform(0.0, 2.0 * np.pi)
        return radius, positions, np.array([np.cos(azimuth), np.sin(azimuth)])

    def stage(self, setup: CameraSetup) -> DropletsStage:
        """Create the drops on the dome of one camera."""
        return DropletsStage(self, setup)


@dataclass(frozen=True)
class DropMap:
    """Effect of drops on pixels.

    Attributes:
        pixels: Indices of the pixels that drops change.
        sources: Indices of the pixels that each of them sees instead.
        weights: Weight of each source.
        coverage: Fraction of each pixel that drops cover.
    """

    pixels: Int[np.ndarray, " m"]
    sources: Int[np.ndarray, "m k"]
    weights: Float[np.ndarray, "m k"]
    coverage: Float[np.ndarray, " m"]


class DropletsStage(Stage):
    """Drops on the dome of one camera; caches the map of their last position."""

    def __init__(self, droplets: Droplets, setup: CameraSetup) -> None:
        """Distribute the drops."""
        super().__init__()
        self._droplets = droplets
        self._camera, self._lens = setup.camera, dome_lens(setup)
        self._rays, self._lit = lit_rays(setup)
        self._field = float(np.arccos(self._rays[self._lit][:, 2].min(initial=1.0)))
        self._radius, self._positions, self._heading = droplets.place(
            self._field, dome_rng(setup, "drop")
        )
        self._nearest = _nearest_lit(self._lit)
        self._last: tuple[float, DropMap] | None = None

    def frame_params(self, frame: FrameContext) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Indices of pixels that drops change, their source pixels, and their weights."""
        drops = self.at_time(frame.step.state.time)
        return drops.pixels, drops.sources, drops.weights

    def mark_dome(self, label: UInt8[np.ndarray, "h w"], time: float) -> None:
        """Mark pixels of which drops cover half or more."""
        drops = self.at_time(time)
        label.reshape(-1)[drops.pixels[drops.coverage >= 0.5]] = DOME_NAMES.index("drop")

    def at_time(self, time: float) -> DropMap:
        """Return the map at a time [s]."""
        # Drops move in increments of half a pixel.
        step = 0.5 * self._field / max(self._camera.width, 1)
        speed = self._droplets.speed * time / self._droplets.distance
        path = step * np.floor(speed / step)
        if self._last is None or self._last[0] != path:
            self._last = (path, self._trace(self._slid(path)))
        return self._last[1]

    def _slid(self, path: float) -> Float[np.ndarray, "d 2"]:
        """Planar positions of the drops after a path [rad]; drops that leave the field re-enter."""
        along, across = self._heading, np.array([-self._heading[1], self._heading[0]])
        reach = self._field + self._radius / self._droplets.distance
        aside = self._positions @ across
        half = np.sqrt(np.maximum(reach**2 - aside**2, 1e-12))
        moved = np.mod(self._positions @ along + path + half, 2.0 * half) - half
        return moved[:, None] * along + aside[:, None] * across

    def _trace(self, positions: Float[np.ndarray, "d 2"]) -> DropMap:
        droplets, lens = self._droplets, self._lens
        centers, size = unflatten(positions), self._radius / droplets.distance
        blur = pupil_disk_radius(lens, droplets.distance) / droplets.distance
        lit = np.flatnonzero(self._lit)
        rays = self._rays.reshape(-1, 3)[lit]
        covered = (rays @ centers.T > np.cos(np.minimum(size + blur, np.pi))).any(axis=1)
        pixels, rays = lit[covered], rays[covered]
        sources = np.empty((len(pixels), _SAMPLES), np.uint32)
        weights = np.empty((len(pixels), _SAMPLES), np.float32)
        hits = np.zeros(len(pixels))
        for k, pupil in enumerate(disk_points(_SAMPLES) * 0.5 * lens.aperture):
            points, transmittance, is_in = self._sample(rays, pupil, centers)
            sources[:, k] = np.where(is_in, self._pixels_of(points), pixels)
            weights[:, k] = transmittance / _SAMPLES
            hits += is_in
        kept = hits > 0.0
        coverage = hits[kept] / _SAMPLES
        return DropMap(pixels[kept].astype(np.uint32), sources[kept], weights[kept], coverage)

    def _sample(
        self,
        rays: Float[np.ndarray, "m 3"],
        pupil: Float[np.ndarray, " 2"],
        centers: Float[np.ndarray, "d 3"],
    ) -> tuple[Float[np.ndarray, "m 3"], Float[np.ndarray, " m"], Bool[np.ndarray, " m"]]:
        """Points at the focus distance reached by rays from a point of the pupil.

        Returns:
            Points [m], the transmittance, and a mask of rays that hit a drop.
        """
        droplets, focus = self._droplets, self._lens.focus_distance
        right, down = lateral_axes(rays)
        start = pupil[0] * right + pupil[1] * down
        heading = unit(focus * rays - start)
        on_dome = start + droplets.distance * heading
        direction = unit(on_dome)
        cosine = direction @ centers.T
        apart = np.arccos(np.clip(cosine, -1.0, 1.0))
        drop = (apart - self._radius / droplets.distance).argmin(axis=1)
        base = self._radius[drop]
        offset = droplets.distance * np.take_along_axis(apart, drop[:, None], 1)[:, 0]
        is_in = offset < base
        angle, transmittance = droplets.refract(offset, base)
        outward = direction - centers[drop] * np.take_along_axis(cosine, drop[:, None], 1)
        bent = unit(heading * np.cos(angle)[:, None] - unit(outward) * np.sin(angle)[:, None])
        points = on_dome + max(focus - droplets.distance, 0.0) * bent
        return points, np.where(is_in, transmittance, 1.0), is_in

    def _pixels_of(self, points: Float[np.ndarray, "m 3"]) -> Int[np.ndarray, " m"]:
        """Indices of the lit pixels that see points, or of the nearest to them."""
        height, width = self._lit.shape
        angle = np.arctan2(np.hypot(points[:, 0], points[:, 1]), points[:, 2])
        scale = np.minimum(1.0, 0.995 * self._field / angle)
        inside = unflatten(flatten(unit(points)) * scale[:, None])
        column, row = np.nan_to_num(self._camera.lens.project(inside)).T
        column = np.clip(np.rint(column), 0, width - 1).astype(int)
        row = np.clip(np.rint(row), 0, height - 1).astype(int)
        return self._nearest[row, column]


def _nearest_lit(lit: Bool[np.ndarray, "h w"]) -> Int[np.ndarray, "h w"]:
    """Index of the lit pixel nearest to each pixel."""
    from scipy.ndimage import distance_transform_edt  # slow to load

    indices = np.asarray(distance_transform_edt(~lit, return_distances=False, return_indices=True))
    return indices[0] * lit.shape[1] + indices[1]


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
