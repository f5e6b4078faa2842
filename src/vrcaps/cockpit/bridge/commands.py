"""Commands of clients: velocity or pose of the magnet, or currents of the coils."""

from __future__ import annotations

import heapq
import threading
from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from itertools import count
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np

from vrcaps.actuation.arm.arm_with_payload import clearances, magnet_pose_at
from vrcaps.actuation.magnet_actuator import RobotActuator
from vrcaps.actuation.steering_program import JoystickCommand
from vrcaps.cockpit.bridge.protocol import shortened
from vrcaps.cockpit.session.operator import axes_towards
from vrcaps.core.errors import InputError
from vrcaps.core.geometry import matrix_from_quaternion, transform_from

if TYPE_CHECKING:
    from jaxtyping import Float

    from vrcaps.actuation.coil_program import CoilProgram
    from vrcaps.actuation.steering_program import SteeringProgram

VELOCITY, POSE = "/magnet/cmd_vel", "/magnet/goal_pose"
JOINTS, CURRENTS = "/joint_command", "/coils/command"
"""Topics of commands."""
_MAX_WAITING = 1000
_WORLD = ("", "world")
_UNIT = 1e-3
"""Maximum difference of the norm of a quaternion from 1."""


class Commands(ABC):
    """Commands that wait for their simulated time, and the last of them.

    A command takes effect at the stamp of its header, immediately if that is 0 or past.

    Attributes:
        kinds: Type of the messages by topic.
    """

    kinds: ClassVar[Mapping[str, str]]

    def __init__(self) -> None:
        self._lock, self._number = threading.Lock(), count()
        self._waiting: list[tuple[int, int, str, Any]] = []

    def send(self, topic: str, message: Mapping[str, Any]) -> str:
        """Send a command; callable from any thread.

        Args:
            topic: One of `kinds`.
            message: Fields of the message.

        Returns:
            Note on a changed value, such as a clipped speed; empty without one.

        Raises:
            InputError: If a field is missing or invalid, or too many commands wait.
        """
        ns = _stamp(message)
        value, note = self._parse(topic, message)
        with self._lock:
            if len(self._waiting) >= _MAX_WAITING:
                raise InputError(f"{_MAX_WAITING} commands wait for their time. Send fewer.")
            heapq.heappush(self._waiting, (ns, next(self._number), topic, value))
        return note

    def stop(self) -> None:
        """Drop pending commands, and stop; callable from any thread."""
        with self._lock:
            self._waiting.clear()
            heapq.heappush(self._waiting, (0, next(self._number), "", None))

    def _due(self, time: float) -> list[tuple[str, Any]]:
        """Remove and return topics and values of the commands up to a time [s]."""
        due, now = [], round(1e9 * time)
        with self._lock:
            while self._waiting and self._waiting[0][0] <= now:
                due.append(heapq.heappop(self._waiting)[2:])
        return due

    @abstractmethod
    def _parse(self, topic: str, message: Mapping[str, Any]) -> tuple[Any, str]:
        """Value of a message, and a note on changed values."""


class MagnetCommands(Commands):
    """Velocity of a magnet, held until the next command, or a pose to which it moves."""

    kinds: ClassVar[Mapping[str, str]] = {
        VELOCITY: "geometry_msgs/msg/TwistStamped",
        POSE: "geometry_msgs/msg/PoseStamped",
    }

    def __init__(self, program: SteeringProgram) -> None:
        """Steer the magnet of a program."""
        super().__init__()
        self._program = program
        self._axes, self._target = np.zeros(6), None
        settings = program.settings
        self._full = np.repeat([settings.joystick_speed, settings.joystick_angular_speed], 3)
        program.operator = self

    def __call__(self, time: float, dt: float) -> JoystickCommand:
        """Joystick command of the program at a time [s] for a duration [s]."""
        for topic, value in self._due(time) if time >= 0.0 else ():
            self._axes = value if topic == VELOCITY else np.zeros(6)
            self._target = value if topic in (POSE, JOINTS) else None
        axes = self._axes
        if self._target is not None:
            axes, is_over = axes_towards(self._program, self._target, dt)
            if is_over:
                axes, self._target = np.zeros(6), None
        linear, angular = tuple(axes[:3].tolist()), tuple(axes[3:].tolist())
        return JoystickCommand(time, linear, angular)  # type: ignore[arg-type]

    def _parse(self, topic: str, message: Mapping[str, Any]) -> tuple[Any, str]:
        if topic == VELOCITY:
            twist = [_vector(message, f"twist.{name}") for name in ("linear", "angular")]
            axes = np.concatenate(twist) / self._full
            clipped = np.clip(axes, -1.0, 1.0)
            is_clipped = bool((axes != clipped).any())
            limits = f"{self._full[0]:g} m/s and {self._full[3]:g} rad/s along each axis"
            return clipped, f"The velocity was clipped to {limits}." if is_clipped else ""
        position = _vector(message, "pose.position")
        wxyz = _vector(message, "pose.orientation", "wxyz")
        norm = float(np.linalg.norm(wxyz))
        if abs(norm - 1.0) > _UNIT:
            raise InputError(f"pose.orientation has the norm {norm:.6g}. Allowed: 1.")
        pose = transform_from(matrix_from_quaternion(wxyz / norm), position)
        allowed = self._program.controller.actuator.workspace.clamp_pose(pose)
        is_clipped = not np.array_equal(allowed, pose)
        return allowed, "The pose was moved into the workspace." if is_clipped else ""


