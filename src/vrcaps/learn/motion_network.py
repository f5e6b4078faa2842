"""Camera motion between two frames, from the flow of image features and known distances.

Features of both frames are correlated in a neighborhood of each position (cost volume; Dosovitskiy
et al., ICCV 2015, FlowNetC), first on a coarse grid, then on a fine one around the coarse flow
(Sun et al., CVPR 2018, PWC-Net). The flow of each grid is the mean of the correlated displacements,
weighted by a softmax of the correlations, plus a correction by convolutions, which also estimate
its standard deviation. The motion is the weighted least-squares solution of the epipolar constraint
with known distances, see `motion_solver`. As no layer outputs the motion itself, a network without
a flow has a motion of zero.

Each activation follows a normalization over the maps of one frame, so it cannot be zero in all
channels, and it is the same in training and prediction. A regression of the motion by an ImageNet
classifier died otherwise: its last batch normalization lets a feature pass that exceeds the mean by
1.27 standard deviations; the statistics of small batches of similar frames were 2.6 times as wide
in training as in prediction, where no feature passed.
"""

from __future__ import annotations

import math
from itertools import pairwise

import torch
from torch import Tensor, nn
from torch.nn import functional

from vrcaps.learn.motion_solver import STRIDE, Flow, at_positions, motion_from_flow

_COARSE = 2
"""Positions of the fine grid per position of the coarse one."""
_COARSE_REACH, _FINE_REACH = 3, 2
"""Maximum displacement that is correlated, in positions of the grid: 24 pixels, and 8 more."""
_FEATURES = (32, 48)
_COARSE_WIDTHS = (64, 64, 48)
_FINE_WIDTHS = (64, 48)
_GROUPS = 8
"""Channels of the layers, and groups of their normalization."""
_SHARPNESS = 15.0
"""Initial factor of the correlations in the softmax."""
_DEVIATION_PX = (0.05, 20.0)
"""Limits of the standard deviation of the flow [px]."""


class MotionNetwork(nn.Module):
    """Flow and motion between two frames."""

    def __init__(self) -> None:
        super().__init__()
        width = _FEATURES[1]
        self.features = nn.Sequential(
            *_layer(3, _FEATURES[0], 7, stride=2),
            *_layer(*_FEATURES, 5, stride=2),
            *_layer(width, width, 3),
            nn.Conv2d(width, width, 3, padding=1),
        )
        self.coarse = _Grid(_COARSE_REACH, width + 3, _COARSE_WIDTHS)
        self.fine = _Grid(_FINE_REACH, width + 5 + _COARSE_WIDTHS[-1], _FINE_WIDTHS)

    def encode(self, image: Tensor) -> Tensor:
        """Features [b c h w] of colors [b 3 s s], 0 to 1."""
        return self.features(2.0 * image - 1.0).float()

    def flow(self, own: Tensor, there: Tensor, ray: Tensor) -> Flow:
        """Return the flow from frames to others.

        Args:
            own: Features of the frames.
            there: Features of the neighbors.
            ray: Unit rays [b 3 s s], zero where the lens has none.
        """
        rays, maps = at_positions(ray), _unit(own)
        small = [functional.avg_pool2d(one, _COARSE) for one in (own, there)]
        known = [functional.avg_pool2d(one, _COARSE) for one in (maps, rays)]
        coarse, _, hidden = self.coarse(*small, torch.cat(known, dim=1))
        first, hidden = (_enlarged(one) for one in (_COARSE * coarse, hidden))
        moved = _moved(there, first)
        step, log_deviation, _ = self.fine(own, moved, torch.cat([maps, rays, first, hidden], 1))
        weight = torch.exp(-2.0 * log_deviation)
        return Flow(STRIDE * (first + step), weight, STRIDE * _COARSE * coarse)

    def forward(self, image: Tensor, other: Tensor, ray: Tensor, log_distance: Tensor) -> Tensor:
        """Return the motion of frames in others [b 6]: a rotation vector [rad] and a translation.

        Args:
            image: Colors [b 3 s s], 0 to 1.
            other: Colors of the neighbors.
            ray: Unit rays [b 3 s s], zero where the lens has none.
            log_distance: ln of the distances along the rays [b 1 s s], in units of the translation.
        """
        flow = self.flow(self.encode(image), self.encode(other), ray)
        return motion_from_flow(flow, ray, log_distance)


