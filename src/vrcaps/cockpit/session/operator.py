"""Operator: converts the input of the driver or of a policy to joystick commands and logs them."""

from __future__ import annotations

import threading
from collections.abc import Callable
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np

from vrcaps.actuation.coil_program import CoilCommand, coil_command_columns
from vrcaps.actuation.steering_program import (
    JOYSTICK_COLUMNS,
    JoystickCommand,
    SteeringProgram,
)
from vrcaps.core import rng
from vrcaps.core.errors import InputError, VrcapsError
from vrcaps.core.geometry import vector_from_rotation
from vrcaps.env.actuation import MagnetActuation
from vrcaps.env.settings import EnvSettings, env_settings
from vrcaps.env.tasks import NavigateTask
from vrcaps.env.vector_env import CapsuleVectorEnv
from vrcaps.policy.catalog import read_policy
from vrcaps.policy.policy import Policy
from vrcaps.world.schedule import patient_at

if TYPE_CHECKING:
    from jaxtyping import Float

    from vrcaps.actuation.coil_program import CoilProgram
    from vrcaps.motion.rollout import Rollout


class Operator:
    """Operator of a `SteeringProgram` or a `CoilProgram`, whose axes are a force and a torque.

    All kinds of input end in axes from −1 to 1, like those of a joystick: keys and pad give them
    directly; a dragged magnet follows the pose by the axes that lead to it at the maximum speed; a
    policy gives its own until there is human input. Currents of coils can be set instead of axes;
    the later input counts. A command is logged only if it differs from the
    previous one, with its start time. Played back as `MagnetSteering.joystick`, the log gives the
    same drive.
    """

    def __init__(self, program: SteeringProgram | CoilProgram) -> None:
        self._program = program
        self._lock = threading.Lock()
        self._axes = np.zeros(6)
        is_magnet = isinstance(program, SteeringProgram)
        self._most = np.zeros(0) if is_magnet else program.array.values("max_current")
        self._currents = np.zeros(len(self._most))
        self._target: Float[np.ndarray, "4 4"] | None = None
        self._is_dragging = False
        self._driver: PolicyDriver | None = None
        self._log: list[JoystickCommand] = []
        self._num_rewound = 0

    @property
    def is_dragged(self) -> bool:
        """True if the magnet is moving to a dragged pose."""
        return self._target is not None

    @property
    def is_steering(self) -> bool:
        """True while keys, a pad, a dragged pose or set currents act."""
        return self._target is not None or bool(self._axes.any() or self._currents.any())

    @property
    def currents(self) -> Float[np.ndarray, " k"]:
        """Set current of each coil [A]; zeros while axes or none are given."""
        return self._currents.copy()

    @property
    def columns(self) -> tuple[str, ...]:
        """Columns of a file of the commands."""
        has_coils = len(self._most) > 0
        return coil_command_columns(len(self._most)) if has_coils else JOYSTICK_COLUMNS

    @property
    def policy(self) -> str:
        """Name of the driving policy; empty if none drives."""
        driver = self._driver
        return "" if driver is None else driver.name

    def start_policy(self, driver: PolicyDriver) -> None:
        """Let a policy drive until it ends control or there is human input."""
        self.stop()
        with self._lock:
            self._driver = driver

    def push(self, axes: Float[np.ndarray, " 6"]) -> None:
        """Set the axes of keys or a pad, held until the next call.

        Args:
            axes: Along and about the world's x, y, z, from −1 to 1.

        Raises:
            InputError: If they are not six such numbers.
        """
        given = np.array(axes, float)
        if given.shape != (6,) or not (np.abs(given) <= 1.0).all():
            raise InputError(f"Joystick axes are {axes}. Allowed: six numbers from -1 to 1.")
        with self._lock:
            self._axes = given
            if given.any():
                self._target = self._driver = None
                self._currents = np.zeros(len(self._most))

    def set_current(self, coil: int, current: float) -> None:
        """Set the current of a coil, held until axes are given or `stop`; axes are released.

        Args:
            coil: Number of the coil, from 1.
            current: Current [A].

        Raises:
            InputError: If there is no such coil, or the current is beyond its limit.
        """
        if not 1 <= coil <= len(self._most):
            allowed = f"1 to {len(self._most)}" if len(self._most) else "none: a magnet is driven"
            raise InputError(f"coil is {coil}. Allowed: {allowed}.")
        most = float(self._most[coil - 1])
        if not abs(current) <= most:
            raise InputError(
                f"The current of coil {coil} is {current:g} A. Allowed: {-most:g} to {most:g} A."
            )
        with self._lock:
            self._currents[coil - 1] = current
            self._axes = np.zeros(6)

    def drag(self, T_world_magnet: Float[np.ndarray, "4 4"], *, is_dragging: bool = True) -> None:
        """Move the magnet to a pose, as close as its workspace allows.

        Args:
            T_world_magnet: The pose.
            is_dragging: Whether the driver is still dragging.

        Raises:
            InputError: If coils are driven.
        """
        if not isinstance(self._program, SteeringProgram):
            raise InputError("Coils have no magnet to drag. Use the keys.")
        target = self._program.controller.actuator.workspace.clamp_pose(T_world_magnet)
        with self._lock:
            self._target, self._is_dragging, self._driver = target, is_dragging, None

    def stop(self) -> None:
        """Release all input: the requested pose of the magnet stays the same."""
        with self._lock:
            self._axes, self._target, self._driver = np.zeros(6), None, None
            self._currents = np.zeros(len(self._most))

    def __call__(self, time: float, dt: float) -> JoystickCommand:
        """Command at a time [s] for the next `dt` [s]; logged from the first frame on."""
        with self._lock:
            axes = np.zeros(6) if time < 0.0 else self._axes_now(time, dt)
            linear, angular = tuple(axes[:3].tolist()), tuple(axes[3:].tolist())
            command = JoystickCommand(time, linear, angular)  # type: ignore[arg-type]
            if len(self._most):
                currents = (
                    tuple(self._currents.tolist()) if time >= 0.0 else (0.0,) * len(self._most)
                )
                command = CoilCommand(time, linear, angular, currents)  # type: ignore[arg-type]
            last = self._log[-1] if self._log else None
            if time >= 0.0 and (last is None or replace(last, time=time) != command):
                self._log.append(command)
            return command

    def commands(self, after: int = 0) -> tuple[int, list[JoystickCommand]]:
        """Number of rewinds of the log, and the commands from an index on."""
        with self._lock:
            return self._num_rewound, self._log[after:]

    def rewind(self, time: float) -> None:
        """Drop commands from a time [s] on, to which the simulation is rewound; stop."""
        self.stop()
        with self._lock:
            self._log = [command for command in self._log if command.time < time]
            self._num_rewound += 1

    def _axes_now(self, time: float, dt: float) -> Float[np.ndarray, " 6"]:
        """Current axes of keys or pad, of a policy, or towards the dragged pose."""
        if self._driver is not None:
            axes = self._driver.axes(time)
            if axes is not None:
                return axes
            self._driver = None
        if self._target is None:
            return self._axes
        assert isinstance(self._program, SteeringProgram)
        axes, is_over = axes_towards(self._program, self._target, dt)
        if is_over and not self._is_dragging:
            self._target = None
            return np.zeros(6)
        return axes


