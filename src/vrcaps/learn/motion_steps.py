"""Motion between consecutive frames: from the motion network, and by direct alignment of images.

The motion minimizes the differences of brightness between a frame and its neighbor, sampled where
the known distances and the motion lead to, by Gauss–Newton iterations from coarse to fine images
(Kerl et al., ICRA 2013; inverse variances by Cauchy). Brightness is relative to its surroundings,
in mean and standard deviation, because the LEDs move with the camera. Any lens is supported: its
unit rays are inverted by Newton iterations.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, TypeAlias, cast

import numpy as np
import torch
from torch import Tensor
from torch.nn import functional

from vrcaps.learn.losses import pose_matrix
from vrcaps.learn.motion_network import MotionNetwork
from vrcaps.learn.motion_solver import (
    at_positions,
    mean_log,
    motion_from_flow,
    mutual_motion,
    positions,
    sampled,
    scaled,
)
from vrcaps.learn.picture_border import bright_part
from vrcaps.learn.tasks.depth import MIDDLE
from vrcaps.recording.frame_sequence import FrameSequence

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from vrcaps.camera.camera import Camera


_COARSE, _FINE = (8, 4), (2,)
"""Pixels of the network's image per pixel of each resolution: of those on which the starts are
compared, and of the others."""
_ITERATIONS = 8
_NEWTON = 2
"""Iterations of the motion per resolution, and of the pixel of a ray per iteration."""
_GRAY = (0.25, 0.5, 0.25)
"""Weights of the colors; vessels are darkest in green."""
_WINDOW = 5
"""Side of the surroundings of a pixel, in pixels of the resolution."""
_CONTRAST = 0.02
"""Standard deviation of brightness that counts as noise."""
_CAUCHY = 0.7
"""Residual whose weight is halved, in root mean squares of the weighted residuals."""
_MAX_STEP = 0.1
"""Maximum length of a step, of the rotation [rad] and the translation relative to the distance."""
_DAMPING = 1e-3
"""Weight of no further step, relative to the mean of the diagonal."""


@dataclass(frozen=True)
class LensMaps:
    """Rays of a lens and their derivatives.

    Attributes:
        ray: Unit rays [b 3 s s], zero where the lens has none.
        columns: Change of the ray by a column [b 3 s s].
        rows: Change of the ray by a row [b 3 s s].
        known: Whether a pixel and its neighbors have rays [b 1 s s], 0 or 1.
    """

    ray: Tensor
    columns: Tensor
    rows: Tensor
    known: Tensor


def lens_maps(ray: Tensor) -> LensMaps:
    """Derivatives of rays [b 3 s s]."""
    has_ray = ray.any(dim=1, keepdim=True).float()
    known = -functional.max_pool2d(-functional.pad(has_ray, 4 * [1]), 3, stride=1)
    return LensMaps(ray, *_gradients(ray), known)


def aligned(
    image: Tensor, other: Tensor, ray: Tensor, log_distance: Tensor, starts: Sequence[Tensor] = ()
) -> Tensor:
    """Motion of frames in others [b 6]: a rotation vector [rad] and a translation.

    Args:
        image: Colors [b 3 s s], 0 to 1.
        other: Colors of the neighbors.
        ray: Unit rays [b 3 s s], zero where the lens has none.
        log_distance: ln of the distances along the rays [b 1 s s], in units of the translation.
        starts: Initial motions [b 6] besides zero motion; the result has the smallest cost.
    """
    lens = lens_maps(ray)
    middle = mean_log(log_distance, lens.known > 0.0)
    log = log_distance - middle[:, None, None, None]
    scale = torch.exp(middle)[:, None]
    color = image.new_tensor(_GRAY).view(1, 3, 1, 1)
    grays = [(one * color).sum(dim=1, keepdim=True) for one in (image, other)]
    none = torch.zeros(len(ray), 6, dtype=ray.dtype, device=ray.device)
    results = []
    for start in (none, *starts):
        T, cost = pose_matrix(torch.cat([start[:, :3], start[:, 3:] / scale], dim=1)), none[:, 0]
        for stride in _COARSE:
            T, cost = _aligned_at(stride, grays, lens, log, T)
        results.append((T, cost))
    Ts, costs = (torch.stack(one) for one in zip(*results, strict=True))
    T = Ts[costs.argmin(dim=0), torch.arange(len(ray))]
    for stride in _FINE:
        T, _ = _aligned_at(stride, grays, lens, log, T)
    return motion_of(T) * torch.cat([torch.ones_like(scale).expand(-1, 3), scale.expand(-1, 3)], 1)


def motion_of(T: Tensor) -> Tensor:
    """Rotation vectors [rad] and translations [b 6] of poses [b 4 4]; inverse of `pose_matrix`."""
    return torch.cat([_rotation_vector(T[:, :3, :3]), T[:, :3, 3]], dim=1)


def relative_brightness(gray: Tensor, known: Tensor) -> Tensor:
    """Brightness relative to mean and standard deviation of the surroundings [b 1 h w]."""
    share = _mean(known).clamp(min=1e-3)
    centered = (gray - _mean(gray * known) / share) * known
    return centered / ((_mean(centered**2) / share).sqrt() + _CONTRAST)


def _aligned_at(
    stride: int, grays: list[Tensor], lens: LensMaps, log: Tensor, T: Tensor
) -> tuple[Tensor, Tensor]:
    """Motion of the smallest cost of the iterations at one resolution [b 4 4], and its cost [b]."""
    size = lens.ray.shape[-1]
    own = at_positions(lens.ray, stride)
    known = (functional.avg_pool2d(lens.known, stride) > 0.99).float()
    points = torch.exp(functional.avg_pool2d(log, stride)) * own
    small = [functional.avg_pool2d(one, stride) for one in grays]
    first, second = (relative_brightness(one, known) for one in small)
    inner = -functional.max_pool2d(-known, 3, stride=1, padding=1)
    slopes = torch.cat(_gradients(first), dim=1) / stride
    maps = torch.cat([second, *(one / stride for one in _gradients(second)), inner], dim=1)
    pixels = positions(size, stride, own.device).expand(len(own), -1, -1, -1)
    pixels = _pixels_of(_moved(points, T), lens, pixels, 4)
    best, least = T, torch.full_like(T[:, 0, 0], torch.inf)
    for _ in range(_ITERATIONS):
        moved = _moved(points, T)
        pixels = _pixels_of(moved, lens, pixels, _NEWTON)
        there = sampled(maps, scaled(pixels, size))
        difference = there[:, :1] - first
        is_seen = inner * (there[:, 3:] > 0.99)
        cost = _cost(difference, is_seen, inner)
        is_better = cost < least
        best, least = torch.where(is_better[:, None, None], T, best), cost.minimum(least)
        slope = 0.5 * (slopes + there[:, 1:3])
        T = pose_matrix(_step(moved, slope, difference, is_seen, pixels, lens)) @ T
    return best, least


def _cost(difference: Tensor, is_seen: Tensor, inner: Tensor) -> Tensor:
    """Mean of r² / (1 + r²) over the inner pixels [b]; pixels out of view count as 1/2."""
    square = difference**2
    each = torch.where(is_seen > 0.0, square / (1.0 + square), 0.5) * inner
    return each.sum(dim=(1, 2, 3)) / inner.sum(dim=(1, 2, 3)).clamp(min=1.0)


def _step(
    moved: Tensor, slope: Tensor, difference: Tensor, weight: Tensor, pixels: Tensor, lens: LensMaps
) -> Tensor:
    """One Gauss–Newton step [b 6] of the differences of brightness."""
    length = moved.norm(dim=1, keepdim=True).clamp(min=1e-3)
    along = _pixel_gradient(slope, lens, pixels)
    unit = moved / length
    along = (along - unit * (along * unit).sum(dim=1, keepdim=True)) / length
    arm = torch.linalg.cross(moved, along, dim=1)
    rows = torch.cat([arm, along], dim=1).flatten(2)
    residual = difference.flatten(2)
    share = weight.flatten(2)
    share = share / share.sum(dim=2, keepdim=True).clamp(min=1e-6)
    scale = (_CAUCHY**2 * (share * residual**2).sum(dim=2, keepdim=True)).clamp(min=1e-8)
    share = share / (1.0 + residual**2 / scale)
    normal = torch.einsum("bin,bjn->bij", rows * share, rows)
    right = -(rows * share * residual).sum(dim=2)
    diagonal = normal.diagonal(dim1=1, dim2=2).mean(dim=1).clamp(min=1e-9)
    damping = _DAMPING * diagonal[:, None, None] * torch.eye(6, device=normal.device)
    step = torch.linalg.solve(normal + damping, right)
    return step * (_MAX_STEP / step.norm(dim=1, keepdim=True).clamp(min=_MAX_STEP))


def _pixel_gradient(slope: Tensor, lens: LensMaps, pixels: Tensor) -> Tensor:
    """Gradient of brightness by the ray [b 3 h w], from that by the pixel [b 2 h w]."""
    columns, rows, inverse = _inverse_at(lens, pixels)
    by = torch.einsum("bijhw,bjhw->bihw", inverse, slope)
    return by[:, :1] * columns + by[:, 1:] * rows


def _inverse_at(lens: LensMaps, pixels: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """Derivatives of the ray at pixels, and the inverse of their products [b 2 2 h w]."""
    maps = sampled(torch.cat([lens.columns, lens.rows], dim=1), scaled(pixels, lens.ray.shape[-1]))
    columns, rows = maps[:, :3], maps[:, 3:]
    a, b, c = ((u * v).sum(dim=1) for u, v in ((columns, columns), (columns, rows), (rows, rows)))
    determinant = (a * c - b * b).clamp(min=1e-12)
    inverse = torch.stack([torch.stack([c, -b], 1), torch.stack([-b, a], 1)], 1)
    return columns, rows, inverse / determinant[:, None, None]


def _pixels_of(moved: Tensor, lens: LensMaps, guess: Tensor, iterations: int) -> Tensor:
    """Pixels [b 2 h w] whose rays point to moved points, by Newton iterations from a guess."""
    size = lens.ray.shape[-1]
    target = functional.normalize(moved, dim=1)
    pixels = guess
    for _ in range(iterations):
        columns, rows, inverse = _inverse_at(lens, pixels)
        error = target - functional.normalize(sampled(lens.ray, scaled(pixels, size)), dim=1)
        by = torch.stack([(columns * error).sum(dim=1), (rows * error).sum(dim=1)], dim=1)
        step = torch.einsum("bijhw,bjhw->bihw", inverse, by).clamp(-0.25 * size, 0.25 * size)
        pixels = (pixels + step).clamp(-0.5 * size, 1.5 * size)
    return pixels


def _moved(points: Tensor, T: Tensor) -> Tensor:
    """Points [b 3 h w] moved by poses [b 4 4]."""
    return torch.einsum("bij,bjhw->bihw", T[:, :3, :3], points) + T[:, :3, 3, None, None]


def _gradients(maps: Tensor) -> tuple[Tensor, Tensor]:
    """Central differences along columns and rows [b c h w]."""
    padded = functional.pad(maps, 4 * [1], mode="replicate")
    columns = 0.5 * (padded[..., 1:-1, 2:] - padded[..., 1:-1, :-2])
    rows = 0.5 * (padded[..., 2:, 1:-1] - padded[..., :-2, 1:-1])
    return columns, rows


def _mean(maps: Tensor) -> Tensor:
    """Mean over the surroundings."""
    return functional.avg_pool2d(maps, _WINDOW, stride=1, padding=_WINDOW // 2)


def _rotation_vector(rotation: Tensor) -> Tensor:
    """Rotation vectors [b 3] of rotations [b 3 3] below half a turn."""
    skew = 0.5 * (rotation - rotation.transpose(1, 2))
    axis = torch.stack([skew[:, 2, 1], skew[:, 0, 2], skew[:, 1, 0]], dim=1)
    sine = axis.norm(dim=1, keepdim=True)
    cosine = 0.5 * (rotation.diagonal(dim1=1, dim2=2).sum(dim=1, keepdim=True) - 1.0)
    angle = torch.atan2(sine, cosine)
    return axis * torch.where(sine > 1e-6, angle / sine.clamp(min=1e-6), 1.0)


Region: TypeAlias = tuple[slice, slice]
"""Rows and columns of an image."""
_BORDER_FRAMES = 8
"""Number of frames, evenly spaced, in which the black border is measured."""


@dataclass(frozen=True)
class Encoded:
    """A frame for the estimation of motion.

    Attributes:
        image: Colors [1 3 s s], 0 to 1.
        ray: Unit rays [1 3 s s].
        features: Features of the motion network.
        log_distance: ln(distance / 30 mm) along the rays [1 1 s s].
    """

    image: Tensor
    ray: Tensor
    features: Tensor
    log_distance: Tensor


def step_between(before: Encoded, here: Encoded, moves: MotionNetwork, *, aligns: bool) -> NDArray:
    """Motion of a frame in the one before it [4 4] [m], estimated in both directions.

    Args:
        before: The frame before.
        here: The frame.
        moves: Trained network.
        aligns: Whether the motion of the network is only the start of a direct alignment.
    """
    pairs = ((here, before), (before, here))
    motions = [
        motion_from_flow(moves.flow(a.features, b.features, a.ray), a.ray, a.log_distance)
        for a, b in pairs
    ]
    if aligns:
        inverse = [motion_of(torch.linalg.inv(pose_matrix(one))) for one in reversed(motions)]
        motions = [
            aligned(a.image, b.image, a.ray, a.log_distance, (own, back))
            for (a, b), own, back in zip(pairs, motions, inverse, strict=True)
        ]
    T_before_here = mutual_motion(*(pose_matrix(one.double())[0] for one in motions))
    result = T_before_here.cpu().numpy()
    result[:3, 3] *= MIDDLE  # the scale of its distances
    return result


def common_region(sequence: FrameSequence, frames: NDArray) -> Region:
    """Rows and columns within the black border of a few frames; all of them for a recording."""
    camera = cast("Camera", sequence.camera)
    whole = slice(0, camera.height), slice(0, camera.width)
    if sequence.episode is not None:
        return whole
    chosen = frames[np.unique(np.linspace(0, len(frames) - 1, _BORDER_FRAMES).astype(int))]
    parts = [bright_part(sequence.image("rgb", int(index))) for index in chosen]
    rows, columns = (
        slice(min(one.start for one in ones), max(one.stop for one in ones))
        for ones in zip(*parts, strict=True)
    )
    return rows, columns
