"""Views to compare: the same square of each image's field of view, its statistics and features.

Statistics are of exposure, color, radial profile, contrast, spectrum and highlights. They need no
network, so they check the distances between features of EfficientNet-Lite0.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import TYPE_CHECKING

import numpy as np
import scipy

from vrcaps.core.color import lab_from_srgb, linear_from_srgb
from vrcaps.core.errors import InputError, require
from vrcaps.core.processes import ProgressReport, no_report
from vrcaps.core.rng import stream
from vrcaps.metrics.appearance import at_most_per_group

if TYPE_CHECKING:
    from jaxtyping import Float, UInt8
    from numpy.typing import NDArray

    from vrcaps.recording.frame_sequence import FrameSequence

DISC = 224
"""Diameter to which the field of view is scaled [px]."""
SIDE = 146
"""Side of the compared square in the middle of it [px]; its corners are within the disc, and
outlines of the view and text in its corners are not."""
_DARK = 24
"""Maximum channel value of the border around a picture [of 255]."""
_MIN_FILLED = 0.1
"""Minimum fraction of brighter pixels in a row or column of the picture."""
_MAX_PER_GROUP = 22
"""Maximum number of images of one patient, so that no patient dominates."""


@dataclass(frozen=True)
class ImageSet:
    """Views of one set.

    Attributes:
        name: Name of the set, for tables.
        views: Central squares of the fields of view, sRGB [n s s 3].
        groups: Patient, or sequence if no patient is known, of each view [n].
        names: Name of each image.
    """

    name: str
    views: UInt8[np.ndarray, "n s s 3"]
    groups: NDArray
    names: tuple[str, ...]

    def __len__(self) -> int:
        return len(self.views)

    def subset(self, indices: NDArray) -> ImageSet:
        """The views of some indices."""
        names = tuple(self.names[k] for k in indices)
        return ImageSet(self.name, self.views[indices], self.groups[indices], names)


def central_view(image: UInt8[np.ndarray, "h w 3"]) -> UInt8[np.ndarray, "s s 3"]:
    """Central square of the field of view of an image.

    The field of view is the bounding box of the rows and columns of which a tenth is brighter than
    a dark border. The square around its center, with the length of its shorter side, is scaled to
    `DISC` pixels, of which the middle `SIDE` are returned. A picture without a border is used in
    the same way, so that both kinds show about the same angle.

    Args:
        image: sRGB image with or without a border.
    """
    from PIL import Image

    bright = image.max(axis=-1) > _DARK
    rows, columns = (_extent(bright.mean(axis=axis)) for axis in (1, 0))
    half = 0.5 * min(rows[1] - rows[0], columns[1] - columns[0])
    y, x = 0.5 * sum(rows), 0.5 * sum(columns)
    kind = Image.Resampling.BOX if 2.0 * half > DISC else Image.Resampling.BICUBIC
    box = (x - half, y - half, x + half, y + half)
    disc = np.asarray(Image.fromarray(image).resize((DISC, DISC), kind, box=box))
    first = (DISC - SIDE) // 2
    return np.ascontiguousarray(disc[first : first + SIDE, first : first + SIDE])


def _extent(filled: NDArray) -> tuple[int, int]:
    """First and end index of the lines that belong to the picture."""
    lines = np.flatnonzero(filled > _MIN_FILLED)
    return (int(lines[0]), int(lines[-1]) + 1) if lines.size else (0, len(filled))


def read_image_set(
    name: str,
    sequences: Sequence[FrameSequence],
    *,
    max_images: int,
    seed: int = 0,
    progress: ProgressReport = no_report,
) -> ImageSet:
    """Read views of sequences: at most `max_images`, drawn at random from all patients.

    Args:
        name: Name of the set.
        sequences: Sequences with the channel `rgb`.
        max_images: Maximum number of images.
        seed: Seed of the draw.
        progress: Called with the number of images read and their total.

    Raises:
        InputError: If there are fewer than three images, or one cannot be read.
    """
    require(max_images >= 3, "max_images", max_images, "3 or more")
    frames = [(one, k) for one in sequences if "rgb" in one.channels for k in range(len(one))]
    if len(frames) < 3:
        raise InputError(f"{name} has {len(frames)} images. Allowed: 3 or more.")
    groups = np.array([one.patient or one.name for one, _ in frames])
    is_grouped = len(np.unique(groups)) > 1
    chosen = at_most_per_group(groups, _MAX_PER_GROUP) if is_grouped else np.arange(len(frames))
    drawn = np.sort(stream(seed, "looks/images").permutation(chosen)[:max_images])
    views = []
    for done, index in enumerate(drawn):
        sequence, frame = frames[index]
        views.append(central_view(sequence.image("rgb", frame)))
        progress(done + 1, len(drawn))
    names = tuple(f"{frames[k][0].name}/{frames[k][1]}" for k in drawn)
    return ImageSet(name, np.stack(views), groups[drawn], names)


STATISTICS = {
    "clipped": "pixels with a channel of 254 or 255 [%]",
    "lightness": "mean L*",
    "lightness spread": "standard deviation of L*",
    "rim": "mean L* beyond 0.75 of the disc's radius, minus the mean",
    "center": "mean L* within 0.2 of the disc's radius, minus the mean",
    "saturation": "mean HSV saturation",
    "ln B/G": "logarithm of mean linear blue over mean linear green",
    "hue": "angle of the mean a*, b* [deg]",
    "a* spread": "standard deviation of a*",
    "fine chroma": "log10 of the mean power of a* above 0.25 cycles per pixel",
    "slope": "slope of the log power spectrum of L*, 0.06 to 0.45 cycles per pixel",
    "ln R/G": "logarithm of mean linear red over mean linear green",
    "b* spread": "standard deviation of b*",
    "dark": "pixels below L* 15 [%]",
    "edges": "pixels with a gradient of L* above 8 per pixel [%]",
    "noise": "median absolute Laplacian of L*, over 4",
    "contrast 2 px": "standard deviation of L* between Gaussians of 1 and 2 px",
    "contrast 4 px": "standard deviation of L* between Gaussians of 2 and 4 px",
    "contrast 8 px": "standard deviation of L* between Gaussians of 4 and 8 px",
    "contrast 16 px": "standard deviation of L* between Gaussians of 8 and 16 px",
    "dark spread": "RMS distance of the darkest tenth from its center, over half the side",
    "highlights": "pixels more than 20 L* above their neighborhood (median of 9 px) [%]",
    "horizontal": "mean L* of the right half minus the left half, absolute",
    "vertical": "mean L* of the lower half minus the upper half, absolute",
}
"""Meaning of each statistic, in the order of `view_statistics`."""

GATES = (
    *("clipped", "lightness", "lightness spread", "center", "rim"),
    *("saturation", "ln B/G", "hue", "a* spread", "fine chroma", "slope"),
)
"""Statistics whose median should lie between the 10th and 90th percentile of real images."""


def view_statistics(view: UInt8[np.ndarray, "s s 3"]) -> Float[np.ndarray, " k"]:
    """Statistics of a view, in the order of `STATISTICS`."""
    lab = lab_from_srgb(view)
    values = {
        **_color(view, lab),
        **_profile(lab[..., 0]),
        **_texture(lab),
    }
    return np.array([values[name] for name in STATISTICS], float)


def _color(view: NDArray, lab: NDArray) -> dict[str, float]:
    largest, smallest = view.max(axis=-1).astype(float), view.min(axis=-1)
    red, green, blue = np.maximum(linear_from_srgb(view).mean(axis=(0, 1)), 1e-6)
    a, b = lab[..., 1], lab[..., 2]
    return {
        "clipped": 100.0 * float((largest >= 254).mean()),
        "saturation": float(((largest - smallest) / np.maximum(largest, 1.0)).mean()),
        "ln B/G": float(np.log(blue / green)),
        "ln R/G": float(np.log(red / green)),
        "hue": float(np.degrees(np.arctan2(b.mean(), a.mean()))),
        "a* spread": float(a.std()),
        "b* spread": float(b.std()),
    }


def _profile(lightness: NDArray) -> dict[str, float]:
    side = len(lightness)
    offset = np.arange(side) + 0.5 - 0.5 * side
    radius = np.hypot(offset[:, None], offset) / (0.5 * DISC)
    mean, half = float(lightness.mean()), side // 2
    darkest = np.argwhere(lightness <= np.quantile(lightness, 0.1))
    spread = np.sqrt(((darkest - darkest.mean(axis=0)) ** 2).sum(axis=1).mean())
    return {
        "lightness": mean,
        "lightness spread": float(lightness.std()),
        "rim": float(lightness[radius > 0.75].mean()) - mean,
        "center": float(lightness[radius < 0.2].mean()) - mean,
        "dark": 100.0 * float((lightness < 15.0).mean()),
        "dark spread": float(spread) / (0.5 * side),
        "horizontal": abs(float(lightness[:, half:].mean() - lightness[:, :half].mean())),
        "vertical": abs(float(lightness[half:].mean() - lightness[:half].mean())),
    }


def _texture(lab: NDArray) -> dict[str, float]:
    lightness, a = lab[..., 0], lab[..., 1]
    blurred = [scipy.ndimage.gaussian_filter(lightness, s) for s in (1, 2, 4, 8, 16)]
    gradient = np.hypot(*np.gradient(lightness))
    laplacian = scipy.ndimage.laplace(lightness)
    local = scipy.ndimage.median_filter(lightness, 9)
    contrast = {
        f"contrast {2 << k} px": float((fine - coarse).std())
        for k, (fine, coarse) in enumerate(pairwise(blurred))
    }
    return {
        "fine chroma": _fine_power(a),
        "slope": _spectral_slope(lightness),
        "edges": 100.0 * float((gradient > 8.0).mean()),
        "noise": float(np.median(np.abs(laplacian))) / 4.0,
        "highlights": 100.0 * float((lightness - local > 20.0).mean()),
        **contrast,
    }


def _frequencies(side: int) -> NDArray:
    """Frequency of each coefficient of a transform [cycles per pixel]."""
    axis = np.fft.fftfreq(side)
    return np.hypot(axis[:, None], axis)


def _fine_power(values: NDArray) -> float:
    power = np.abs(np.fft.fft2(values - values.mean())) ** 2
    return float(np.log10(power[_frequencies(len(values)) > 0.25].mean() + 1e-6))


def _spectral_slope(values: NDArray) -> float:
    window = np.hanning(len(values))
    power = np.abs(np.fft.fft2((values - values.mean()) * window[:, None] * window)) ** 2
    frequency = _frequencies(len(values))
    edges = np.linspace(0.06, 0.45, 16)
    bands = [power[(frequency >= low) & (frequency < high)].mean() for low, high in pairwise(edges)]
    middles = 0.5 * (edges[1:] + edges[:-1])
    return float(np.polyfit(np.log(middles), np.log(np.array(bands) + 1e-9), 1)[0])


LEVELS = ("block 3", "block 5", "pooled")
"""Levels of the network: mean and standard deviation of the 40 channels after its third block
(texture), of the 112 after its fifth, and the 1280 channels that its classifier takes (content)."""

_SIDE = 224
_BATCH = 16


def view_features(
    views: UInt8[np.ndarray, "n s s 3"],
    *,
    progress: ProgressReport = no_report,
) -> dict[str, Float[np.ndarray, "n d"]]:
    """Features of views by level.

    Args:
        views: sRGB views.
        progress: Called with the number of views done and their total.

    Raises:
        MissingExtraError: If PyTorch or the weights are not installed.
    """
    from vrcaps.core.errors import import_extra

    torch, timm = import_extra("torch", "learn"), import_extra("timm", "learn")
    from vrcaps.learn.networks import ENCODER, imagenet_weights

    network = timm.create_model(ENCODER, pretrained=False)
    network.load_state_dict(imagenet_weights())
    network.eval()
    settings = timm.data.resolve_data_config({}, model=network)
    mean, spread = (np.array(settings[key], np.float32) for key in ("mean", "std"))
    rows: dict[str, list[np.ndarray]] = {level: [] for level in LEVELS}
    with torch.inference_mode():
        for first in range(0, len(views), _BATCH):
            batch = np.stack([_scaled(view) for view in views[first : first + _BATCH]])
            normal = ((batch / np.float32(255.0)) - mean) / spread
            maps = network.bn1(network.conv_stem(torch.from_numpy(normal).permute(0, 3, 1, 2)))
            for index, block in enumerate(network.blocks):
                maps = block(maps)
                if index in (2, 4):
                    moments = torch.cat([maps.mean((2, 3)), maps.std((2, 3))], 1)
                    rows[f"block {index + 1}"].append(moments.numpy())
            rows["pooled"].append(network.bn2(network.conv_head(maps)).mean((2, 3)).numpy())
            progress(min(first + _BATCH, len(views)), len(views))
    return {level: np.concatenate(parts).astype(float) for level, parts in rows.items()}


def _scaled(view: UInt8[np.ndarray, "s s 3"]) -> Float[np.ndarray, "k k 3"]:
    from PIL import Image

    image = Image.fromarray(view).resize((_SIDE, _SIDE), Image.Resampling.BICUBIC)
    return np.asarray(image, np.float32)
