"""Coil program: currents of an array of electromagnets over time, or from a joystick."""

from __future__ import annotations

import math
from bisect import bisect_right
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Annotated

import numpy as np

from vrcaps.actuation.coil_array import (
    CoilArray,
    CoilState,
    advance_coils,
    coils_at_rest,
    currents_for_wrench,
    read_coil_array,
    unit_wrenches,
)
from vrcaps.actuation.steering_program import (
    JOYSTICK_COLUMNS,
    JoystickCommand,
    check_joystick,
)
from vrcaps.core.errors import InputError
from vrcaps.core.fields import FileRef, Range, check_fields, file_ref, path_of
from vrcaps.core.units import CM
from vrcaps.world.control import Control
from vrcaps.world.schedule import read_numbers, require_series, row_at

if TYPE_CHECKING:
    from jaxtyping import Float

    from vrcaps.magnet.sources import Source
    from vrcaps.world.model import Model
    from vrcaps.world.world import World

_OFF = 0.01
"""Current, relative to its maximum, below which a coil counts as off."""
_POSITIVE = Range(above=0.0, below=math.inf)


@dataclass(frozen=True)
class Currents:
    """Commanded currents at a time.

    Attributes:
        time: Time since the first frame [s].
        currents: Current of each coil [A]; more than its maximum is clipped.
    """

    time: float
    currents: tuple[float, ...]


@dataclass(frozen=True)
class CoilCommand(JoystickCommand):
    """Joystick axes from a time onwards, or currents instead.

    Attributes:
        currents: Current of each coil [A], commanded while all axes are 0; empty for none.
    """

    currents: tuple[float, ...] = ()


@dataclass(frozen=True)
class CoilSteering:
    """Settings of an array of electromagnets that acts on the capsule.

    Commands are currents over time, or joystick axes, which are converted to a force and a torque
    on the capsule by the currents that generate the least heat.

    Example:
        >>> ramp = (Currents(0.0, (0.0,) * 9), Currents(2.0, (0.0,) * 4 + (40.0,) + (0.0,) * 4))
        >>> vrcaps.Scenario(capsule="magnetic", motion=vrcaps.Dynamics(coils=CoilSteering(ramp)))

    Attributes:
        currents: Commanded currents, linear in time between entries.
        coils: Name of the array, see `coil_array_names`, path of its TOML file, or an array in
            memory.
        array_position: Origin of the array in the world [m]; None is below the organ's center.
        standoff: Gap between the array's surface and the organ's lowest point, if no position is
            given [m].
        joystick: Joystick axes as an alternative, each entry until the next.
        command_file: CSV file of either as an alternative, with the columns ``time_s,coil_1_a,…``
            or those of a joystick, see `read_commands`; or of both, see `CoilCommand`.
        joystick_force: Force at a full axis [N].
        joystick_torque: Torque at a full axis [N·m].
        period: Time between updates of the currents [s].
    """

    currents: tuple[Currents, ...] = ()
    coils: str | CoilArray = "table-3x3"
    array_position: tuple[float, float, float] | None = None
    standoff: Annotated[float, Range(min=0.0, max=1.0, unit="m")] = 3.0 * CM
    joystick: tuple[JoystickCommand, ...] = ()
    command_file: FileRef | str | None = None
    joystick_force: Annotated[float, _POSITIVE] = 0.05
    joystick_torque: Annotated[float, _POSITIVE] = 0.002
    period: Annotated[float, Range(above=0.0, max=0.05, unit="s")] = 0.01

    def __post_init__(self) -> None:
        check_fields(self)
        object.__setattr__(self, "coils", read_coil_array(self.coils))
        if self.command_file is not None:
            object.__setattr__(self, "command_file", file_ref(self.command_file))
        if sum(map(bool, (self.currents, self.joystick, self.command_file))) > 1:
            raise InputError(
                "Several of currents, joystick and command_file are given. Give one of them."
            )
        check_currents(self.currents, len(self.array.coils), "currents")
        check_joystick(self.joystick, "joystick")

    @property
    def array(self) -> CoilArray:
        """The coil array in memory."""
        return read_coil_array(self.coils)


