"""Steering program of a magnet: its settings and their execution during a simulation."""

from __future__ import annotations

import math
from bisect import bisect_right
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import numpy as np

from vrcaps.actuation.arm.arm import Arm, arm_of, read_arm
from vrcaps.actuation.arm.arm_with_payload import ArmWithPayload, transverse_mount
from vrcaps.actuation.capsule_target import CapsuleTarget, centerline_target, project_to_wall
from vrcaps.actuation.magnet_actuator import FreeActuator, MagnetActuator, RobotActuator
from vrcaps.actuation.magnet_controller import CapsuleView, ControllerGains, MagnetController
from vrcaps.actuation.magnet_pose_solver import Workspace
from vrcaps.actuation.wall_path import PathFollower, WallPath, centerline_wall_path
from vrcaps.core.errors import InputError, require
from vrcaps.core.fields import FileRef, Range, check_fields, file_ref, path_of
from vrcaps.core.units import CM, DEG, MM
from vrcaps.magnet.presets import magnet_of, read_magnet
from vrcaps.magnet.sources import Block, Cylinder, Magnet, Ring, Sphere
from vrcaps.sensors.tracking import CapsuleTracker, TrackingSensors
from vrcaps.world.control import Control
from vrcaps.world.model import Model
from vrcaps.world.schedule import read_numbers, require_rising, require_series, row_at

if TYPE_CHECKING:
    from jaxtyping import Float

    from vrcaps.world.world import World

WAYPOINT_COLUMNS = ("time_s", "arc_length_m", "yaw_deg", "pitch_deg")
JOYSTICK_COLUMNS = (
    "time_s",
    "linear_x",
    "linear_y",
    "linear_z",
    "angular_x",
    "angular_y",
    "angular_z",
)
GENTLE_GAINS = ControllerGains(
    upper_wall_force=0.15,
    speed=2.0 * CM,
    lookahead=10.0 * MM,
    proportional_gain=3.0,
    integral_gain=2.0,
    damping_ratio=2.0,
)
"""Gains that move a capsule over folds without sliding."""
_BASE_BESIDE = 55.0 * CM
BASE_BELOW = 15.0 * CM
"""Height of the organ's highest point above the base of an arm [m]."""


@dataclass(frozen=True)
class Waypoint:
    """Position and viewing direction of the capsule at a time.

    Attributes:
        time: Time since the first frame [s].
        arc_length: Arc length along the centerline [m].
        yaw: Rotation of the view about the second transverse axis of the gut's frame [rad].
        pitch: Rotation of the view about the first transverse axis [rad].
    """

    time: float
    arc_length: float
    yaw: float = 0.0
    pitch: float = 0.0


@dataclass(frozen=True)
class JoystickCommand:
    """Joystick axes from a time onwards.

    Attributes:
        time: Time since the first frame [s].
        linear: Axes −1 to 1 that move the magnet along the world's x, y, z.
        angular: Axes −1 to 1 that rotate it about these axes.
    """

    time: float
    linear: tuple[float, float, float] = (0.0, 0.0, 0.0)
    angular: tuple[float, float, float] = (0.0, 0.0, 0.0)


