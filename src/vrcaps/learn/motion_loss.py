"""Losses of flow and motion by the labels of simulated video."""

from __future__ import annotations

import numpy as np
import torch
from torch import Tensor
from torch.nn import functional

from vrcaps.learn.motion_solver import STRIDE, Flow, at_positions
from vrcaps.learn.task import Batch
from vrcaps.learn.tasks.depth import MIDDLE

_MAX_FLOW = 28.0
"""Maximum flow that the flow is trained on [px]."""
_COARSE, _LIKELIHOOD = 0.5, 0.2
"""Weights of the flow of the coarse grid and of the standard deviation, relative to the flow."""
_SHORT = 5e-4
"""Length of a translation below which its error is not relative to its own [m]."""
MIN_COSINE = 0.05
"""Minimum cosine of the angle between a ray and the axis: near a right angle, depth along the axis
does not determine the distance."""


def true_flow(batch: Batch, T_other_own: Tensor) -> Tensor:
    """Compute the flow of a static wall [b 2 h w], in pixels, at positions of `MotionNetwork`.

    It is NaN where no distance is known.

    Args:
        batch: `depth` [b s s], `ray` [b 3 s s] and `view`, letterbox and camera of each image.
        T_other_own: Pose of the frame's camera in the neighbor's [m] [b 4 4].
    """
    size = batch["ray"].shape[-1]
    distance = functional.avg_pool2d(distances_of(batch)[:, None], STRIDE)
    points = (distance * at_positions(batch["ray"])).flatten(2)
    moved = T_other_own[:, :3, :3] @ points + T_other_own[:, :3, 3:]
    flows = []
    for (letterbox, camera), start, end in zip(
        batch["view"], points.transpose(1, 2), moved.transpose(1, 2), strict=True
    ):
        pixels = [torch.stack(letterbox.to_square(camera.lens.project(p))) for p in (start, end)]
        flows.append((pixels[1] - pixels[0]).view(2, size // STRIDE, -1))
    return torch.stack(flows)


def flow_error(flow: Flow, truth: Tensor) -> Tensor:
    """Error of a flow [px]: of both grids, and the likelihood of its standard deviation.

    The last is −ln of the density exp(−r / σ) / (2π σ²) of the distance r from the true flow, a
    Laplace distribution in two dimensions.
    """
    pixels, deviation = flow.pixels, flow.weight[:, 0] ** -0.5
    known = torch.isfinite(truth).all(dim=1)
    known = known & (torch.nan_to_num(truth).abs() < _MAX_FLOW).all(dim=1)
    distance = _distance(pixels, truth, known)
    error = distance + _LIKELIHOOD * (distance / deviation + 2.0 * torch.log(deviation))
    total = (error * known).sum() / known.sum().clamp(min=1)
    if flow.coarse is None:
        return total
    large = functional.interpolate(flow.coarse, size=truth.shape[-2:], mode="bilinear")
    coarse = _distance(large, truth, known)
    return total + _COARSE * (coarse * known).sum() / known.sum().clamp(min=1)


def _distance(pixels: Tensor, truth: Tensor, known: Tensor) -> Tensor:
    """Distance of a flow from the true one [b h w] [px], smooth at 0."""
    difference = torch.where(known[:, None], pixels - truth, 0.0)
    return ((difference**2).sum(dim=1) + 1e-4).sqrt()


def motion_error(motion: Tensor, T_other_own: Tensor) -> Tensor:
    """Error of motions [b 4 4]: ln(1 + relative error of the translation + error of the rotation).

    Rotations are in units of 0.02 rad, about a pixel; translations below half a millimeter count as
    of that length.
    """
    turned = (motion[:, :3, :3] - T_other_own[:, :3, :3]).flatten(1).norm(dim=1)
    shifted = (MIDDLE * motion[:, :3, 3] - T_other_own[:, :3, 3]).norm(dim=1)
    length = T_other_own[:, :3, 3].norm(dim=1).clamp(min=_SHORT)
    return torch.log1p(turned / 0.02 + shifted / length).mean()


def distances_of(batch: Batch) -> Tensor:
    """True distances along rays [b s s]."""
    along = batch["ray"][:, 2]
    return batch["depth"] / along.where(along > MIN_COSINE, np.nan)
