"""Sequences resampled to a pinhole of a given field of view, with exact labels.

The camera pose is unchanged; only the lens differs. Each pixel of the pinhole therefore looks
along a ray that the old lens maps to a position in the old image, the same in every frame:

| channels | value of a new pixel |
|---|---|
| `rgb`, `radiance` | bilinear mean of the four pixels around that position, in linear light |
| `depth`, `ray_distance`, … | distance along the new ray, from the inverse distances around |
| `flow_forward`, `flow_backward` | nearest pixel's; both ends mapped to rays and to the pinhole |
| `occlusion` | nearest pixel's, or true where `flow_forward` leaves the new image |
| all others | nearest pixel's |

The inverse of the distance along a ray is linear in the ray for a flat wall, so interpolation
adds no perspective error. If four pixels do not see one surface, the nearest pixel's distance
is taken, so that no value lies between a fold and the wall behind it.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import lru_cache, partial
from math import atan, degrees, pi, radians, tan
from typing import TYPE_CHECKING, Any

import numpy as np

from vrcaps.camera.camera import Camera, camera_rays, in_image, pixel_grid, project_points
from vrcaps.camera.derive import focal_length_px
from vrcaps.camera.lens import LensPinhole
from vrcaps.core.color import linear_from_srgb, srgb_from_linear
from vrcaps.core.errors import InputError, require
from vrcaps.recording.frame_sequence import FrameSequence
from vrcaps.render.channels import CHANNELS

if TYPE_CHECKING:
    from collections.abc import Callable

    from jaxtyping import Bool, Float, Int
    from numpy.typing import NDArray

_MAX_SLOPE = tan(radians(85.0))
"""Tangent of the maximum angle to the wall's normal for pixels to count as one surface."""
_SNAP_PX = 1e-6
"""Positions this close to a pixel are snapped, so that a pinhole remains unchanged."""
_STEP = radians(0.1)


def rectified(
    sequence: FrameSequence, field_of_view: float, size: tuple[int, int] | None = None
) -> FrameSequence:
    """Return the frames as seen by a pinhole with the same pose.

    Example:
        >>> sequence = vrcaps.read_episode("runs/colon").sequence("front")
        >>> rectified(sequence, math.radians(90)).camera.lens

    Args:
        sequence: Frames of a camera with any lens. Its `episode` is kept, with the old lens.
        field_of_view: Angle from the left to the right edge of the new image [rad].
        size: Width and height of the new image [px]. By default the resolution at the center and
            the aspect ratio are kept. A coarser image is sampled, not averaged.

    Raises:
        InputError: If the lens is unknown, the field is too wide for it, or the image is too large.
    """
    return resampled(sequence, pinhole_camera(sequence, field_of_view, size))


def resampled(sequence: FrameSequence, camera: Camera) -> FrameSequence:
    """Return the frames as seen by another camera with the same pose.

    Args:
        sequence: Frames of a camera with a known lens.
        camera: New camera with the same viewing direction and a field of view below 180°.

    Returns:
        The same frames; without `occlusion` if `flow_forward` is unknown.

    Raises:
        InputError: If the lens of the sequence is unknown.
    """
    load = partial(_load, sequence.load, _require_camera(sequence), camera)
    # Without flow it is unknown what leaves the smaller view and is not seen next.
    lost = () if "flow_forward" in sequence.channels else ("occlusion",)
    channels = tuple(name for name in sequence.channels if name not in lost)
    return replace(sequence, channels=channels, load=load, camera=camera)


def pinhole_camera(
    sequence: FrameSequence, field_of_view: float, size: tuple[int, int] | None = None
) -> Camera:
    """Camera of `rectified`: square pixels, the optical axis in the center of the image.

    Raises:
        InputError: As `rectified`.
    """
    return pinhole_of(_require_camera(sequence), field_of_view, size, name=sequence.name)


def pinhole_of(
    camera: Camera,
    field_of_view: float,
    size: tuple[int, int] | None = None,
    *,
    name: str | None = None,
) -> Camera:
    """Pinhole with the pose of a camera, see `pinhole_camera`.

    Args:
        camera: Camera with any lens.
        field_of_view: Angle from the left to the right edge of the new image [rad].
        size: Width and height of the new image [px]; None keeps the resolution at the center.
        name: Name for messages; None is that of the camera.

    Raises:
        InputError: If the field is too wide for the lens, or the image is too large.
    """
    given = f"{degrees(field_of_view):g}"
    require(0.0 < field_of_view < pi, "Field of view", given, "above 0 to below 180 degrees")
    if size is None:
        width = max(1, round(2.0 * focal_length_px(camera.lens) * tan(field_of_view / 2.0)))
        size = (width, max(1, round(width * camera.height / camera.width)))
    focal = size[0] / 2.0 / tan(field_of_view / 2.0)
    lens = LensPinhole(fx=focal, fy=focal, cx=(size[0] - 1) / 2.0, cy=(size[1] - 1) / 2.0)
    outermost = atan((size[0] - 1) / 2.0 / focal)
    if not _sees(camera, np.array([-outermost, outermost])).all():
        raise InputError(
            f"{name or camera.name} sees {degrees(widest_field(camera)):.1f} degrees from left to "
            f"right. A field of view of {given} degrees does not fit; give that or less."
        )
    return replace(
        camera,
        lens=lens,
        width=size[0],
        height=size[1],
        image_circle_px=None,
        nominal_field=field_of_view,
    )


