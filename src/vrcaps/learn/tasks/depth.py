"""Metric depth from a single image, trained on exact labels.

Besides color, the network's input is each pixel's ray, so that one network works for any lens, and
a light cue: the LEDs are next to the lens, so the brightness of a wall falls with the square of its
distance. Half the negative logarithm of brightness is therefore the logarithm of distance up to
albedo, incidence and exposure.

Images are converted to the camera's own exposure where their exposure is known. Colors then exceed
1 where a camera with this exposure would saturate; they are compressed by a logarithm, but not the
light cue.

The loss is on d = ln prediction − ln ground truth: its mean absolute value, its variance
(scale-invariant error, Eigen et al., NIPS 2014, eq. 4 with λ = 1), and its gradients at four scales
(Li and Snavely, CVPR 2018, eq. 4).
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass, field
from typing import TYPE_CHECKING, Annotated, ClassVar, TypeAlias

import numpy as np
import torch
from torch import Tensor, nn

from vrcaps.core.color import linear_from_srgb, srgb_from_linear, turbo
from vrcaps.core.errors import InputError
from vrcaps.core.fields import Range, check_fields
from vrcaps.learn.augment import Augmentation, flip, transpose
from vrcaps.learn.baselines import log_depth_baselines
from vrcaps.learn.networks import MIRRORED, Backbone, UNet, mirror
from vrcaps.learn.picture_border import (
    LENS_NEEDED,
    Letterbox,
    PictureView,
    log_scale_of,
    view_of,
)
from vrcaps.learn.task import (
    MAX_WEIGHT,
    BackboneTask,
    Batch,
    Losses,
    Metric,
    Sample,
    scalars,
    total,
)
from vrcaps.metrics.depth import DepthErrors, depth_errors, mean_depth_errors
from vrcaps.recording.frame_sequence import FrameSequence
from vrcaps.render.channels import CHANNELS

if TYPE_CHECKING:
    from jaxtyping import Float, UInt8
    from numpy.typing import NDArray

    from vrcaps.camera.camera import Camera

MIDDLE = 0.03
"""Depth [m] at an output of 0."""

_DARK = 0.004
"""Offset of the linear brightness in the light cue: one step of 8 bits."""
_SCALES = 4
DepthTerms: TypeAlias = tuple[DepthErrors, float, float, float]
"""Depth errors of one frame: unaligned, scaled by the median, rank correlation, ln scale."""


@dataclass(frozen=True)
class DepthTask(BackboneTask[DepthTerms]):
    """Metric depth z of every pixel [m].

    Attributes:
        backbone: Input size and encoder of the network.
        has_light_cue: Whether the light cue, −½ ln of the linear brightness, which falls with the
            square of distance, is an input of the network.
        gradient_weight: Weight of the gradient loss.
        normalizes_exposure: Whether an image of unknown exposure is divided by the exposure that
            its brightness implies, so that predictions do not depend on it. Otherwise predicted
            distances are scaled by the root of its median brightness relative to recordings, and
            independence of it depends on training.
        mirroring: Whether a prediction is the mean over the image and its three mirror images
            (test-time augmentation), which takes four times as long.
        exposure_dropout: Fraction of training images whose exposure is treated as unknown: changed
            by up to a factor of `max_exposure`, and compensated as in prediction.
        max_exposure: Maximum change of such an exposure, as a factor. High ones saturate large
            parts of images.
        augmentation: Random changes of training images. Colors are changed only where the exposure
            is unknown.
    """

    backbone: Backbone = field(default_factory=Backbone)
    has_light_cue: bool = True
    gradient_weight: Annotated[float, Range(0.0, MAX_WEIGHT)] = 0.5
    normalizes_exposure: bool = False
    mirroring: bool = False
    exposure_dropout: Annotated[float, Range(0.0, 1.0)] = 0.25
    max_exposure: Annotated[float, Range(1.0, 16.0)] = 4.0
    augmentation: Augmentation = field(default_factory=lambda: Augmentation(1.2, 1.2, 1.15, 0.6))

    kind: ClassVar[str] = "depth"
    pipeline_tag: ClassVar[str] = "depth-estimation"
    input_names: ClassVar[tuple[str, ...]] = ("image", "ray")
    optional_inputs: ClassVar[tuple[str, ...]] = ("log_scale", "exposure")
    output_text: ClassVar[str] = "ln(depth z / 30 mm) of each pixel [b 1 s s]"
    metric: ClassVar[Metric] = Metric("abs_rel", is_error=True)
    predicts_lengths: ClassVar[bool] = True

    def __post_init__(self) -> None:
        check_fields(self)
        self.backbone.require_stride()

    def items(self, sequence: FrameSequence) -> Iterable[int]:
        """Return all frames of a sequence with images, depth and a camera.

        Raises:
            InputError: If one of the three is missing.
        """
        missing = [name for name in ("rgb", "depth") if name not in sequence.channels]
        if missing or sequence.camera is None:
            what = f"the channel {missing[0]!r}" if missing else "a calibrated camera"
            raise InputError(f"Training for depth requires {what}. {sequence.name} has none.")
        return range(len(sequence))

    def sample(self, sequence: FrameSequence, index: int) -> Sample:
        """Return the image without its black border, the rays, and the true depth or NaN."""
        view = view_of(sequence, index, predicts_lengths=True)
        letterbox = Letterbox(view.image.shape[0], view.image.shape[1], self.input_size)
        depth = sequence.image("depth", index)[view.region]
        truth = letterbox.nearest(np.where(view.is_insert, np.nan, depth), np.nan)
        return {**self.view_inputs(view), "depth": truth}

    def view_inputs(self, view: PictureView) -> Sample:
        """Return image, unit rays, exposure, and ln of the scale at an unknown exposure."""
        stated = scalars(log_scale=view.log_scale, exposure=view.exposure)
        return {**super().view_inputs(view), **stated}

    def inputs(
        self, image: UInt8[np.ndarray, "h w 3"], letterbox: Letterbox, camera: Camera | None
    ) -> Sample:
        """Return the image and unit rays, zero where the lens has none.

        Raises:
            InputError: If there is no camera.
        """
        return image_and_rays(image, letterbox, camera)

    def augment(self, sample: Sample, rng: np.random.Generator) -> Sample:
        """Apply a random crop, flips and transposition; recolor images of unknown exposure.

        Brightness is a cue of distance where the exposure is known, so these colors are kept.
        Images whose exposure is dropped stand for those of other cameras.
        """
        sample = self.augmentation.crop(sample, rng)
        for axis, component in ((1, 0), (0, 1)):
            if rng.random() < 0.5:
                sample = flip(sample, axis)
                sample["ray"][..., component] *= -1.0
        if rng.random() < 0.5:
            sample = transpose(sample)
            sample["ray"] = sample["ray"][..., [1, 0, 2]]
        image = sample["image"]
        if rng.random() < self.exposure_dropout:
            image = _exposed(image, self.max_exposure ** rng.uniform(-1.0, 1.0))
        elif sample.get("log_scale", 0.0) == 0.0:
            return sample
        image = self.augmentation.recolor(image, rng)
        return sample | {"image": image} | scalars(log_scale=log_scale_of(image), exposure=1.0)

    def network(self, *, is_pretrained: bool) -> nn.Module:
        """Create a network from batches to ln(depth / 30 mm) [b 1 s s]."""
        return DepthNetwork(
            self.backbone,
            self.has_light_cue,
            is_pretrained=is_pretrained,
            mirroring=self.mirroring,
        )

    def output(self, network: nn.Module, batch: Batch) -> Tensor:
        """Return ln(depth / 30 mm) [b 1 s s] of images, converted to the camera's own exposure."""
        log_scale, exposure = batch.get("log_scale"), batch.get("exposure")
        if self.normalizes_exposure and log_scale is not None and exposure is not None:
            exposure, log_scale = exposure * torch.exp(2.0 * log_scale), None
        if exposure is not None:
            linear = _linear(batch["image"]) / exposure.view(-1, 1, 1, 1)
            batch = {**batch, "image": _encoded(linear)}
        output = super().output(network, batch)
        return output if log_scale is None else output + log_scale.view(-1, 1, 1, 1)

    def loss(self, network: nn.Module, batch: Batch) -> Losses:
        """Loss terms over the pixels that have a true depth."""
        return depth_loss(self.output(network, batch), batch["depth"], self.gradient_weight)

    def terms(self, output: NDArray, sample: Sample) -> DepthTerms:
        """Errors of one frame without alignment and after scaling by the median, rank and scale."""
        return depth_terms(depth_of(output), sample["depth"])

    def summary(self, terms: Sequence[DepthTerms]) -> Mapping[str, float]:
        """Means over frames; `scale` is the geometric mean of median prediction over median truth.

        `rank` is Spearman's correlation: it needs no scale, and is 0 for a constant.
        """
        return depth_summary(terms)

    def baselines(
        self, samples: Sequence[Sample], groups: Sequence[str]
    ) -> Mapping[str, Sequence[NDArray]]:
        """A constant, the mean image of other groups, and brightness."""
        baselines = log_depth_baselines(samples, groups)
        middle = np.log(MIDDLE)
        return {name: [(one - middle)[None] for one in logs] for name, logs in baselines.items()}

    def picture(self, output: NDArray, sample: Sample) -> UInt8[np.ndarray, "s k 3"]:
        """Image, true depth and predicted depth on one color scale."""
        return depth_picture(depth_of(output), sample)

    def files(self, output: NDArray, letterbox: Letterbox) -> Mapping[str, NDArray]:
        """Depth in 16 bits, in steps of 10 µm as in an episode."""
        return {".png": CHANNELS["depth"].encoding.encode(letterbox.back(depth_of(output)))}


