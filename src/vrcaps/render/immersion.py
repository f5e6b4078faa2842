"""Turbid fluid and the film on the dome, applied to the radiance that the wall sends to a camera.

The model is that of underwater images (Jaffe, IEEE J. Oceanic Eng. 15(2), 1990): light of the wall
that is not scattered, light that is scattered forward and blurs the image, and light of the LEDs
that the fluid scatters back. Depth, labels and flow are those of the wall or of what floats in
front of it; the fluid has no surface.
"""

from __future__ import annotations

import math
from functools import cache
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from vrcaps import _core
from vrcaps.camera.camera import camera_rays
from vrcaps.camera.derive import focal_length_px
from vrcaps.core.geometry import invert
from vrcaps.core.rng import stream
from vrcaps.lumen.contents import Film, Medium
from vrcaps.render.scattering import directions, h_function

if TYPE_CHECKING:
    from collections.abc import Callable

    from jaxtyping import Bool, Float, Int
    from numpy.typing import NDArray

    from vrcaps.camera.camera import Camera
    from vrcaps.capsule.device import Device
    from vrcaps.render.imaging import Imaging
    from vrcaps.world.model import Model, State


_NOISE_DEVIATION = 0.69
"""Standard deviation of the core's noise."""


class CameraView(NamedTuple):
    """Constants of a camera.

    Attributes:
        camera: The camera.
        rays: Directions of the pixels, NaN where it sees nothing.
        lit: Mask of the pixels that see anything.
        start: Distance at which each ray leaves the capsule [m].
        focal_px: Pixels per radian on the axis.
        relief: Thickness of the film over its mean by arc length; None without a film.
    """

    camera: Camera
    rays: Float[np.ndarray, "h w 3"]
    lit: Bool[np.ndarray, "h w"]
    start: Float[np.ndarray, "h w"]
    focal_px: float
    relief: Callable[[float], Float[np.ndarray, "h w"]] | None


class Amounts(NamedTuple):
    """Amounts at a position along the gut.

    Attributes:
        arc_length: Position of the capsule along the centerline [m].
        density: Density of the fluid relative to its median.
        depth: Mean number of scatterings in the film on the dome.
    """

    arc_length: float
    density: float
    depth: float


