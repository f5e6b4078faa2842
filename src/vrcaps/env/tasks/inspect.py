"""Inspection task: find the lesions of an organ and look at each."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated, Any, ClassVar

import numpy as np

from vrcaps.config.limits import Range, check_fields
from vrcaps.core.errors import InputError
from vrcaps.env.rewards import Reward
from vrcaps.env.tasks.task import Task
from vrcaps.lesion import Angioectasia, Polyp, Ulcer
from vrcaps.metrics.coverage import CoverageLevel
from vrcaps.metrics.point_coverage import POINT_LEVELS, require_point_level

if TYPE_CHECKING:
    from jaxtyping import Bool, Float

    from vrcaps.env.simulation import Simulation


@dataclass(frozen=True)
class InspectTask(Task):
    """Look at each lesion for some time without interruption.

    Lesions are the instances of the organ: those from the settings, or those of its file.

    Attributes:
        level: Coverage level at which a lesion's surface must be seen.
        dwell: Time for which each must be in view without interruption [s].
        fraction: Fraction of a lesion's area that one view must show; a camera sees less than half
            of a polyp at a time.
        most: Maximum number of lesions in an organ.
    """

    level: CoverageLevel = "resolved"
    dwell: Annotated[float, Range(above=0.0, max=60.0, unit="s")] = 1.0
    fraction: Annotated[float, Range(above=0.0, max=1.0)] = 0.2
    most: Annotated[int, Range(min=1, max=1000)] = 32

    kind: ClassVar[str] = "inspect"

    def __post_init__(self) -> None:
        check_fields(self)
        require_point_level(self.level, "task")

    @property
    def rewards(self) -> tuple[Reward, ...]:
        """Lesions and area in percent, ten for success, with a small time penalty."""
        return (
            Reward("progress", 100.0),
            Reward("area-gain", 10.0),
            Reward("success", 10.0),
            Reward("time", 0.1),
        )

    @property
    def defaults(self) -> dict[str, Any]:
        """Default settings: a stomach with three lesions, with enough time to find them."""
        return {
            "organs": ("stomach",),
            "lesions": (Polyp(), Ulcer(), Angioectasia()),
            "episode_time": 180.0,
            "stuck_time": 90.0,
        }

    def allocate(self, simulation: Simulation) -> None:
        """Allocate the state of each lesion, in the order of their instances."""
        memory = simulation.memory
        memory.allocate("inspect/count", dtype=np.int64)
        memory.allocate("inspect/now", (self.most,))
        memory.allocate("inspect/longest", (self.most,))

    def begin(self, simulation: Simulation, index: int, rng: np.random.Generator) -> None:
        """Start with no lesion inspected.

        Raises:
            InputError: If the organ has no lesions, or too many.
        """
        points, memory = simulation.patient(index).points, simulation.memory
        count = len(points.lesions)
        if not 1 <= count <= self.most:
            name = simulation.patient(index).model.organ.name
            raise InputError(
                f"{name} has {count} lesions. Allowed: 1 to {self.most}, InspectTask's most. Set "
                "lesions=(Polyp(), …), or give an organ file that has some."
            )
        memory["inspect/count"][index] = count
        memory["inspect/now"][index] = memory["inspect/longest"][index] = 0.0
        simulation.flags[index][points.first_of_lesions :] = 0

    def update(self, simulation: Simulation, numbers: np.ndarray) -> None:
        """Update the time for which each lesion has been in view."""
        memory, bit = simulation.memory, 1 << POINT_LEVELS.index(self.level)
        shown = np.zeros((len(numbers), self.most), bool)
        for row, index in enumerate(numbers):
            points = simulation.patient(index).points
            flags = simulation.flags[index][points.first_of_lesions :]
            fractions = ((flags & bit) != 0).reshape(len(points.lesions), -1).mean(axis=1)
            shown[row, : len(fractions)] = fractions >= self.fraction
            # Each step marks the current view again; lesions' points have no area.
            flags[:] = 0
        period = simulation.settings.control_period
        now = np.where(shown, memory["inspect/now"][numbers] + period, 0.0)
        memory["inspect/now"][numbers] = now
        memory["inspect/longest"][numbers] = np.maximum(memory["inspect/longest"][numbers], now)

    def _looked_at(self, simulation: Simulation) -> Float[np.ndarray, "n m"]:
        """Fraction of the required time for which each lesion was in view."""
        enough = self.dwell * (1.0 - 1e-9)  # sums of periods are rounded
        return np.minimum(simulation.memory["inspect/longest"] / enough, 1.0)

    def progress(self, simulation: Simulation) -> Float[np.ndarray, " n"]:
        """Mean over all lesions of the fraction of the required time in view."""
        count = np.maximum(simulation.memory["inspect/count"], 1)
        return self._looked_at(simulation).sum(axis=1) / count

    def is_done(self, simulation: Simulation) -> Bool[np.ndarray, " n"]:
        """Return whether each lesion was in view for long enough."""
        count = simulation.memory["inspect/count"]
        return (count > 0) & ((self._looked_at(simulation) >= 1.0).sum(axis=1) >= count)

    def measures(self, simulation: Simulation) -> dict[str, np.ndarray]:
        """Numbers of lesions, of detected lesions, and of those in view for long enough."""
        return {
            "lesions": simulation.memory["inspect/count"].copy(),
            "lesions_found": (simulation.memory["inspect/longest"] > 0.0).sum(axis=1),
            "lesions_inspected": (self._looked_at(simulation) >= 1.0).sum(axis=1),
        }
