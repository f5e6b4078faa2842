"""Arrays of electromagnets with electrical and thermal limits, by name, file or in memory."""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, ClassVar

import numpy as np

from vrcaps.config.convert import from_plain
from vrcaps.config.plain_files import CatalogFolder, read_plain
from vrcaps.core.errors import InputError, require
from vrcaps.core.fields import FileRef, Range, check_fields, file_ref, path_of
from vrcaps.core.names import inside
from vrcaps.magnet.field import SourceSet
from vrcaps.magnet.field_map import read_field_map
from vrcaps.magnet.sources import InternalMagnet, Solenoid, Source, magnet_pose

if TYPE_CHECKING:
    from jaxtyping import Float

_MAX_COILS = 64
_ABOVE = Range(above=0.0, below=math.inf)
_MM = {"unit": "mm"}
Vector = tuple[float, float, float]


@dataclass(frozen=True, kw_only=True)
class Winding:
    """Electrical and thermal limits that all electromagnets have.

    The current follows its command as that of a driven inductance, with the time constant
    `rise_time`. The winding is one thermal mass: C dT/dt = R I² − (T − T_ambient)/R_th. Its
    resistance is taken as constant.

    Attributes:
        position: Center in the frame of the array [m].
        direction: Direction of the moment for a current above 0, of any length.
        max_current: Maximum current in both directions [A].
        rise_time: Time constant L/R of the current [s]; 0 follows at once.
        resistance: Resistance [ohm].
        heat_capacity: Heat capacity [J/K].
        thermal_resistance: Thermal resistance to the surroundings or the coolant [K/W].
        max_temperature: Temperature at which the driver switches the coil off [°C].
    """

    position: Vector = field(metadata=_MM)
    direction: Vector = (0.0, 0.0, 1.0)
    max_current: Annotated[float, _ABOVE] = field(metadata={"unit": "a"})
    rise_time: Annotated[float, Range(min=0.0, max=60.0, unit="s")] = field(
        default=0.02, metadata={"unit": "s"}
    )
    resistance: Annotated[float, Range(min=0.0, below=math.inf)] = field(
        default=1.0, metadata={"unit": "ohm"}
    )
    heat_capacity: Annotated[float, _ABOVE] = field(default=1000.0, metadata={"unit": "j_per_k"})
    thermal_resistance: Annotated[float, _ABOVE] = field(default=0.5, metadata={"unit": "k_per_w"})
    max_temperature: Annotated[float, Range(min=0.0, max=300.0, unit="°C")] = field(
        default=90.0, metadata={"unit": "c"}
    )

    def __post_init__(self) -> None:
        check_fields(self)
        magnet_pose(self.position, self.direction)  # type: ignore[arg-type]

    def pose(self, T_world_array: Float[np.ndarray, "4 4"]) -> Float[np.ndarray, "4 4"]:
        """Pose of the coil in the world."""
        return T_world_array @ magnet_pose(np.array(self.position), np.array(self.direction))


@dataclass(frozen=True, kw_only=True)
class Electromagnet(Winding):
    """Air-core solenoid with its limits.

    Attributes: See `Winding`; besides these
        radius: Mean radius of the winding [m].
        length: Length of the winding [m].
        turns: Number of windings.
        thickness: Outer minus inner radius of the winding [m].
    """

    radius: Annotated[float, _ABOVE] = field(metadata=_MM)
    length: Annotated[float, _ABOVE] = field(metadata=_MM)
    turns: Annotated[int, Range(min=1)]
    thickness: Annotated[float, Range(min=0.0)] = field(default=0.0, metadata=_MM)

    kind: ClassVar[str] = "solenoid"

    def __post_init__(self) -> None:
        super().__post_init__()
        self.source(np.eye(4))

    def source(self, T_world_array: Float[np.ndarray, "4 4"]) -> Source:
        """Source of 1 A, switched off."""
        layers = 4 if self.thickness else 1
        pose = self.pose(T_world_array)
        return Solenoid(
            self.radius, self.length, 1.0, self.turns, self.thickness, layers, pose, strength=0.0
        )


@dataclass(frozen=True, kw_only=True)
class MappedCoil(Winding):
    """Electromagnet, possibly with an iron core, whose field was measured or computed.

    Attributes: See `Winding`; besides these
        map: Field map, see `read_field_map`, in the frame of the coil: z along `direction`.
        map_current: Current of the map [A].
    """

    map: FileRef | str
    map_current: Annotated[float, _ABOVE] = field(default=1.0, metadata={"unit": "a"})

    kind: ClassVar[str] = "map"

    def __post_init__(self) -> None:
        super().__post_init__()
        object.__setattr__(self, "map", file_ref(self.map))

    def source(self, T_world_array: Float[np.ndarray, "4 4"]) -> Source:
        """Source of 1 A, switched off."""
        read = read_field_map(path_of(self.map))
        pose = self.pose(T_world_array)
        return replace(read, factor=1.0 / self.map_current, T_world_magnet=pose, strength=0.0)


Coils = tuple[Electromagnet | MappedCoil, ...]


