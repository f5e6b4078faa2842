"""Many images, and their depth, as one of a wider camera that stands where one of them was taken.

Images are joined where each is nearest to its own middle and blended in bands, low frequencies over
wide seams and high ones over narrow (Burt and Adelson, ACM TOG 2(4), 1983).

Depth follows exactly if the camera only turned, or the wall is flat: a point at depth z on the ray
r = (x, y, 1) of one camera has depth z (H r)₃ in the other, where the homography H between rays is
scaled so that its middle singular value is 1 (Ma et al., An Invitation to 3-D Vision, 2004, lemma
5.18).
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from vrcaps.camera.camera import Camera
from vrcaps.camera.lens import LensPinhole
from vrcaps.errors import InputError
from vrcaps.tools.reconstruction.bundle import mapped
from vrcaps.tools.reconstruction.opencv import opencv

if TYPE_CHECKING:
    from jaxtyping import Bool, Float, Float32, UInt8

_WIDEST = 2.5
"""Largest tangent to the axis that a mosaic shows: 68°; beyond, a plane stretches too far."""
_MOST_SCALE = 3.0
"""Factor in size beyond which an image is left out."""
_WIDEST_SEAM = 1 / 16
"""Width of the seams of the lowest band, of an image's shorter side; each band halves it."""
_GRID = 9
"""Points along a side of an image at which its homography is looked at."""


@dataclass(frozen=True)
class Mosaic:
    """A wide image made of many.

    Attributes:
        rgb: Colors; black where no image sees.
        depth: Depth z [m]; NaN where it is not known.
        camera: Pinhole that sees it, at the pose of the reference.
        reference: Number of the image that it is aligned to.
        images: Numbers of the images that it is made of.
    """

    rgb: UInt8[np.ndarray, "h w 3"]
    depth: Float32[np.ndarray, "h w"]
    camera: Camera
    reference: int
    images: tuple[int, ...]


def usable(
    homographies: Mapping[int, Float[np.ndarray, "3 3"]], camera: Camera
) -> dict[int, Float[np.ndarray, "3 3"]]:
    """The homographies of images that lie before the reference and keep about their size there.

    Args:
        homographies: From pixels of each image to pixels of the reference.
        camera: That took the images.
    """
    return {k: H for k, H in homographies.items() if _is_sane(H, camera)}


def _is_sane(homography: np.ndarray, camera: Camera) -> bool:
    columns, rows = (np.linspace(0.0, size - 1.0, _GRID) for size in (camera.width, camera.height))
    points = np.stack(np.meshgrid(columns, rows), axis=-1).reshape(-1, 2)
    ahead = np.concatenate([points, np.ones((len(points), 1))], axis=1) @ homography[2]
    # The area of a pixel there, det H / (h₃ · p)³.
    area = np.linalg.det(homography) / ahead**3
    middle = area[len(area) // 2]
    return bool((ahead > 0.0).all() and _MOST_SCALE**-2 < middle < _MOST_SCALE**2)


def mosaic_camera(
    homographies: Sequence[Float[np.ndarray, "3 3"]], camera: Camera
) -> tuple[Camera, tuple[int, int]]:
    """The camera that sees all images, and the column and row of the reference's corner in it.

    Args:
        homographies: From pixels of each image to pixels of the reference.
        camera: Pinhole that took the images.
    """
    lens = pinhole_of(camera)
    corners = np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]])
    corners *= (camera.width - 1, camera.height - 1)
    found = np.concatenate([mapped(H, corners) for H in homographies])
    center, focal = np.array([lens.cx, lens.cy]), np.array([lens.fx, lens.fy])
    low = np.floor(np.maximum(found.min(axis=0), center - _WIDEST * focal)).astype(int)
    high = np.ceil(np.minimum(found.max(axis=0), center + _WIDEST * focal)).astype(int)
    left, top = (-low).tolist()
    width, height = (high - low + 1).tolist()
    moved = replace(lens, cx=lens.cx + left, cy=lens.cy + top)
    return replace(camera, lens=moved, width=width, height=height), (left, top)