@dataclass(frozen=True)
class ResampledCamera:
    """Camera whose images are resampled to another one with the same pose.

    Attributes:
        source: The camera.
        target: The other one; the same if images are kept.
    """

    source: Camera
    target: Camera

    @property
    def is_resampled(self) -> bool:
        """True if images are not kept."""
        return self.target is not self.source

    @property
    def note(self) -> str:
        """Description of the resampling, in one line."""
        return (
            f"Images of {self.source.name}, with a {self.source.lens.kind} lens, are resampled to "
            f"a pinhole of {degrees(self.target.nominal_field or 0.0):.4g} degrees."
        )

    def image(self, image: NDArray, channel: str) -> NDArray:
        """Image of a channel as the target sees it, see `resampled`."""
        if not self.is_resampled:
            return image
        return _load(lambda channel, index: image, self.source, self.target, channel, 0)


def widest_field(camera: Camera) -> float:
    """Maximum field of view [rad] of a pinhole that the camera fills from left to right."""
    angles = np.arange(0.0, pi / 2.0, _STEP)
    blind = ~(_sees(camera, angles) & _sees(camera, -angles))
    return 2.0 * float(angles[max(0, np.argmax(blind) - 1)] if blind.any() else angles[-1])


def _sees(camera: Camera, angles: Float[np.ndarray, " n"]) -> Bool[np.ndarray, " n"]:
    """Return whether rays at these angles to the axis, to its right, reach the image."""
    rays = np.stack([np.sin(angles), np.zeros_like(angles), np.cos(angles)], axis=-1)
    return in_image(camera, _snapped(project_points(camera, rays)))


def _require_camera(sequence: FrameSequence) -> Camera:
    if sequence.camera is None:
        raise InputError(
            f"{sequence.name} has no camera, so its images cannot be resampled. "
            "Give its source a calibration."
        )
    return sequence.camera


def _snapped(pixels: NDArray) -> NDArray:
    whole = np.rint(pixels)
    return np.where(np.abs(pixels - whole) <= _SNAP_PX, whole, pixels)


@dataclass(frozen=True)
class _Map:
    """Map from the pixels of a new image to the old one.

    Attributes:
        seen: Whether the old image has a value there.
        nearest: Index of the nearest pixel in the old image; 0 where nothing is seen.
        corners: Indices of the four surrounding pixels.
        weights: Weights of the corners; 0 outside the old lens's field; they add up to 1.
        old_rays: Unit rays of the old pixels.
        new_rays: Unit rays of the new pixels.
        max_ratio: Maximum ratio of distances of neighboring pixels on one surface.
    """

    seen: Bool[np.ndarray, "h w"]
    nearest: Int[np.ndarray, "h w"]
    corners: Int[np.ndarray, "4 h w"]
    weights: Float[np.ndarray, "4 h w"]
    old_rays: Float[np.ndarray, "n 3"]
    new_rays: Float[np.ndarray, "h w 3"]
    max_ratio: float


@lru_cache(maxsize=4)
def _map(old: Camera, new: Camera) -> _Map:
    new_rays = new.lens.unproject(pixel_grid(new.width, new.height))
    old_rays = old.lens.unproject(pixel_grid(old.width, old.height)).reshape(-1, 3)
    lit = np.isfinite(camera_rays(old)[..., 0]).ravel()
    positions = _snapped(project_points(old, new_rays))
    inside = in_image(old, positions)
    positions = np.where(inside[..., None], positions, 0.0)
    nearest = _number(old, np.rint(positions))
    first = np.floor(np.clip(positions, 0.0, (old.width - 1, old.height - 1)))
    rest = np.clip(positions - first, 0.0, 1.0)
    steps = [np.array([right, down]) for down in (0, 1) for right in (0, 1)]
    corners = np.stack([_number(old, first + step) for step in steps])
    weights = [np.where(step, rest, 1.0 - rest).prod(axis=-1) for step in steps]
    weights = np.stack(weights).astype(np.float32) * lit[corners]
    seen = inside & lit[nearest] & np.isfinite(new_rays[..., 0])
    weights = weights / np.where(seen, weights.sum(axis=0), 1.0)
    max_ratio = 1.0 + np.sqrt(2.0) * _MAX_SLOPE / focal_length_px(old.lens)
    return _Map(seen, nearest, corners, weights, old_rays, new_rays, float(max_ratio))


