"""What lies on the dome before a camera: drops, each a small lens, and smears."""

from __future__ import annotations

from dataclasses import dataclass
from statistics import NormalDist
from typing import TYPE_CHECKING, Any, Literal, get_args

import numpy as np

import vrcaps.rng
from vrcaps import _core
from vrcaps.camera.rays import camera_rays
from vrcaps.camera_pipeline.optics import Defocus
from vrcaps.errors import InputError, require
from vrcaps.units import DEG, MM

if TYPE_CHECKING:
    from jaxtyping import Bool, Float, Int, UInt8

    from vrcaps.camera.camera import Camera

DOME_NAMES = ("nothing", "drop", "smear")
"""Classes of what lies on the dome: numbers of the channel `dome_label`."""

Matter = Literal["mucus", "bile", "blood"]

MATTER: dict[str, tuple[tuple[float, float, float], float]] = {
    "mucus": ((150.0, 200.0, 400.0), 9e3),
    "bile": ((600.0, 1.5e3, 9e3), 3e3),
    "blood": ((150.0, 1.1e4, 1.4e4), 1.2e3),
}
"""Absorption for red, green and blue, and transport scattering [1/m]. Blood is oxygenated at some
0.4 of its haemoglobin (Bosschaart et al., Lasers Med. Sci. 29, 2014); the others go by eye."""

_SAMPLES = 9
"""Rays through the pupil for each pixel that a drop changes."""

_WAVES = 64
_TRIES = 12
_MARKED = 0.1
"""Share of the light that a smear takes or scatters where `dome_label` shows it."""

_LENS = Defocus(0.5 * MM)
"""Aperture and focus where depth of field is not among the effects."""


@dataclass(frozen=True)
class Droplets:
    """Drops of water on the dome: plano-convex lenses millimetres before the pupil.

    A drop is a cap of a sphere of radius ``R = a / sin γ`` with its base radius a and its contact
    angle γ. A ray at distance r from its axis meets the cap at the angle α with sin α = r/R and
    leaves it at β with sin β = n sin α, turned by β − α towards the axis; none leaves where
    n sin α > 1, and the rim is dark. A pixel sees through as much of the dome as the pupil's cone
    covers there, ``A |1 − D/s|`` wide (A the aperture, D the dome's distance, s that of focus).

    Attributes:
        number: In the camera's field.
        radius: Median base radius [m].
        spread: Standard deviation of the logarithm of the radius.
        contact_angle: γ [rad]. On wet plastic some 30 to 70 degrees.
        ior: n, refractive index.
        distance: D, of the dome from the entrance pupil [m].
        speed: At which all slide across the dome [m/s]; one that has left comes in again.
    """

    number: int
    radius: float = 0.5 * MM
    spread: float = 0.4
    contact_angle: float = 50.0 * DEG
    ior: float = 1.333
    distance: float = 5.0 * MM
    speed: float = 0.0

    def __post_init__(self) -> None:
        require(1 <= self.number <= 200, "Droplets' number", self.number, "1 to 200")
        widest = 0.5 * self.distance
        require(0.0 < self.radius <= widest, "Droplets' radius", self.radius, "above 0 to D/2")
        require(0.0 <= self.spread <= 1.0, "Droplets' spread", self.spread, "0 to 1")
        angle = self.contact_angle
        require(0.0 < angle < 0.5 * np.pi, "Droplets' contact_angle", angle, "above 0 to π/2")
        require(1.0 < self.ior < 3.0, "Droplets' ior", self.ior, "above 1 to 3")
        require(0.0 < self.distance < 1.0, "Droplets' distance", self.distance, "above 0 to 1 m")
        require(0.0 <= self.speed < 0.1, "Droplets' speed", self.speed, "0 to 0.1 m/s")

    def turned(
        self, offset: Float[np.ndarray, "*n"], base: Float[np.ndarray, "*n"]
    ) -> tuple[Float[np.ndarray, "*n"], Float[np.ndarray, "*n"]]:
        """Angle by which rays turn towards the axis [rad], and the share of light that leaves.

        Args:
            offset: From the axis [m], at most the base radius.
            base: Base radius of the drop [m].
        """
        sine = np.sin(self.contact_angle) * np.minimum(offset / base, 1.0)
        outside = np.minimum(self.ior * sine, 1.0)
        cos_in, cos_out = np.sqrt(1.0 - sine**2), np.sqrt(1.0 - outside**2)
        across = (self.ior * cos_in - cos_out) / (self.ior * cos_in + cos_out)
        along = (cos_in - self.ior * cos_out) / (cos_in + self.ior * cos_out)
        return np.arcsin(outside) - np.arcsin(sine), 1.0 - 0.5 * (across**2 + along**2)