def _exposed(image: UInt8[np.ndarray, "s s 3"], factor: float) -> UInt8[np.ndarray, "s s 3"]:
    """Change the exposure of an image by a factor; saturated values are lost."""
    return srgb_from_linear(np.clip(factor * linear_from_srgb(image), 0.0, 1.0))


def depth_terms(estimate: Float[np.ndarray, "s s"], truth: Float[np.ndarray, "s s"]) -> DepthTerms:
    """Depth errors of one frame, see `DepthTerms`."""
    from scipy.stats import rankdata

    with np.errstate(invalid="ignore"):
        known = np.isfinite(estimate) & (truth > 0.0)
    d, t = estimate[known], truth[known]
    plain = depth_errors(d, t)
    aligned = depth_errors(d, t, align="median")
    rank = float(np.corrcoef(rankdata(d), rankdata(t))[0, 1]) if np.ptp(d) * np.ptp(t) else 0.0
    return plain, aligned.abs_rel, rank, float(np.log(np.median(d) / np.median(t)))


def depth_summary(terms: Sequence[DepthTerms]) -> Mapping[str, float]:
    """Means of the depth errors of frames, and the geometric mean of their scales."""
    plain, aligned, rank, log_scale = zip(*terms, strict=True)
    return {
        **asdict(mean_depth_errors(plain)),
        "abs_rel_median": float(np.mean(aligned)),
        "rank": float(np.mean(rank)),
        "scale": float(np.exp(np.mean(log_scale))),
    }


