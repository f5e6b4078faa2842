"""Policy or baseline that controls the joystick of a drive."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np

from vrcaps.core import rng
from vrcaps.core.errors import InputError, VrcapsError
from vrcaps.env.actuation import MagnetActuation
from vrcaps.env.settings import EnvSettings, env_settings
from vrcaps.env.tasks import NavigateTask
from vrcaps.env.vector_env import CapsuleVectorEnv
from vrcaps.policy.catalog import read_policy
from vrcaps.policy.policy import Policy
from vrcaps.world.schedule import patient_at

if TYPE_CHECKING:
    from jaxtyping import Float

    from vrcaps.motion.rollout import Rollout

_WORLD = np.zeros(1, int)
"""Index of the only world."""

_SOON = 1e-9
"""Tolerance [s] of a control period's end: a step that starts so little earlier is after it."""


class PolicyDriver:
    """Driver that queries a policy once per control period of simulated time and holds its axes.

    The policy sees an environment with one world, that of the drive, in which the magnet has its
    requested pose. It acts by `MagnetActuation`, whose actions are joystick axes except for the
    speeds that they are fractions of.

    Attributes:
        name: Name of the policy.
    """

    def __init__(
        self,
        name: str,
        rollout: Rollout,
        *,
        posture: str,
        seed: int = 0,
        goal: float | None = None,
        on_message: Callable[[str], None] = lambda text: None,
    ) -> None:
        """Load the policy; the simulation may continue meanwhile.

        Args:
            name: See `read_policy`.
            rollout: The simulation of the drive.
            posture: Initial posture of the patient.
            seed: Random seed of the policy.
            goal: Target of a policy that navigates, as a fraction of the centerline; None leaves it
                to the policy.
            on_message: Called with the reason for which the policy hands back.

        Raises:
            InputError: If it is not a policy, or not one that can move a magnet.
            UnknownNameError: If there is no policy of that name.
        """
        self.name, self._rollout, self._notify = name, rollout, on_message
        self._policy = read_policy(name)
        changes = rollout.settings.posture_changes
        self._posture = changes[-1].posture if changes else posture
        settings = _settings(self._policy, rollout, self._posture, goal)
        self._policy.requires.check(settings, name)
        self._env, self._seed = CapsuleVectorEnv(settings), seed
        self._patient = self._env.episode.simulation.worlds.patients[
            0
        ]  # created now: it takes a while
        self._axes, self._time, self._due = np.zeros(6), -np.inf, -np.inf

    def axes(self, time: float) -> Float[np.ndarray, " 6"] | None:
        """Joystick axes at a time [s], called from the stepping thread; None hands back."""
        if time < self._due - _SOON:
            return self._axes
        try:
            self._axes = self._act(time)
        except VrcapsError as error:
            self._notify(f"Policy {self.name} releases control: {error}")
            return None
        except Exception as error:  # the simulation survives any error of a policy
            self._notify(f"Policy {self.name} releases control: {type(error).__name__}: {error}.")
            return None
        return self._axes

    def _act(self, time: float) -> Float[np.ndarray, " 6"]:
        """Query the policy at a time [s].

        Raises:
            InputError: If the patient is turned, or the action is invalid.
        """
        rollout, episode = self._rollout, self._env.episode
        program, simulation, period = rollout.program, episode.simulation, self._period
        assert program is not None
        self._check_posture(time)
        if self._time < 0.0:
            generator = rng.stream(self._seed, "cockpit/policy")
            simulation.follow(0, rollout.world, rollout.arc_length, generator)
            self._policy.reset(_WORLD, [self._seed])
            self._due = time
        else:
            simulation.arrive(_WORLD, time - self._time)
        self._time, self._due = time, max(self._due + period, time)
        simulation.memory["magnet/T"][0] = program.controller.requested
        actions = self._policy.act(episode.observe(), self._env)
        axes = episode.check_actions(actions)[0] * self._joystick_shares()
        return axes / max(1.0, float(np.abs(axes).max()))

    @property
    def _period(self) -> float:
        return self._env.settings.control_period

    def _joystick_shares(self) -> Float[np.ndarray, " 6"]:
        """Joystick axes with the speed of full actions."""
        steering, actuation = self._rollout.settings.magnet, self._env.settings.actuation
        assert steering is not None
        assert isinstance(actuation, MagnetActuation)
        linear = actuation.speed / steering.joystick_speed
        angular = actuation.angular_speed / steering.joystick_angular_speed
        return np.repeat([linear, angular], 3)

    def _check_posture(self, time: float) -> None:
        """Check that the patient has the posture that the policy assumes.

        Raises:
            InputError: If not.
        """
        model, settings = self._rollout.model, self._rollout.settings
        now = patient_at(model.T_world_patient, settings.posture_changes, time)
        taken = self._patient.model.T_world_patient
        if not np.allclose(now[:3, :3], taken[:3, :3], atol=1e-9):
            raise InputError(
                f"the policy was started for the posture {self._posture}. Start it again "
                "after the turn."
            )


def _settings(policy: Policy, rollout: Rollout, posture: str, goal: float | None) -> EnvSettings:
    """Settings of an environment with the patient and the capsule of a rollout."""
    steering, world = rollout.settings.magnet, rollout.world
    assert steering is not None
    wanted: dict[str, Any] = dict(policy.requires.settings)
    own = wanted.get("actuation")
    if not isinstance(own, MagnetActuation):
        own = MagnetActuation(
            speed=steering.joystick_speed, angular_speed=steering.joystick_angular_speed
        )
    settings = env_settings(
        **wanted
        | {
            "organs": (rollout.model.organ,),
            "capsule": rollout.model.device,
            "posture": posture,
            "tissue": world.tissue,
            "dynamics": world.dynamics,
            "actuation": replace(own, magnet=steering.magnet, standoff=steering.standoff),
        }
    )
    if goal is not None and isinstance(settings.task, NavigateTask):
        settings = replace(settings, task=replace(settings.task, goal=goal))
    return settings
