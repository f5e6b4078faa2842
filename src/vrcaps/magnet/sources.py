"""Sources of a magnetic field, each with a pose: +z of frame `magnet` is along the moment.

Laws and limits are in `docs/concepts/magnets.md`. Currents are right-handed about +z.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np

from vrcaps.core.errors import InputError, require
from vrcaps.magnet.magnets import (
    MAGNETIC_CONSTANT,
    NEODYMIUM_DENSITY,
    Block,
    Cylinder,
    Magnet,
    Ring,
    Sphere,
)
from vrcaps.magnet.pose import check_pose, magnet_pose

if TYPE_CHECKING:
    from jaxtyping import Float

    from vrcaps._core import FieldSources

__all__ = [
    "MAGNETIC_CONSTANT",
    "NEODYMIUM_DENSITY",
    "Block",
    "Coil",
    "Cylinder",
    "Dipole",
    "FieldMap",
    "InternalMagnet",
    "Magnet",
    "Ring",
    "Solenoid",
    "Source",
    "Sphere",
    "UniformField",
    "check_pose",
    "magnet_pose",
    "magnet_rows",
]

_MAX_LAYERS = 100
_MIN_POINTS = 4


def _identity() -> np.ndarray:
    return np.eye(4)


def _pose(source: Source) -> np.ndarray:
    return np.asarray(source.T_world_magnet, float)


def _above_zero(source: object, *names: str) -> None:
    for name in names:
        value = getattr(source, name)
        label = f"{type(source).__name__} {name}"
        require(0.0 < value < math.inf, label, value, "above 0")


def _finite(source: object, *names: str) -> None:
    for name in names:
        value = getattr(source, name)
        require(math.isfinite(value), f"{type(source).__name__} {name}", value, "a finite number")


@dataclass(frozen=True)
class Dipole:
    """Point dipole.

    Attributes:
        moment: Magnetic moment along +z [A·m²], above 0.
        T_world_magnet: Pose of the dipole.
    """

    moment: float
    T_world_magnet: Float[np.ndarray, "4 4"] = field(default_factory=_identity)

    def __post_init__(self) -> None:
        _above_zero(self, "moment")
        check_pose("T_world_magnet", self.T_world_magnet)

    def add_to(self, core: FieldSources) -> int:
        """Add this source to the core's; return the number of core sources used."""
        core.add_dipole(_pose(self), self.moment)
        return 1


@dataclass(frozen=True)
class Coil:
    """Flat coil: `turns` windings on one circle, as one thin wire.

    Attributes:
        radius: Radius of the circle [m].
        current: Current [A]; 0 is off, a negative current reverses the field.
        turns: Number of windings, 1 or more.
        T_world_magnet: Pose of its center.
    """

    radius: float
    current: float
    turns: int = 1
    T_world_magnet: Float[np.ndarray, "4 4"] = field(default_factory=_identity)

    def __post_init__(self) -> None:
        _above_zero(self, "radius")
        _finite(self, "current")
        require(self.turns >= 1, "Coil turns", self.turns, "1 or more")
        check_pose("T_world_magnet", self.T_world_magnet)

    def add_to(self, core: FieldSources) -> int:
        """Add this source to the core's; return the number of core sources used."""
        core.add_ring(_pose(self), self.radius, self.current * self.turns)
        return 1


@dataclass(frozen=True)
class Solenoid:
    """Solenoid: `layers` thin shells of uniform current.

    The pitch of the winding is neglected. A single layer is at `radius`; several layers divide the
    thickness of the winding evenly, each in the middle of its part.

    Attributes:
        radius: Mean radius of the winding [m].
        length: Length of the winding [m].
        current: Current [A]; 0 is off.
        turns: Total number of windings in all layers, 1 or more.
        thickness: Outer minus inner radius of the winding [m], below 2 `radius`.
        layers: Number of shells that represent the thickness, 1 to 100.
        T_world_magnet: Pose of its center.
        strength: Initial factor on the field, which the controls of a world change.
    """

    radius: float
    length: float
    current: float
    turns: int
    thickness: float = 0.0
    layers: int = 1
    T_world_magnet: Float[np.ndarray, "4 4"] = field(default_factory=_identity)
    strength: float = 1.0

    def __post_init__(self) -> None:
        _above_zero(self, "radius", "length")
        _finite(self, "current", "strength")
        require(self.turns >= 1, "Solenoid turns", self.turns, "1 or more")
        is_thin = 0.0 <= self.thickness < 2.0 * self.radius
        require(is_thin, "Solenoid thickness", self.thickness, "0 to below twice the radius")
        is_count = 1 <= self.layers <= _MAX_LAYERS
        require(is_count, "Solenoid layers", self.layers, f"1 to {_MAX_LAYERS}")
        check_pose("T_world_magnet", self.T_world_magnet)

    def add_to(self, core: FieldSources) -> int:
        """Add this source to the core's; return the number of core sources used."""
        sheet = MAGNETIC_CONSTANT * self.current * self.turns / (self.layers * self.length)
        for k in range(self.layers):
            radius = self.radius + self.thickness * ((k + 0.5) / self.layers - 0.5)
            core.add_shell(_pose(self), radius, self.length, sheet)
            core.set_strength(len(core) - 1, self.strength)
        return self.layers