class Immersion:
    """Turbid fluid and film of a model, for its cameras."""

    def __init__(self, model: Model, imaging: Imaging) -> None:
        """Resolve the settings of the model's contents."""
        self._model, self._seed = model, model.contents.seed
        self._medium, self._film = model.contents.medium_and_film
        self._is_stained = self._medium is not None and any(self._medium.stain)
        if self._medium is not None:
            absorbed = imaging.absorption or (lambda coefficients: coefficients)
            self._absorption = absorbed(self._medium.absorption)
            self._stain = absorbed(self._medium.stain)
            self._channels = imaging.channels
        self._views: dict[int, CameraView] = {}
        self._noise = int(stream(self._seed, "lumen/medium/clouds").integers(2**32))

    def amounts(self, state: State) -> Amounts | None:
        """Amounts at the capsule's position in a state; None where the view is clear."""
        if self._medium is None and self._film is None:
            return None
        s = self._model.arc_length_at(state.T_world_capsule)
        density = 0.0 if self._medium is None else self._medium.density(s, self._seed)
        depth = 0.0 if self._film is None else self._film.depth(s, self._seed)
        is_seen = density > 0.0 or depth > 0.0 or self._is_stained
        return Amounts(s, density, depth) if is_seen else None

    def apply(
        self,
        amounts: Amounts,
        camera: Camera,
        T_world_camera: Float[np.ndarray, "4 4"],
        leds: Float[np.ndarray, "k 11"],
        planes: Float[np.ndarray, "3 h w"],
        distance: Float[np.ndarray, "h w"],
    ) -> None:
        """Change the radiance of a view in place.

        Args:
            amounts: Amounts at the capsule's place.
            camera: The camera.
            T_world_camera: Its pose.
            leds: Its LEDs, as the core takes them.
            planes: Radiance by color [W/(sr·m²)].
            distance: Distance of the surface along each ray [m], NaN where there is none.
        """
        view = self._view(camera)
        if self._medium is not None and (amounts.density > 0.0 or self._is_stained):
            pose = invert(self._model.T_world_patient) @ T_world_camera
            medium = self._core_medium(self._medium, amounts.density)
            veil, clear = _core.immerse(planes, view.rays, distance, view.start, pose, leds, medium)
            if amounts.density > 0.0:  # clear fluid only absorbs
                _scatter(planes, view, clear, self._medium.anisotropy)
                planes += veil
        if self._film is not None and view.relief is not None and amounts.depth > 0.0:
            scattered = amounts.depth * view.relief(amounts.arc_length)
            count = max(amounts.depth / -math.expm1(-amounts.depth), 1.0)
            sigma = self._film.angle * math.sqrt(count) * view.focal_px
            fraction = -np.expm1(-scattered, dtype=np.float32)
            _core.scatter_forward(planes, view.lit, fraction, min(sigma, 0.25 * camera.width))

    def _core_medium(self, medium: Medium, density: float) -> dict[str, object]:
        scattering = [density * medium.scattering[k] for k in self._channels]
        absorption = [density * x for x in self._absorption]
        transport = [(1.0 - medium.anisotropy) * x for x in scattering]
        absorbed = np.add(absorption, self._stain).tolist()
        albedos = [
            s / (s + a) if s > 0.0 else 0.0 for s, a in zip(transport, absorbed, strict=True)
        ]
        return {
            "absorption": absorption,
            "stain": self._stain,
            "scattering": scattering,
            "anisotropy": medium.anisotropy,
            "orders": [order_ratio(round(albedo, 4)) for albedo in albedos],
            "clouds": ((density > 0.0) * medium.cloud_spread / _NOISE_DEVIATION, medium.cloud_size),
            "flocs": (min(density, 1.0) * medium.floc_extinction, medium.floc_size),
            "floc_color": medium.floc_color,
            "seed": self._noise,
        }

    def _view(self, camera: Camera) -> CameraView:
        key = id(camera)
        if key not in self._views:
            rays = np.ascontiguousarray(camera_rays(camera), np.float32)
            device = self._model.device
            start = shell_distance(device, camera.T_capsule_camera, rays)
            names = [each.name for each in device.cameras]
            index = names.index(camera.name) if camera.name in names else 0
            relief = None
            if self._film is not None:
                relief = film_relief(self._film, _angles(rays), self._seed, index)
            lit = np.asarray(np.isfinite(rays).all(axis=-1))
            focal = focal_length_px(camera.lens)
            self._views[key] = CameraView(camera, rays, lit, start, focal, relief)
        return self._views[key]


def _scatter(
    planes: Float[np.ndarray, "3 h w"],
    view: CameraView,
    clear: NDArray[np.float32],
    anisotropy: float,
) -> None:
    """Blur light of the wall that turbid fluid scatters forward, in place.

    Multiple small-angle scattering along the path (Wells, J. Opt. Soc. Am. 59(6), 1969): each
    deflection acts on the rest of the path, hence the third of its variance.

    Args:
        planes: Radiance by color [W/(sr·m²)].
        view: Constants of the camera.
        clear: Fraction of the light that is not scattered [h w].
        anisotropy: Mean cosine of the scattering angle.
    """
    mean = float(-np.log(np.maximum(clear[view.lit], 1e-6)).mean())
    count = max(mean / -math.expm1(-mean), 1.0) if mean > 0.0 else 1.0
    angle = math.sqrt((1.0 - anisotropy) * count / 3.0)
    sigma = min(angle * view.focal_px, 0.25 * view.camera.width)
    _core.scatter_forward(planes, view.lit, 1.0 - clear, sigma)


@cache
def order_ratio(albedo: float) -> float:
    """Ratio of successive orders of scattering for a single-scattering albedo.

    Light of a beam along the normal that a half-space sends back along it is H(1)² times that of
    the first order (Chandrasekhar, *Radiative Transfer*, 1960, section 38), the sum 1/(1 − q) of a
    geometric series.

    Args:
        albedo: Fraction of extinction that is scattering, 0 to 1.
    """
    cosine, weight = directions(1.0)
    known = np.array([min(albedo, 0.9995)])
    h = h_function(known, cosine, weight)[0]
    kernel = weight * cosine / (1.0 + cosine)
    at_one = 1.0 / (np.sqrt(1.0 - known[0]) + 0.5 * known[0] * (h @ kernel))
    return float(1.0 - 1.0 / at_one**2)


