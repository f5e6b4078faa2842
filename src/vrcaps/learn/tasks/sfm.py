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

The motion follows from the flow of features and the distances, see `motion_network`. From scratch,
training takes very long to leave its trivial solution: constant distance and no motion. Simulated
video has labels, and `supervision` uses them; such a checkpoint can then be fine-tuned on video
without labels.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import nullcontext
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Annotated, ClassVar, cast

import numpy as np
import torch
from torch import Tensor, nn

from vrcaps.core.errors import InputError
from vrcaps.core.fields import Range, check_fields
from vrcaps.core.geometry import invert
from vrcaps.formats.slam.tum import trajectory_text
from vrcaps.learn.augment import with_gain
from vrcaps.learn.baselines import log_depth_baselines
from vrcaps.learn.losses import (
    inconsistency,
    match_brightness,
    photometric_error,
    pose_matrix,
    smoothness,
    synthesize_view,
)
from vrcaps.learn.motion_network import MotionNetwork
from vrcaps.learn.motion_solver import motion_from_flow
from vrcaps.learn.motion_steps import Encoded, Region, common_region, step_between
from vrcaps.learn.motion_training import (
    MIN_COSINE,
    cropped,
    distances_of,
    flow_error,
    mirrored,
    motion_error,
    transposed,
    true_flow,
)
from vrcaps.learn.networks import Backbone
from vrcaps.learn.picture_border import LENS_NEEDED, Letterbox, part_of
from vrcaps.learn.samples import batch_of
from vrcaps.learn.task import MAX_WEIGHT, BackboneTask, Batch, Losses, Metric, Sample, total
from vrcaps.learn.tasks.depth import (
    MIDDLE,
    DepthNetwork,
    DepthTerms,
    depth_loss,
    depth_of,
    depth_picture,
    depth_summary,
    depth_terms,
    image_and_rays,
)
from vrcaps.metrics.trajectory import motion_baselines, motion_errors
from vrcaps.recording.frame_sequence import CAMERA_POSE, TIME, FrameSequence
from vrcaps.render.channels import CHANNELS

if TYPE_CHECKING:
    from jaxtyping import UInt8
    from numpy.typing import NDArray

    from vrcaps.camera.camera import Camera

_NEIGHBORS = ("before", "after")
_GRADIENT_WEIGHT = 0.5
"""Weight of the gradient loss on true distances."""
_MIN_POSES = 3
"""Minimum number of poses of an evaluated trajectory."""


