"""Tasks of an environment: see the whole wall, reach a position along the gut, inspect lesions."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated, Any, ClassVar

import numpy as np

from vrcaps.core.errors import InputError, UnknownNameError
from vrcaps.core.fields import Range, check_fields
from vrcaps.core.units import CM
from vrcaps.env.actuation import MagnetActuation
from vrcaps.env.parts import EnvView, Reward, Task
from vrcaps.env.randomization import Start
from vrcaps.env.rewards import AreaGain, ProgressGain, Success, TimePenalty
from vrcaps.lesion import Angioectasia, Polyp, Ulcer
from vrcaps.metrics.coverage import CoverageLevel
from vrcaps.metrics.point_coverage import POINT_LEVELS, require_point_level

if TYPE_CHECKING:
    from jaxtyping import Bool, Float

    from vrcaps.organ.surface import OrganSurface


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
        return (AreaGain(100.0, self.level), TimePenalty(0.1))

    def progress(self, view: EnvView) -> Float[np.ndarray, " n"]:
        """Seen fraction of the wall."""
        return view.coverage.seen(self.level)

    def is_done(self, view: EnvView) -> Bool[np.ndarray, " n"]:
        """Return whether the target is reached."""
        return view.coverage.seen(self.level) >= self.target

    def measures(self, view: EnvView) -> dict[str, np.ndarray]:
        """Seen fraction at each level."""
        return {f"coverage_{level}": view.coverage.seen(level).copy() for level in POINT_LEVELS}


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

    goal: Annotated[float, Range(0.0, 1.0)] | str = 1.0
    tolerance: Annotated[float, Range(above=0.0, max=0.1, unit="m")] = 2.0 * CM

    kind: ClassVar[str] = "navigate"

    def __post_init__(self) -> None:
        check_fields(self, of="NavigateTask")

    @property
    def rewards(self) -> tuple[Reward, ...]:
        """Progress along the path in percent, ten for success, with a small time penalty."""
        return (ProgressGain(100.0), Success(10.0), TimePenalty(0.02))

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

    def allocate(self, view: EnvView) -> None:
        """Allocate start and goal [m], and the maximum fraction of the path so far."""
        for name in ("start", "goal", "best"):
            view.memory.allocate(f"navigate/{name}")

    def begin(self, view: EnvView, index: int, rng: np.random.Generator) -> None:
        """Start at the position where the capsule came to rest.

        Raises:
            UnknownNameError: If the organ has no segment of the goal's name.
        """
        memory, start = view.memory, view.arc_length[index]
        organ = view.patient(index).model.organ
        memory["navigate/start"][index] = start
        memory["navigate/goal"][index] = _goal_arc_length(organ, self.goal, start)
        memory["navigate/best"][index] = 0.0
        self.update(view, np.array([index]))

    def update(self, view: EnvView, indices: np.ndarray) -> None:
        """Update the progress of the capsules."""
        memory = view.memory
        start, goal, best = (memory[f"navigate/{name}"] for name in ("start", "goal", "best"))
        length = np.abs(goal - start) - self.tolerance
        covered = (view.arc_length - start) * np.sign(goal - start)
        # If the start is near the goal, the path has no length.
        part = np.where(length > 0.0, covered / np.maximum(length, 1e-9), 1.0).clip(0.0, 1.0)
        best[indices] = np.maximum(best, part)[indices]

    def progress(self, view: EnvView) -> Float[np.ndarray, " n"]:
        """Maximum fraction of the path so far."""
        return view.memory["navigate/best"]

    def is_done(self, view: EnvView) -> Bool[np.ndarray, " n"]:
        """Return whether the goal was reached or passed."""
        return view.memory["navigate/best"] >= 1.0

    def measures(self, view: EnvView) -> dict[str, np.ndarray]:
        """Maximum fraction of the path so far, and remaining distance along the gut [m]."""
        memory = view.memory
        left = np.abs(memory["navigate/goal"] - view.arc_length)
        return {"completion": memory["navigate/best"].copy(), "distance_to_goal": left}


def _goal_arc_length(organ: OrganSurface, goal: float | str, start: float) -> float:
    """Arc length of a goal [m]; for a segment, its end that is nearer to the start."""
    if not isinstance(goal, str):
        return goal * organ.centerline.length
    present = {organ.label_names[number] for number in np.unique(organ.label)}
    if goal not in present - {"background"}:
        raise UnknownNameError(f"segment of {organ.name}", goal, present - {"background"})
    inside = organ.arc_length[organ.label == organ.label_names.index(goal)]
    return float(np.clip(start, inside.min(), inside.max()))


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
            ProgressGain(100.0),
            AreaGain(10.0),
            Success(10.0),
            TimePenalty(0.1),
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

    def allocate(self, view: EnvView) -> None:
        """Allocate the state of each lesion, in the order of their instances."""
        memory = view.memory
        memory.allocate("inspect/count", dtype=np.int64)
        memory.allocate("inspect/now", (self.most,))
        memory.allocate("inspect/longest", (self.most,))

    def begin(self, view: EnvView, index: int, rng: np.random.Generator) -> None:
        """Start with no lesion inspected.

        Raises:
            InputError: If the organ has no lesions, or too many.
        """
        points, memory = view.patient(index).points, view.memory
        count = len(points.lesions)
        if not 1 <= count <= self.most:
            name = view.patient(index).model.organ.name
            raise InputError(
                f"{name} has {count} lesions. Allowed: 1 to {self.most}, InspectTask's most. Set "
                "lesions=(Polyp(), …), or give an organ file that has some."
            )
        memory["inspect/count"][index] = count
        memory["inspect/now"][index] = memory["inspect/longest"][index] = 0.0
        view.coverage.flags[index][points.first_of_lesions :] = 0

    def update(self, view: EnvView, indices: np.ndarray) -> None:
        """Update the time for which each lesion has been in view."""
        memory, bit = view.memory, 1 << POINT_LEVELS.index(self.level)
        in_view = np.zeros((len(indices), self.most), bool)
        for row, index in enumerate(indices):
            points = view.patient(index).points
            flags = view.coverage.flags[index][points.first_of_lesions :]
            fractions = ((flags & bit) != 0).reshape(len(points.lesions), -1).mean(axis=1)
            in_view[row, : len(fractions)] = fractions >= self.fraction
            # Each step marks the current view again; lesions' points have no area.
            flags[:] = 0
        period = view.control_period
        now = np.where(in_view, memory["inspect/now"][indices] + period, 0.0)
        memory["inspect/now"][indices] = now
        memory["inspect/longest"][indices] = np.maximum(memory["inspect/longest"][indices], now)

    def _inspected(self, view: EnvView) -> Float[np.ndarray, "n m"]:
        """Fraction of the required time for which each lesion was in view."""
        enough = self.dwell * (1.0 - 1e-9)  # sums of periods are rounded
        return np.minimum(view.memory["inspect/longest"] / enough, 1.0)

    def progress(self, view: EnvView) -> Float[np.ndarray, " n"]:
        """Mean over all lesions of the fraction of the required time in view."""
        count = np.maximum(view.memory["inspect/count"], 1)
        return self._inspected(view).sum(axis=1) / count

    def is_done(self, view: EnvView) -> Bool[np.ndarray, " n"]:
        """Return whether each lesion was in view for long enough."""
        count = view.memory["inspect/count"]
        return (count > 0) & ((self._inspected(view) >= 1.0).sum(axis=1) >= count)

    def measures(self, view: EnvView) -> dict[str, np.ndarray]:
        """Numbers of lesions, of detected lesions, and of those in view for long enough."""
        return {
            "lesions": view.memory["inspect/count"].copy(),
            "lesions_found": (view.memory["inspect/longest"] > 0.0).sum(axis=1),
            "lesions_inspected": (self._inspected(view) >= 1.0).sum(axis=1),
        }
