"""Navigation task: bring the capsule to a position along the gut."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated, Any, ClassVar

import numpy as np

from vrcaps.config.limits import Range, check_fields
from vrcaps.core.errors import UnknownNameError, require
from vrcaps.core.units import CM
from vrcaps.env.actuation.magnet import MagnetActuation
from vrcaps.env.rewards import Reward
from vrcaps.env.start import Start
from vrcaps.env.tasks.task import Task

if TYPE_CHECKING:
    from jaxtyping import Bool, Float

    from vrcaps.env.simulation import Simulation
    from vrcaps.organ.surface import OrganSurface


@dataclass(frozen=True)
class NavigateTask(Task):
    """Reach a position along the gut from the start of the episode.

    The centerline leads from the oral to the anal end: in a colon from the caecum to the rectum.

    Attributes:
        goal: A fraction of the centerline, or a segment by its label, such as `pylorus`: the border
            at which the capsule enters it.
        tolerance: Distance to the goal along the gut at which the task is completed [m]; a closed
            end is out of reach by half a capsule.
    """

    goal: float | str = 1.0
    tolerance: Annotated[float, Range(above=0.0, max=0.1, unit="m")] = 2.0 * CM

    kind: ClassVar[str] = "navigate"

    def __post_init__(self) -> None:
        check_fields(self)
        if not isinstance(self.goal, str):
            is_valid = 0.0 <= self.goal <= 1.0
            require(is_valid, "NavigateTask's goal", self.goal, "0 to 1, or a segment's name")

    @property
    def rewards(self) -> tuple[Reward, ...]:
        """Progress along the path in percent, ten for success, with a small time penalty."""
        return (Reward("progress", 100.0), Reward("success", 10.0), Reward("time", 0.02))

    @property
    def defaults(self) -> dict[str, Any]:
        """Default settings: a colon from end to end, and a magnet for its deepest parts."""
        return {
            "organs": ("colon",),
            "actuation": MagnetActuation("cylinder-152.4", speed=0.2, angular_speed=2.0),
            "start": Start(fraction=(0.0, 0.0)),
            "episode_time": 1200.0,
            "stuck_time": 60.0,
        }

    def allocate(self, simulation: Simulation) -> None:
        """Allocate start and goal [m], and the maximum fraction of the path so far."""
        for name in ("start", "goal", "best"):
            simulation.memory.allocate(f"navigate/{name}")

    def begin(self, simulation: Simulation, index: int, rng: np.random.Generator) -> None:
        """Start at the position where the capsule came to rest.

        Raises:
            UnknownNameError: If the organ has no segment of the goal's name.
        """
        memory, start = simulation.memory, simulation.arc_length[index]
        organ = simulation.patient(index).model.organ
        memory["navigate/start"][index] = start
        memory["navigate/goal"][index] = _place(organ, self.goal, start)
        memory["navigate/best"][index] = 0.0
        self.update(simulation, np.array([index]))

    def update(self, simulation: Simulation, numbers: np.ndarray) -> None:
        """Update the progress of the capsules."""
        memory = simulation.memory
        start, goal, best = (memory[f"navigate/{name}"] for name in ("start", "goal", "best"))
        way = np.abs(goal - start) - self.tolerance
        covered = (simulation.arc_length - start) * np.sign(goal - start)
        # If the start is near the goal, the path has no length.
        part = np.where(way > 0.0, covered / np.maximum(way, 1e-9), 1.0).clip(0.0, 1.0)
        best[numbers] = np.maximum(best, part)[numbers]

    def progress(self, simulation: Simulation) -> Float[np.ndarray, " n"]:
        """Maximum fraction of the path so far."""
        return simulation.memory["navigate/best"]

    def is_done(self, simulation: Simulation) -> Bool[np.ndarray, " n"]:
        """Return whether the goal was reached or passed."""
        return simulation.memory["navigate/best"] >= 1.0

    def measures(self, simulation: Simulation) -> dict[str, np.ndarray]:
        """Maximum fraction of the path so far, and remaining distance along the gut [m]."""
        memory = simulation.memory
        left = np.abs(memory["navigate/goal"] - simulation.arc_length)
        return {"completion": memory["navigate/best"].copy(), "distance_to_goal": left}


def _place(organ: OrganSurface, goal: float | str, start: float) -> float:
    """Arc length of a goal [m]; for a segment, its end that is nearer to the start."""
    if not isinstance(goal, str):
        return goal * organ.centerline.length
    present = {organ.label_names[number] for number in np.unique(organ.label)}
    if goal not in present - {"background"}:
        raise UnknownNameError(f"segment of {organ.name}", goal, present - {"background"})
    inside = organ.arc_length[organ.label == organ.label_names.index(goal)]
    return float(np.clip(start, inside.min(), inside.max()))
