"""Metric depth from a single image, trained on exact labels.

Besides color, the network's input is each pixel's ray, so that one network works for any lens, and
a light cue: the LEDs are next to the lens, so the brightness of a wall falls with the square of its
distance. Half the negative logarithm of brightness is therefore the logarithm of distance up to
albedo, incidence and exposure.

The loss is on d = ln prediction − ln ground truth: its mean absolute value, its variance
(scale-invariant error, Eigen et al., NIPS 2014, eq. 4 with λ = 1), and its gradients at four scales
(Li and Snavely, CVPR 2018, eq. 4).
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import asdict, dataclass
from typing import TYPE_CHECKING, Annotated, Any, ClassVar

import numpy as np

from vrcaps.config.limits import Range, check_fields
from vrcaps.core.errors import InputError
from vrcaps.learn.letterbox import Letterbox, require_size
from vrcaps.learn.networks import ENCODER, dense_network, require_torch
from vrcaps.learn.picture_border import input_image, view_of
from vrcaps.learn.task import (
    MAX_SIZE,
    MAX_WEIGHT,
    Batch,
    Metric,
    Sample,
    flip,
    outputs_of,
    recolored,
    transposed,
    zoomed,
)
from vrcaps.metrics.depth import depth_errors, mean_depth_errors
from vrcaps.recording.frame_sequence import FrameSequence
from vrcaps.render.channels import CHANNELS

if TYPE_CHECKING:
    from jaxtyping import Float, UInt8
    from numpy.typing import NDArray

    from vrcaps.camera.camera import Camera

MIDDLE = 0.03
"""Depth [m] at an output of 0."""

LENS_NEEDED = (
    "Depth needs the lens of the camera that took the images. Give --capsule NAME (a name of the "
    "catalog such as colonoscope, or a device file), or --fov DEGREES for an assumed lens, such "
    "as --fov 140."
)
_DARK = 0.004
"""Offset of the linear brightness in the light cue: one step of 8 bits."""
_SCALES = 4


@dataclass(frozen=True)
class DepthTask:
    """Depth z of every pixel [m].

    Attributes:
        size: Side of the network's input images [px]; maps need a multiple of 32.
        encoder: Name of a timm model, such as resnet152.
        has_light_cue: Whether the light cue is an input of the network.
        gradient_weight: Weight of the gradient loss.
        brightness: Maximum random change of exposure, as a factor: 1.3 is ± 30 %.
        tint: Maximum random change of each color channel, as a factor.
        gamma: Maximum random exponent. With 1 for this and both above, colors are not changed; use
            it for one camera with known exposure and light.
        zoom: Minimum side of a random crop, relative to the frame; 1 is the whole frame.
    """

    size: Annotated[int, Range(32, MAX_SIZE)] = 192
    encoder: str = ENCODER
    has_light_cue: bool = True
    gradient_weight: Annotated[float, Range(0.0, MAX_WEIGHT)] = 0.5
    brightness: Annotated[float, Range(1.0, 10.0)] = 1.2
    tint: Annotated[float, Range(1.0, 10.0)] = 1.2
    gamma: Annotated[float, Range(1.0, 10.0)] = 1.15
    zoom: Annotated[float, Range(above=0.0, max=1.0)] = 0.6

    kind: ClassVar[str] = "depth"
    input_names: ClassVar[tuple[str, ...]] = ("image", "ray")
    output_text: ClassVar[str] = "ln(depth z / 30 mm) of each pixel [b 1 s s]"
    figure: ClassVar[Metric] = Metric("abs_rel", is_error=True)

    def __post_init__(self) -> None:
        check_fields(self)
        require_size(self.size)

    def items(self, sequence: FrameSequence) -> Iterable[int]:
        """Return all frames of a sequence with images, depth and a camera.

        Raises:
            InputError: If one of the three is missing.
        """
        missing = [name for name in ("rgb", "depth") if name not in sequence.channels]
        if missing or sequence.camera is None:
            what = f"the channel {missing[0]!r}" if missing else "a calibrated camera"
            raise InputError(f"Learning depth needs {what}, which {sequence.name} has not.")
        return range(len(sequence))

    def sample(self, sequence: FrameSequence, index: int) -> Sample:
        """Return the image without its black border, the rays, and the true depth or NaN."""
        view = view_of(self.kind, sequence, input_image(self.kind, sequence, index))
        fit = Letterbox(view.image.shape[0], view.image.shape[1], self.size)
        depth = sequence.image("depth", index)[view.place]
        truth = fit.nearest(np.where(view.is_insert, np.nan, depth), np.nan)
        return {**self.inputs(view.image, fit, view.camera), "depth": truth}

    def inputs(
        self, image: UInt8[np.ndarray, "h w 3"], fit: Letterbox, camera: Camera | None
    ) -> Sample:
        """Return the image and unit rays, zero where the lens has none.

        Raises:
            InputError: If there is no camera.
        """
        return image_and_rays(image, fit, camera)

    def augmented(self, sample: Sample, rng: np.random.Generator) -> Sample:
        """Apply a random crop, flips and transposition, and color jitter to half of the samples.

        Brightness is a cue of distance. The loss is mainly absolute, so it is minimal at the
        median: as half of the images keep their colors, the prediction keeps their scale.
        """
        sample = zoomed(sample, rng, self.zoom)
        for axis, component in ((1, 0), (0, 1)):
            if rng.random() < 0.5:
                sample = flip(sample, axis)
                sample["ray"][..., component] *= -1.0
        if rng.random() < 0.5:
            sample = transposed(sample)
            sample["ray"] = sample["ray"][..., [1, 0, 2]]
        if rng.random() < 0.5:
            return sample
        image = recolored(
            sample["image"], rng, exposure=self.brightness, tint=self.tint, gamma=self.gamma
        )
        return sample | {"image": image}

    def network(self, *, is_pretrained: bool) -> Any:
        """Create a network from batches to ln(depth / 30 mm) [b 1 s s]."""
        return _network_class()(self.encoder, self.has_light_cue, is_pretrained)

    def loss(self, network: Any, batch: Batch) -> dict[str, Any]:
        """Loss terms over the pixels that have a true depth."""
        return self.output_loss(outputs_of(network, self, batch), batch)

    def output_loss(self, output: Any, batch: Batch) -> dict[str, Any]:
        """Loss terms of an output [b 1 s s]."""
        torch = require_torch()
        truth = batch["depth"]
        valid = torch.isfinite(truth) & (truth > 0.0)
        target = torch.log(torch.where(valid, truth, MIDDLE) / MIDDLE)
        error = torch.where(valid, output[:, 0] - target, 0.0)
        count = valid.sum(dim=(1, 2)).clamp(min=1)
        mean = error.sum(dim=(1, 2)) / count
        terms = {
            "absolute": (error.abs().sum(dim=(1, 2)) / count).mean(),
            "variance": ((error**2).sum(dim=(1, 2)) / count - mean**2).mean(),
            "gradient": self.gradient_weight * _gradients(error, valid),
        }
        return {**terms, "loss": sum(terms.values())}

    def scores(self, outputs: Iterable[NDArray], samples: Iterable[Sample]) -> Mapping[str, float]:
        """Errors without alignment, and the relative error after scaling by the median."""
        plain, aligned = [], []
        for output, sample in zip(outputs, samples, strict=True):
            estimate = depth_of(output)
            plain.append(depth_errors(estimate, sample["depth"]))
            aligned.append(depth_errors(estimate, sample["depth"], align="median"))
        return {
            **asdict(mean_depth_errors(plain)),
            "abs_rel_median": mean_depth_errors(aligned).abs_rel,
        }

    def picture(self, output: NDArray, sample: Sample) -> UInt8[np.ndarray, "s k 3"]:
        """Image, true depth and predicted depth on one color scale."""
        return depth_picture(depth_of(output), sample)

    def files(self, output: NDArray, fit: Letterbox) -> Mapping[str, NDArray]:
        """Depth in 16 bits, in steps of 10 µm as in an episode."""
        return {".png": CHANNELS["depth"].encoding.encode(fit.back(depth_of(output)))}

    def row(self, output: NDArray) -> Mapping[str, Any]:
        """Return no columns."""
        return {}


def image_and_rays(
    image: UInt8[np.ndarray, "h w 3"], fit: Letterbox, camera: Camera | None
) -> Sample:
    """Image and unit rays in the square, zero where the lens has none.

    Raises:
        InputError: If there is no camera.
    """
    if camera is None:
        raise InputError(LENS_NEEDED)
    rays = np.nan_to_num(camera.lens.unproject(fit.pixels.astype(float)))
    return {"image": fit.image(image), "ray": fit.padded(rays.astype(np.float32), 0.0)}


def depth_of(output: Float[np.ndarray, "1 s s"]) -> Float[np.ndarray, "s s"]:
    """Depth [m] of a network's output."""
    return MIDDLE * np.exp(output[0])