def check_currents(entries: tuple[Currents, ...], count: int, where: str) -> None:
    """Check that all currents are finite, one for each coil, and times increase.

    Raises:
        InputError: If not; names the entry.
    """
    for index, entry in enumerate(entries):
        if len(entry.currents) != count:
            raise InputError(
                f"{where}: entry {index} has {len(entry.currents)} currents. Allowed: {count}, one "
                "for each coil."
            )
    require_series([(entry.time, *entry.currents) for entry in entries], where)


@dataclass(frozen=True)
class CoilStatus:
    """State of the coils after the last command.

    Attributes:
        commands: Commanded currents [A].
        state: Currents and temperatures.
        limit: Reason why a current differs from its command: empty, `current` or `temperature`.
    """

    commands: Float[np.ndarray, " k"]
    state: CoilState
    limit: str


def coil_column_names(count: int) -> tuple[str, ...]:
    """Columns of `coil_row` in `frames.parquet`."""
    names = ("command_a", "current_a", "temperature_c")
    return (*(f"coil_{k}_{name}" for name in names for k in range(1, count + 1)), "coil_limit")


def coil_command_columns(count: int) -> tuple[str, ...]:
    """Columns of a file of `CoilCommand` for a number of coils."""
    return (*JOYSTICK_COLUMNS, *(f"coil_{k}_a" for k in range(1, count + 1)))


def coil_row(status: CoilStatus) -> dict[str, float | str]:
    """Row of `coil_column_names`."""
    state = status.state
    values = (*status.commands, *state.currents, *state.temperatures)
    names = coil_column_names(len(status.commands))
    return dict(zip(names, (*map(float, values), status.limit), strict=True))


def array_pose(
    model: Model, position: tuple[float, float, float] | None, standoff: float
) -> Float[np.ndarray, "4 4"]:
    """``T_world_array`` of an array below the organ, or at a position."""
    pose = np.eye(4)
    low, high = model.vertices_world.min(axis=0), model.vertices_world.max(axis=0)
    below = [*(0.5 * (low + high))[:2], low[2] - standoff]
    pose[:3, 3] = below if position is None else position
    return pose


