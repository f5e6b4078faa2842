"""Geometry of a camera's motion: rays between pixels, and motion by least squares from a flow.

A point p of a frame, moved by a small rotation w and a translation t, lies on the ray q of the
neighbor that the flow leads to::

    q × (p + w × p + t) = 0

The equations are linear in w and t. They are divided by |p|, so that residuals are angles. Weights
are inverse variances of the flow; after the first iteration they are divided by 1 + (r / c)² for a
residual r (Cauchy), because positions of a moving wall, an occlusion or a wrong distance do not
follow the motion of the others. A flow of zero has a motion of zero.
"""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor
from torch.nn import functional

from vrcaps.learn.losses import pose_matrix

STRIDE = 4
"""Pixels per position of the flow, along rows and columns."""
WHOLE = 0.99
"""Minimum length of a mean of unit rays; it is shorter if it includes pixels without a ray."""
_DAMPING = 1e-5
"""Weight of a static camera relative to the equations, for frames without texture."""
_ITERATIONS = 4
"""Gauss–Newton iterations: the equations are linear in small rotations only."""
_CAUCHY = 1.5
"""Residual whose weight is halved, in root mean squares of the weighted residuals."""


@dataclass(frozen=True)
class Flow:
    """Flow from a frame to its neighbor.

    Attributes:
        pixels: Displacement along columns and rows [b 2 h w], in pixels of the network's image.
        weight: Inverse variance of the displacement [b 1 h w], in pixels⁻².
        coarse: Displacement of a coarser grid [b 2 h/2 w/2] [px]; None if there is none.
    """

    pixels: Tensor
    weight: Tensor
    coarse: Tensor | None = None


def at_positions(ray: Tensor, stride: int = STRIDE) -> Tensor:
    """Unit rays at the positions of the flow [b 3 h w]; zero where the lens has none."""
    return _whole(functional.avg_pool2d(ray, stride))