class ArmCommands(MagnetCommands):
    """Commands of a magnet on an arm; in addition, the angles of the joints at a pose of it.

    The angles of joints that a message does not name are those at the time of its arrival. The
    magnet moves straight to the pose; an arm of seven axes may reach it by other angles.
    """

    kinds: ClassVar[Mapping[str, str]] = {
        **MagnetCommands.kinds,
        JOINTS: "sensor_msgs/msg/JointState",
    }

    def _parse(self, topic: str, message: Mapping[str, Any]) -> tuple[Any, str]:
        if topic != JOINTS:
            return super()._parse(topic, message)
        actuator = self._program.controller.actuator
        assert isinstance(actuator, RobotActuator)
        robot = actuator.robot
        names = [f"joint_{k}" for k in range(1, robot.arm.num_joints + 1)]
        indices, given = _joint_values(message, names, "position", "angles [rad]")
        state = self._program.controller.status.actuator
        angles = np.array(state.joint_angles, float)
        angles[indices] = given
        clipped = np.clip(angles, robot.arm.lower, robot.arm.upper)
        if clearances(robot, clipped[None]).min() < 0.0:
            raise InputError("At these angles the arm collides with itself or the table.")
        pose = actuator.workspace.clamp_pose(magnet_pose_at(robot, clipped))
        is_clipped = not np.array_equal(clipped, angles)
        return pose, "Angles were clipped to the limits of the joints." if is_clipped else ""


class CoilCommands(Commands):
    """Currents of coils, held until the next command."""

    kinds: ClassVar[Mapping[str, str]] = {CURRENTS: "sensor_msgs/msg/JointState"}

    def __init__(self, program: CoilProgram) -> None:
        """Set the currents of a program."""
        super().__init__()
        self._most = program.array.values("max_current")
        self._names = [f"coil_{k}" for k in range(1, len(self._most) + 1)]
        self._currents = np.zeros(len(self._most))
        program.current_operator = self

    def __call__(self, time: float, dt: float) -> Float[np.ndarray, " k"]:
        """Currents [A] at a time [s] for a duration [s]."""
        del dt
        for _, value in self._due(time):
            self._currents = np.zeros(len(self._most)) if value is None else self._changed(value)
        return self._currents

    def _changed(self, value: Mapping[int, float]) -> Float[np.ndarray, " k"]:
        currents = self._currents.copy()
        currents[list(value)] = list(value.values())
        return currents

    def _parse(self, topic: str, message: Mapping[str, Any]) -> tuple[Any, str]:
        indices, currents = _joint_values(message, self._names, "effort", "currents [A]")
        most = self._most[indices]
        clipped = np.clip(currents, -most, most)
        is_clipped = not np.array_equal(clipped, currents)
        note = f"A current was clipped to {most.max():g} A." if is_clipped else ""
        return dict(zip(indices, clipped.tolist(), strict=True)), note


def _stamp(message: Mapping[str, Any]) -> int:
    """Stamp of a message's header [ns]; 0 without one.

    Raises:
        InputError: If it is invalid, or the frame is not the world.
    """
    header = message.get("header", {})
    stamp = header.get("stamp", {}) if isinstance(header, dict) else None
    if not isinstance(header, dict) or not isinstance(stamp, dict):
        raise InputError(f"header is {shortened(header)}. Allowed: stamp with sec and nanosec.")
    frame = header.get("frame_id", "")
    if frame not in _WORLD:
        raise InputError(f"frame_id is {shortened(frame)}. Allowed: world.")
    sec, nanosec = (stamp.get(name, 0) for name in ("sec", "nanosec"))
    for name, value, most in (("sec", sec, 2**31), ("nanosec", nanosec, 10**9)):
        if not (type(value) is int and 0 <= value < most):
            raise InputError(f"{name} is {shortened(value)}. Allowed: 0 to {most - 1}.")
    return sec * 10**9 + nanosec


def _vector(
    message: Mapping[str, Any], path: str, axes: Sequence[str] = "xyz"
) -> Float[np.ndarray, " n"]:
    """Vector in a message.

    Raises:
        InputError: If it is missing or has a value that is not a finite number.
    """
    value: Any = message
    for name in path.split("."):
        value = value.get(name) if isinstance(value, dict) else None
    if not isinstance(value, dict):
        raise InputError(f"{path} is {shortened(value)}. Allowed: numbers {', '.join(axes)}.")
    return np.array([_number(value.get(axis), f"{path}.{axis}") for axis in axes])


def _joint_values(
    message: Mapping[str, Any], known: Sequence[str], field: str, what: str
) -> tuple[list[int], list[float]]:
    """Indices of the joints that a `JointState` names, all if none, and their values.

    Raises:
        InputError: If a name is unknown or repeated, or a value is missing or invalid.
    """
    names = message.get("name")
    names = list(known) if names is None or names == [] else names
    is_valid = isinstance(names, list) and all(isinstance(name, str) for name in names)
    if not (is_valid and set(names) <= set(known) and len(set(names)) == len(names)):
        allowed = f"{known[0]} to {known[-1]}, each once"
        raise InputError(f"name is {shortened(names)}. Allowed: {allowed}.")
    given = message.get(field)
    if not isinstance(given, list) or len(given) != len(names):
        raise InputError(f"{field} is {shortened(given)}. Allowed: {len(names)} {what}.")
    return [known.index(name) for name in names], [_number(value, field) for value in given]


def _number(value: Any, what: str) -> float:
    is_number = isinstance(value, int | float) and not isinstance(value, bool)
    if not (is_number and abs(value) <= 1e9):
        raise InputError(f"{what} is {shortened(value)}. Allowed: a number from -1e9 to 1e9.")
    return float(value)