def _number(camera: Camera, pixels: Float[np.ndarray, "*batch 2"]) -> Int[np.ndarray, "*batch"]:
    """Row-major indices of pixels (column, row); those beyond an edge are clamped to it."""
    at = np.clip(pixels, 0, (camera.width - 1, camera.height - 1)).astype(np.int32)
    return at[..., 1] * camera.width + at[..., 0]


def _load(
    load: Callable[[str, int], NDArray], old: Camera, new: Camera, channel: str, index: int
) -> NDArray:
    mapping, kind = _map(old, new), CHANNELS[channel]
    flat = _read(load, old, channel, index)
    if kind.is_light:
        return _light(flat, mapping)
    if kind.display == "flow":
        first, last = _ends(flat, mapping, old, new)
        motion = np.round(last - first, 9)  # so that rounding does not change a pinhole's own flow
        return np.where(mapping.seen[..., None], motion, np.nan).astype(np.float32)
    if kind.encoding == CHANNELS["depth"].encoding:
        return _distance(flat, mapping, is_z=channel != "ray_distance")
    values = flat[mapping.nearest]
    if channel == "occlusion":
        _, last = _ends(_read(load, old, "flow_forward", index), mapping, old, new)
        values |= ~in_image(new, last)
    empty = -1 if channel == "face" else np.nan if flat.dtype.kind == "f" else 0
    seen = mapping.seen.reshape(*mapping.seen.shape, *(1,) * (flat.ndim - 1))
    return np.where(seen, values, np.array(empty, flat.dtype))


def _read(
    load: Callable[[str, int], NDArray], camera: Camera, channel: str, index: int
) -> NDArray[Any]:
    """Read pixels [n] or [n c] of an image."""
    image = load(channel, index)
    if image.shape[:2] != (camera.height, camera.width):
        raise InputError(
            f"An image of {channel} is {image.shape[1]} x {image.shape[0]} pixels, its camera "
            f"{camera.width} x {camera.height}. Give the camera of these images."
        )
    return image.reshape(-1, *image.shape[2:])


def _light(flat: NDArray, mapping: _Map) -> NDArray:
    """Bilinear mean in linear light; black where nothing was seen."""
    is_srgb = flat.dtype == np.uint8
    linear = linear_from_srgb(flat) if is_srgb else flat
    mean = np.zeros((*mapping.seen.shape, flat.shape[-1]))
    for numbers, weights in zip(mapping.corners, mapping.weights, strict=True):
        mean += linear[numbers] * weights[..., None]
    mean = np.where(mapping.seen[..., None], mean, 0.0)
    return srgb_from_linear(mean) if is_srgb else mean.astype(flat.dtype)


def _distance(flat: NDArray, mapping: _Map, *, is_z: bool) -> NDArray:
    """Distance along the new pixel's ray, or its z, from the surrounding inverse distances."""
    distance = flat.astype(float)
    if is_z:
        z = mapping.old_rays[:, 2]
        distance = np.where(z > 0.0, distance, np.nan) / np.where(z > 0.0, z, 1.0)
    around = distance[mapping.corners]
    used = mapping.weights > 0.0
    nearest_distance = np.where(used, around, np.inf).min(axis=0)
    farthest_distance = np.where(used, around, -np.inf).max(axis=0)
    # False where a corner has no value.
    is_one_surface = mapping.seen & (farthest_distance <= mapping.max_ratio * nearest_distance)
    inverse = np.where(used, mapping.weights / np.where(used, around, 1.0), 0.0).sum(axis=0)
    mean = 1.0 / np.where(is_one_surface, inverse, 1.0)
    result = np.where(is_one_surface, mean, distance[mapping.nearest])
    result = np.where(mapping.seen, result, np.nan)
    return (result * mapping.new_rays[..., 2] if is_z else result).astype(np.float32)


def _ends(
    flow: NDArray, mapping: _Map, old: Camera, new: Camera
) -> tuple[Float[np.ndarray, "h w 2"], Float[np.ndarray, "h w 2"]]:
    """Image positions, now and then, of the point seen by the nearest old pixel of a new pixel.

    Both ends are mapped by the old lens to rays and from there to the new image. The point lies
    within half an old pixel of the new pixel's ray.
    """
    starts = pixel_grid(old.width, old.height).reshape(-1, 2)
    first, last = (
        new.lens.project(old.lens.unproject(each))[mapping.nearest]
        for each in (starts, starts + flow)
    )
    return first, last