class DepthNetwork(UNet):
    """U-Net on color, rays and the light cue; with `mirroring`, the mean over mirror images."""

    def __init__(
        self,
        backbone: Backbone,
        has_light_cue: bool,
        *,
        is_pretrained: bool,
        mirroring: bool = False,
    ) -> None:
        super().__init__(backbone, 6 + has_light_cue, 1, is_pretrained=is_pretrained)
        self.has_light_cue, self.mirroring = has_light_cue, mirroring

    def forward(self, image: Tensor, *maps: Tensor) -> Tensor:
        """Return ln(depth / 30 mm) [b 1 s s] of color images and rays."""
        if self.training or not self.mirroring:
            return self._log_depth(image, *maps)
        (ray,) = maps
        log_depths = []
        for axes in MIRRORED:
            # Mirrored columns change the sign of a ray's x, mirrored rows that of its y.
            sign = ray.new_tensor([1.0 - 2.0 * (axis in axes) for axis in (3, 2, 1)])
            mirrored = mirror(ray, axes) * sign.view(3, 1, 1)
            log_depths.append(mirror(self._log_depth(mirror(image, axes), mirrored), axes))
        return torch.stack(log_depths).mean(dim=0)

    def _log_depth(self, image: Tensor, *maps: Tensor) -> Tensor:
        cue = [light_cue(image)] if self.has_light_cue else []
        compressed = torch.where(image > 1.0, 1.0 + 0.5 * torch.log(image.clamp(min=1.0)), image)
        return super().forward(compressed, *maps, *cue)