@dataclass(frozen=True)
class CoilArray:
    """Electromagnets in one frame: z up, and z = 0 the surface on which the patient lies.

    Attributes:
        title: Description.
        coils: The electromagnets.
        ambient: Temperature of the surroundings and of coils at the start [°C].
    """

    coils: Coils
    title: str = ""
    ambient: Annotated[float, Range(min=-50.0, max=100.0, unit="°C")] = field(
        default=25.0, metadata={"unit": "c"}
    )

    def __post_init__(self) -> None:
        check_fields(self)
        count = len(self.coils)
        require(1 <= count <= _MAX_COILS, "number of coils", count, f"1 to {_MAX_COILS}")
        for index, coil in enumerate(self.coils):
            allowed = f"above the ambient {self.ambient:g} °C"
            is_valid = coil.max_temperature > self.ambient
            require(is_valid, f"coils[{index}].max_temperature", coil.max_temperature, allowed)

    def sources(self, T_world_array: Float[np.ndarray, "4 4"]) -> tuple[Source, ...]:
        """One source of 1 A for each coil, switched off; a world's strengths are its currents.

        Raises:
            InputError: If a field map cannot be read.
        """
        return tuple(coil.source(T_world_array) for coil in self.coils)

    def values(self, name: str) -> Float[np.ndarray, " k"]:
        """Value of a field of every coil."""
        return np.array([getattr(coil, name) for coil in self.coils], float)


@dataclass(frozen=True)
class CoilState:
    """Currents and temperatures of coils. Arrays may have batch axes before the coils.

    Attributes:
        currents: Currents [A].
        temperatures: Temperatures of the windings [°C].
        is_hot: Whether a coil was switched off because of its temperature.
    """

    currents: Float[np.ndarray, "*n k"]
    temperatures: Float[np.ndarray, "*n k"]
    is_hot: np.ndarray


def coils_at_rest(array: CoilArray) -> CoilState:
    """State without currents, at the ambient temperature."""
    count = len(array.coils)
    return CoilState(np.zeros(count), np.full(count, array.ambient), np.zeros(count, bool))


def advance_coils(
    array: CoilArray, state: CoilState, commands: Float[np.ndarray, "*n k"], dt: float
) -> CoilState:
    """Return the state after `dt` [s] of commanded currents [A], which are clipped to the limits.

    Both equations are integrated exactly: the current decays exponentially to its command, the
    temperature to that at the mean of R I² over the step. A coil at its maximum temperature is
    switched off until it is cooler.
    """
    most, rise = array.values("max_current"), array.values("rise_time")
    is_hot = state.temperatures >= array.values("max_temperature")
    wanted = np.where(is_hot, 0.0, np.clip(commands, -most, most))
    with np.errstate(divide="ignore"):
        steps = np.where(rise > 0.0, dt / rise, np.inf)
    gap = state.currents - wanted
    currents = wanted + gap * np.exp(-steps)
    share = np.where(np.isinf(steps), 0.0, -np.expm1(-steps) / steps)
    half = np.where(np.isinf(steps), 0.0, -np.expm1(-2.0 * steps) / (2.0 * steps))
    squared = wanted**2 + 2.0 * wanted * gap * share + gap**2 * half
    thermal = array.values("thermal_resistance")
    settled = array.ambient + thermal * array.values("resistance") * squared
    decay = np.exp(-dt / (thermal * array.values("heat_capacity")))
    temperatures = settled + (state.temperatures - settled) * decay
    return CoilState(currents, temperatures, is_hot)


def unit_wrenches(
    sources: tuple[Source, ...],
    magnets: tuple[InternalMagnet, ...],
    T_world_capsule: Float[np.ndarray, "4 4"],
) -> Float[np.ndarray, "6 k"]:
    """Force [N/A] and torque [N·m/A] of each coil on a capsule per ampere.

    Raises:
        InputError: If the capsule is where a field is undefined.
    """
    columns = [
        np.concatenate(SourceSet([replace(source, strength=1.0)]).wrench(magnets, T_world_capsule))
        for source in sources
    ]
    return np.array(columns).T


def currents_for_wrench(
    wrenches: Float[np.ndarray, "6 k"],
    target: Float[np.ndarray, " 6"],
    max_currents: Float[np.ndarray, " k"],
    *,
    length: float = 0.01,
) -> Float[np.ndarray, " k"]:
    """Currents [A] with the least heat whose wrench is nearest to a target, scaled to the limits.

    Minimum-norm least squares, as for OctoMag (Kummer et al., IEEE Trans. Robot. 26:1006, 2010).

    Args:
        wrenches: Wrench of each coil per ampere, see `unit_wrenches`.
        target: Force [N] and torque [N·m].
        max_currents: Maximum currents [A].
        length: Lever by which torques are compared with forces [m].
    """
    weights = np.repeat([1.0, 1.0 / length], 3)[:, None]
    currents = np.linalg.lstsq(weights * wrenches, weights[:, 0] * target, rcond=1e-3)[0]
    return currents / max(1.0, float((np.abs(currents) / max_currents).max()))


_ARRAYS = CatalogFolder(Path(__file__).parent / "coil_arrays", "coil array")


def coil_array_names() -> tuple[str, ...]:
    """Names of the coil arrays, sorted."""
    return _ARRAYS.names()


def read_coil_array(given: str | Path | CoilArray) -> CoilArray:
    """Read a coil array by its name or TOML file; an array in memory is unchanged.

    Paths of field maps in a file are relative to its folder and must not lead out of it.

    Raises:
        UnknownNameError: If the catalog has no such array.
        InputError: If the file cannot be read or describes no possible array.
    """
    if isinstance(given, CoilArray):
        return given
    if not isinstance(given, str | Path):
        raise InputError(
            f"coils are of type {type(given).__name__}. Allowed: a name "
            f"({', '.join(coil_array_names())}), the path of a TOML file, or a CoilArray."
        )
    path = _ARRAYS.find(given)
    array = from_plain(CoilArray, read_plain(path, "coil array"), at=f"{path.name}:", units=True)
    coils = tuple(
        replace(coil, map=FileRef(str(inside(path.parent, path_of(coil.map)))))
        if isinstance(coil, MappedCoil)
        else coil
        for coil in array.coils
    )
    return replace(array, coils=coils)