@dataclass(frozen=True)
class Smears:
    """A film on the dome, in streaks: it tints, and spreads light evenly over the image.

    Where it is t thick, ``exp(−(a + s) t)`` of the light goes straight on, with its absorption a
    and its transport scattering s; ``exp(−a t) (1 − exp(−s t))`` comes from all of the image alike.

    Attributes:
        thickness: Of the film, one standard deviation of its hills above the edge of a streak [m].
        cover: Share of the dome that it covers.
        matter: What it is.
        width: Of a streak [m].
        slenderness: Length of a streak over its width.
        distance: Of the dome from the entrance pupil [m].
    """

    thickness: float
    cover: float = 0.4
    matter: Matter = "mucus"
    width: float = 1.2 * MM
    slenderness: float = 4.0
    distance: float = 5.0 * MM

    def __post_init__(self) -> None:
        require(
            0.0 < self.thickness < 0.01, "Smears' thickness", self.thickness, "above 0 to 0.01 m"
        )
        require(0.0 < self.cover < 1.0, "Smears' cover", self.cover, "above 0 to below 1")
        require(0.0 < self.width < 1.0, "Smears' width", self.width, "above 0 to 1 m")
        require(self.slenderness >= 1.0, "Smears' slenderness", self.slenderness, "1 or more")
        require(0.0 < self.distance < 1.0, "Smears' distance", self.distance, "above 0 to 1 m")
        if self.matter not in get_args(Matter):
            allowed = ", ".join(get_args(Matter))
            raise InputError(f"Smears' matter is {self.matter!r}. Allowed: {allowed}.")

    def profile(
        self, places: Float[np.ndarray, "*n 2"], blur: float, rng: np.random.Generator
    ) -> Float[np.ndarray, "*n"]:
        """Thickness at places of the dome, laid flat [m].

        Args:
            places: [m].
            blur: Radius of the disk that a pixel sees at once [m]; a wave k loses
                exp(−(k · blur)² / 8) of its height, as in a Gaussian of the disk's variance.
            rng: Source of randomness.
        """
        turn = rng.uniform(0.0, np.pi)
        size = self.width * np.array([self.slenderness, 1.0])
        waves = 2.0 * rng.standard_normal((_WAVES, 2)) / size
        axes = np.array([[np.cos(turn), np.sin(turn)], [-np.sin(turn), np.cos(turn)]])
        waves, phases = waves @ axes, rng.uniform(0.0, 2.0 * np.pi, _WAVES)
        left = np.exp(-((waves**2).sum(axis=1)) * blur**2 / 8.0)
        hills = np.zeros(places.shape[:-1])
        for wave, phase, height in zip(waves, phases, left, strict=True):
            hills += height * np.cos(places @ wave + phase)
        hills *= np.sqrt(2.0 / _WAVES)
        return self.thickness * np.maximum(hills - NormalDist().inv_cdf(1.0 - self.cover), 0.0)