def depth_loss(output: Tensor, depth: Tensor, gradient_weight: float) -> Losses:
    """Loss terms of an output [b 1 s s] over the pixels that have a true depth.

    Args:
        output: ln(depth / 30 mm).
        depth: True depth [m] [b s s], NaN or 0 where it is not known.
        gradient_weight: Weight of the gradient loss.
    """
    valid = torch.isfinite(depth) & (depth > 0.0)
    target = torch.log(torch.where(valid, depth, MIDDLE) / MIDDLE)
    error = torch.where(valid, output[:, 0] - target, 0.0)
    count = valid.sum(dim=(1, 2)).clamp(min=1)
    mean = error.sum(dim=(1, 2)) / count
    return total(
        {
            "absolute": (error.abs().sum(dim=(1, 2)) / count).mean(),
            "variance": ((error**2).sum(dim=(1, 2)) / count - mean**2).mean(),
            "gradient": gradient_weight * _gradients(error, valid),
        }
    )


def image_and_rays(
    image: UInt8[np.ndarray, "h w 3"], letterbox: Letterbox, camera: Camera | None
) -> Sample:
    """Image and unit rays in the square, zero where the lens has none.

    Raises:
        InputError: If there is no camera.
    """
    if camera is None:
        raise InputError(LENS_NEEDED)
    rays = np.nan_to_num(camera.lens.unproject(letterbox.pixels.astype(float)))
    return {"image": letterbox.image(image), "ray": letterbox.padded(rays.astype(np.float32), 0.0)}


def depth_of(output: Float[np.ndarray, "1 s s"]) -> Float[np.ndarray, "s s"]:
    """Depth [m] of a network's output."""
    return MIDDLE * np.exp(output[0])


def depth_picture(depth: Float[np.ndarray, "s s"], sample: Sample) -> UInt8[np.ndarray, "s k 3"]:
    """Image, true depth if it is known, and predicted depth on one color scale."""
    maps = [sample["depth"], depth] if "depth" in sample else [depth]
    low, high = np.nanpercentile(np.stack(maps), [1.0, 99.0])
    scaled = [(one - low) / max(high - low, 1e-9) for one in maps]
    colored = [(turbo(one) * 255.0).astype(np.uint8) for one in scaled]
    return np.concatenate([sample["image"], *colored], axis=1)


def light_cue(image: Tensor) -> Tensor:
    """−½ ln of linear brightness [b 1 s s], from sRGB color [b 3 s s]."""
    return -0.5 * torch.log(_linear(image).mean(dim=1, keepdim=True) + _DARK)


def _linear(color: Tensor) -> Tensor:
    """Linear values of sRGB-encoded ones, also above 1."""
    return torch.where(color <= 0.04045, color / 12.92, ((color + 0.055) / 1.055) ** 2.4)


def _encoded(linear: Tensor) -> Tensor:
    """Inverse of `_linear`."""
    high = 1.055 * linear.clamp(min=0.0031308) ** (1.0 / 2.4) - 0.055
    return torch.where(linear <= 0.0031308, 12.92 * linear, high)


def _gradients(error: Tensor, valid: Tensor) -> Tensor:
    """Mean absolute difference between the errors of neighbors, over scales 1, 2, 4, 8."""
    result = torch.zeros((), device=error.device)
    for step in (2**k for k in range(_SCALES)):
        e, v = error[:, ::step, ::step], valid[:, ::step, ::step]
        across, down = v[:, :, 1:] & v[:, :, :-1], v[:, 1:] & v[:, :-1]
        for slope, known in ((e[:, :, 1:] - e[:, :, :-1], across), (e[:, 1:] - e[:, :-1], down)):
            result = result + (slope.abs() * known).sum() / known.sum().clamp(1)
    return result
