"""Operator: converts the driver's input to joystick commands and logs them."""

from __future__ import annotations

import threading
from typing import TYPE_CHECKING

import numpy as np

from vrcaps.actuation.steering_program import JoystickCommand, SteeringProgram
from vrcaps.core.errors import InputError
from vrcaps.core.transforms import vector_from_rotation

if TYPE_CHECKING:
    from jaxtyping import Float

    from vrcaps.cockpit.session.policy_driver import PolicyDriver

_ARRIVED = (1e-5, 1e-4)
"""Distance [m] and angle [rad] from a dragged pose within which it counts as reached."""

_BLOCKED = ("unreachable", "collision")
"""Actuator limits at which a dragged pose is dropped once it is released."""


class Operator:
    """Operator of a `SteeringProgram`.

    All kinds of input end in axes from −1 to 1, like those of a joystick: keys and pad give them
    directly; a dragged magnet follows the pose by the axes that lead to it at the maximum speed; a
    policy gives its own until there is human input. A command is logged only if it differs from the
    previous one, with its start time. Played back as `MagnetSteering.joystick`, the log gives the
    same drive.
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
        """True if the magnet is moving to a dragged pose."""
        return self._target is not None

    @property
    def policy(self) -> str:
        """Name of the driving policy; empty if none drives."""
        driver = self._driver
        return "" if driver is None else driver.name

    def start_policy(self, driver: PolicyDriver) -> None:
        """Let a policy drive until it hands back or there is human input."""
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
            raise InputError(f"Joystick axes {axes}. Allowed: six numbers from -1 to 1.")
        with self._lock:
            self._axes = given
            if given.any():
                self._target = self._driver = None

    def drag(self, T_world_magnet: Float[np.ndarray, "4 4"], *, is_dragging: bool = True) -> None:
        """Move the magnet to a pose, as close as its workspace allows.

        Args:
            T_world_magnet: The pose.
            is_dragging: Whether the driver is still dragging.
        """
        target = self._program.controller.actuator.workspace.clamp_pose(T_world_magnet)
        with self._lock:
            self._target, self._is_dragging, self._driver = target, is_dragging, None

    def stop(self) -> None:
        """Release all input: the requested pose of the magnet stays the same."""
        with self._lock:
            self._axes, self._target, self._driver = np.zeros(6), None, None

    def __call__(self, time: float, dt: float) -> JoystickCommand:
        """Command at a time [s] for the next `dt` [s]; logged from the first frame on."""
        with self._lock:
            axes = np.zeros(6) if time < 0.0 else self._axes_now(time, dt)
            linear, angular = tuple(axes[:3].tolist()), tuple(axes[3:].tolist())
            command = JoystickCommand(time, linear, angular)  # type: ignore[arg-type]
            last = self._log[-1] if self._log else None
            if time >= 0.0 and (last is None or (last.linear, last.angular) != (linear, angular)):
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
        # All axes by the same factor: the magnet moves straight to the dragged pose.
        return axes / max(1.0, float(np.abs(axes).max()))