@dataclass(frozen=True)
class UniformField:
    """Uniform field.

    Attributes:
        flux_density: Flux density along +z [T]; may be 0 or below.
        T_world_magnet: Defines the direction of +z; its position is irrelevant.
    """

    flux_density: float
    T_world_magnet: Float[np.ndarray, "4 4"] = field(default_factory=_identity)

    def __post_init__(self) -> None:
        _finite(self, "flux_density")
        check_pose("T_world_magnet", self.T_world_magnet)

    def add_to(self, core: FieldSources) -> int:
        """Add this source to the core's; return the number of core sources used."""
        core.add_uniform(_pose(self), self.flux_density)
        return 1


@dataclass(frozen=True)
class FieldMap:
    """Measured or externally computed field on a regular grid.

    It is interpolated by a tricubic spline (Catmull and Rom 1974): continuous with its gradient,
    exact for quadratic fields. The gradient is that of the spline, so F = ∇(m·B) stays a gradient,
    but div B and curl B vanish only within the accuracy of the grid.

    Attributes:
        origin: Position of the first point [m].
        spacing: Distance between points along x, y, z [m].
        flux_density: Values [T] in frame `magnet`, four or more points along each axis.
        factor: Factor on the values, such as the current of a map per ampere.
        T_world_magnet: Pose of the map.
        strength: Initial factor on the field, which the controls of a world change.
    """

    origin: tuple[float, float, float]
    spacing: tuple[float, float, float]
    flux_density: Float[np.ndarray, "nx ny nz 3"]
    factor: float = 1.0
    T_world_magnet: Float[np.ndarray, "4 4"] = field(default_factory=_identity)
    strength: float = 1.0

    def __post_init__(self) -> None:
        shape = np.shape(self.flux_density)
        if len(shape) != 4 or shape[3] != 3 or min(shape[:3]) < _MIN_POINTS:
            raise InputError(
                f"A field map has shape {shape}. Allowed: [nx ny nz 3], {_MIN_POINTS} or more "
                "points along each axis."
            )
        if not np.isfinite(self.flux_density).all():
            raise InputError("A field map contains values that are not finite. Fill them in first.")
        if not (np.isfinite(self.origin).all() and min(self.spacing) > 0.0):
            raise InputError(
                f"A field map has origin {self.origin} and spacing {self.spacing}. "
                "Allowed: finite numbers, spacing above 0."
            )
        _finite(self, "factor", "strength")
        check_pose("T_world_magnet", self.T_world_magnet)

    def add_to(self, core: FieldSources) -> int:
        """Add this source to the core's; return the number of core sources used."""
        values = np.ascontiguousarray(self.flux_density, float)
        core.add_map(_pose(self), self.origin, self.spacing, values, self.factor)
        core.set_strength(len(core) - 1, self.strength)
        return 1


Source = Dipole | Cylinder | Ring | Block | Sphere | Coil | Solenoid | UniformField | FieldMap
"""Any source; an array of electromagnets is a list of sources."""


@dataclass(frozen=True)
class InternalMagnet:
    """A magnet fixed in a capsule, modeled as a dipole at its center.

    Attributes:
        position_capsule: Center of the magnet in the capsule frame [m].
        moment_capsule: Moment of the magnet in the capsule frame [A·m²], not zero.
    """

    position_capsule: tuple[float, float, float] = field(metadata={"unit": "mm", "key": "position"})
    moment_capsule: tuple[float, float, float] = field(metadata={"unit": "a_m2", "key": "moment"})

    def __post_init__(self) -> None:
        values = np.array([*self.position_capsule, *self.moment_capsule], float)
        if values.shape != (6,) or not np.isfinite(values).all() or not values[3:].any():
            raise InputError(
                f"An internal magnet has position {self.position_capsule} and moment "
                f"{self.moment_capsule}. Allowed: three finite numbers each, the moment not zero."
            )


def magnet_rows(magnets: Sequence[InternalMagnet]) -> Float[np.ndarray, "k 6"]:
    """Position [m] and moment [A·m²] of each magnet in the capsule frame, as the core expects."""
    rows = [[*magnet.position_capsule, *magnet.moment_capsule] for magnet in magnets]
    return np.array(rows, float).reshape(-1, 6)
