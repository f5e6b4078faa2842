"""Rewards of an environment: weighted terms, each of which depends on the last step."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar

import numpy as np

from vrcaps.core.errors import InputError
from vrcaps.env.parts import EnvView, Reward
from vrcaps.metrics.coverage import CoverageLevel
from vrcaps.metrics.point_coverage import POINT_LEVELS, require_point_level

if TYPE_CHECKING:
    from jaxtyping import Bool, Float

_MIN_UNSEEN = 0.005
"""Unseen fraction below which `LogGain` levels off."""


def total_reward(
    rewards: Sequence[Reward], view: EnvView
) -> tuple[Float[np.ndarray, " n"], dict[str, Float[np.ndarray, " n"]]]:
    """Sum of all rewards, and the sum of those of each kind."""
    terms: dict[str, Float[np.ndarray, " n"]] = {}
    for reward in rewards:  # a kind may occur twice, at different levels
        terms[reward.kind] = terms.get(reward.kind, 0.0) + reward.value(view)
    return np.sum(list(terms.values()), axis=0), terms


@dataclass(frozen=True)
class AreaGain(Reward):
    """Fraction of the whole wall that was seen for the first time.

    Attributes:
        level: Coverage level.
    """

    level: CoverageLevel = "visible"

    kind: ClassVar[str] = "area-gain"

    def __post_init__(self) -> None:
        super().__post_init__()
        require_point_level(self.level, "reward")

    def gain(self, view: EnvView) -> Float[np.ndarray, " n"]:
        """Fraction that was seen for the first time in the last step."""
        return view.coverage.gain[:, POINT_LEVELS.index(self.level)]

    def term(self, view: EnvView) -> Float[np.ndarray, " n"]:
        """Return the gain."""
        return self.gain(view)


@dataclass(frozen=True)
class LogGain(AreaGain):
    """Decrease of ln(u + 0.005) with the unseen fraction u: halving u has about the same reward.

    It also rewards the last percent of the wall, for which `AreaGain` is negligible.
    """

    kind: ClassVar[str] = "log-gain"

    def term(self, view: EnvView) -> Float[np.ndarray, " n"]:
        """Return the decrease in the last step."""
        unseen = 1.0 - view.coverage.seen(self.level)
        return np.log1p(self.gain(view) / (unseen + _MIN_UNSEEN))


@dataclass(frozen=True)
class PaperGain(AreaGain):
    """α (C_t − C_{t−1}) with α = 0.1 and C in percent (Incetan et al. 2021, eq. of the reward)."""

    kind: ClassVar[str] = "paper"

    def term(self, view: EnvView) -> Float[np.ndarray, " n"]:
        """Return the gain, scaled."""
        return 0.1 * 100.0 * self.gain(view)


@dataclass(frozen=True)
class ThresholdedGain(AreaGain):
    """Reward of VR-Caps' code: 0.1 of a gain above 0.03 percentage points, else −0.01."""

    kind: ClassVar[str] = "paper-thresholded"

    def term(self, view: EnvView) -> Float[np.ndarray, " n"]:
        """Return the gain, scaled, or the penalty."""
        percent = 100.0 * self.gain(view)
        return np.where(percent > 0.03, 0.1 * percent, -0.01)


@dataclass(frozen=True)
class TimePenalty(Reward):
    """Negative duration of a step [s]."""

    kind: ClassVar[str] = "time"

    def term(self, view: EnvView) -> Float[np.ndarray, " n"]:
        """Return the negative control period."""
        return np.full(view.num_worlds, -view.control_period)


@dataclass(frozen=True)
class ForcePenalty(Reward):
    """Negative sum of normal forces beyond a capsule's weight, 0.1 N [N]."""

    kind: ClassVar[str] = "force"

    def term(self, view: EnvView) -> Float[np.ndarray, " n"]:
        """Return the negative excess force."""
        return -np.maximum(view.normal_force_total - 0.1, 0.0)