def blended(
    homographies: Mapping[int, Float[np.ndarray, "3 3"]],
    camera: Camera,
    image_of: Callable[[int], UInt8[np.ndarray, "h w 3"]],
    depth_of: Callable[[int], Float[np.ndarray, "h w"]] | None,
    reference: int,
    is_seen: Bool[np.ndarray, "h w"] | None = None,
) -> Mosaic:
    """The mosaic of images.

    Args:
        homographies: From pixels of each image to pixels of the reference.
        camera: Pinhole that took the images.
        image_of: Reads an image.
        depth_of: Reads its depth z [m]; None if there is none.
        reference: Number of the reference.
        is_seen: Pixels of each image that count; None takes all.

    Raises:
        MissingExtraError: If OpenCV is not installed.
    """
    cv2 = opencv()
    wide, corner = mosaic_camera(list(homographies.values()), camera)
    nearest = np.full((wide.height, wide.width), -1)
    middle = np.zeros((wide.height, wide.width), np.float32)
    total, weights = np.zeros_like(middle), np.zeros_like(middle)
    seen = np.ones((camera.height, camera.width)) if is_seen is None else is_seen
    for image, at, weight in _views(homographies, wide, corner, camera):
        weight *= cv2.remap(seen.astype(np.float32), *at, cv2.INTER_NEAREST)  # noqa: PLW2901
        is_nearer = weight > middle
        nearest[is_nearer], middle[is_nearer] = image, weight[is_nearer]
        if depth_of is not None:
            factor = _depth_factor(homographies[image], camera, at)
            depth = cv2.remap(depth_of(image).astype(np.float32), *at, cv2.INTER_NEAREST)
            known = np.isfinite(depth) & (weight > 0.0)
            total[known] += weight[known] * np.log(depth[known] * factor[known])
            weights[known] += weight[known]
    bands = max(1, int(np.log2(_WIDEST_SEAM * min(camera.width, camera.height))))
    blender = cv2.detail.MultiBandBlender(0, bands)
    blender.prepare((0, 0, wide.width, wide.height))
    for image, at, _ in _views(homographies, wide, corner, camera):
        warped = cv2.remap(image_of(image), *at, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
        mask = np.where(nearest == image, 255, 0).astype(np.uint8)
        blender.feed(warped.astype(np.int16), mask, (0, 0))
    rgb = np.clip(blender.blend(None, None)[0], 0, 255).astype(np.uint8)
    rgb[nearest < 0] = 0
    is_known = weights > 0.0
    depth = np.where(is_known, np.exp(total / np.where(is_known, weights, 1.0)), np.nan)
    return Mosaic(rgb, depth.astype(np.float32), wide, reference, tuple(homographies))


def _views(
    homographies: Mapping[int, np.ndarray], wide: Camera, corner: tuple[int, int], camera: Camera
) -> Iterator[tuple[int, tuple[np.ndarray, np.ndarray], np.ndarray]]:
    """For each image: where the mosaic's pixels lie in it, and 1 in its middle, 0 at its edges."""
    axes = (np.arange(n) - k for n, k in zip((wide.width, wide.height), corner, strict=True))
    columns, rows = np.meshgrid(*axes)
    points = np.stack([columns, rows, np.ones_like(rows)], axis=-1).astype(np.float32)
    for image, homography in homographies.items():
        back = np.linalg.inv(homography)
        there = points @ back.T.astype(np.float32)
        ahead = there[..., 2] > 1e-6
        scale = np.where(ahead, there[..., 2], 1.0)
        at = np.where(ahead[..., None], there[..., :2] / scale[..., None], -10.0)
        across = 1.0 - np.abs(2.0 * (at + 0.5) / (camera.width, camera.height) - 1.0)
        weight = np.clip(across, 0.0, 1.0).prod(axis=-1)
        column, row = (np.ascontiguousarray(at[..., k], np.float32) for k in (0, 1))
        yield image, (column, row), np.where(ahead, weight, 0.0).astype(np.float32)


def _depth_factor(
    homography: np.ndarray, camera: Camera, at: tuple[np.ndarray, np.ndarray]
) -> np.ndarray:
    """Depth in the reference's camera over depth in the image's, at pixels of the image."""
    lens = pinhole_of(camera)
    matrix = np.array([[lens.fx, 0.0, lens.cx], [0.0, lens.fy, lens.cy], [0.0, 0.0, 1.0]])
    rays = np.linalg.inv(matrix)
    between = rays @ homography @ matrix
    third = (between / np.linalg.svd(between, compute_uv=False)[1])[2] @ rays
    factor = third[0] * at[0] + third[1] * at[1] + third[2]
    return np.maximum(factor, 1e-6).astype(np.float32)


def pinhole_of(camera: Camera) -> LensPinhole:
    """The camera's lens, a pinhole.

    Raises:
        InputError: If it is none.
    """
    if not isinstance(camera.lens, LensPinhole):
        raise InputError(f"Camera {camera.name!r} is no pinhole. Give rectified images.")
    return camera.lens