@dataclass(frozen=True)
class MagnetSteering:
    """Settings of an external magnet that steers the capsule.

    Without waypoints and joystick the magnet moves the capsule along the wall of the gut from its
    start position, and waits if the capsule does not follow.

    Example:
        >>> steering = vrcaps.MagnetSteering(arm="panda", wall="upper", speed=0.01)
        >>> vrcaps.Scenario(capsule="magnetic", motion=vrcaps.Dynamics(magnet=steering))

    Attributes:
        magnet: Name of the magnet, see `vrcaps.magnet.presets.magnet_names`, path of its TOML file,
            or a magnet in memory; one heavier than the arm's payload causes a note, and moves as if
            the arm could carry it.
        arm: Arm that carries the magnet, with its moment across the flange: a name, the path of a
            TOML or URDF file, or an arm in memory; None moves the magnet without a robot.
        arm_base: Position of the arm's base in the world [m]; None is 55 cm from the organ's
            center, towards −x, and 15 cm below its highest point.
        standoff: Minimum gap between the organ's highest point and the magnet, for the abdominal
            wall and the air above it [m].
        wall: Wall against which the capsule is pressed: the lower, on which the magnet supports
            part of its weight, or the upper, to which it is pulled.
        speed: Speed along the wall without waypoints [m/s].
        end: End of that motion, as a fraction of the centerline; before the start it moves back.
        gains: Gains of the controller.
        pose: Source of the capsule's pose, velocity and contact for the controller: `true`, from
            the simulation, or `located`, from the readings of `sensors`.
        sensors: Sensors for the localization.
        waypoints: Positions at times, interpolated linearly.
        joystick: Joystick axes as an alternative, each entry until the next.
        command_file: CSV file of waypoints or joystick axes as an alternative, see `read_commands`.
        joystick_speed: Speed at a full axis [m/s].
        joystick_angular_speed: Angular speed at a full axis [rad/s].
        period: Time between updates of the controller [s].
    """

    magnet: str | Cylinder | Ring | Block | Sphere = "cylinder-76.2"
    arm: str | Arm | None = None
    arm_base: tuple[float, float, float] | None = None
    standoff: Annotated[float, Range(above=0.0, max=1.0, unit="m")] = 4.0 * CM
    wall: Literal["upper", "lower"] = "lower"
    speed: Annotated[float, Range(above=0.0, max=1.0, unit="m/s")] = 5.0 * MM
    end: Annotated[float, Range(0.0, 1.0)] = 1.0
    gains: ControllerGains = GENTLE_GAINS
    pose: Literal["true", "located"] = "true"
    sensors: TrackingSensors = field(default_factory=TrackingSensors)
    waypoints: tuple[Waypoint, ...] = ()
    joystick: tuple[JoystickCommand, ...] = ()
    command_file: FileRef | str | None = None
    joystick_speed: Annotated[float, Range(above=0.0, below=math.inf)] = 5.0 * CM
    joystick_angular_speed: Annotated[float, Range(above=0.0, below=math.inf)] = 0.5
    period: Annotated[float, Range(above=0.0, max=0.05, unit="s")] = 0.01

    def __post_init__(self) -> None:
        if self.command_file is not None:
            object.__setattr__(self, "command_file", file_ref(self.command_file))
        object.__setattr__(self, "magnet", magnet_of(self.magnet))
        if self.arm is not None:
            object.__setattr__(self, "arm", arm_of(self.arm))
        check_fields(self)
        if sum(map(bool, (self.waypoints, self.joystick, self.command_file))) > 1:
            raise InputError(
                "Several of waypoints, joystick and command_file are given. Give one of them."
            )
        check_waypoints(self.waypoints, "waypoints")
        check_joystick(self.joystick, "joystick")


def read_commands(
    path: str | Path,
) -> tuple[tuple[Waypoint, ...], tuple[JoystickCommand, ...]]:
    """Read waypoints or joystick commands from a CSV, as stated by its header.

    Waypoints have the header ``time_s,arc_length_m,yaw_deg,pitch_deg``, joystick commands
    ``time_s,linear_x,linear_y,linear_z,angular_x,angular_y,angular_z``.

    Raises:
        InputError: If the file cannot be read, its header differs or a line is invalid.
    """
    header, rows = read_numbers(path, (WAYPOINT_COLUMNS, JOYSTICK_COLUMNS), "commands")
    if header == WAYPOINT_COLUMNS:
        waypoints = tuple(Waypoint(t, s, yaw * DEG, pitch * DEG) for t, s, yaw, pitch in rows)
        check_waypoints(waypoints, str(path))
        return waypoints, ()
    joystick = tuple(JoystickCommand(t, (x, y, z), (a, b, c)) for t, x, y, z, a, b, c in rows)
    check_joystick(joystick, str(path))
    return (), joystick


def check_waypoints(waypoints: tuple[Waypoint, ...], where: str) -> None:
    """Check that all numbers are finite and times increase.

    Raises:
        InputError: If not; names the entry.
    """
    require_series([tuple(vars(point).values()) for point in waypoints], where)


