"""Sample of a data set's frames, of fixed size and evenly spread, and its histograms by split."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from typing import TYPE_CHECKING

import numpy as np

from vrcaps.camera.camera import Camera, camera_rays
from vrcaps.core.color import LUMA_WEIGHTS
from vrcaps.core.units import MM
from vrcaps.data.dataset import Dataset, Member
from vrcaps.data.store import read_at_once
from vrcaps.recording.episode import Episode
from vrcaps.recording.frame_sequence import SPLITS
from vrcaps.tools.report import make_figure, png_bytes

if TYPE_CHECKING:
    from jaxtyping import Float
    from matplotlib.axes import Axes
    from numpy.typing import NDArray

NUM_SHOTS = 240
_PIXELS = 2000
"""Pixels per image that count in histograms, spread evenly."""
_GOLDEN = 0.618033988749895
"""Golden ratio: its multiples modulo 1 are evenly spread."""
_VELOCITY = tuple(f"capsule_v{axis}_m_per_s" for axis in "xyz")
_LESION = "instance"


@dataclass(frozen=True)
class SampledFrame:
    """One sampled frame of one camera.

    Attributes:
        member: Recording of the frame.
        organ: Name of the organ.
        segment: Segment in which the capsule is.
        capsule: Name of the capsule.
        camera: Name of the camera.
        frame: Index of the frame.
        depth: Depth of some of its pixels [m]; empty without a channel `depth`.
        brightness: Gray level, 0 to 255, of some of the pixels that the lens illuminates.
        has_masks: Whether lesions have masks.
        lesions: Kinds of the visible lesions.
    """

    member: Member
    organ: str
    segment: str
    capsule: str
    camera: str
    frame: int
    depth: Float[np.ndarray, " n"]
    brightness: Float[np.ndarray, " n"]
    has_masks: bool
    lesions: tuple[str, ...]


@dataclass(frozen=True)
class Sample:
    """Sample of a data set.

    Attributes:
        shots: Frames, in the order of their recordings.
        speeds: Split, and speed of the capsule at all frames [m/s], of each sampled recording.
    """

    frames: tuple[SampledFrame, ...]
    speeds: tuple[tuple[str, Float[np.ndarray, " n"]], ...]


def sample(dataset: Dataset, num_shots: int = NUM_SHOTS) -> Sample:
    """Sample frames that are spread evenly over recordings, time and cameras.

    Args:
        dataset: Open data set with at least one recording.
        num_shots: Number of frames; fewer if the data set has fewer.

    Raises:
        InputError: If a file cannot be read.
    """
    members = dataset.members()
    indices: dict[int, list[int]] = {}
    for number in range(num_shots):
        indices.setdefault(number * len(members) // num_shots, []).append(number)
    chosen = [(members[index], numbers) for index, numbers in indices.items()]
    sampled = read_at_once(_sampled_frames, chosen)
    frames = tuple(shot for frames, _ in sampled for shot in frames)
    speeds = [
        (member.split, speed) for (member, _), (_, speed) in zip(chosen, sampled, strict=True)
    ]
    return Sample(frames, tuple(speeds))


def _sampled_frames(chosen: tuple[Member, list[int]]) -> tuple[list[SampledFrame], NDArray]:
    """Frames of a recording, at positions fixed by their indices, and the capsule's speeds."""
    member, keys = chosen
    episode = member.read()
    count = len(episode) * len(episode.cameras)
    indices = sorted({int(key * _GOLDEN % 1.0 * count) for key in keys})
    frames = [_shot(member, episode, *divmod(index, len(episode.cameras))) for index in indices]
    velocity = np.stack([episode.table.columns[name] for name in _VELOCITY], axis=-1)
    return frames, np.linalg.norm(velocity, axis=-1)


