"""Motion between consecutive frames of a sequence, from the motion network and direct alignment."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, TypeAlias, cast

import numpy as np
import torch
from torch import Tensor

from vrcaps.learn.alignment import aligned, motion_of
from vrcaps.learn.losses import pose_matrix
from vrcaps.learn.motion_network import MotionNetwork
from vrcaps.learn.motion_solver import motion_from_flow, mutual_motion
from vrcaps.learn.picture_border import bright_part
from vrcaps.learn.tasks.depth import MIDDLE
from vrcaps.recording.frame_sequence import FrameSequence

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from vrcaps.camera.camera import Camera

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
    """Rows and columns within the black border of all of a few frames; all in a recording."""
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
