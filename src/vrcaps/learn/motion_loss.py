"""Losses of flow and motion by the labels of simulated video."""

from __future__ import annotations

import numpy as np
import torch
from torch import Tensor
from torch.nn import functional

from vrcaps.learn.motion_network import STRIDE, Flow, at_positions
from vrcaps.learn.task import Batch
from vrcaps.learn.tasks.depth import MIDDLE

_MAX_FLOW = 14.0
"""Maximum flow that the flow is trained on [px]."""
MIN_COSINE = 0.05
"""Minimum cosine of the angle between a ray and the axis: near a right angle, depth along the axis
does not determine the distance."""


def true_flow(batch: Batch, T_other_own: Tensor) -> Tensor:
    """Compute the flow of a static wall [b 2 h w], in pixels, at positions of `MotionNetwork`.

    It is NaN where no distance is known, or where it exceeds the range of the network.

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
    flow = torch.stack(flows)
    is_near = (flow.abs() < _MAX_FLOW).all(dim=1, keepdim=True)
    return torch.where(is_near, flow, torch.nan)


def flow_error(flow: Flow, truth: Tensor) -> Tensor:
    """Mean distance of the flow from the true one [px]."""
    known = torch.isfinite(truth).all(dim=1)
    difference = torch.where(known[:, None], flow.pixels - truth, 0.0)
    return ((difference**2).sum(dim=1) + 1e-4).sqrt().mul(known).sum() / known.sum().clamp(min=1)


def motion_error(motion: Tensor, T_other_own: Tensor) -> Tensor:
    """Error of motions [b 4 4], in units of 2 mm and 0.02 rad, about a pixel each."""
    turned = (motion[:, :3, :3] - T_other_own[:, :3, :3]).flatten(1).norm(dim=1)
    shifted = (MIDDLE * motion[:, :3, 3] - T_other_own[:, :3, 3]).norm(dim=1)
    return (turned / 0.02 + shifted / 0.002).mean()


def distances_of(batch: Batch) -> Tensor:
    """True distances along rays [b s s]."""
    along = batch["ray"][:, 2]
    return batch["depth"] / along.where(along > MIN_COSINE, np.nan)
