"""Comparison of an estimated path of the capsule with the true path of an episode."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from vrcaps.core.errors import InputError
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
"""Alignments to the true path, by their names in the page."""


@dataclass(frozen=True)
class PathEstimate:
    """Estimated and true poses at the frames of an episode that the estimate covers.

    Attributes:
        frames: Indices of these frames, ascending.
        estimated: Estimated ``T_world_capsule``.
        true: True ``T_world_capsule``.
    """

    frames: Int[np.ndarray, " k"]
    estimated: Float[np.ndarray, "k 4 4"]
    true: Float[np.ndarray, "k 4 4"]

    def aligned(self, align: TrajectoryAlignment) -> PathEstimate:
        """Align the estimate to the true path (Umeyama, TPAMI 13(4), 1991).

        Raises:
            InputError: If the positions do not determine a rotation.
        """
        return PathEstimate(self.frames, aligned_poses(self.estimated, self.true, align), self.true)

    @property
    def errors(self) -> Float[np.ndarray, " k"]:
        """Distance of each estimated position from the true one [m]."""
        return np.linalg.norm(self.estimated[:, :3, 3] - self.true[:, :3, 3], axis=1)

    def place_of(self, frame: int) -> int | None:
        """Index of a frame in `frames`; None if the estimate does not cover it."""
        place = int(np.searchsorted(self.frames, frame))
        return place if place < len(self.frames) and self.frames[place] == frame else None


def read_path_estimate(path: Path, episode: Episode) -> PathEstimate:
    """Read an estimated path from a TUM file, in meters, at the times of an episode's frames.

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
