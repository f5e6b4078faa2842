"""A run whose capsule is steered by a magnet: what is asked for, and who carries it out."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Literal

import numpy as np

from vrcaps.actuation.arm.arm_catalog import load_arm
from vrcaps.actuation.arm.arm_with_payload import Carrier, across_mount
from vrcaps.actuation.capsule_target import Goal, gut_goal, onto_wall
from vrcaps.actuation.magnet_actuator import FreeHolder, Holder
from vrcaps.actuation.magnet_controller import Pilot, Steering
from vrcaps.actuation.magnet_pose_solver import Room
from vrcaps.actuation.robot_actuator import ArmHolder
from vrcaps.actuation.wall_path import Follower, WallPath, gut_wall_path
from vrcaps.errors import InputError, UnknownNameError, require
from vrcaps.magnet.presets import load_magnet
from vrcaps.units import CM, DEG, MM
from vrcaps.world.control import Control
from vrcaps.world.model import Model
from vrcaps.world.schedule import read_numbers, require_rising, require_series, row_at

if TYPE_CHECKING:
    from jaxtyping import Float

    from vrcaps.world.world import World

WAYPOINT_COLUMNS = ("time_s", "arc_length_m", "yaw_deg", "pitch_deg")
AXES_COLUMNS = ("time_s", "move_x", "move_y", "move_z", "turn_x", "turn_y", "turn_z")
SIDES = ("up", "down")
GENTLE = Steering(press=0.15, speed=2.0 * CM, lead=10.0 * MM, stiffening=3.0, rate=2.0, damping=2.0)
"""Gains that lead a capsule over folds without a slide."""
_BESIDE, _BELOW = 55.0 * CM, 15.0 * CM


@dataclass(frozen=True)
class Waypoint:
    """Where the capsule is to be at a time, and how it looks aside there.

    Attributes:
        time: Since the first frame [s].
        arc_length: Along the gut [m].
        yaw: Look aside about the second transverse axis of the gut's frame [rad].
        pitch: About the first [rad].
    """

    time: float
    arc_length: float
    yaw: float = 0.0
    pitch: float = 0.0


@dataclass(frozen=True)
class Axes:
    """A joystick from a time on.

    Attributes:
        time: Since the first frame [s].
        move: Axes −1 to 1 that move the magnet along the world's x, y, z.
        turn: Axes −1 to 1 that turn it about them.
    """

    time: float
    move: tuple[float, float, float] = (0.0, 0.0, 0.0)
    turn: tuple[float, float, float] = (0.0, 0.0, 0.0)


@dataclass(frozen=True)
class MagnetSteering:
    """How a magnet outside steers the capsule.

    Without waypoints and axes it leads the capsule along the gut's wall from where it starts, and
    waits where the capsule does not follow.

    Attributes:
        magnet: Name of the magnet, see `vrcaps.magnet.presets.magnet_names`; one heavier than the
            arm may carry is noted, and moved as if it could.
        arm: Name or file of the arm that carries it, its moment across the flange; None holds it
            freely.
        base: Place of the arm's base in the world [m]; None is 55 cm beside the organ's middle,
            towards −x, and 15 cm below its highest point.
        skin: Least gap between the organ's highest point and the magnet: the wall of the belly and
            the air above it [m].
        side: Wall that the capsule is pressed against: the lower, on which the magnet lightens it,
            or the upper, to which it is pulled.
        speed: Along the wall without waypoints [m/s].
        until: Where that ends, as a share of the centreline; before the start it leads back.
        steering: Gains of the loop.
        waypoints: Where to be when; linear in time between them.
        axes: A joystick instead, each entry until the next.
        file: CSV of either instead, see `read_commands`.
        joystick_speed: Speed of a full axis [m/s].
        joystick_rate: Angular speed of a full axis [rad/s].
        period: Time between updates of the loop [s].
        file_sha256: Checksum of the file; filled in when recorded, checked when given.
    """

    magnet: str = "cylinder-76.2"
    arm: str | None = None
    base: tuple[float, float, float] | None = None
    skin: float = 4.0 * CM
    side: Literal["up", "down"] = "down"
    speed: float = 5.0 * MM
    until: float = 1.0
    steering: Steering = GENTLE
    waypoints: tuple[Waypoint, ...] = ()
    axes: tuple[Axes, ...] = ()
    file: str = ""
    joystick_speed: float = 5.0 * CM
    joystick_rate: float = 0.5
    period: float = 0.01
    file_sha256: str = ""

    def __post_init__(self) -> None:
        if self.side not in SIDES:
            raise UnknownNameError("side", self.side, SIDES)
        if sum(map(bool, (self.waypoints, self.axes, self.file))) > 1:
            raise InputError("Of waypoints, axes and file several are given. Give one of them.")
        for name, most in (("skin", 1.0), ("speed", 1.0), ("period", 0.05)):
            value = getattr(self, name)
            require(0.0 < value <= most, f"Steering's {name}", value, f"above 0 to {most:g}")
        require(0.0 <= self.until <= 1.0, "Steering's until", self.until, "0 to 1")
        for name in ("joystick_speed", "joystick_rate"):
            value = getattr(self, name)
            require(0.0 < value < math.inf, f"Steering's {name}", value, "above 0")
        check_waypoints(self.waypoints, "waypoints")
        check_axes(self.axes, "axes")


def read_commands(path: str | Path) -> tuple[tuple[Waypoint, ...], tuple[Axes, ...]]:
    """Read waypoints or a joystick from a CSV; its header says which.

    Waypoints have the header ``time_s,arc_length_m,yaw_deg,pitch_deg``, a joystick
    ``time_s,move_x,move_y,move_z,turn_x,turn_y,turn_z``.

    Raises:
        InputError: If the file cannot be read, its header is another or a line is wrong.
    """
    header, rows = read_numbers(path, (WAYPOINT_COLUMNS, AXES_COLUMNS), "commands")
    if header == WAYPOINT_COLUMNS:
        waypoints = tuple(Waypoint(t, s, yaw * DEG, pitch * DEG) for t, s, yaw, pitch in rows)
        check_waypoints(waypoints, str(path))
        return waypoints, ()
    axes = tuple(Axes(t, (x, y, z), (a, b, c)) for t, x, y, z, a, b, c in rows)
    check_axes(axes, str(path))
    return (), axes


def check_waypoints(waypoints: tuple[Waypoint, ...], where: str) -> None:
    """Check that all numbers are finite and times rise.

    Raises:
        InputError: If not; names the entry.
    """
    require_series([tuple(vars(point).values()) for point in waypoints], where)


def check_axes(axes: tuple[Axes, ...], where: str) -> None:
    """Check that axes are from −1 to 1 and times rise.

    Raises:
        InputError: If not; names the entry.
    """
    for index, entry in enumerate(axes):
        numbers = np.abs((*entry.move, *entry.turn))
        if not (np.isfinite(entry.time) and (numbers <= 1.0).all()):
            raise InputError(
                f"{where}: entry {index} is {entry.move}, {entry.turn} at {entry.time} s. "
                "Allowed: axes of -1 to 1 at finite times."
            )
    require_rising([entry.time for entry in axes], where)


class Commander:
    """Carries out what is asked of a magnet while a world is stepped."""

    def __init__(
        self,
        model: Model,
        settings: MagnetSteering,
        T_world_capsule: Float[np.ndarray, "4 4"],
        arc_length: float,
    ) -> None:
        """Takes the magnet to the capsule.

        Raises:
            InputError: If the device holds no magnet, the magnet cannot be held where it begins, or
                a waypoint is not on the centreline.
            UnknownNameError: If there is no such magnet or arm.
        """
        self._model, self._line = model, model.organ.centerline
        self.settings, self._start = settings, arc_length
        self._waypoints, self._axes = settings.waypoints, settings.axes
        if settings.file:
            self._waypoints, self._axes = read_commands(settings.file)
        for point in self._waypoints:
            allowed = f"0 to {self._line.length:g} m"
            on = 0.0 <= point.arc_length <= self._line.length
            require(on, "A waypoint's arc_length", point.arc_length, allowed)
        self.follower: Follower | None = None
        if not (self._waypoints or self._axes):
            path = self._way(T_world_capsule[:3, 2])
            self.follower = Follower(path, settings.speed, settings.steering.lead)
        goal = self._goal(0.0, model.T_world_patient)
        self.pilot = Pilot(
            model,
            load_magnet(settings.magnet),
            _holder(model, settings),
            T_world_capsule,
            goal,
            steering=settings.steering,
        )

    @property
    def notes(self) -> tuple[str, ...]:
        """What is to be said of the set-up, one line each."""
        holder = self.pilot.holder
        note = holder.carrier.overload if isinstance(holder, ArmHolder) else ""
        return (note,) if note else ()

    def control(
        self, world: World, time: float, dt: float, T_world_patient: Float[np.ndarray, "4 4"]
    ) -> Control:
        """Command for the next `dt` [s]."""
        s = self.settings
        if self.follower is not None:
            goal = self.follower.goal(world.T_world_capsule, dt)
            if T_world_patient is not self._model.T_world_patient:
                goal = self._goal(time, T_world_patient)
            return self.pilot.hold(world, goal, dt)
        if not self._axes:
            return self.pilot.hold(world, self._goal(time, T_world_patient), dt)
        now = [entry for entry in self._axes if entry.time <= time]
        held = now[-1] if now else Axes(0.0)
        rates = {"speed": s.joystick_speed, "rate": s.joystick_rate}
        control = self.pilot.drive(held.move, held.turn, dt, **rates)
        self.pilot.judge(world)
        return control

    def to_array(self) -> Float[np.ndarray, " q"]:
        """All that changes, for `restore`."""
        along = 0.0 if self.follower is None else self.follower.along
        return np.append(self.pilot.to_array(), along)

    def restore(self, saved: Float[np.ndarray, " q"]) -> None:
        """Goes back to what `to_array` gave."""
        self.pilot.restore(saved[:-1])
        if self.follower is not None:
            self.follower.along = float(saved[-1])

    def _way(self, look: Float[np.ndarray, " 3"]) -> WallPath:
        """The way along the wall, on which the capsule goes on to look ahead or back as it does."""
        end, side = self.settings.until * self._line.length, self.settings.side
        here = gut_goal(self._line, self._model.T_world_patient, self._start)
        back = bool(np.asarray(here.along) @ look < 0.0)
        return gut_wall_path(self._model, self._start, end, side=side, backwards=back)

    def _goal(self, time: float, T_world_patient: Float[np.ndarray, "4 4"]) -> Goal:
        """The goal at a time, or along the way; of a patient who has turned, on the wall as it is.

        With a joystick it is where the capsule starts.
        """
        s, points = self.settings, self._waypoints
        place, yaw, pitch = self._start, 0.0, 0.0
        if points:
            place, yaw, pitch = row_at(
                [tuple(vars(point).values()) for point in points], time
            ).tolist()
        elif self.follower is not None:
            end = s.until * self._line.length
            place += self.follower.share * (end - place)
        goal = gut_goal(self._line, T_world_patient, place, yaw=yaw, pitch=pitch, side=s.side)
        return onto_wall(self._model, T_world_patient, goal)


def _holder(model: Model, settings: MagnetSteering) -> Holder:
    magnet = load_magnet(settings.magnet)
    low, high = model.vertices_world.min(axis=0), model.vertices_world.max(axis=0)
    lowest = float(high[2]) + settings.skin + 0.5 * magnet.diameter
    room = Room(low=(-math.inf, -math.inf, lowest), apart=0.5 * magnet.diameter + 3.0 * CM)
    if settings.arm is None:
        return FreeHolder(room)
    base = np.eye(4)
    middle = 0.5 * (low + high)
    beside = (middle[0] - _BESIDE, middle[1], high[2] - _BELOW)
    base[:3, 3] = beside if settings.base is None else settings.base
    carrier = Carrier(load_arm(settings.arm), magnet, base, across_mount(magnet))
    return ArmHolder(carrier, room)