class Dome:
    """The dome of one camera with all that lies on it; holds where that is.

    Attributes:
        film: Share of each colour that is not absorbed [3 h w], share of that which goes straight
            on [h w], and number of lit pixels; None without smears.
    """

    def __init__(
        self,
        camera: Camera,
        droplets: Droplets | None,
        smears: Smears | None,
        *,
        lens: Defocus | None,
        seed: tuple[int, ...],
    ) -> None:
        """Lays drops and smears.

        Args:
            camera: That looks through it.
            droplets: None for none.
            smears: None for none.
            lens: Aperture and focus.
            seed: Decides where all lies: the scenario's, then the camera's number.
        """
        self._camera, self._droplets, self._lens = camera, droplets, lens or _LENS
        self._rays = camera_rays(camera).astype(float)
        self._lit = np.asarray(np.isfinite(self._rays).all(axis=-1))
        self._field = float(np.arccos(self._rays[self._lit][:, 2].min(initial=1.0)))
        drops, film = vrcaps.rng.stream(seed[0], "camera/dome", *seed[1:]).spawn(2)
        self.film, self._is_smeared = None, np.zeros(self._lit.shape, bool)
        if smears is not None:
            self._smear(smears, film)
        self._map: tuple[float, Any] | None = None
        if droplets is not None:
            self._radius, self._place, self._way = _lay(droplets, self._field, drops)
            self._near = _nearest_lit(self._lit)

    def apply(self, planes: Float[np.ndarray, "3 h w"], time: float) -> Float[np.ndarray, "3 h w"]:
        """The image as it is seen through what lies on the dome at a time [s]."""
        return _core.through_dome(planes, self.film, self.drops(time))

    def drops(self, time: float) -> tuple[Any, Any, Any] | None:
        """Pixels that drops change, the pixels that they see instead, and how much those count."""
        return None if self._droplets is None else self._drops(time)[:3]

    def labels(self, time: float) -> UInt8[np.ndarray, "h w"]:
        """What each pixel looks through at a time [s], as in the channel `dome_label`."""
        label = np.where(self._is_smeared, np.uint8(2), np.uint8(0))
        if self._droplets is not None:
            pixels, _, _, through = self._drops(time)
            label.reshape(-1)[pixels[through >= 0.5]] = 1
        return label

    def _smear(self, smears: Smears, rng: np.random.Generator) -> None:
        blur = _blur(self._lens, smears.distance)
        places = smears.distance * _flat(np.nan_to_num(self._rays))
        thick = np.where(self._lit, smears.profile(places, blur, rng), 0.0)
        absorption, scattering = MATTER[smears.matter]
        left = np.exp(-np.array(absorption)[:, None, None] * thick).astype(np.float32)
        clear = np.exp(-scattering * thick).astype(np.float32)
        self.film = (left, clear, float(np.count_nonzero(self._lit)))
        self._is_smeared = left.mean(axis=0) * clear < 1.0 - _MARKED

    def _drops(self, time: float) -> tuple[Any, Any, Any, Any]:
        """Pixels, what they see, its weights, and the share of each that drops cover."""
        droplets = self._droplets
        assert droplets is not None
        # Drops move by half a pixel at a time.
        step = 0.5 * self._field / max(self._camera.width, 1)
        way = step * np.floor(droplets.speed * time / droplets.distance / step)
        if self._map is None or self._map[0] != way:
            self._map = (way, self._trace(self._slid(way)))
        return self._map[1]

    def _slid(self, way: float) -> Float[np.ndarray, "d 2"]:
        """Places of the drops after a way [rad], laid flat; they come in where others go out."""
        assert self._droplets is not None
        along, across = self._way, np.array([-self._way[1], self._way[0]])
        reach = self._field + self._radius / self._droplets.distance
        aside = self._place @ across
        half = np.sqrt(np.maximum(reach**2 - aside**2, 1e-12))
        moved = np.mod(self._place @ along + way + half, 2.0 * half) - half
        return moved[:, None] * along + aside[:, None] * across

    def _trace(self, places: Float[np.ndarray, "d 2"]) -> tuple[Any, Any, Any, Any]:
        droplets, lens = self._droplets, self._lens
        assert droplets is not None
        centers, size = _round(places), self._radius / droplets.distance
        blur = _blur(lens, droplets.distance) / droplets.distance
        lit = np.flatnonzero(self._lit)
        rays = self._rays.reshape(-1, 3)[lit]
        touched = (rays @ centers.T > np.cos(np.minimum(size + blur, np.pi))).any(axis=1)
        pixels, rays = lit[touched], rays[touched]
        seen = np.empty((len(pixels), _SAMPLES), np.uint32)
        weights = np.empty((len(pixels), _SAMPLES), np.float32)
        through = np.zeros(len(pixels))
        for k, pupil in enumerate(_disk(_SAMPLES) * 0.5 * lens.aperture):
            points, share, is_in = self._sample(rays, pupil, centers)
            seen[:, k] = np.where(is_in, self._pixels_of(points), pixels)
            weights[:, k] = share / _SAMPLES
            through += is_in
        kept = through > 0.0
        share = through[kept] / _SAMPLES
        return pixels[kept].astype(np.uint32), seen[kept], weights[kept], share

    def _sample(
        self,
        rays: Float[np.ndarray, "m 3"],
        pupil: Float[np.ndarray, " 2"],
        centers: Float[np.ndarray, "d 3"],
    ) -> tuple[Float[np.ndarray, "m 3"], Float[np.ndarray, " m"], Bool[np.ndarray, " m"]]:
        """What rays from a place in the pupil reach at the distance of focus.

        Returns:
            Points [m], the share of the light that comes through, whether a drop was met.
        """
        droplets, focus = self._droplets, self._lens.focus_distance
        assert droplets is not None
        right, down = _across(rays)
        start = pupil[0] * right + pupil[1] * down
        heading = _unit(focus * rays - start)
        on_dome = start + droplets.distance * heading
        place = _unit(on_dome)
        cosine = place @ centers.T
        apart = np.arccos(np.clip(cosine, -1.0, 1.0))
        drop = (apart - self._radius / droplets.distance).argmin(axis=1)
        base = self._radius[drop]
        offset = droplets.distance * np.take_along_axis(apart, drop[:, None], 1)[:, 0]
        is_in = offset < base
        turn, share = droplets.turned(offset, base)
        outward = place - centers[drop] * np.take_along_axis(cosine, drop[:, None], 1)
        bent = _unit(heading * np.cos(turn)[:, None] - _unit(outward) * np.sin(turn)[:, None])
        points = on_dome + max(focus - droplets.distance, 0.0) * bent
        return points, np.where(is_in, share, 1.0), is_in

    def _pixels_of(self, points: Float[np.ndarray, "m 3"]) -> Int[np.ndarray, " m"]:
        """Numbers of the lit pixels that see points, or of the nearest to them."""
        height, width = self._lit.shape
        angle = np.arctan2(np.hypot(points[:, 0], points[:, 1]), points[:, 2])
        inside = _round(
            _flat(_unit(points)) * (np.minimum(1.0, 0.995 * self._field / angle))[:, None]
        )
        column, row = np.nan_to_num(self._camera.lens.project(inside)).T
        column = np.clip(np.rint(column), 0, width - 1).astype(int)
        row = np.clip(np.rint(row), 0, height - 1).astype(int)
        return self._near[row, column]


