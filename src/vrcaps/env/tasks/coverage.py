"""Coverage task: see as much of the organ's wall as possible, as fast as possible."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated, ClassVar

from vrcaps.config.limits import Range, check_fields
from vrcaps.env.rewards import Reward
from vrcaps.env.tasks.task import Task
from vrcaps.metrics.coverage import CoverageLevel
from vrcaps.metrics.point_coverage import POINT_LEVELS, require_point_level

if TYPE_CHECKING:
    import numpy as np
    from jaxtyping import Bool, Float

    from vrcaps.env.simulation import Simulation


@dataclass(frozen=True)
class CoverageTask(Task):
    """See the whole wall.

    Attributes:
        level: Coverage level of the task.
        target: Fraction of the wall at which the task is completed.
    """

    level: CoverageLevel = "visible"
    target: Annotated[float, Range(above=0.0, max=1.0)] = 0.98

    kind: ClassVar[str] = "coverage"

    def __post_init__(self) -> None:
        check_fields(self)
        require_point_level(self.level, "task")

    @property
    def rewards(self) -> tuple[Reward, ...]:
        """Gain of area, in percent of the whole, with a small time penalty."""
        return (Reward("area-gain", 100.0, self.level), Reward("time", 0.1))

    def progress(self, simulation: Simulation) -> Float[np.ndarray, " n"]:
        """Seen fraction of the wall."""
        return simulation.seen(self.level)

    def is_done(self, simulation: Simulation) -> Bool[np.ndarray, " n"]:
        """Return whether the target is reached."""
        return simulation.seen(self.level) >= self.target

    def measures(self, simulation: Simulation) -> dict[str, np.ndarray]:
        """Seen fraction at each level."""
        return {f"coverage_{level}": simulation.seen(level).copy() for level in POINT_LEVELS}