_WORLD = np.zeros(1, int)
"""Index of the only world."""

_TOLERANCE = 1e-9
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
            on_message: Called with the reason why the policy ends control.

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
        """Joystick axes at a time [s], or None to end control; called by the stepping thread."""
        if time < self._due - _TOLERANCE:
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


_ARRIVED = (1e-5, 1e-4)
"""Distance [m] and angle [rad] from a pose within which it counts as reached."""
_BLOCKED = ("unreachable", "collision")
"""Limits of the actuator at which it cannot come closer."""


def axes_towards(
    program: SteeringProgram, T_world_magnet: Float[np.ndarray, "4 4"], dt: float
) -> tuple[Float[np.ndarray, " 6"], bool]:
    """Axes −1 to 1 that move the requested pose of a magnet straight to another at maximum speed.

    Args:
        program: Program of the magnet.
        T_world_magnet: Pose to reach.
        dt: Duration of the command [s].

    Returns:
        The axes, and whether the pose is reached or the actuator cannot come closer.
    """
    settings, controller = program.settings, program.controller
    now, limit = controller.requested, controller.status.actuator.limit
    offset = T_world_magnet[:3, 3] - now[:3, 3]
    rotation = vector_from_rotation(T_world_magnet[:3, :3] @ now[:3, :3].T)
    is_near = np.linalg.norm(offset) < _ARRIVED[0] and np.linalg.norm(rotation) < _ARRIVED[1]
    full = np.repeat([settings.joystick_speed, settings.joystick_angular_speed], 3) * dt
    axes = np.concatenate([offset, rotation]) / full
    # All axes by the same factor, so that the path is straight.
    axes = axes / max(1.0, float(np.abs(axes).max()))
    return axes, bool(is_near) or limit in _BLOCKED