@dataclass(frozen=True)
class SfmTask(BackboneTask[DepthTerms | None]):
    """Depth up to scale and camera motion, from video without labels.

    Attributes:
        backbone: Input size and encoder of the network.
        step: Offset from a frame to its neighbors, in frames.
        photometric_weight: Weight of the photometric loss.
        smoothness_weight: Weight of the smoothness loss.
        geometry_weight: Weight of the loss of inconsistent distances.
        matches_brightness: Whether predictions are scaled to the frame's brightness.
        supervision: Weight of the loss on true distances, flow and motions; 0 needs no labels.
        has_light_cue: Whether the light cue of depth, −½ ln of the linear brightness, is an input
            of the network of distances.
        trains_distances: Whether the network of distances is trained; otherwise it keeps its
            initial weights, such as those of `--start depth`, and training is four times as fast.
        min_crop: Minimum side of a random crop, relative to the image, in training by labels alone.
        aligns: Whether the motion of the network is the start of a direct alignment, see
            `alignment`; otherwise it is the result. Training does not depend on it.
    """

    backbone: Backbone = field(default_factory=Backbone)
    step: Annotated[int, Range(1, 1000)] = 1
    photometric_weight: Annotated[float, Range(0.0, MAX_WEIGHT)] = 1.0
    smoothness_weight: Annotated[float, Range(0.0, MAX_WEIGHT)] = 0.1
    geometry_weight: Annotated[float, Range(0.0, MAX_WEIGHT)] = 0.5
    matches_brightness: bool = True
    supervision: Annotated[float, Range(0.0, MAX_WEIGHT)] = 0.0
    has_light_cue: bool = True
    trains_distances: bool = True
    min_crop: Annotated[float, Range(above=0.0, max=1.0)] = 0.5
    aligns: bool = True

    kind: ClassVar[str] = "sfm"
    pipeline_tag: ClassVar[str] = "depth-estimation"
    input_names: ClassVar[tuple[str, ...]] = ("image", "ray")
    output_text: ClassVar[str] = "ln(distance along the ray / 30 mm), up to a scale [b 1 s s]"
    metric: ClassVar[Metric] = Metric("loss", is_error=True)
    similar_tasks: ClassVar[tuple[str, ...]] = ("depth",)
    reads_sequences: ClassVar[bool] = True

    def __post_init__(self) -> None:
        check_fields(self)
        self.backbone.require_stride()

    def items(self, sequence: FrameSequence) -> Iterable[int]:
        """Return the frames that have both neighbors.

        Raises:
            InputError: If images, camera, enough frames, or labels for supervision are missing.
        """
        if "rgb" not in sequence.channels or sequence.camera is None:
            what = "images" if sequence.camera else "a calibrated camera"
            raise InputError(f"Training on video requires {what}. {sequence.name} has none.")
        if len(sequence) <= 2 * self.step:
            raise InputError(
                f"{sequence.name} has {len(sequence)} frames. Allowed: {2 * self.step + 1} or more."
            )
        if self.supervision > 0.0:
            if "depth" not in sequence.channels:
                raise InputError(f"Supervision requires depth. {sequence.name} has none.")
            _ = sequence.Ts_world_camera
        return range(self.step, len(sequence) - self.step)

    def sample(self, sequence: FrameSequence, index: int) -> Sample:
        """Return the frame with its rays, its neighbors, and its true depth if known."""
        image = sequence.image("rgb", index)
        letterbox = Letterbox(image.shape[0], image.shape[1], self.input_size)
        sample = self.inputs(image, letterbox, sequence.camera)
        for name, offset in zip(_NEIGHBORS, (-self.step, self.step), strict=True):
            sample[name] = letterbox.image(sequence.image("rgb", index + offset))
            if self.supervision > 0.0:
                own, other = sequence.Ts_world_camera[[index, index + offset]]
                sample[f"T_{name}_own"] = (invert(other) @ own).astype(np.float32)
        if "depth" in sequence.channels:
            sample["depth"] = letterbox.nearest(sequence.image("depth", index), np.nan)
        sample["view"] = (letterbox, sequence.camera)
        return {**sample, **(_true_flows(sample) if self.supervision > 0.0 else {})}

    def inputs(
        self, image: UInt8[np.ndarray, "h w 3"], letterbox: Letterbox, camera: Camera | None
    ) -> Sample:
        """Return the image and unit rays, zero where the lens has none.

        Raises:
            InputError: If there is no camera.
        """
        return image_and_rays(image, letterbox, camera)

    def augment(self, sample: Sample, rng: np.random.Generator) -> Sample:
        """Apply the same change of exposure, white balance and gamma to all three frames.

        With labels alone, also crop, mirror and transpose them.
        """
        if self._is_geometry_free:
            sample = cropped(sample, self.min_crop, rng) if rng.random() < 0.5 else sample
            for axis in (0, 1):
                sample = mirrored(sample, axis) if rng.random() < 0.5 else sample
            sample = transposed(sample) if rng.random() < 0.5 else sample
        gain = 1.2 ** rng.uniform(-1.0, 1.0) * rng.uniform(0.95, 1.05, 3)
        gamma = rng.uniform(0.9, 1.1)
        changed = {n: with_gain(sample[n], gain, gamma) for n in ("image", *_NEIGHBORS)}
        return sample | changed

    @property
    def _is_geometry_free(self) -> bool:
        """Whether the loss projects no points by the lens of the whole image."""
        return self.photometric_weight == 0.0 and self.geometry_weight == 0.0

    def network(self, *, is_pretrained: bool) -> nn.Module:
        """Create a network from batches to ln(distance / 30 mm) [b 1 s s], and motion."""
        return SfmNetwork(self.backbone, self.has_light_cue, is_pretrained=is_pretrained)

    def loss(self, network: nn.Module, batch: Batch) -> Losses:
        """Loss terms over both neighbors."""
        image, ray = batch["image"], batch["ray"]
        photometric, geometry, labels = (image.new_zeros(()) for _ in range(3))
        own = self._trained_output(network, batch)
        moves = cast(SfmNetwork, network).moves
        frames = torch.cat([image, *(batch[name] for name in _NEIGHBORS)])
        features = moves.encode(frames).split(len(image))
        for name, there in zip(_NEIGHBORS, features[1:], strict=True):
            flow = moves.flow(features[0], there, ray)
            T_other_own = pose_matrix(motion_from_flow(flow, ray, own.detach()))
            if not self._is_geometry_free:
                other = self._trained_output(network, {"image": batch[name], "ray": ray})
                view = synthesize_view(batch[name], other, own, T_other_own, ray, batch["view"])
                unlike, color = inconsistency(view), view.color
                if self.matches_brightness:
                    color = match_brightness(color, image, view.is_valid)
                error = photometric_error(color, image) * (1.0 - unlike)
                count = view.is_valid.sum().clamp(min=1)
                photometric = photometric + (error * view.is_valid).sum() / count
                geometry = geometry + (unlike * view.is_valid).sum() / count
            if self.supervision > 0.0:
                labels = labels + motion_error(T_other_own, batch[f"T_{name}_own"])
                labels = labels + flow_error(flow, batch[f"flow_{name}"])
        if self.supervision > 0.0 and self.trains_distances:
            labels = labels + depth_loss(own, distances_of(batch), _GRADIENT_WEIGHT)["loss"]
        return total(
            {
                "photometric": 0.5 * self.photometric_weight * photometric,
                "geometry": 0.5 * self.geometry_weight * geometry,
                "smoothness": self.smoothness_weight * smoothness(own, image),
                "labels": self.supervision * labels,
            }
        )

    def _trained_output(self, network: nn.Module, batch: Batch) -> Tensor:
        """Distances, without gradients if they are not trained."""
        with nullcontext() if self.trains_distances else torch.no_grad():
            return self.output(network, batch)

    def outputs(self, network: nn.Module, batch: Batch) -> dict[str, Tensor]:
        """Return the distances, and the motion between neighbors in the batch."""
        image, ray, own = batch["image"], batch["ray"], self.output(network, batch)
        moves = cast(SfmNetwork, network).moves
        return {"output": own, "motion": moves(image, image.roll(1, 0), ray, own)}

    def terms(self, output: NDArray, sample: Sample) -> DepthTerms | None:
        """Depth errors of one frame; None if its true depth is not known."""
        if "depth" not in sample:
            return None
        return depth_terms(_depth_of(output, sample), sample["depth"])

    def summary(self, terms: Sequence[DepthTerms | None]) -> Mapping[str, float]:
        """Depth errors after scaling by the median of each frame, where true depth is known."""
        known = [one for one in terms if one is not None]
        if not known:
            return {}
        both = depth_summary(known)
        return {"abs_rel": both["abs_rel_median"], "rank": both["rank"]}

    def baselines(
        self, samples: Sequence[Sample], groups: Sequence[str]
    ) -> Mapping[str, Sequence[NDArray]]:
        """A constant depth, the mean image of other groups, and brightness."""
        if any("depth" not in sample for sample in samples):
            return {}
        baselines = log_depth_baselines(samples, groups)
        shift = [np.log(MIDDLE * np.maximum(one["ray"][..., 2], MIN_COSINE)) for one in samples]
        return {
            name: [(log - own)[None] for log, own in zip(logs, shift, strict=True)]
            for name, logs in baselines.items()
        }

    def picture(self, output: NDArray, sample: Sample) -> UInt8[np.ndarray, "s k 3"]:
        """Image, true depth if it is known, and predicted depth scaled to it."""
        depth = _depth_of(output, sample)
        if "depth" in sample:
            depth *= np.nanmedian(sample["depth"]) / np.median(depth)
        return depth_picture(depth, sample)

    def files(self, output: NDArray, letterbox: Letterbox) -> Mapping[str, NDArray]:
        """Distance along the ray in 16 bits, in steps of 10 µm, at a reference scale of 30 mm."""
        return {".png": CHANNELS["ray_distance"].encoding.encode(letterbox.back(depth_of(output)))}

    def sequence_errors(
        self, network: nn.Module, sequence: FrameSequence, device: str
    ) -> Mapping[str, Mapping[str, float]]:
        """Errors of the trajectory, of a static camera and of a constant velocity."""
        if CAMERA_POSE not in sequence.values or len(sequence) < _MIN_POSES:
            return {}
        truth = sequence.Ts_world_camera
        estimate = self.trajectory(network, sequence, device=device).Ts_world_camera
        estimates = {"network": estimate, **motion_baselines(truth)}
        return {name: motion_errors(poses, truth) for name, poses in estimates.items()}

    def sequence_files(
        self,
        network: nn.Module,
        sequence: FrameSequence,
        frames: Sequence[int],
        *,
        device: str,
        on_frame: Callable[[], None],
    ) -> Mapping[str, bytes]:
        """Predicted trajectory of a sequence in TUM format."""
        trajectory = self.trajectory(network, sequence, frames, device=device, on_frame=on_frame)
        return {"trajectory.txt": trajectory_text(trajectory).encode()}

    def trajectory(
        self,
        network: nn.Module,
        sequence: FrameSequence,
        frames: Sequence[int] = (),
        *,
        device: str = "cpu",
        on_frame: Callable[[], None] = lambda: None,
    ) -> FrameSequence:
        """Predict the trajectory of a sequence, in the frame of its first camera.

        Motions between neighboring frames are chained; they are known up to one scale.

        Args:
            network: Trained network.
            sequence: Frames of one camera.
            frames: Increasing indices of the frames to use; the result has only these. Empty for
                all.
            device: Device of the network.
            on_frame: Called after each frame.

        Returns:
            The sequence with the predicted poses.

        Raises:
            InputError: If an image cannot be read.
        """
        if sequence.camera is None:
            raise InputError(LENS_NEEDED)
        kept = np.array(frames or range(len(sequence)))
        region = common_region(sequence, kept)
        moves, poses, before = cast(SfmNetwork, network).moves, [np.eye(4)], None
        with torch.inference_mode():
            for index in kept:
                here = self._encoded(network, sequence, int(index), region, device)
                if before is not None:
                    step = step_between(before, here, moves, aligns=self.aligns)
                    poses.append(poses[-1] @ step)
                before = here
                on_frame()
        values = {TIME: sequence.times[kept], CAMERA_POSE: np.stack(poses)}
        return replace(sequence.subset(kept), values=values)

    def _encoded(
        self, network: nn.Module, sequence: FrameSequence, index: int, region: Region, device: str
    ) -> Encoded:
        """Inputs, features and distances of one frame."""
        image = np.ascontiguousarray(sequence.image("rgb", index)[region])
        letterbox = Letterbox(image.shape[0], image.shape[1], self.input_size)
        camera = part_of(cast("Camera", sequence.camera), *region)
        batch = batch_of([self.inputs(image, letterbox, camera)], device)
        features = cast(SfmNetwork, network).moves.encode(batch["image"])
        return Encoded(batch["image"], batch["ray"], features, self.output(network, batch))