@dataclass(frozen=True)
class ProgressGain(Reward):
    """Gain of the task's progress over its best so far, as a fraction."""

    kind: ClassVar[str] = "progress"

    def allocate(self, view: EnvView) -> None:
        """Allocate the best progress so far and the gain of the last step."""
        view.memory.allocate("progress/best")
        view.memory.allocate("progress/gain")

    def begin(self, view: EnvView, index: int) -> None:
        """Start with the current progress."""
        view.memory["progress/best"][index] = view.task.progress(view)[index]
        view.memory["progress/gain"][index] = 0.0

    def update(self, view: EnvView, active: Bool[np.ndarray, " n"]) -> None:
        """Measure the gain of the active worlds."""
        best, gain = view.memory["progress/best"], view.memory["progress/gain"]
        progress = view.task.progress(view)
        gain[:] = np.where(active, np.maximum(progress - best, 0.0), 0.0)
        best[active] += gain[active]

    def term(self, view: EnvView) -> Float[np.ndarray, " n"]:
        """Return the gain of the last step."""
        return view.memory["progress/gain"]


@dataclass(frozen=True)
class TotalVariation(AreaGain):
    """Negative growth of the frontier's length in the last step, in circumferences of the gut.

    It rewards closing holes and straight frontiers (Jonnarth, Zhao, Felsberg, arXiv 2306.16978,
    incremental total variation reward).
    """

    kind: ClassVar[str] = "total-variation"

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.level != "visible":
            raise InputError(
                f"The reward total-variation has the level {self.level!r}. Allowed: 'visible', "
                "the level of the map."
            )

    def allocate(self, view: EnvView) -> None:
        """Allocate the frontier's length and its growth in the last step."""
        view.memory.allocate("frontier/length")
        view.memory.allocate("frontier/growth")

    def begin(self, view: EnvView, index: int) -> None:
        """Start with the current frontier."""
        self.update(view, np.arange(view.num_worlds) == index)
        view.memory["frontier/growth"][index] = 0.0

    def update(self, view: EnvView, active: Bool[np.ndarray, " n"]) -> None:
        """Measure the frontier on the maps of the active worlds."""
        coverage, growth = view.coverage, view.memory["frontier/growth"]
        growth[:] = 0.0
        has_wall = coverage.cell_area[active] > 0.0
        length = frontier_length(coverage.cell_fraction[active], has_wall, view.grid)
        growth[active] = length - view.memory["frontier/length"][active]
        view.memory["frontier/length"][active] = length

    def term(self, view: EnvView) -> Float[np.ndarray, " n"]:
        """Return the negative growth."""
        return -view.memory["frontier/growth"]


@dataclass(frozen=True)
class Success(Reward):
    """One if the task is completed."""

    kind: ClassVar[str] = "success"

    def term(self, view: EnvView) -> Float[np.ndarray, " n"]:
        """Return one for each completed task."""
        return view.task.is_done(view).astype(float)


def frontier_length(
    fraction: Float[np.ndarray, "n c"], has_wall: Bool[np.ndarray, "n c"], grid: tuple[int, int]
) -> Float[np.ndarray, " n"]:
    """Length of the frontier between seen and unseen wall, in circumferences of the gut.

    It is the discrete isotropic total variation of the map, Σ sqrt(Δ_along² + Δ_around²), divided
    by the number of its columns; cells without wall do not count.

    Args:
        fraction: Seen fraction of each cell of the maps.
        has_wall: Whether each cell contains wall.
        grid: Number of rows along the gut and of columns around it, which are periodic.
    """
    maps, wall = fraction.reshape(-1, *grid), has_wall.reshape(-1, *grid)
    around = (np.roll(maps, -1, axis=2) - maps) * (np.roll(wall, -1, axis=2) & wall)
    along = np.zeros_like(maps)
    along[:, :-1] = np.diff(maps, axis=1) * (wall[:, 1:] & wall[:, :-1])
    return np.sqrt(along**2 + around**2).sum(axis=(1, 2)) / grid[1]
