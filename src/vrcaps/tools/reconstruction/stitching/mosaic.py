"""Mosaic of images and their depth, in a wider camera at the pose of one of them.

Homographies to that image are chained over the best pairs, then adjusted jointly: Brown and Lowe,
IJCV 74(1), 2007, sections 3 and 4, with homographies in place of rotations, since a capsule also
translates. Each image contributes where it is nearest to its own center. Images are blended in
bands, low frequencies over wide seams and high ones over narrow (Burt and Adelson, ACM TOG 2(4),
1983).

Depth is exact if the camera only rotated, or the wall is flat: a point at depth z on the ray
r = (x, y, 1) of one camera has depth z (H r)₃ in the other, where the homography H between rays is
scaled so that its middle singular value is 1 (Ma et al., An Invitation to 3-D Vision, 2004, lemma
5.18).
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from vrcaps.camera.camera import Camera
from vrcaps.camera.lens import LensPinhole
from vrcaps.camera.lens.exchange import as_pinhole
from vrcaps.core.errors import InputError
from vrcaps.tools.reconstruction.matching import Pair, chained, opencv

if TYPE_CHECKING:
    from jaxtyping import Bool, Float, Float32, UInt8

_POINTS = 40
"""Maximum number of matches of a pair in the adjustment."""
_ROUGH_PX = 1.0
"""Distance above which the loss of a match is less than quadratic."""
_EVALUATIONS = 30


def chained_homographies(
    count: int, images: Sequence[int], pairs: Sequence[Pair]
) -> tuple[int, dict[int, Float[np.ndarray, "3 3"]]]:
    """Reference image, and the homography of each image to it along the pairs of most inliers.

    Args:
        count: Number of images.
        images: Images of one component.
        pairs: Pairs of overlapping images.
    """
    reference, chain = chained(count, images, pairs, lambda pair: pair.homography)
    return reference, {image: _normalized(matrix) for image, matrix in chain.items()}


def adjusted(
    homographies: dict[int, Float[np.ndarray, "3 3"]],
    pairs: Sequence[Pair],
    reference: int,
    size: tuple[int, int],
) -> dict[int, Float[np.ndarray, "3 3"]]:
    """Adjust the homographies to the reference jointly to the matches of all pairs.

    Minimizes the Huber norm of the distances [px], in the second image of a pair, between its
    matches and the mapped ones of the first image (bundle adjustment; Brown 2007, eq. 15).

    Args:
        homographies: Homography of each image, near the solution.
        pairs: Matches.
        reference: The image that is kept fixed.
        size: Width and height of the images [px].
    """
    from scipy.optimize import least_squares

    free = [image for image in homographies if image != reference]
    used = [p for p in pairs if p.first in homographies and p.second in homographies]
    if not free or not used:
        return dict(homographies)
    # Centered and in units of half a width, so that all eight parameters are of one size.
    half, (x, y) = size[0] / 2.0, ((size[0] - 1) / 2.0, (size[1] - 1) / 2.0)
    to_pixel = np.array([[half, 0.0, x], [0.0, half, y], [0.0, 0.0, 1.0]])
    to_unit = np.linalg.inv(to_pixel)
    problem = _Matches(used, free, reference, to_unit)
    start = [_normalized(to_unit @ homographies[k] @ to_pixel).ravel()[:8] for k in free]
    solved = least_squares(
        lambda x: half * problem.residuals(x),
        np.concatenate(start),
        jac_sparsity=problem.sparsity(),
        loss="huber",
        f_scale=_ROUGH_PX,
        max_nfev=_EVALUATIONS,
        x_scale="jac",
    )
    refined = dict(homographies)
    for image, matrix in zip(free, problem.matrices(solved.x), strict=False):
        refined[image] = _normalized(to_pixel @ matrix @ to_unit)
    return refined


class _Matches:
    """Matches of all pairs, as one least squares problem in units of half a width."""

    def __init__(self, pairs: Sequence[Pair], free: Sequence[int], reference: int, to_unit) -> None:
        indices = {image: k for k, image in enumerate([*free, reference])}
        chosen = [
            np.unique(np.linspace(0, len(p.points_first) - 1, _POINTS).astype(int)) for p in pairs
        ]
        self.pair = np.repeat(np.arange(len(pairs)), [len(c) for c in chosen])
        self.first = np.array([indices[p.first] for p in pairs])
        self.second = np.array([indices[p.second] for p in pairs])
        one, other = (
            np.concatenate([points[c] for points, c in zip(sides, chosen, strict=True)])
            for sides in ([p.points_first for p in pairs], [p.points_second for p in pairs])
        )
        self.one, self.other = (mapped(to_unit, points) for points in (one, other))
        self.num_free = len(free)

    def matrices(self, x: np.ndarray) -> np.ndarray:
        """Homographies of the free images, and of the reference."""
        rows = np.concatenate([x.reshape(-1, 8), np.ones((self.num_free, 1))], axis=1)
        return np.concatenate([rows.reshape(-1, 3, 3), np.eye(3)[None]])

    def residuals(self, x: np.ndarray) -> np.ndarray:
        """Differences between matches and mapped points."""
        matrices = self.matrices(x)
        across = np.linalg.inv(matrices)[self.second] @ matrices[self.first]
        rows = np.concatenate([self.one, np.ones((len(self.one), 1))], axis=1)
        there = np.einsum("nij,nj->ni", across[self.pair], rows)
        return (there[:, :2] / there[:, 2:] - self.other).ravel()

    def sparsity(self) -> Any:
        """Sparsity of the Jacobian."""
        from scipy.sparse import coo_array

        rows, columns = [], []
        for images in (self.first[self.pair], self.second[self.pair]):
            counts = np.flatnonzero(images < self.num_free)
            row = (2 * counts[:, None] + np.arange(2)).ravel()
            rows.append(np.repeat(row, 8))
            columns.append((8 * np.repeat(images[counts], 2)[:, None] + np.arange(8)).ravel())
        at = (np.concatenate(rows), np.concatenate(columns))
        shape = (2 * len(self.pair), 8 * self.num_free)
        return coo_array((np.ones(len(at[0])), at), shape=shape).tocsr()


def mapped(
    homography: Float[np.ndarray, "3 3"], points: Float[np.ndarray, "n 2"]
) -> Float[np.ndarray, "n 2"]:
    """Map points by a homography."""
    rows = np.concatenate([points, np.ones((len(points), 1))], axis=1) @ homography.T
    return rows[:, :2] / rows[:, 2:]


def _normalized(homography: np.ndarray) -> np.ndarray:
    return homography / homography[2, 2]


_MAX_TANGENT = 2.5
"""Maximum tangent to the axis in a mosaic: 68°; beyond, a plane stretches too far."""
_MAX_SCALE = 3.0
"""Scale factor above which an image is excluded."""
_WIDEST_SEAM = 1 / 16
"""Width of the seams of the lowest band, relative to the shorter side; each band halves it."""
_GRID = 9
"""Points along a side of an image at which its homography is evaluated."""


@dataclass(frozen=True)
class Mosaic:
    """Wide image composed of many.

    Attributes:
        rgb: Colors; black where no image covers it.
        depth: Depth z [m]; NaN where it is unknown.
        camera: Pinhole camera of the mosaic, at the pose of the reference.
        reference: Index of the reference image.
        images: Indices of the images used.
    """

    rgb: UInt8[np.ndarray, "h w 3"]
    depth: Float32[np.ndarray, "h w"]
    camera: Camera
    reference: int
    images: tuple[int, ...]


def usable(
    homographies: Mapping[int, Float[np.ndarray, "3 3"]], camera: Camera
) -> dict[int, Float[np.ndarray, "3 3"]]:
    """Select the homographies of images in front of the reference and of similar scale.

    Args:
        homographies: Map pixels of each image to pixels of the reference.
        camera: Camera of the images.
    """
    return {k: H for k, H in homographies.items() if _is_sane(H, camera)}


def _is_sane(homography: np.ndarray, camera: Camera) -> bool:
    columns, rows = (np.linspace(0.0, size - 1.0, _GRID) for size in (camera.width, camera.height))
    points = np.stack(np.meshgrid(columns, rows), axis=-1).reshape(-1, 2)
    ahead = np.concatenate([points, np.ones((len(points), 1))], axis=1) @ homography[2]
    # The local scale of areas, det H / (h₃ · p)³.
    area = np.linalg.det(homography) / ahead**3
    middle = area[len(area) // 2]
    return bool((ahead > 0.0).all() and _MAX_SCALE**-2 < middle < _MAX_SCALE**2)


def mosaic_camera(
    homographies: Sequence[Float[np.ndarray, "3 3"]], camera: Camera
) -> tuple[Camera, tuple[int, int]]:
    """Camera that covers all images, and the column and row of the reference's corner in it.

    Args:
        homographies: Map pixels of each image to pixels of the reference.
        camera: Pinhole camera of the images.
    """
    lens = pinhole_of(camera)
    corners = np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]])
    corners *= (camera.width - 1, camera.height - 1)
    points = np.concatenate([mapped(H, corners) for H in homographies])
    center, focal = np.array([lens.cx, lens.cy]), np.array([lens.fx, lens.fy])
    low = np.floor(np.maximum(points.min(axis=0), center - _MAX_TANGENT * focal)).astype(int)
    high = np.ceil(np.minimum(points.max(axis=0), center + _MAX_TANGENT * focal)).astype(int)
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
    """Blend images into a mosaic.

    Args:
        homographies: Map pixels of each image to pixels of the reference.
        camera: Pinhole camera of the images.
        image_of: Reads an image.
        depth_of: Reads its depth z [m]; None if there is none.
        reference: Index of the reference.
        is_seen: Valid pixels of each image; None means all.

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
    """Mosaic pixels mapped to each image, and weights from 1 at its center to 0 at its edges."""
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
    """Ratio of depth in the reference's camera to depth in the image's, at pixels of the image."""
    lens = pinhole_of(camera)
    matrix = np.array([[lens.fx, 0.0, lens.cx], [0.0, lens.fy, lens.cy], [0.0, 0.0, 1.0]])
    rays = np.linalg.inv(matrix)
    between = rays @ homography @ matrix
    third = (between / np.linalg.svd(between, compute_uv=False)[1])[2] @ rays
    factor = third[0] * at[0] + third[1] * at[1] + third[2]
    return np.maximum(factor, 1e-6).astype(np.float32)


def pinhole_of(camera: Camera) -> LensPinhole:
    """Return the camera's pinhole lens.

    Raises:
        InputError: If its lens is not a pinhole.
    """
    lens = as_pinhole(camera.lens)
    if lens is None:
        raise InputError(f"Camera {camera.name!r} is not a pinhole. Give rectified images.")
    return lens