def positions(size: int, stride: int = STRIDE, device: torch.device | str = "cpu") -> Tensor:
    """Column and row of the positions of the flow [2 h w], in pixels."""
    middle = stride * torch.arange(size // stride, device=device) + 0.5 * (stride - 1)
    rows, columns = torch.meshgrid(middle, middle, indexing="ij")
    return torch.stack([columns, rows])


def sampled(maps: Tensor, pixels: Tensor) -> Tensor:
    """Maps [b c s s] at columns and rows [b 2 h w] by linear interpolation; zero outside.

    The maps may have any resolution; pixels are those of an image of `size`, see `scaled`.
    """
    grid = pixels.permute(0, 2, 3, 1)
    return functional.grid_sample(maps, grid, align_corners=False)


def scaled(pixels: Tensor, size: int) -> Tensor:
    """Pixels of an image of a size as the coordinates of `sampled`, −1 to 1."""
    return (2.0 * pixels + 1.0) / size - 1.0


def rays_at(ray: Tensor, pixels: Tensor) -> Tensor:
    """Unit rays at columns and rows [b 2 h w] by linear interpolation; zero outside the lens.

    A pixel without flow has the same ray in both frames, so that no flow gives no motion.
    """
    return _whole(sampled(ray, scaled(pixels, ray.shape[-1])))


def _whole(mean: Tensor) -> Tensor:
    """Unit vectors of means of rays; zero where some of them are zero."""
    length = mean.norm(dim=1, keepdim=True)
    return torch.where(length > WHOLE, mean / length.clamp(min=1e-6), torch.zeros_like(mean))


def motion_from_flow(flow: Flow, ray: Tensor, log_distance: Tensor) -> Tensor:
    """Least-squares motion of frames in others [b 6]: a rotation vector [rad] and a translation.

    Args:
        flow: Flow to the others.
        ray: Unit rays [b 3 s s], zero where the lens has none.
        log_distance: ln of the distances along the rays [b 1 s s], in units of the translation.
    """
    at = positions(ray.shape[-1], device=ray.device)
    own, there = rays_at(ray, at.expand_as(flow.pixels)), rays_at(ray, at + flow.pixels)
    log = functional.avg_pool2d(log_distance, STRIDE)
    is_known = own.any(dim=1, keepdim=True) & there.any(dim=1, keepdim=True)
    weight = (flow.weight * is_known).flatten(1)
    middle = mean_log(log, is_known)
    points = (torch.exp(log - middle[:, None, None, None]) * own).flatten(2).transpose(1, 2)
    rays = there.flatten(2).transpose(1, 2)
    motion = _least_squares(points, rays, _shares(weight))
    return torch.cat([motion[:, :3], torch.exp(middle)[:, None] * motion[:, 3:]], dim=1)


def mean_log(log_distance: Tensor, is_known: Tensor) -> Tensor:
    """Mean logarithm of the known distances [b]."""
    known = is_known.flatten(1)
    return (log_distance.flatten(1) * known).sum(dim=1) / known.sum(dim=1).clamp(min=1)


def mutual_motion(there: Tensor, back: Tensor) -> Tensor:
    """Mean of a motion [4 4] and the inverse of the motion back [4 4]."""
    inverse = torch.linalg.inv(back)
    u, _, vt = torch.linalg.svd(there[:3, :3] + inverse[:3, :3])
    mean = 0.5 * (there + inverse)
    mean[:3, :3] = u @ vt
    return mean


def _shares(weight: Tensor) -> Tensor:
    """Weights [b n] whose sum is 1, or 0 if all are 0."""
    return weight / weight.sum(dim=1, keepdim=True).clamp(min=1e-6)


def _least_squares(points: Tensor, rays: Tensor, weight: Tensor) -> Tensor:
    """Motion [b 6] of points [b n 3] onto rays [b n 3], with weights [b n] whose sum is 1."""
    turn, shift = points.new_zeros(len(points), 3), points.new_zeros(len(points), 3)
    moved, robust = points, weight
    for _ in range(_ITERATIONS):
        step = _step(moved, rays, robust)
        T = pose_matrix(step)
        rotation = T[:, :3, :3].transpose(1, 2)
        moved = moved @ rotation + step[:, None, 3:]
        shift = (shift[:, None] @ rotation)[:, 0] + step[:, 3:]
        turn = turn + step[:, :3]  # later steps are small, so their order does not matter
        robust = _shares(weight * _robustness(moved.detach(), rays.detach(), weight.detach()))
    return torch.cat([turn, shift], dim=1)


def _robustness(points: Tensor, rays: Tensor, weight: Tensor) -> Tensor:
    """Cauchy weights [b n], 0 to 1, of the angles between points and rays."""
    across = torch.linalg.cross(rays, functional.normalize(points, dim=2))
    square = (across**2).sum(dim=2)
    scale = (_CAUCHY**2 * (weight * square).sum(dim=1, keepdim=True)).clamp(min=1e-12)
    return 1.0 / (1.0 + square / scale)


def _step(points: Tensor, rays: Tensor, weight: Tensor) -> Tensor:
    """One linear step: rotation vector and translation [b 6]."""
    scale = 1.0 / points.norm(dim=2, keepdim=True).clamp(min=1e-3)
    q = cross_matrix(rays)
    matrix = torch.cat([-q @ cross_matrix(points), q], dim=3) * scale[..., None]
    target = -torch.linalg.cross(rays, points) * scale
    weighted = matrix * weight[..., None, None]
    normal = torch.einsum("bnij,bnik->bjk", weighted, matrix)
    right = torch.einsum("bnij,bni->bj", weighted, target)
    damping = _DAMPING * torch.eye(6, dtype=normal.dtype, device=normal.device)
    return torch.linalg.solve(normal + damping, right)


def cross_matrix(vectors: Tensor) -> Tensor:
    """Matrices [b n 3 3] of the cross product with vectors [b n 3]."""
    x, y, z = vectors.unbind(dim=-1)
    zero = torch.zeros_like(x)
    return torch.stack([zero, -z, y, z, zero, -x, -y, x, zero], dim=-1).unflatten(-1, (3, 3))