def _shot(member: Member, episode: Episode, frame: int, camera_number: int) -> SampledFrame:
    camera = episode.cameras[camera_number]
    images = {
        name: episode.image(camera.name, name, frame)
        for name in ("rgb", "depth", _LESION)
        if name in episode.channels
    }
    none = np.zeros(0)
    return SampledFrame(
        member,
        episode.head["organ"]["name"],
        str(episode.table.columns["segment"][frame]),
        episode.head["capsule"]["name"],
        camera.name,
        frame,
        _some(images["depth"][np.isfinite(images["depth"])]) if "depth" in images else none,
        _some((images["rgb"] @ LUMA_WEIGHTS)[_lit(camera)]) if "rgb" in images else none,
        _LESION in images,
        _visible(episode, images[_LESION]) if _LESION in images else (),
    )


def _visible(episode: Episode, instance: NDArray) -> tuple[str, ...]:
    seen = set(np.unique(instance).tolist())
    lesions: Sequence[Mapping] = episode.head["organ"]["lesions"]
    return tuple(dict.fromkeys(x["kind"] for x in lesions if x[_LESION] in seen))


def _some(values: NDArray) -> NDArray:
    return values[:: max(1, len(values) // _PIXELS)]


@cache
def _lit(camera: Camera) -> NDArray:
    """Mask [h w] of the pixels that the lens illuminates."""
    return np.all(np.isfinite(camera_rays(camera)), axis=-1, keepdims=False)


SPLIT_COLORS = {"train": "#3b6fb6", "val": "#e0982f", "test": "#1a8a4a"}

_SIZE_INCH, _DPI = (12.8, 3.4), 110
_BINS = 48
_HIGHEST = 99.5
"""Percentile at which an open axis ends; larger values count in the last bin."""


def histogram_picture(sample: Sample) -> bytes:
    """Draw the three histograms side by side, as a PNG."""
    fig = make_figure(*_SIZE_INCH)
    views = fig.subplots(1, 3)
    _draw(views[0], _pixels(sample, "depth", MM), "depth [mm]", "fraction of pixels [%]")
    _draw(
        views[1], _pixels(sample, "brightness", 1.0), "gray level", "fraction of pixels [%]", 255.0
    )
    _draw(views[2], _speeds(sample), "speed of the capsule [mm/s]", "fraction of frames [%]")
    handles = views[2].get_legend_handles_labels()
    fig.legend(*handles, loc="outside upper center", ncols=len(SPLITS), frameon=False)
    return png_bytes(fig, _DPI)


def _pixels(sample: Sample, name: str, unit: float) -> dict[str, NDArray]:
    """Values of sampled pixels of each split, in the given unit."""
    sampled = {split: [np.zeros(0)] for split in SPLITS}
    for shot in sample.frames:
        sampled[shot.member.split].append(getattr(shot, name) / unit)
    return {split: np.concatenate(values) for split, values in sampled.items()}


def _speeds(sample: Sample) -> dict[str, NDArray]:
    """Speeds of each split [mm/s]."""
    none, speeds = np.zeros(0), sample.speeds
    return {
        split: np.concatenate([none, *(speed / MM for name, speed in speeds if name == split)])
        for split in SPLITS
    }


def _draw(
    view: Axes,
    values: Mapping[str, NDArray],
    label: str,
    share: str,
    highest: float | None = None,
) -> None:
    """Draw an outline for each split that has values."""
    together = np.concatenate([*values.values()])
    view.set(xlabel=label, ylabel=share)
    if not together.size:
        view.text(0.5, 0.5, "not recorded", ha="center", transform=view.transAxes, color="#777777")
        view.set(xticks=(), yticks=())
        return
    end = highest or float(np.percentile(together, _HIGHEST)) * 1.05 or 1.0
    edges = np.linspace(0.0, end, _BINS + 1)
    for split, own in values.items():
        if own.size:
            counts, _ = np.histogram(np.minimum(own, end), edges)
            color = SPLIT_COLORS[split]
            view.stairs(100.0 * counts / own.size, edges, color=color, lw=1.6, label=split)
            view.stairs(100.0 * counts / own.size, edges, color=color, alpha=0.12, fill=True)
    view.set(xlim=(0.0, end), ylim=(0.0, None))
    view.grid(alpha=0.3)
