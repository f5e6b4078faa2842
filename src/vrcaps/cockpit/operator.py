"""Operator: makes joystick commands of what the driver does, and is the log of them."""

from __future__ import annotations

import threading
from typing import TYPE_CHECKING

import numpy as np

from vrcaps.actuation.steering_program import JoystickCommand, SteeringProgram
from vrcaps.errors import InputError
from vrcaps.transforms import vector_from_rotation

if TYPE_CHECKING:
    from jaxtyping import Float

    from vrcaps.cockpit.policy_driver import PolicyDriver

_ARRIVED = (1e-5, 1e-4)
"""Distance [m] and angle [rad] from a dragged pose within which the magnet has arrived."""

_BLOCKED = ("unreachable", "collision")
"""Limits of the actuator behind which a dragged pose is given up once it is let go."""


class Operator:
    """The operator of a `SteeringProgram`.

    All ways to drive end in axes from −1 to 1, as a joystick has them: keys and pad give them as
    they are; a dragged magnet follows the pose by the axes that lead to it at the greatest speed
    allowed; a policy gives its own until a human gives any. A command is logged only where it
    differs from the one before, at the time from which it holds. So the log, played back as
    `MagnetSteering.joystick`, is the same drive.
    """

    def __init__(self, program: SteeringProgram) -> None:
        self._program = program
        self._lock = threading.Lock()
        self._axes = np.zeros(6)
        self._target: Float[np.ndarray, "4 4"] | None = None
        self._is_dragging = False
        self._driver: PolicyDriver | None = None
        self._log: list[JoystickCommand] = []
        self._num_rewound = 0

    @property
    def is_dragged(self) -> bool:
        """Whether the magnet is on its way to a pose that it was dragged to."""
        return self._target is not None

    @property
    def policy(self) -> str:
        """Name of the policy that drives; empty where none does."""
        driver = self._driver
        return "" if driver is None else driver.name

    def hand_over(self, driver: PolicyDriver) -> None:
        """Lets a policy drive, until it hands back or a human drives again."""
        self.stop()
        with self._lock:
            self._driver = driver

    def push(self, axes: Float[np.ndarray, " 6"]) -> None:
        """Holds the axes of keys or a pad, until other ones come.

        Args:
            axes: Along and about the world's x, y, z, from −1 to 1.

        Raises:
            InputError: If they are no six such numbers.
        """
        given = np.array(axes, float)
        if given.shape != (6,) or not (np.abs(given) <= 1.0).all():
            raise InputError(f"Joystick axes {axes}. Allowed: six numbers from -1 to 1.")
        with self._lock:
            self._axes = given
            if given.any():
                self._target = self._driver = None

    def drag(self, T_world_magnet: Float[np.ndarray, "4 4"], *, is_dragging: bool = True) -> None:
        """Leads the magnet to a pose, as near as its workspace allows.

        Args:
            T_world_magnet: The pose.
            is_dragging: Whether the driver still holds it.
        """
        target = self._program.controller.actuator.workspace.clamp_pose(T_world_magnet)
        with self._lock:
            self._target, self._is_dragging, self._driver = target, is_dragging, None

    def stop(self) -> None:
        """Lets go of everything: the magnet stays where it is asked for."""
        with self._lock:
            self._axes, self._target, self._driver = np.zeros(6), None, None

    def __call__(self, time: float, dt: float) -> JoystickCommand:
        """The command at a time [s] for the next `dt` [s]; logged from the first frame on."""
        with self._lock:
            axes = np.zeros(6) if time < 0.0 else self._axes_now(time, dt)
            linear, angular = tuple(axes[:3].tolist()), tuple(axes[3:].tolist())
            command = JoystickCommand(time, linear, angular)  # type: ignore[arg-type]
            last = self._log[-1] if self._log else None
            if time >= 0.0 and (last is None or (last.linear, last.angular) != (linear, angular)):
                self._log.append(command)
            return command

    def commands(self, after: int = 0) -> tuple[int, list[JoystickCommand]]:
        """How often the log was cut back, and the commands from a number on."""
        with self._lock:
            return self._num_rewound, self._log[after:]

    def rewind(self, time: float) -> None:
        """Forgets commands from a time [s] on, to which the simulation goes back; stops."""
        self.stop()
        with self._lock:
            self._log = [command for command in self._log if command.time < time]
            self._num_rewound += 1

    def _axes_now(self, time: float, dt: float) -> Float[np.ndarray, " 6"]:
        """Axes of keys or pad, of a policy, or those that lead to the dragged pose."""
        if self._driver is not None:
            axes = self._driver.axes(time)
            if axes is not None:
                return axes
            self._driver = None
        if self._target is None:
            return self._axes
        settings, controller = self._program.settings, self._program.controller
        now, status = controller.requested, controller.status.actuator
        offset = self._target[:3, 3] - now[:3, 3]
        rotation = vector_from_rotation(self._target[:3, :3] @ now[:3, :3].T)
        near = np.linalg.norm(offset) < _ARRIVED[0] and np.linalg.norm(rotation) < _ARRIVED[1]
        if not self._is_dragging and (near or status.limit in _BLOCKED):
            self._target = None
            return np.zeros(6)
        full = np.repeat([settings.joystick_speed, settings.joystick_angular_speed], 3) * dt
        axes = np.concatenate([offset, rotation]) / full
        # All axes by the same factor: the magnet goes straight to where it was dragged.
        return axes / max(1.0, float(np.abs(axes).max()))