def depth_picture(depth: Float[np.ndarray, "s s"], sample: Sample) -> UInt8[np.ndarray, "s k 3"]:
    """Image, true depth if it is known, and predicted depth on one color scale."""
    from matplotlib import colormaps

    maps = [sample["depth"], depth] if "depth" in sample else [depth]
    low, high = np.nanpercentile(np.stack(maps), [1.0, 99.0])
    shown = [(one - low) / max(high - low, 1e-9) for one in maps]
    colored = [(colormaps["turbo"](one)[..., :3] * 255.0).astype(np.uint8) for one in shown]
    return np.concatenate([sample["image"], *colored], axis=1)


def light_cue(image: Any) -> Any:
    """−½ ln of linear brightness [b 1 s s], from color [b 3 s s] between 0 and 1."""
    torch = require_torch()
    linear = torch.where(image <= 0.04045, image / 12.92, ((image + 0.055) / 1.055) ** 2.4)
    return -0.5 * torch.log(linear.mean(dim=1, keepdim=True) + _DARK)


def _gradients(error: Any, valid: Any) -> Any:
    """Mean absolute difference between the errors of neighbors, over scales 1, 2, 4, 8."""
    total = 0.0
    for step in (2**k for k in range(_SCALES)):
        e, v = error[:, ::step, ::step], valid[:, ::step, ::step]
        across, down = v[:, :, 1:] & v[:, :, :-1], v[:, 1:] & v[:, :-1]
        total = total + ((e[:, :, 1:] - e[:, :, :-1]).abs() * across).sum() / across.sum().clamp(1)
        total = total + ((e[:, 1:] - e[:, :-1]).abs() * down).sum() / down.sum().clamp(1)
    return total


def _network_class() -> Any:
    torch = require_torch()

    class DepthNetwork(torch.nn.Module):
        """U-Net on color, rays and the light cue."""

        def __init__(self, encoder: str, has_light_cue: bool, is_pretrained: bool) -> None:
            super().__init__()
            self.has_light_cue = has_light_cue
            self.net = dense_network(encoder, 6 + has_light_cue, 1, is_pretrained=is_pretrained)

        def forward(self, image: Any, ray: Any) -> Any:
            maps = [2.0 * image - 1.0, ray]
            if self.has_light_cue:
                maps.append(light_cue(image))
            return self.net(torch.cat(maps, dim=1))

    return DepthNetwork