class SfmNetwork(DepthNetwork):
    """Distances of one frame, and the motion between two."""

    def __init__(self, backbone: Backbone, has_light_cue: bool, *, is_pretrained: bool) -> None:
        super().__init__(backbone, has_light_cue, is_pretrained=is_pretrained)
        self.moves = MotionNetwork()

    def forward(self, image: Tensor, *maps: Tensor) -> Tensor:
        """Return ln(distance / 30 mm) [b 1 s s] of color images and rays, from depth along z."""
        along = maps[0][:, 2:]
        cosine = torch.where(along > 0.0, along.clamp(min=MIN_COSINE), 1.0)
        return super().forward(image, *maps) - torch.log(cosine)


def _true_flows(sample: Sample) -> Sample:
    """True flow [h w 2] to each neighbor, of a static wall."""
    batch = batch_of([{name: sample[name] for name in ("ray", "depth", "view")}])
    flows = {}
    for name in _NEIGHBORS:
        flow = true_flow(batch, torch.from_numpy(sample[f"T_{name}_own"][None]))
        flows[f"flow_{name}"] = flow[0].permute(1, 2, 0).numpy().astype(np.float32)
    return flows


def _depth_of(output: NDArray, sample: Sample) -> NDArray:
    """Depth z from distances along rays."""
    return depth_of(output) * np.maximum(sample["ray"][..., 2], 0.0)