def shell_distance(
    device: Device, T_capsule_camera: Float[np.ndarray, "4 4"], rays: Float[np.ndarray, "h w 3"]
) -> Float[np.ndarray, "h w"]:
    """Distance at which rays of a camera leave the capsule's body [m], as float32.

    Args:
        device: The capsule, a cylinder with round ends.
        T_capsule_camera: Pose of the camera.
        rays: Directions of the pixels; NaN gives 0.
    """
    eye, half = T_capsule_camera[:3, 3], 0.5 * device.length - device.radius
    d = np.nan_to_num(rays.astype(float)) @ T_capsule_camera[:3, :3].T
    a, b = (d[..., :2] ** 2).sum(-1), d[..., :2] @ eye[:2]
    c = eye[:2] @ eye[:2] - device.radius**2
    side = (-b + np.sqrt(np.maximum(b * b - a * c, 0.0))) / np.maximum(a, 1e-12)
    is_side = np.abs(eye[2] + side * d[..., 2]) <= half
    ends = []
    for end in (-half, half):
        offset = eye - (0.0, 0.0, end)
        b, c = d @ offset, offset @ offset - device.radius**2
        ends.append(-b + np.sqrt(np.maximum(b * b - c, 0.0)))
    front = np.where(d[..., 2] > 0.0, ends[1], ends[0])
    return np.where(is_side & (a > 1e-12), side, front).clip(0.0).astype(np.float32)


def _angles(rays: Float[np.ndarray, "h w 3"]) -> Float[np.ndarray, "h w 2"]:
    """Azimuthal equidistant projection of rays [rad]."""
    lateral = np.hypot(rays[..., 0], rays[..., 1])
    factor = np.arctan2(lateral, rays[..., 2]) / np.maximum(lateral, 1e-12)
    return rays[..., :2] * factor[..., None]


_WAVES = 32
_COARSE = 4
"""Pixels between those where the thickness of a film is computed."""


def film_relief(
    film: Film, points: Float[np.ndarray, "h w 2"], seed: int, index: int
) -> Callable[[float], Float[np.ndarray, "h w"]]:
    """Thickness over the dome relative to its mean, as a function of the arc length [m].

    A sum of waves of random direction whose phases advance with the travel of the capsule.

    Args:
        film: The film.
        points: Angles of each pixel's ray from the camera's axis, to the right and down [rad].
        seed: Seed of the contents.
        index: Index of the camera.
    """
    rng = stream(seed, "lumen/film/relief", index)
    waves = rng.standard_normal((_WAVES, 2)) / film.width
    phases = rng.uniform(0.0, 2.0 * np.pi, _WAVES)
    rates = rng.standard_normal(_WAVES) * (np.pi / film.patch_length)
    height, width = points.shape[:2]
    down, right = _upsampling(height), _upsampling(width)
    coarse = points[::_COARSE, ::_COARSE]
    angles = np.einsum("kc,yxc->kyx", waves, np.nan_to_num(coarse))
    basis = np.concatenate([np.cos(angles), -np.sin(angles)]).astype(np.float32)
    scale = film.relief * math.sqrt(2.0 / _WAVES)

    def at(arc_length: float) -> Float[np.ndarray, "h w"]:
        turned = phases + rates * arc_length
        factors = np.concatenate([np.cos(turned), np.sin(turned)]).astype(np.float32)
        # Without BLAS, whose idle threads would take time from the renderer.
        relief = np.maximum(1.0 + scale * np.einsum("k,kyx->yx", factors, basis), 0.0)
        first, second, t = down
        relief = relief[first] + t[:, None] * (relief[second] - relief[first])
        first, second, t = right
        before, after = relief.take(first, axis=1), relief.take(second, axis=1)
        return before + t * (after - before)

    return at


def _upsampling(
    count: int,
) -> tuple[Int[np.ndarray, " n"], Int[np.ndarray, " n"], Float[np.ndarray, " n"]]:
    """Indices and weights of linear interpolation from every few pixels to all.

    Returns:
        Indices of the sample before and after each pixel, and the weight of the latter; the last
        sample is repeated.
    """
    place = np.arange(count) / _COARSE
    last = (count - 1) // _COARSE
    first = np.minimum(place.astype(int), last)
    return first, np.minimum(first + 1, last), (place - first).astype(np.float32)