class CoilProgram:
    """Execution of the settings of `CoilSteering` while a world is simulated.

    Attributes:
        settings: Settings of the program.
        array: The electromagnets.
        T_world_array: Pose of the array.
        sources: One source of 1 A for each coil; its strength in a world is the current.
        status: State after the last command.
        target: Force [N] and torque [N·m] that the last joystick command requests.
        operator: Callback for live steering, see `SteeringProgram`.
        current_operator: Callback for live currents: returns the current of each coil [A] at a
            time [s] for a duration [s]; all other commands are then ignored.
    """

    def __init__(self, model: Model, settings: CoilSteering) -> None:
        """Place the array.

        Raises:
            InputError: If the capsule has no magnet, or a file cannot be read.
        """
        self.settings, self.array = settings, settings.array
        entries, self._joystick = settings.currents, settings.joystick
        if settings.command_file is not None:
            entries, self._joystick = _read_commands(settings)
        self._rows = [(entry.time, *entry.currents) for entry in entries]
        self.T_world_array = array_pose(model, settings.array_position, settings.standoff)
        self.sources: tuple[Source, ...] = self.array.sources(self.T_world_array)
        self._magnets, self.target = model.device.magnets, np.zeros(6)
        self._most = self.array.values("max_current")
        rest = coils_at_rest(self.array)
        self.status = CoilStatus(np.zeros(len(self.array.coils)), rest, "")
        self.operator: Callable[[float, float], JoystickCommand] | None = None
        self.current_operator: Callable[[float, float], Float[np.ndarray, " k"]] | None = None

    @property
    def notes(self) -> tuple[str, ...]:
        """Notes on the setup: none."""
        return ()

    @property
    def is_on(self) -> bool:
        """Whether a coil has more than 1 % of its maximum current."""
        return bool((np.abs(self.status.state.currents) > _OFF * self._most).any())

    @property
    def reached_limit(self) -> str:
        """Limit of the status, or `current` if a command is scaled down to the maximum."""
        is_full = (np.abs(self.status.commands) > (1.0 - 1e-9) * self._most).any()
        return self.status.limit or ("current" if is_full else "")

    def control(self, world: World, time: float, dt: float) -> Control:
        """Command for the next `dt` [s] at a time of the run [s]; none before the first frame."""
        commands = np.zeros(len(self.array.coils))
        if time >= 0.0:
            commands = self._commands(world, time, dt)
        state = advance_coils(self.array, self.status.state, commands, dt)
        limit = "temperature" if state.is_hot.any() else ""
        if not limit and (np.abs(commands) > self._most).any():
            limit = "current"
        self.status = CoilStatus(commands, state, limit)
        return Control(strengths=state.currents)

    def _commands(self, world: World, time: float, dt: float) -> Float[np.ndarray, " k"]:
        if self.current_operator is not None:
            return self.current_operator(time, dt)
        if self._rows:
            return row_at(self._rows, time)
        if self.operator is None and not self._joystick:
            return np.zeros(len(self.array.coils))
        command = (self.operator or self._recorded_command)(time, dt)
        if isinstance(command, CoilCommand) and any(command.currents):
            self.target = np.zeros(6)
            return np.array(command.currents)
        settings = self.settings
        self.target = target = np.concatenate(
            [
                settings.joystick_force * np.array(command.linear),
                settings.joystick_torque * np.array(command.angular),
            ]
        )
        if not target.any():
            return np.zeros(len(self.array.coils))
        wrenches = unit_wrenches(self.sources, self._magnets, world.T_world_capsule)
        return currents_for_wrench(wrenches, target, self._most)

    def _recorded_command(self, time: float, dt: float) -> JoystickCommand:
        count = bisect_right(self._joystick, time, key=lambda entry: entry.time)
        return self._joystick[count - 1] if count else JoystickCommand(0.0)

    def powered(self, status: CoilStatus) -> tuple[Source, ...]:
        """Sources with the currents of a status as their strengths."""
        pairs = zip(self.sources, status.state.currents.tolist(), strict=True)
        return tuple(replace(source, strength=current) for source, current in pairs)

    def to_array(self) -> Float[np.ndarray, " q"]:
        """Complete state of the program, for `restore`."""
        state = self.status.state
        return np.concatenate([self.status.commands, state.currents, state.temperatures])

    def restore(self, saved: Float[np.ndarray, " q"]) -> None:
        """Restore the state given by `to_array`."""
        commands, currents, temperatures = np.array(saved, float).reshape(3, -1)
        is_hot = temperatures >= self.array.values("max_temperature")
        limit = "temperature" if is_hot.any() else ""
        self.status = CoilStatus(commands, CoilState(currents, temperatures, is_hot), limit)


def _read_commands(
    settings: CoilSteering,
) -> tuple[tuple[Currents, ...], tuple[JoystickCommand, ...]]:
    """Read the command file.

    Raises:
        InputError: If it cannot be read, its header differs or a line is invalid.
    """
    assert settings.command_file is not None
    path, count = path_of(settings.command_file), len(settings.array.coils)
    columns = ("time_s", *(f"coil_{k}_a" for k in range(1, count + 1)))
    headers = (columns, JOYSTICK_COLUMNS, coil_command_columns(count))
    header, rows = read_numbers(path, headers, "commands")
    if header == columns:
        entries = tuple(Currents(row[0], tuple(row[1:])) for row in rows)
        check_currents(entries, count, str(path))
        return entries, ()
    joystick = tuple(
        CoilCommand(t, (x, y, z), (a, b, c), tuple(currents))
        for t, x, y, z, a, b, c, *currents in rows
    )
    check_joystick(joystick, str(path))
    for index, entry in enumerate(joystick):
        if not np.isfinite(entry.currents).all():
            raise InputError(f"{path}: entry {index} has a current that is not finite.")
    return (), joystick
