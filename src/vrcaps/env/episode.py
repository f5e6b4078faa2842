"""Batched episodes with observations, rewards and ends, independent of the Gymnasium API."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from vrcaps.core.errors import InputError, require
from vrcaps.env.organs import check_names
from vrcaps.env.rewards import frontier_length, total_reward
from vrcaps.env.simulation import Simulation
from vrcaps.env.views import View

if TYPE_CHECKING:
    from jaxtyping import Bool, Float

    from vrcaps.env.patient import Patients
    from vrcaps.env.settings import EnvSettings
    from vrcaps.env.snapshot import WorldSnapshot

_PROGRESS = 1e-3
"""Minimum gain of progress that counts."""


@dataclass(frozen=True)
class EpisodeStep:
    """Result of one step, with a row for each world; 0 for worlds that did not step.

    Attributes:
        reward: Reward of the step.
        terminated: Whether the task is completed.
        truncated: Whether the episode ends for another reason: time, no progress, or a fault.
        measures: Metrics of the task and terms of the reward.
    """

    reward: Float[np.ndarray, " n"]
    terminated: Bool[np.ndarray, " n"]
    truncated: Bool[np.ndarray, " n"]
    measures: dict[str, np.ndarray]


class Episode:
    """Episodes of a task in several worlds."""

    def __init__(
        self, settings: EnvSettings, num_worlds: int, *, render_mode: str | None = None
    ) -> None:
        """Allocate buffers; worlds are created by `begin`. See `Simulation`.

        Raises:
            InputError: If the render mode is unknown, or a file of settings is missing.
            UnknownNameError: If there is no organ or no capsule of a name.
        """
        from gymnasium import spaces

        check_names(settings)
        require(render_mode in (None, "rgb_array"), "render_mode", render_mode, "rgb_array or None")
        self.settings, self.render_mode = settings, render_mode
        self.simulation = Simulation(settings, num_worlds, with_textures=render_mode is not None)
        self.rewards = settings.rewards or settings.task.rewards
        memory = self.simulation.memory
        self._best = memory.allocate("progress/best")
        self._gain = memory.allocate("progress/gain")
        self._mark = memory.allocate("progress/mark")
        self._since = memory.allocate("progress/since")
        self._frontier = memory.allocate("frontier/length")
        self._growth = memory.allocate("frontier/growth")
        self.action_space = settings.actuation.space()
        self.observation_space = spaces.Dict(
            {o.name: o.space(self.simulation) for o in settings.observations}
        )

    def __reduce__(self) -> tuple[Any, ...]:
        """Support pickling; a copy creates its organs again and continues with the same bytes."""
        s = self.simulation
        begun = [k for k in range(s.num_worlds) if s.patient_number(k) >= 0]
        worlds = {k: s.snapshot(k) for k in begun}
        return _restored, (self.settings, s.num_worlds, self.render_mode, worlds)

    def __deepcopy__(self, memo: object) -> Episode:
        """Return a copy that shares the immutable parts: the settings and the organs."""
        _, given = self.__reduce__()
        return _restored(*given, patients=self.simulation.patients)

    def begin(self, index: int, rng: np.random.Generator, patient: int | None = None) -> None:
        """Start an episode in one world, see `Simulation.reset`."""
        self.simulation.reset(index, rng, patient)
        progress = self.settings.task.progress(self.simulation)[index]
        self._best[index] = self._mark[index] = progress
        self._gain[index] = self._since[index] = 0.0
        self._follow_frontier(np.arange(self.simulation.num_worlds) == index)
        self._growth[index] = 0.0

    def check_actions(self, actions: Any) -> np.ndarray:
        """Convert actions to an array with a row for each world.

        Raises:
            InputError: If an action is not in the space.
        """
        space, count = self.action_space, self.simulation.num_worlds
        actions = np.asarray(actions)
        valid = actions.shape == (count, *space.shape)
        if valid and hasattr(space, "low"):
            actions = actions.astype(np.float64)
            valid = bool(np.all((actions >= space.low) & (actions <= space.high)))
        elif valid:
            valid = np.issubdtype(actions.dtype, np.integer) and bool(
                np.all((actions >= space.start) & (actions < space.start + space.n))
            )
        if not valid:
            shown = " ".join(str(actions).split())
            raise InputError(
                f"The action is {shown[:200]}. Allowed: {count} of {space}. {_limits(space)}"
            )
        return actions

    def step(self, actions: np.ndarray, active: Bool[np.ndarray, " n"]) -> EpisodeStep:
        """Advance the active worlds by one control period."""
        simulation, task = self.simulation, self.settings.task
        simulation.step(actions, active)
        self._follow_progress(active)
        self._follow_frontier(active)
        speed = np.linalg.norm(simulation.velocity_world[:, 0], axis=1)
        is_too_fast = speed > self.settings.max_speed
        failed = simulation.is_outside | np.array([bool(text) for text in simulation.failure])
        failed |= is_too_fast
        reward, terms = total_reward(self.rewards, simulation)
        terminated = active & task.is_done(simulation) & ~failed
        over_time = simulation.time > self.settings.episode_time - 1e-9
        is_stuck = self._since >= self.settings.stuck_time
        truncated = active & ~terminated & (over_time | is_stuck | failed)
        measures = self.measures() | {f"reward_{name}": term for name, term in terms.items()}
        measures |= {"is_stuck": active & is_stuck, "is_too_fast": active & is_too_fast}
        # Failed or ejected worlds receive no reward.
        paid = active & ~failed
        return EpisodeStep(np.where(paid, reward, 0.0), terminated, truncated, measures)

    def _follow_progress(self, active: Bool[np.ndarray, " n"]) -> None:
        progress = self.settings.task.progress(self.simulation)
        self._gain[:] = np.where(active, np.maximum(progress - self._best, 0.0), 0.0)
        self._best[active] += self._gain[active]
        gains = active & (progress > self._mark + _PROGRESS)
        period = self.settings.control_period
        self._since[:] = np.where(gains, 0.0, self._since + np.where(active, period, 0.0))
        self._mark[:] = np.where(gains, progress, self._mark)

    def _follow_frontier(self, active: Bool[np.ndarray, " n"]) -> None:
        """Measure the frontier on the map, if a reward uses it."""
        self._growth[:] = 0.0
        if any(reward.term == "total-variation" for reward in self.rewards):
            s = self.simulation
            has_wall = s.cell_area[active] > 0.0
            length = frontier_length(s.cell_fraction[active], has_wall, s.settings.grid)
            self._growth[active] = length - self._frontier[active]
            self._frontier[active] = length

    def observe(self) -> dict[str, np.ndarray]:
        """Return the observations of all worlds, in new arrays."""
        observations = self.settings.observations
        return {o.name: o.observe(self.simulation) for o in observations}

    def measures(self) -> dict[str, np.ndarray]:
        """Return the metrics of the episodes of all worlds."""
        s = self.simulation
        return {
            **self.settings.task.measures(s),
            **self.settings.actuation.measures(s),
            "time": s.time.copy(),
            "arc_length": s.arc_length.copy(),
            "normal_force_total": s.normal_force_total.copy(),
            "is_success": self.settings.task.is_done(s),
            "is_outside": s.is_outside.copy(),
            "failure": np.array(s.failure, object),
        }

    def images(self) -> list[np.ndarray]:
        """Render the first camera of each capsule, at its native size.

        Raises:
            InputError: If a world has no episode yet.
        """
        if any(self.simulation.patient_number(k) < 0 for k in range(self.simulation.num_worlds)):
            raise InputError("No episode has begun, so there is nothing to draw. Call reset first.")
        return [image.copy() for image in self.simulation.views.images(View(), "rgb")]


def _restored(
    settings: EnvSettings,
    num_worlds: int,
    render_mode: str | None,
    worlds: dict[int, WorldSnapshot],
    *,
    patients: Patients | None = None,
) -> Episode:
    """Reconstruct episodes from the state of `Episode.__reduce__`."""
    episode = Episode(settings, num_worlds, render_mode=render_mode)
    episode.simulation.patients = patients or episode.simulation.patients
    for index, saved in worlds.items():
        episode.simulation.restore(index, saved)
    return episode


def _limits(space: Any) -> str:
    """Explanation of the limits of an action space, for a message."""
    if not hasattr(space, "low"):
        return "An action is the number of a choice."
    return (
        "An action is a share, -1 to 1, of the largest force, torque or speed that the settings of "
        "the actuation state, not a value in N or m/s; clip it to the space."
    )
