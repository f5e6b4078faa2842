"""Evenly spread sample of a data set's frames and their contents, of fixed size."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from typing import TYPE_CHECKING

import numpy as np

from vrcaps.camera.camera import Camera, camera_rays
from vrcaps.core.color import LUMA_WEIGHTS
from vrcaps.data.dataset import Dataset, Member
from vrcaps.data.stored_files import read_at_once
from vrcaps.recording.episode import Episode

if TYPE_CHECKING:
    from jaxtyping import Float
    from numpy.typing import NDArray

NUM_SHOTS = 240
_PIXELS = 2000
"""Pixels per image that count in histograms, spread evenly."""
_GOLDEN = 0.618033988749895
"""Golden ratio: its multiples modulo 1 are evenly spread."""
_VELOCITY = tuple(f"capsule_v{axis}_m_per_s" for axis in "xyz")
_LESION = "instance"


@dataclass(frozen=True)
class Shot:
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

    shots: tuple[Shot, ...]
    speeds: tuple[tuple[str, Float[np.ndarray, " n"]], ...]


def sample(dataset: Dataset, num_shots: int = NUM_SHOTS) -> Sample:
    """Sample frames that are spread evenly over recordings, time and cameras.

    Args:
        dataset: Open data set with at least one recording.
        num_shots: Number of frames; fewer if there are not so many.

    Raises:
        InputError: If a file cannot be read.
    """
    members = dataset.members()
    places: dict[int, list[int]] = {}
    for number in range(num_shots):
        places.setdefault(number * len(members) // num_shots, []).append(number)
    chosen = [(members[index], numbers) for index, numbers in places.items()]
    found = read_at_once(_shots_of, chosen)
    shots = tuple(shot for shots, _ in found for shot in shots)
    speeds = [(member.split, speed) for (member, _), (_, speed) in zip(chosen, found, strict=True)]
    return Sample(shots, tuple(speeds))


def _shots_of(chosen: tuple[Member, list[int]]) -> tuple[list[Shot], NDArray]:
    """Frames of a recording, at positions fixed by their indices, and the capsule's speeds."""
    member, numbers = chosen
    episode = member.read()
    count = len(episode) * len(episode.cameras)
    places = sorted({int(number * _GOLDEN % 1.0 * count) for number in numbers})
    shots = [_shot(member, episode, *divmod(place, len(episode.cameras))) for place in places]
    velocity = np.stack([episode.table.columns[name] for name in _VELOCITY], axis=-1)
    return shots, np.linalg.norm(velocity, axis=-1)


def _shot(member: Member, episode: Episode, frame: int, camera_number: int) -> Shot:
    camera = episode.cameras[camera_number]
    images = {
        name: episode.image(camera.name, name, frame)
        for name in ("rgb", "depth", _LESION)
        if name in episode.channels
    }
    none = np.zeros(0)
    return Shot(
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
