"""Batched episodes with observations, rewards and ends, independent of the Gymnasium API."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from vrcaps.core.errors import InputError, require
from vrcaps.env.cameras import View
from vrcaps.env.parts import EnvView
from vrcaps.env.patients import Patients, check_names
from vrcaps.env.rewards import total_reward
from vrcaps.env.settings import EnvSettings
from vrcaps.env.simulation import Simulation, WorldSnapshot
from vrcaps.env.transmission import Link

if TYPE_CHECKING:
    from jaxtyping import Bool, Float


_MIN_PROGRESS = 1e-3
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
        self,
        settings: EnvSettings,
        num_worlds: int,
        *,
        render_mode: str | None = None,
        patients: Patients | None = None,
    ) -> None:
        """Allocate buffers; worlds are created by `begin`. See `Simulation`.

        Raises:
            InputError: If the render mode is unknown, or a file of settings is missing.
            UnknownNameError: If an organ or the capsule is unknown.
        """
        from gymnasium import spaces

        check_names(settings.organs, settings.capsule)
        require(render_mode in (None, "rgb_array"), "render_mode", render_mode, "rgb_array or None")
        self.settings, self.render_mode = settings, render_mode
        self.simulation = Simulation(
            settings, num_worlds, with_textures=render_mode is not None, patients=patients
        )
        self.rewards = settings.rewards or settings.task.rewards
        self._mark = self.simulation.memory.allocate("progress/mark")
        self._since = self.simulation.memory.allocate("progress/since")
        # Rewards of one kind share their state.
        self._trackers = list({reward.kind: reward for reward in self.rewards}.values())
        for reward in self._trackers:
            reward.allocate(self.view)
        self.action_space = settings.actuation.space()
        self.observation_space = spaces.Dict(
            {o.name: o.space(self.view) for o in settings.observations}
        )
        self._link = Link(
            settings.transmission,
            self.simulation.memory,
            self.action_space,
            settings.observations,
            self.observation_space,
        )

    def __reduce__(self) -> tuple[Any, ...]:
        """Support pickling; a copy creates its organs again and continues with the same bytes."""
        s = self.simulation
        running = [k for k in range(s.num_worlds) if self.view.patient_index(k) >= 0]
        worlds = {k: s.snapshot(k) for k in running}
        return _restored, (self.settings, s.num_worlds, self.render_mode, worlds)

    def __deepcopy__(self, memo: object) -> Episode:
        """Return a copy that shares the immutable parts: the settings and the organs."""
        _, given = self.__reduce__()
        return _restored(*given, patients=self.simulation.worlds.patients)

    @property
    def view(self) -> EnvView:
        """View of the worlds."""
        return self.simulation.view

    def begin(self, index: int, rng: np.random.Generator, patient: int | None = None) -> None:
        """Start an episode in one world, see `Simulation.reset`."""
        self.simulation.reset(index, rng, patient)
        self._link.begin(index, rng)
        self._mark[index] = self.settings.task.progress(self.view)[index]
        self._since[index] = 0.0
        for reward in self._trackers:
            reward.begin(self.view, index)

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
            given = " ".join(str(actions).split())
            raise InputError(
                f"The action is {given[:200]}. Allowed: {count} of {space}. {_limits(space)}"
            )
        return actions

    def step(self, actions: np.ndarray, active: Bool[np.ndarray, " n"]) -> EpisodeStep:
        """Advance the active worlds by one control period."""
        simulation, view, task = self.simulation, self.view, self.settings.task
        simulation.step(self._link.send(actions, active), active)
        self._update_progress(active)
        for tracker in self._trackers:
            tracker.update(view, active)
        is_too_fast = np.linalg.norm(view.velocity_world[:, 0], axis=1) > self.settings.max_speed
        failed = np.array([bool(text) for text in simulation.failure])
        failed |= simulation.worlds.is_outside | is_too_fast
        reward, terms = total_reward(self.rewards, view)
        terminated = active & task.is_done(view) & ~failed
        over_time = view.time > self.settings.episode_time - 1e-9
        is_stuck = self._since >= self.settings.stuck_time
        truncated = active & ~terminated & (over_time | is_stuck | failed)
        measures = self.measures() | {f"reward_{name}": term for name, term in terms.items()}
        measures |= {"is_stuck": active & is_stuck, "is_too_fast": active & is_too_fast}
        # Failed or ejected worlds receive no reward.
        paid = active & ~failed
        return EpisodeStep(np.where(paid, reward, 0.0), terminated, truncated, measures)

    def _update_progress(self, active: Bool[np.ndarray, " n"]) -> None:
        """Measure the time for which the active worlds have made no progress."""
        progress = self.settings.task.progress(self.view)
        gains = active & (progress > self._mark + _MIN_PROGRESS)
        period = self.settings.control_period
        self._since[:] = np.where(gains, 0.0, self._since + np.where(active, period, 0.0))
        self._mark[:] = np.where(gains, progress, self._mark)

    def observe(self) -> dict[str, np.ndarray]:
        """Return the observations of all worlds, in new arrays."""
        observations = self.settings.observations
        return self._link.receive({o.name: o.observe(self.view) for o in observations})

    @property
    def observation_names(self) -> dict[str, tuple[str, ...]]:
        """Name of each value of each observation, or of each channel of an image or a map.

        Units are in brackets.
        """
        return {o.name: o.names(self.view) for o in self.settings.observations}

    def measures(self) -> dict[str, np.ndarray]:
        """Return the metrics of the episodes of all worlds."""
        simulation, view = self.simulation, self.view
        return {
            **self.settings.task.measures(view),
            **self.settings.actuation.measures(view),
            "time": view.time.copy(),
            "arc_length": view.arc_length.copy(),
            "normal_force_total": view.normal_force_total.copy(),
            "is_success": self.settings.task.is_done(view),
            "is_outside": simulation.worlds.is_outside.copy(),
            "failure": np.array(simulation.failure, object),
        }

    def images(self) -> list[np.ndarray]:
        """Render the first camera of each capsule, at its native size.

        Raises:
            InputError: If a world has no episode yet.
        """
        if any(self.view.patient_index(k) < 0 for k in range(self.view.num_worlds)):
            raise InputError("No episode has started, so there is no image. Call reset first.")
        return [image.copy() for image in self.view.cameras.images(View(), "rgb")]


def _restored(
    settings: EnvSettings,
    num_worlds: int,
    render_mode: str | None,
    worlds: dict[int, WorldSnapshot],
    *,
    patients: Patients | None = None,
) -> Episode:
    """Reconstruct episodes from the state of `Episode.__reduce__`."""
    episode = Episode(settings, num_worlds, render_mode=render_mode, patients=patients)
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
