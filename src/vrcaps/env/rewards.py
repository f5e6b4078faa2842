"""Rewards: named, weighted terms, each a function of the last step."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated, ClassVar, Protocol

import numpy as np

from vrcaps.config.limits import Range, check_fields
from vrcaps.core.errors import InputError, UnknownNameError
from vrcaps.core.registry import Registry
from vrcaps.metrics.coverage import CoverageLevel
from vrcaps.metrics.point_coverage import POINT_LEVELS, require_point_level

if TYPE_CHECKING:
    from jaxtyping import Bool, Float

    from vrcaps.env.simulation import Simulation

_MIN_UNSEEN = 0.005
"""Unseen fraction below which the reward `log-gain` levels off."""


class RewardTerm(Protocol):
    """Term of the reward from a plug-in, registered with `REWARDS.register`."""

    kind: ClassVar[str]

    def __call__(self, simulation: Simulation, reward: Reward) -> Float[np.ndarray, " n"]:
        """Value of each world for the last step, without the weight."""
        ...


REWARDS: Registry[RewardTerm] = Registry("reward", {})
"""Terms of plug-ins by name; the built-in ones are in `TERMS`."""


@dataclass(frozen=True)
class Reward:
    """One term of the reward.

    Attributes:
        term: Its name: one of `TERMS`, or of a term in `REWARDS`.
        weight: Factor of the term.
        level: Coverage level, for terms of coverage.
    """

    term: str
    weight: Annotated[float, Range()] = 1.0
    level: CoverageLevel = "visible"

    def __post_init__(self) -> None:
        check_fields(self)
        if self.term not in TERMS and self.term not in REWARDS:
            raise UnknownNameError("reward", self.term, reward_names())
        require_point_level(self.level, "reward")
        if self.term == "total-variation" and self.level != "visible":
            raise InputError(
                f"The reward total-variation has the level {self.level!r}. Allowed: 'visible', "
                "which the map is of."
            )

    def value(self, simulation: Simulation) -> Float[np.ndarray, " n"]:
        """Reward of each world for the last step."""
        term = TERMS[self.term] if self.term in TERMS else REWARDS[self.term]()
        return self.weight * term(simulation, self)


def total_reward(
    rewards: tuple[Reward, ...], simulation: Simulation
) -> tuple[Float[np.ndarray, " n"], dict[str, Float[np.ndarray, " n"]]]:
    """Sum of all rewards, and the reward of each term."""
    terms: dict[str, Float[np.ndarray, " n"]] = {}
    for reward in rewards:  # a term may occur twice, at different levels
        terms[reward.term] = terms.get(reward.term, 0.0) + reward.value(simulation)
    return np.sum(list(terms.values()), axis=0), terms


def _area_gain(simulation: Simulation, reward: Reward) -> Float[np.ndarray, " n"]:
    """Fraction of the whole wall that was seen for the first time."""
    return simulation.gain[:, POINT_LEVELS.index(reward.level)]


def _log_gain(simulation: Simulation, reward: Reward) -> Float[np.ndarray, " n"]:
    """Decrease of ln(u + 0.005) with the unseen fraction u: halving u has about the same reward.

    Therefore the last hundredths are worth seeking, which `area-gain` hardly rewards.
    """
    unseen = 1.0 - simulation.seen(reward.level)
    return np.log1p(_area_gain(simulation, reward) / (unseen + _MIN_UNSEEN))


def _paper_gain(simulation: Simulation, reward: Reward) -> Float[np.ndarray, " n"]:
    """α (C_t − C_{t−1}) with α = 0.1 and C in percent (Incetan et al. 2021, eq. of the reward)."""
    return 0.1 * 100.0 * _area_gain(simulation, reward)


def _paper_thresholded(simulation: Simulation, reward: Reward) -> Float[np.ndarray, " n"]:
    """Reward of VR-Caps' code: 0.1 of a gain above 0.03 percentage points, else −0.01."""
    percent = 100.0 * _area_gain(simulation, reward)
    return np.where(percent > 0.03, 0.1 * percent, -0.01)


def _time(simulation: Simulation, reward: Reward) -> Float[np.ndarray, " n"]:
    """Negative duration of a step [s]."""
    return np.full(simulation.num_worlds, -simulation.settings.control_period)


def _force(simulation: Simulation, reward: Reward) -> Float[np.ndarray, " n"]:
    """Negative sum of normal forces beyond a capsule's weight, 0.1 N [N]."""
    return -np.maximum(simulation.normal_force_total - 0.1, 0.0)


def _progress(simulation: Simulation, reward: Reward) -> Float[np.ndarray, " n"]:
    """Gain of the task's progress over its best so far, as a fraction."""
    return simulation.memory["progress/gain"]


def _total_variation(simulation: Simulation, reward: Reward) -> Float[np.ndarray, " n"]:
    """Negative growth of the frontier's length in the last step, in circumferences of the gut.

    It rewards closing holes and straight frontiers (Jonnarth, Zhao, Felsberg, arXiv 2306.16978,
    incremental total variation reward).
    """
    return -simulation.memory["frontier/growth"]


def _success(simulation: Simulation, reward: Reward) -> Float[np.ndarray, " n"]:
    """One if the task is completed."""
    return simulation.settings.task.is_done(simulation).astype(float)


TERMS: dict[str, Callable[[Simulation, Reward], Float[np.ndarray, " n"]]] = {
    "area-gain": _area_gain,
    "log-gain": _log_gain,
    "paper": _paper_gain,
    "paper-thresholded": _paper_thresholded,
    "time": _time,
    "force": _force,
    "progress": _progress,
    "total-variation": _total_variation,
    "success": _success,
}
"""Terms by name."""


def frontier_length(
    fraction: Float[np.ndarray, "n c"], has_wall: Bool[np.ndarray, "n c"], grid: tuple[int, int]
) -> Float[np.ndarray, " n"]:
    """Length of the frontier between seen and unseen wall, in circumferences of the gut.

    It is the discrete isotropic total variation of the map, Σ sqrt(Δ_along² + Δ_around²), divided
    by its number of columns; cells without wall do not count.

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


def reward_names() -> tuple[str, ...]:
    """Names of all terms, including those of plug-ins."""
    return (*TERMS, *REWARDS)