def _blur(lens: Defocus, distance: float) -> float:
    """Radius of the disk on the dome that a pixel sees at once [m]."""
    return 0.5 * lens.aperture * abs(1.0 - distance / lens.focus_distance)


def _lay(
    droplets: Droplets, field: float, rng: np.random.Generator
) -> tuple[Float[np.ndarray, " d"], Float[np.ndarray, "d 2"], Float[np.ndarray, " 2"]]:
    """Radii [m], places laid flat [rad], and the unit direction in which drops slide.

    Places are even over the field; of a few tries each takes the one with most room.
    """
    radius = droplets.radius * np.exp(droplets.spread * rng.standard_normal(droplets.number))
    radius = np.minimum(radius, 0.5 * droplets.distance)
    places = np.empty((droplets.number, 2))
    for k in range(droplets.number):
        # Even on the sphere: the cosine of the angle to the axis is even.
        angle = np.arccos(1.0 - rng.random(_TRIES) * (1.0 - np.cos(field)))
        turn = rng.uniform(0.0, 2.0 * np.pi, _TRIES)
        tries = np.column_stack([angle * np.cos(turn), angle * np.sin(turn)])
        gaps = np.linalg.norm(tries[:, None] - places[None, :k], axis=-1)
        gaps -= (radius[:k] + radius[k]) / droplets.distance
        places[k] = tries[gaps.min(axis=1, initial=np.inf).argmax()]
    turn = rng.uniform(0.0, 2.0 * np.pi)
    return radius, places, np.array([np.cos(turn), np.sin(turn)])


def _nearest_lit(lit: Bool[np.ndarray, "h w"]) -> Int[np.ndarray, "h w"]:
    from scipy.ndimage import distance_transform_edt

    found = distance_transform_edt(~lit, return_distances=False, return_indices=True)
    indices = np.asarray(found)
    return indices[0] * lit.shape[1] + indices[1]


def _disk(count: int) -> Float[np.ndarray, "k 2"]:
    """Points even over the unit disk (Vogel 1979)."""
    radius = np.sqrt((np.arange(count) + 0.5) / count)
    turn = np.arange(count) * np.pi * (3.0 - np.sqrt(5.0))
    return np.column_stack([radius * np.cos(turn), radius * np.sin(turn)])


def _flat(rays: Float[np.ndarray, "*n 3"]) -> Float[np.ndarray, "*n 2"]:
    """Directions as points of a plane whose distance from the middle is the angle to the axis."""
    across = np.hypot(rays[..., 0], rays[..., 1])
    factor = np.arctan2(across, rays[..., 2]) / np.maximum(across, 1e-12)
    return rays[..., :2] * factor[..., None]


def _round(places: Float[np.ndarray, "*n 2"]) -> Float[np.ndarray, "*n 3"]:
    """Back from the plane to unit directions."""
    angle = np.linalg.norm(places, axis=-1, keepdims=True)
    return np.concatenate([places * np.sinc(angle / np.pi), np.cos(angle)], axis=-1)


def _across(rays: Float[np.ndarray, "m 3"]) -> tuple[np.ndarray, np.ndarray]:
    """Unit vectors to the right of and below each ray."""
    x, z = rays[:, 0] + 1e-12, rays[:, 2]
    right = _unit(np.column_stack([z, np.zeros_like(x), -x]))
    return right, np.cross(rays, right)


def _unit(vectors: Float[np.ndarray, "*n 3"]) -> Float[np.ndarray, "*n 3"]:
    length = np.linalg.norm(vectors, axis=-1, keepdims=True)
    return vectors / np.maximum(length, 1e-15)
