"""Path estimate: an estimated path of the capsule beside the true one of an episode."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from vrcaps.errors import InputError
from vrcaps.metrics.trajectory import TrajectoryAlignment, aligned_poses
from vrcaps.motion.replay import read_tum
from vrcaps.motion.trajectory import resample

if TYPE_CHECKING:
    from jaxtyping import Float, Int

    from vrcaps.recording.episode import Episode

ALIGNMENTS: dict[str, TrajectoryAlignment] = {
    "as given": "none",
    "rigid": "se3",
    "rigid and scale": "sim3",
}
"""What may be fitted to the true path first, by its name in the page."""


@dataclass(frozen=True)
class PathEstimate:
    """Estimated and true poses at the frames of an episode that the estimate covers.

    Attributes:
        frames: Numbers of these frames, rising.
        estimated: Estimated ``T_world_capsule``.
        true: True ones.
    """

    frames: Int[np.ndarray, " k"]
    estimated: Float[np.ndarray, "k 4 4"]
    true: Float[np.ndarray, "k 4 4"]

    def aligned(self, align: TrajectoryAlignment) -> PathEstimate:
        """The same, aligned to the true path first (Umeyama, TPAMI 13(4), 1991).

        Raises:
            InputError: If the positions fix no rotation.
        """
        return PathEstimate(self.frames, aligned_poses(self.estimated, self.true, align), self.true)

    @property
    def errors(self) -> Float[np.ndarray, " k"]:
        """Distance of each estimated position from the true one [m]."""
        return np.linalg.norm(self.estimated[:, :3, 3] - self.true[:, :3, 3], axis=1)

    def place_of(self, frame: int) -> int | None:
        """Place of a frame among `frames`; None if the estimate does not cover it."""
        place = int(np.searchsorted(self.frames, frame))
        return place if place < len(self.frames) and self.frames[place] == frame else None


def read_path_estimate(path: Path, episode: Episode) -> PathEstimate:
    """An estimated path from a TUM file, in meters, at the times of an episode's frames.

    Raises:
        InputError: If the file cannot be read or covers fewer than two frames.
    """
    given = read_tum(path, unit="m")
    first, last, times = given.times[0], given.times[-1], episode.times
    frames = np.flatnonzero((times >= first) & (times <= last))
    if len(frames) < 2:
        raise InputError(
            f"{path} covers {first:g} s to {last:g} s, the episode {times[0]:g} s to "
            f"{times[-1]:g} s. Give each pose the time of its frame, as frames.parquet has it."
        )
    poses = resample(given, times[frames]).Ts_world_capsule
    return PathEstimate(frames, poses, episode.Ts_world_capsule[frames])