class _Grid(nn.Module):
    """Flow of one grid, from correlations and further maps."""

    def __init__(self, reach: int, num_maps: int, widths: tuple[int, ...]) -> None:
        super().__init__()
        self.reach = reach
        self.log_sharpness = nn.Parameter(torch.tensor(math.log(_SHARPNESS)))
        widths = ((2 * reach + 1) ** 2 + num_maps, *widths)
        layers = [module for pair in pairwise(widths) for module in _layer(*pair, 3)]
        self.hidden = nn.Sequential(*layers)
        self.output = nn.Conv2d(widths[-1], 3, 3, padding=1)
        for value in self.output.parameters():
            nn.init.zeros_(value)

    def forward(self, own: Tensor, there: Tensor, maps: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        """Displacement [b 2 h w] in positions, ln of its deviation [px], and hidden features."""
        likeness = correlation(own, there, self.reach)
        hidden = self.hidden(torch.cat([likeness, maps], dim=1))
        output = self.output(hidden).float()
        share = torch.softmax(self.log_sharpness.exp() * likeness, dim=1)
        mean = torch.einsum("bnhw,nk->bkhw", share, _displacements(self.reach, share))
        low, high = (math.log(one) for one in _DEVIATION_PX)
        middle = 0.5 * (high - low)
        log_deviation = 0.5 * (low + high) + middle * torch.tanh(output[:, 2:] / middle)
        return mean + output[:, :2], log_deviation, hidden


def _layer(before: int, after: int, kernel: int, stride: int = 1) -> list[nn.Module]:
    """Convolution, normalization over the map, and activation."""
    convolution = nn.Conv2d(before, after, kernel, stride=stride, padding=kernel // 2)
    return [convolution, nn.GroupNorm(_GROUPS, after), nn.GELU()]


def _unit(features: Tensor) -> Tensor:
    """Features with zero mean and unit norm at each position."""
    return functional.normalize(features - features.mean(dim=(2, 3), keepdim=True), dim=1)


def _displacements(reach: int, like: Tensor) -> Tensor:
    """Columns and rows of the correlated displacements [n 2], in positions."""
    shifts = torch.arange(-reach, reach + 1, dtype=like.dtype, device=like.device)
    rows, columns = torch.meshgrid(shifts, shifts, indexing="ij")
    return torch.stack([columns.flatten(), rows.flatten()], dim=1)


def correlation(first: Tensor, second: Tensor, reach: int = _COARSE_REACH) -> Tensor:
    """Correlation of features [b c h w] with those of neighboring positions [b n h w], −1 to 1."""
    height, width = first.shape[-2:]
    own, padded = _unit(first), functional.pad(_unit(second), 4 * [reach])
    shifts = range(2 * reach + 1)
    return torch.stack(
        [
            (own * padded[..., y : y + height, x : x + width]).sum(dim=1)
            for y in shifts
            for x in shifts
        ],
        dim=1,
    )


def _enlarged(maps: Tensor) -> Tensor:
    """Maps of the coarse grid at the positions of the fine one."""
    return functional.interpolate(maps, scale_factor=_COARSE, mode="bilinear")


def _moved(features: Tensor, displacement: Tensor) -> Tensor:
    """Features at displaced positions, by linear interpolation; zero outside."""
    height, width = features.shape[-2:]
    rows, columns = torch.meshgrid(
        *(torch.arange(n, device=features.device) for n in (height, width)), indexing="ij"
    )
    size = displacement.new_tensor([width, height]).view(2, 1, 1)
    grid = (2.0 * (torch.stack([columns, rows]) + displacement) + 1.0) / size - 1.0
    return functional.grid_sample(features, grid.permute(0, 2, 3, 1), align_corners=False)
