"""Trivial baselines of the tasks, as outputs in the format of a network.

A metric says little without them: a network that does not beat them has learned nothing of use. All
but the mean image are fitted to the ground truth of the evaluated frames themselves, which favors
the baselines. The mean image is the mean over the frames of other groups (see `frame_groups`).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING

import numpy as np

from vrcaps.core.color import linear_from_srgb
from vrcaps.learn.task import Sample
from vrcaps.metrics.labels import dice

if TYPE_CHECKING:
    from jaxtyping import Bool, Float, UInt8
    from numpy.typing import NDArray

    Outputs = list[NDArray]
    Fit = Callable[[Sample], Float[np.ndarray, "s s"]]

_DARK = 0.004
"""Offset of the linear brightness: one step of 8 bits."""
_BLUR = 1.0 / 50.0
"""Standard deviation of the blur of brightness, relative to the side, against highlights."""
_RADII = np.linspace(0.1, 0.5, 9)
"""Radii of centered discs that are tried, relative to the side of the image."""
_LEVELS = np.linspace(0.02, 0.98, 25)
"""Quantiles of redness that are tried as thresholds."""


def log_depth_baselines(samples: Sequence[Sample], groups: Sequence[str]) -> dict[str, Outputs]:
    """Logarithm of depth [m] [s s] of each frame: one constant, the mean image, and by brightness.

    By brightness, depth is proportional to one over the root of blurred linear brightness: exact
    for LEDs at the lens, a wall of one color that faces the camera, and known exposure.

    Args:
        samples: Frames with `depth` [m] [s s], NaN where it is not known, and with `exposure` if it
            is known and not 1.
        groups: Group of each frame.
    """
    logs = np.stack([_log(sample["depth"]) for sample in samples])
    middle = float(np.nanmedian(logs))
    cues = [
        _light_distance(one["image"]) + 0.5 * np.log(one.get("exposure", 1.0)) for one in samples
    ]
    offset = np.nanmedian([np.nanmedian(log - cue) for log, cue in zip(logs, cues, strict=True)])
    return {
        "constant": [np.full(logs.shape[1:], middle) for _ in samples],
        "mean image": _mean_of_others(logs, groups, middle),
        "brightness": [cue + offset for cue in cues],
    }


def _log(depth: Float[np.ndarray, "s s"]) -> Float[np.ndarray, "s s"]:
    with np.errstate(invalid="ignore"):
        return np.log(np.where(depth > 0.0, depth, np.nan))


def _light_distance(image: UInt8[np.ndarray, "s s 3"]) -> Float[np.ndarray, "s s"]:
    """−½ ln of blurred linear brightness."""
    from scipy.ndimage import gaussian_filter

    linear = gaussian_filter(linear_from_srgb(image).mean(axis=-1), _BLUR * len(image))
    return -0.5 * np.log(linear + _DARK)


def _mean_of_others(
    logs: Float[np.ndarray, "n s s"], groups: Sequence[str], middle: float
) -> Outputs:
    """Mean over the frames of other groups; `middle` where none of them has a value."""
    names = np.array(groups)
    known = np.isfinite(logs)
    values = np.where(known, logs, 0.0)
    means = {}
    for name in dict.fromkeys(groups):
        other = names != name
        count = known[other].sum(axis=0)
        mean = values[other].sum(axis=0) / np.maximum(count, 1)
        means[name] = np.where(count > 0, mean, middle)
    return [means[name] for name in groups]


def mask_baselines(
    images: Sequence[UInt8[np.ndarray, "s s 3"]], masks: Sequence[Bool[np.ndarray, "s s"]]
) -> dict[str, Outputs]:
    """Masks [s s] of each image: none, the whole image, a centered disc and a redness threshold.

    Radius and threshold have the highest mean Dice coefficient over the images with a true mask.
    """
    size = len(images[0])
    distance = np.hypot(*(np.indices((size, size)) - 0.5 * (size - 1))) / size
    red = [redness(image) for image in images]
    marked = [k for k, mask in enumerate(masks) if mask.any()]
    levels = np.quantile(np.stack(red), _LEVELS)

    def best(candidates: Sequence[float], estimate: Callable[[float, int], NDArray]) -> float:
        scores = [
            np.mean([dice(estimate(one, k), masks[k]) for k in marked] or [0.0])
            for one in candidates
        ]
        return float(candidates[int(np.argmax(scores))])

    radius = best(_RADII.tolist(), lambda one, k: distance <= one)
    level = best(levels.tolist(), lambda one, k: red[k] >= one)
    return {
        "nothing": [np.zeros((size, size), bool) for _ in images],
        "whole image": [np.ones((size, size), bool) for _ in images],
        "centered disc": [distance <= radius for _ in images],
        "redness": [one >= level for one in red],
    }


def redness(image: UInt8[np.ndarray, "s s 3"]) -> Float[np.ndarray, "s s"]:
    """Fraction of red in the sum of the three channels, 0 where the image is black."""
    total = image.sum(axis=-1, dtype=float)
    return image[..., 0] / np.maximum(total, 1.0)


def class_baselines(
    images: Sequence[UInt8[np.ndarray, "s s 3"]], labels: Sequence[int], count: int
) -> dict[str, Outputs]:
    """Logits [c] of each image: class frequencies, and by its mean redness or brightness.

    The mean of the bright pixels is compared with those of the classes by normal distributions of
    one common variance (linear discriminant analysis).
    """
    truth = np.array(labels)
    prior = np.log(np.bincount(truth, minlength=count) / len(truth) + 1e-6)
    features = {
        "mean redness": [float(redness(one)[one.max(axis=-1) > 0].mean()) for one in images],
        "mean brightness": [float(one[one.max(axis=-1) > 0].mean()) for one in images],
    }
    outputs: dict[str, Outputs] = {"most frequent": [prior for _ in images]}
    for name, values in features.items():
        outputs[name] = list(_discriminant(np.nan_to_num(values), truth, prior))
    return outputs


def _discriminant(
    values: Float[np.ndarray, " n"], truth: NDArray, prior: Float[np.ndarray, " c"]
) -> Float[np.ndarray, "n c"]:
    means = np.array(
        [values[truth == k].mean() if (truth == k).any() else 0.0 for k in range(len(prior))]
    )
    spread = max(float(np.sqrt(np.mean((values - means[truth]) ** 2))), 1e-9)
    return prior - 0.5 * ((values[:, None] - means) / spread) ** 2


def upsampling_baselines(samples: Sequence[Sample]) -> dict[str, Outputs]:
    """Bicubic and nearest-neighbor upsampling, color from 0 to 1 [3 h w]."""
    from PIL import Image

    methods = {"bicubic": Image.Resampling.BICUBIC, "nearest": Image.Resampling.NEAREST}
    return {
        name: [_upsampled(sample, method) for sample in samples] for name, method in methods.items()
    }


def _upsampled(sample: Sample, method: int) -> NDArray:
    from PIL import Image

    height, width = sample["truth"].shape[:2]
    large = Image.fromarray(sample["image"]).resize((width, height), Image.Resampling(method))
    return np.moveaxis(np.asarray(large), -1, 0) / 255.0