def check_joystick(joystick: tuple[JoystickCommand, ...], where: str) -> None:
    """Check that axes are from −1 to 1 and times increase.

    Raises:
        InputError: If not; names the entry.
    """
    for index, entry in enumerate(joystick):
        axes = np.abs((*entry.linear, *entry.angular))
        if not (np.isfinite(entry.time) and (axes <= 1.0).all()):
            raise InputError(
                f"{where}: entry {index} is {entry.linear}, {entry.angular} at {entry.time} s. "
                "Allowed: axes of -1 to 1 at finite times."
            )
    require_rising([entry.time for entry in joystick], where)


class SteeringProgram:
    """Execution of the settings of `MagnetSteering` while a world is simulated.

    Attributes:
        settings: Settings of the program.
        operator: Callback for live steering: returns the joystick command at a time [s] for a
            duration [s]; the joystick commands of the settings are then ignored.
    """

    def __init__(
        self,
        model: Model,
        settings: MagnetSteering,
        T_world_capsule: Float[np.ndarray, "4 4"],
        arc_length: float,
        *,
        seed: int = 0,
    ) -> None:
        """Move the magnet to the capsule.

        Args:
            model: Organ and device.
            settings: Settings of the program.
            T_world_capsule: Pose of the capsule.
            arc_length: Position of the capsule along the centerline [m].
            seed: Seed of the noise of sensors that locate the capsule, 0 or more.

        Raises:
            InputError: If the device has no magnet, or several for localization, the magnet cannot
                be held at its first pose, or a waypoint is not on the centerline.
            UnknownNameError: If there is no such magnet or arm.
        """
        self._model, self.settings = model, settings
        self._line, self._start = model.organ.centerline, arc_length
        self._waypoints = settings.waypoints
        self._joystick = settings.joystick
        self.operator: Callable[[float, float], JoystickCommand] | None = None
        if settings.command_file is not None:
            self._waypoints, self._joystick = read_commands(path_of(settings.command_file))
        allowed = f"0 to {self._line.length:g} m"
        for point in self._waypoints:
            is_on = 0.0 <= point.arc_length <= self._line.length
            require(is_on, "A waypoint's arc_length", point.arc_length, allowed)
        self.follower: PathFollower | None = None
        if not (self._waypoints or self._joystick):
            path = self._path(T_world_capsule[:3, 2])
            self.follower = PathFollower(path, settings.speed, settings.gains.lookahead)
        self.controller = MagnetController(
            model,
            read_magnet(settings.magnet),
            _make_actuator(model, settings),
            T_world_capsule,
            self._target(0.0, model.T_world_patient),
            gains=settings.gains,
        )
        self.tracker: CapsuleTracker | None = None
        if settings.pose == "located":
            self.tracker = CapsuleTracker(
                model, settings.sensors, T_world_capsule, period=settings.period, seed=seed
            )

    @property
    def notes(self) -> tuple[str, ...]:
        """Notes on the setup, one line each."""
        actuator = self.controller.actuator
        note = actuator.robot.overload_note if isinstance(actuator, RobotActuator) else ""
        return (note,) if note else ()

    def control(
        self, world: World, time: float, dt: float, T_world_patient: Float[np.ndarray, "4 4"]
    ) -> Control:
        """Command for the next `dt` [s].

        Args:
            world: The current world.
            time: Time of the run [s].
            dt: Duration of the command [s].
            T_world_patient: Posture of the patient.
        """
        capsule = self.observe(world)
        if self.follower is not None:
            target = self.follower.target(capsule.T_world_capsule, dt)
            if T_world_patient is not self._model.T_world_patient:
                target = self._target(time, T_world_patient)
            return self.controller.track(capsule, target, dt)
        if not self._joystick:
            return self.controller.track(capsule, self._target(time, T_world_patient), dt)
        command = (self.operator or self._recorded_command)(time, dt)
        control = self.controller.jog(
            command.linear,
            command.angular,
            dt,
            speed=self.settings.joystick_speed,
            angular_speed=self.settings.joystick_angular_speed,
        )
        self.controller.update_status(capsule)
        return control

    def _recorded_command(self, time: float, dt: float) -> JoystickCommand:
        """Last joystick command at or before a time; neutral before the first."""
        count = bisect_right(self._joystick, time, key=lambda entry: entry.time)
        return self._joystick[count - 1] if count else JoystickCommand(0.0)

    def observe(self, world: World) -> CapsuleView:
        """Capsule state for the controller; reads the sensors used for localization."""
        if self.tracker is None:
            return world
        self.tracker.read(world, self.controller.sources)
        return self.tracker

    def to_array(self) -> Float[np.ndarray, " q"]:
        """Complete state of the program, for `restore`."""
        arc_length = 0.0 if self.follower is None else self.follower.arc_length
        tracked = () if self.tracker is None else self.tracker.to_array()
        return np.concatenate([tracked, self.controller.to_array(), [arc_length]])

    def restore(self, saved: Float[np.ndarray, " q"]) -> None:
        """Restore the state given by `to_array`."""
        first = 0 if self.tracker is None else len(self.tracker.to_array())
        self.controller.restore(saved[first:-1])
        if self.tracker is not None:
            self.tracker.restore(saved[:first], self.controller.sources)
        if self.follower is not None:
            self.follower.arc_length = float(saved[-1])

    def _path(self, look: Float[np.ndarray, " 3"]) -> WallPath:
        """Path along the wall on which the capsule keeps facing forward or backward."""
        end = self.settings.end * self._line.length
        here = centerline_target(self._line, self._model.T_world_patient, self._start)
        is_backward = bool(np.asarray(here.tangent) @ look < 0.0)
        return centerline_wall_path(
            self._model, self._start, end, wall=self.settings.wall, is_backward=is_backward
        )

    def _target(self, time: float, T_world_patient: Float[np.ndarray, "4 4"]) -> CapsuleTarget:
        """Target at a time or along the path, on the wall of a patient in any posture.

        With a joystick it is the start position of the capsule.
        """
        arc_length, yaw, pitch = self._start, 0.0, 0.0
        if self._waypoints:
            rows = [tuple(vars(point).values()) for point in self._waypoints]
            arc_length, yaw, pitch = row_at(rows, time).tolist()
        elif self.follower is not None:
            end = self.settings.end * self._line.length
            arc_length += self.follower.progress * (end - arc_length)
        target = centerline_target(
            self._line,
            T_world_patient,
            arc_length,
            yaw=yaw,
            pitch=pitch,
            wall=self.settings.wall,
        )
        return project_to_wall(self._model, T_world_patient, target)


