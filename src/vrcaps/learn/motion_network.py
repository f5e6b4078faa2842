"""Camera motion between two frames, from the flow of image features and known distances.

The features of both frames are correlated in a neighborhood of each position (cost volume;
Dosovitskiy et al., ICCV 2015, FlowNetC). Convolutions turn the correlations into a flow and a
weight for each position. The motion is the weighted least-squares solution of the epipolar
constraint with known distances: a point p of the frame, moved by a small rotation w and a
translation t, lies on the ray q of the neighbor that the flow leads to::

    q × (p + w × p + t) = 0

The equations are linear in w and t. They are divided by |p|, so that residuals are angles. As no
layer outputs the motion itself, a network without a flow has a motion of zero, and two equal frames
have none.

Each activation follows a normalization over the maps of one frame, so it cannot be zero in all
channels, and it is the same in training and prediction. A regression of the motion by an ImageNet
classifier died otherwise: its last batch normalization lets a feature pass that exceeds the mean by
1.27 standard deviations; the statistics of small batches of similar frames were 2.6 times as wide
in training as in prediction, where no feature passed.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import torch
from torch import Tensor, nn
from torch.nn import functional

from vrcaps.learn.losses import pose_matrix

STRIDE = 4
"""Pixels per position of the flow, along rows and columns."""
_REACH = 3
"""Maximum displacement that is correlated, in positions."""
_FEATURES = (32, 48)
_WIDTHS = (64, 64, 48)
_GROUPS = 8
"""Channels of the layers, and groups of their normalization."""
_WHOLE = 0.99
"""Minimum length of a mean of unit rays; it is shorter if it includes pixels without a ray."""
_DAMPING = 1e-4
"""Weight of a static camera relative to the equations, for frames without texture."""
_ITERATIONS = 3
"""Gauss–Newton iterations: the equations are linear in small rotations only."""


@dataclass(frozen=True)
class Flow:
    """Flow from a frame to its neighbor.

    Attributes:
        pixels: Displacement along columns and rows [b 2 h w], in pixels of the network's image.
        weight: Weight of each position [b 1 h w], 0 to 1.
    """

    pixels: Tensor
    weight: Tensor


class MotionNetwork(nn.Module):
    """Flow and motion between two frames."""

    def __init__(self) -> None:
        super().__init__()
        self.features = nn.Sequential(
            *_layer(3, _FEATURES[0], 7, stride=2),
            *_layer(*_FEATURES, 5, stride=2),
            nn.Conv2d(_FEATURES[1], _FEATURES[1], 3, padding=1),
        )
        widths = ((2 * _REACH + 1) ** 2 + _FEATURES[1] + 3, *_WIDTHS)
        layers = [module for pair in pairwise(widths) for module in _layer(*pair, 3)]
        self.head = nn.Sequential(*layers, nn.Conv2d(widths[-1], 3, 3, padding=1))

    def flow(self, image: Tensor, other: Tensor, ray: Tensor) -> Flow:
        """Return the flow from frames to others.

        Args:
            image: Colors [b 3 s s], 0 to 1.
            other: Colors of the neighbors.
            ray: Unit rays [b 3 s s], zero where the lens has none.
        """
        own, there = (self.features(2.0 * one - 1.0).float() for one in (image, other))
        maps = torch.cat([correlation(own, there), _unit(own), at_positions(ray)], dim=1)
        output = self.head(maps).float()
        return Flow(STRIDE * output[:, :2], torch.sigmoid(output[:, 2:]))

    def forward(self, image: Tensor, other: Tensor, ray: Tensor, log_distance: Tensor) -> Tensor:
        """Return the motion of frames in others [b 6]: a rotation vector [rad] and a translation.

        Args:
            image: Colors [b 3 s s], 0 to 1.
            other: Colors of the neighbors.
            ray: Unit rays [b 3 s s], zero where the lens has none.
            log_distance: ln of the distances along the rays [b 1 s s], in units of the translation.
        """
        flow = self.flow(image, other, ray)
        return motion_from_flow(flow, ray, log_distance)


def _layer(before: int, after: int, kernel: int, stride: int = 1) -> list[nn.Module]:
    """Convolution, normalization over the map, and activation."""
    convolution = nn.Conv2d(before, after, kernel, stride=stride, padding=kernel // 2)
    return [convolution, nn.GroupNorm(_GROUPS, after), nn.GELU()]


def _unit(features: Tensor) -> Tensor:
    """Features with zero mean and unit norm at each position."""
    return functional.normalize(features - features.mean(dim=(2, 3), keepdim=True), dim=1)


def correlation(first: Tensor, second: Tensor) -> Tensor:
    """Correlation of features [b c h w] with those of neighboring positions [b n h w], −1 to 1."""
    height, width = first.shape[-2:]
    own, padded = _unit(first), functional.pad(_unit(second), 4 * [_REACH])
    shifts = range(2 * _REACH + 1)
    return torch.stack(
        [
            (own * padded[..., y : y + height, x : x + width]).sum(dim=1)
            for y in shifts
            for x in shifts
        ],
        dim=1,
    )


def at_positions(ray: Tensor) -> Tensor:
    """Unit rays at the positions of the flow [b 3 h w]; zero where the lens has none."""
    mean = functional.avg_pool2d(ray, STRIDE)
    length = mean.norm(dim=1, keepdim=True)
    return torch.where(length > _WHOLE, mean / length.clamp(min=1e-6), torch.zeros_like(mean))


def positions(size: int, device: torch.device | str = "cpu") -> Tensor:
    """Column and row of the positions of the flow [2 h w], in pixels."""
    middle = STRIDE * torch.arange(size // STRIDE, device=device) + 0.5 * (STRIDE - 1)
    rows, columns = torch.meshgrid(middle, middle, indexing="ij")
    return torch.stack([columns, rows])


def motion_from_flow(flow: Flow, ray: Tensor, log_distance: Tensor) -> Tensor:
    """Least-squares motion [b 6] of a flow, see `MotionNetwork.forward`."""
    at = positions(ray.shape[-1], ray.device)
    own, there = _rays_at(ray, at.expand_as(flow.pixels)), _rays_at(ray, at + flow.pixels)
    log = functional.avg_pool2d(log_distance, STRIDE)
    is_known = own.any(dim=1, keepdim=True) & there.any(dim=1, keepdim=True)
    weight = (flow.weight * is_known).flatten(1)
    known = is_known.flatten(1)
    count = known.sum(dim=1).clamp(min=1)
    middle = (log.flatten(1) * known).sum(dim=1) / count
    points = (torch.exp(log - middle[:, None, None, None]) * own).flatten(2).transpose(1, 2)
    rays = there.flatten(2).transpose(1, 2)
    motion = _least_squares(points, rays, weight / weight.sum(dim=1, keepdim=True).clamp(min=1e-6))
    return torch.cat([motion[:, :3], torch.exp(middle)[:, None] * motion[:, 3:]], dim=1)


def _rays_at(ray: Tensor, pixels: Tensor) -> Tensor:
    """Unit rays at columns and rows [b 2 h w] by linear interpolation; zero outside the lens.

    A pixel without flow has the same ray in both frames, so that no flow gives no motion.
    """
    grid = (2.0 * pixels + 1.0) / ray.shape[-1] - 1.0
    mean = functional.grid_sample(ray, grid.permute(0, 2, 3, 1), align_corners=False)
    length = mean.norm(dim=1, keepdim=True)
    return torch.where(length > _WHOLE, mean / length.clamp(min=1e-6), torch.zeros_like(mean))


def _least_squares(points: Tensor, rays: Tensor, weight: Tensor) -> Tensor:
    """Motion [b 6] of points [b n 3] onto rays [b n 3], with weights [b n] whose sum is 1."""
    turn, shift = points.new_zeros(len(points), 3), points.new_zeros(len(points), 3)
    moved = points
    for _ in range(_ITERATIONS):
        step = _step(moved, rays, weight)
        T = pose_matrix(step)
        rotation = T[:, :3, :3].transpose(1, 2)
        moved = moved @ rotation + step[:, None, 3:]
        shift = (shift[:, None] @ rotation)[:, 0] + step[:, 3:]
        turn = turn + step[:, :3]  # later steps are small, so their order does not matter
    return torch.cat([turn, shift], dim=1)


def _step(points: Tensor, rays: Tensor, weight: Tensor) -> Tensor:
    """One linear step: rotation vector and translation [b 6]."""
    scale = 1.0 / points.norm(dim=2, keepdim=True).clamp(min=1e-3)
    q = _cross_matrix(rays)
    matrix = torch.cat([-q @ _cross_matrix(points), q], dim=3) * scale[..., None]
    target = -torch.linalg.cross(rays, points) * scale
    weighted = matrix * weight[..., None, None]
    normal = torch.einsum("bnij,bnik->bjk", weighted, matrix)
    right = torch.einsum("bnij,bni->bj", weighted, target)
    damping = _DAMPING * torch.eye(6, dtype=normal.dtype, device=normal.device)
    return torch.linalg.solve(normal + damping, right)


def _cross_matrix(vectors: Tensor) -> Tensor:
    """Matrices [b n 3 3] of the cross product with vectors [b n 3]."""
    x, y, z = vectors.unbind(dim=-1)
    zero = torch.zeros_like(x)
    return torch.stack([zero, -z, y, z, zero, -x, -y, x, zero], dim=-1).unflatten(-1, (3, 3))
