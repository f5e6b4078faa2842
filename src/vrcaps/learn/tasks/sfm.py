"""Depth and camera motion, trained on video without labels.

A frame is predicted from its neighbors: its predicted distances give points, the predicted motion
transforms them, and the lens projects them into the neighbor, whose colors are sampled there. The
loss is the difference between the prediction and the frame, and the difference between the
neighbor's own distances and those of the transformed points (Bian et al., NeurIPS 2019:
SC-SfMLearner). With D and D' the two distances::

    inconsistency  M  = |D − D'| / (D + D')                               (eq. 5)
    photometric    (0.15 |I − I'| + 0.85 (1 − SSIM) / 2) · (1 − M)         (eqs. 2, 3, 8)
    smoothness     |∇d|  e^{−|∇I|} of mean-normalized d                    (eq. 4)

Distances are along rays and any lens model is supported, so fisheye frames need no rectification.
The LEDs move with the camera, so a wall gets brighter as the camera approaches: the prediction is
scaled to the mean and standard deviation of the frame's colors before they are compared (Ozyoruk et
al., Medical Image Analysis 71, 2021).

From scratch, training takes very long to leave its trivial solution: constant distance and no
motion. Simulated video has labels, and `supervision` uses them; such a checkpoint can then be
fine-tuned on video without labels.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from itertools import pairwise
from typing import TYPE_CHECKING, Annotated, Any, ClassVar

import numpy as np

from vrcaps.config.limits import Range, check_fields
from vrcaps.core.errors import InputError
from vrcaps.core.transforms import invert
from vrcaps.learn.letterbox import Letterbox, require_size
from vrcaps.learn.networks import ENCODER, dense_network, motion_network, require_torch
from vrcaps.learn.samples import batch_of
from vrcaps.learn.task import MAX_SIZE, MAX_WEIGHT, Batch, Metric, Sample, with_gain
from vrcaps.learn.tasks.depth import MIDDLE, DepthTask, depth_of, depth_picture, image_and_rays
from vrcaps.learn.view_synthesis import (
    inconsistency_of,
    matched_brightness,
    matrix_of,
    photometric_error,
    predicted,
    smoothness,
)
from vrcaps.metrics.depth import depth_errors, mean_depth_errors
from vrcaps.recording.frame_sequence import CAMERA_POSE, TIME, FrameSequence
from vrcaps.render.channels import CHANNELS

if TYPE_CHECKING:
    from jaxtyping import UInt8
    from numpy.typing import NDArray

    from vrcaps.camera.camera import Camera
    from vrcaps.learn.checkpoint import TrainedNetwork

_NEIGHBORS = ("before", "after")
_MIN_COSINE = 0.05
"""Minimum cosine of the angle between a ray and the axis: near a right angle, depth along the axis
does not determine the distance."""


@dataclass(frozen=True)
class SfmTask:
    """Depth up to scale and camera motion, from video without labels.

    Attributes:
        size: Side of the network's input images [px]; maps need a multiple of 32.
        encoder: Name of a timm model, such as resnet18.
        step: Offset from a frame to its neighbors, in frames.
        photometric_weight: Weight of the photometric loss.
        smoothness_weight: Weight of the smoothness loss.
        geometry_weight: Weight of the loss of inconsistent distances.
        matches_brightness: Whether predictions are scaled to the frame's brightness.
        supervision: Weight of the loss on true distances and motions; 0 needs no labels.
    """

    size: Annotated[int, Range(32, MAX_SIZE)] = 192
    encoder: str = ENCODER
    step: Annotated[int, Range(1, 1000)] = 1
    photometric_weight: Annotated[float, Range(0.0, MAX_WEIGHT)] = 1.0
    smoothness_weight: Annotated[float, Range(0.0, MAX_WEIGHT)] = 0.1
    geometry_weight: Annotated[float, Range(0.0, MAX_WEIGHT)] = 0.5
    matches_brightness: bool = True
    supervision: Annotated[float, Range(0.0, MAX_WEIGHT)] = 0.0

    kind: ClassVar[str] = "sfm"
    input_names: ClassVar[tuple[str, ...]] = ("image", "ray")
    output_text: ClassVar[str] = "ln(distance along the ray / 30 mm), up to a scale [b 1 s s]"
    figure: ClassVar[Metric] = Metric("loss", is_error=True)

    def __post_init__(self) -> None:
        check_fields(self)
        require_size(self.size)

    def items(self, sequence: FrameSequence) -> Iterable[int]:
        """Return the frames that have both neighbors.

        Raises:
            InputError: If there are no images, no camera, too few frames, or no labels for
                supervision.
        """
        if "rgb" not in sequence.channels or sequence.camera is None:
            what = "images" if sequence.camera else "a calibrated camera"
            raise InputError(f"Learning from video needs {what}, which {sequence.name} has not.")
        if len(sequence) <= 2 * self.step:
            raise InputError(
                f"{sequence.name} has {len(sequence)} frames. Allowed: {2 * self.step + 1} or more."
            )
        if self.supervision > 0.0:
            if "depth" not in sequence.channels:
                raise InputError(f"Supervision needs depth, which {sequence.name} has not.")
            _ = sequence.Ts_world_camera
        return range(self.step, len(sequence) - self.step)

    def sample(self, sequence: FrameSequence, index: int) -> Sample:
        """Return the frame with its rays, its neighbors, and its true depth if known."""
        image = sequence.image("rgb", index)
        fit = Letterbox(image.shape[0], image.shape[1], self.size)
        sample = self.inputs(image, fit, sequence.camera)
        for name, offset in zip(_NEIGHBORS, (-self.step, self.step), strict=True):
            sample[name] = fit.image(sequence.image("rgb", index + offset))
            if self.supervision > 0.0:
                own, other = sequence.Ts_world_camera[[index, index + offset]]
                sample[f"T_{name}_own"] = (invert(other) @ own).astype(np.float32)
        if "depth" in sequence.channels:
            sample["depth"] = fit.nearest(sequence.image("depth", index), np.nan)
        return {**sample, "view": (fit, sequence.camera)}

    def inputs(
        self, image: UInt8[np.ndarray, "h w 3"], fit: Letterbox, camera: Camera | None
    ) -> Sample:
        """Return the image and unit rays, zero where the lens has none.

        Raises:
            InputError: If there is no camera.
        """
        return image_and_rays(image, fit, camera)

    def augmented(self, sample: Sample, rng: np.random.Generator) -> Sample:
        """Apply the same change of exposure, white balance and gamma to all three frames."""
        gain = 1.2 ** rng.uniform(-1.0, 1.0) * rng.uniform(0.95, 1.05, 3)
        gamma = rng.uniform(0.9, 1.1)
        changed = {n: with_gain(sample[n], gain, gamma) for n in ("image", *_NEIGHBORS)}
        return sample | changed

    def network(self, *, is_pretrained: bool) -> Any:
        """Create a network from batches to ln(distance / 30 mm) [b 1 s s], and motion."""
        return _network_class()(self.encoder, is_pretrained)

    def loss(self, network: Any, batch: Batch) -> dict[str, Any]:
        """Loss terms over both neighbors."""
        terms = {"photometric": 0.0, "geometry": 0.0, "labels": 0.0}
        image, ray = batch["image"], batch["ray"]
        own = network(image, ray).float()
        for name in _NEIGHBORS:
            other = network(batch[name], ray).float()
            T_other_own = matrix_of(network.motion(image, batch[name]).float())
            found = predicted(batch[name], other, own, T_other_own, ray, batch["view"])
            unlike = inconsistency_of(found)
            color = found.color
            if self.matches_brightness:
                color = matched_brightness(color, image, found.is_valid)
            error = photometric_error(color, image) * (1.0 - unlike)
            count = found.is_valid.sum().clamp(min=1)
            terms["photometric"] += (error * found.is_valid).sum() / count
            terms["geometry"] += (unlike * found.is_valid).sum() / count
            if self.supervision > 0.0:
                terms["labels"] += _motion_error(T_other_own, batch[f"T_{name}_own"])
        if self.supervision > 0.0:
            terms["labels"] += DepthTask().output_loss(own, _distances(batch))["loss"]
        weighted = {
            "photometric": 0.5 * self.photometric_weight * terms["photometric"],
            "geometry": 0.5 * self.geometry_weight * terms["geometry"],
            "smoothness": self.smoothness_weight * smoothness(own, image),
            "labels": self.supervision * terms["labels"],
        }
        return {**weighted, "loss": sum(weighted.values())}

    def scores(self, outputs: Iterable[NDArray], samples: Iterable[Sample]) -> Mapping[str, float]:
        """Depth errors after scaling by the median of each frame, where true depth is known."""
        errors = [
            depth_errors(_depth_of(output, sample), sample["depth"], align="median")
            for output, sample in zip(outputs, samples, strict=True)
            if "depth" in sample
        ]
        return asdict(mean_depth_errors(errors)) if errors else {}

    def picture(self, output: NDArray, sample: Sample) -> UInt8[np.ndarray, "s k 3"]:
        """Image, true depth if it is known, and predicted depth scaled to it."""
        depth = _depth_of(output, sample)
        if "depth" in sample:
            depth *= np.nanmedian(sample["depth"]) / np.median(depth)
        return depth_picture(depth, sample)

    def files(self, output: NDArray, fit: Letterbox) -> Mapping[str, NDArray]:
        """Distance along the ray in 16 bits, in steps of 10 µm, at a reference scale of 30 mm."""
        return {".png": CHANNELS["ray_distance"].encoding.encode(fit.back(depth_of(output)))}

    def row(self, output: NDArray) -> Mapping[str, Any]:
        """Return no columns."""
        return {}


def estimated_trajectory(
    trained: TrainedNetwork, sequence: FrameSequence, frames: Sequence[int] = ()
) -> FrameSequence:
    """Predict the trajectory of a sequence, in the frame of its first camera.

    Motions between neighboring frames are chained; they are known up to one scale.

    Args:
        trained: Task and network.
        sequence: Frames of one camera.
        frames: Increasing indices of the frames to use; the result has only these. Empty for all.

    Returns:
        The sequence with the predicted poses.

    Raises:
        InputError: If an image cannot be read.
    """
    torch = require_torch()
    poses = [np.eye(4)]
    kept = np.array(frames or range(len(sequence)))
    images = (sequence.image("rgb", int(index)) for index in kept)
    size = trained.learner.size
    squares = (Letterbox(image.shape[0], image.shape[1], size).image(image) for image in images)
    tensors = (batch_of([{"image": square}])["image"] for square in squares)
    with torch.inference_mode():
        for before, here in pairwise(one.to(trained.device) for one in tensors):
            motion = matrix_of(trained.network.motion(here, before).float())[0]
            T_before_here = motion.double().cpu().numpy()
            T_before_here[:3, 3] *= MIDDLE  # the scale of its distances
            poses.append(poses[-1] @ T_before_here)
    values = {TIME: sequence.times[kept], CAMERA_POSE: np.stack(poses)}
    return replace(sequence.subset(kept), values=values)


def _motion_error(motion: Any, T_other_own: Any) -> Any:
    """Error of motions [b 4 4], in units of 2 mm and 0.02 rad, about a pixel each."""
    turned = (motion[:, :3, :3] - T_other_own[:, :3, :3]).flatten(1).norm(dim=1)
    shifted = (MIDDLE * motion[:, :3, 3] - T_other_own[:, :3, 3]).norm(dim=1)
    return (turned / 0.02 + shifted / 0.002).mean()


def _distances(batch: Batch) -> Batch:
    """True distances along rays, in the form of true depth for `DepthTask`."""
    along = batch["ray"][:, 2]
    return {"depth": batch["depth"] / along.where(along > _MIN_COSINE, np.nan)}


def _depth_of(output: NDArray, sample: Sample) -> NDArray:
    """Depth z from distances along rays."""
    return depth_of(output) * np.maximum(sample["ray"][..., 2], 0.0)


def _network_class() -> Any:
    torch = require_torch()

    class SfmNetwork(torch.nn.Module):
        """Distances of one frame, and the motion between two."""

        def __init__(self, encoder: str, is_pretrained: bool) -> None:
            super().__init__()
            self.net = dense_network(encoder, 6, 1, is_pretrained=is_pretrained)
            self.moves = motion_network(encoder, is_pretrained=is_pretrained)

        def forward(self, image: Any, ray: Any) -> Any:
            return self.net(torch.cat([2.0 * image - 1.0, ray], dim=1))

        def motion(self, image: Any, other: Any) -> Any:
            """Rotation vector [rad] and translation of the frame in the other [b 6]."""
            return 0.01 * self.moves(2.0 * torch.cat([image, other], dim=1) - 1.0)

    return SfmNetwork