def workspace_above(model: Model, magnet: Magnet, standoff: float) -> Workspace:
    """Workspace of a magnet at least a gap [m] above the organ's highest point."""
    radius = 0.5 * magnet.bounds[0]
    lowest = float(model.vertices_world[:, 2].max()) + standoff + radius
    return Workspace(low=(-math.inf, -math.inf, lowest), min_distance=radius + 3.0 * CM)


def base_beside(vertices_world: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, " 3"]:
    """Base position of an arm in the world from which it reaches above the patient [m].

    Args:
        vertices_world: Vertices of the wall at rest [m].
    """
    low, high = vertices_world.min(axis=0), vertices_world.max(axis=0)
    center = 0.5 * (low + high)
    return np.array([center[0] - _BASE_BESIDE, center[1], high[2] - BASE_BELOW])


def _make_actuator(model: Model, settings: MagnetSteering) -> MagnetActuator:
    magnet = read_magnet(settings.magnet)
    workspace = workspace_above(model, magnet, settings.standoff)
    if settings.arm is None:
        return FreeActuator(workspace)
    T_world_base = np.eye(4)
    given = settings.arm_base
    T_world_base[:3, 3] = base_beside(model.vertices_world) if given is None else given
    arm = read_arm(settings.arm)
    robot = ArmWithPayload(arm, magnet, T_world_base, transverse_mount(magnet))
    return RobotActuator(robot, workspace)
