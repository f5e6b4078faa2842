"""Permanent magnets: cylinder, ring, block and sphere, uniformly magnetized.

In frame `magnet` +z is along the moment for every shape, so that every magnet is held and aimed
alike. Their permeability is taken as μ₀; that of rare-earth magnets is close (1.05). Inside, where
H is B/μ₀ minus the magnetization, B is also defined.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Annotated, Any, ClassVar, Literal

import numpy as np

from vrcaps.config.convert import from_plain, register_shorthand
from vrcaps.config.plain_files import stored_fields
from vrcaps.core.errors import InputError, UnknownNameError, import_extra, require
from vrcaps.core.fields import Range, check_fields
from vrcaps.magnet.pose import check_pose

if TYPE_CHECKING:
    import trimesh

    from vrcaps._core import FieldSources

NEODYMIUM_DENSITY = 7500.0
"""Density of sintered NdFeB [kg/m³] (manufacturers' data sheets)."""
MAGNETIC_CONSTANT = 1.25663706127e-6
"""μ₀ [N/A²] (CODATA 2022), as in the compiled core."""
GRADES = {
    "N35": (1.17, 1.22),
    "N38": (1.22, 1.25),
    "N40": (1.25, 1.28),
    "N42": (1.28, 1.32),
    "N45": (1.32, 1.38),
    "N48": (1.38, 1.42),
    "N50": (1.40, 1.45),
    "N52": (1.43, 1.48),
    "N55": (1.47, 1.52),
}
"""Minimum and maximum remanence [T] of sintered NdFeB at 20 °C: data sheets of Magnet Expert (N35
to N52) and Vormag (N55). It falls by 0.12 % per kelvin."""

_Size = Annotated[float, Range(above=0.0, max=1.0, unit="m")]
_Remanence = Annotated[float, Range(above=0.0, max=2.0, unit="T")]
_STRENGTHS = ("grade", "remanence_t", "moment_a_m2")
_MM, _T = {"unit": "mm"}, {"unit": "t"}
_NOT_STORED = {"stored": False}


def remanence_of(grade: str, *, part: float = 0.5) -> float:
    """Remanence [T] of a grade: minimum (`part` 0), center (0.5) or maximum (1).

    Raises:
        UnknownNameError: If the grade is not in the table.
        InputError: If `part` is not from 0 to 1.
    """
    if grade not in GRADES:
        raise UnknownNameError("grade", grade, GRADES)
    require(0.0 <= part <= 1.0, "part", part, "0 to 1")
    low, high = GRADES[grade]
    return low + part * (high - low)


def _identity() -> np.ndarray:
    return np.eye(4)


class _Shape:
    """Properties that all shapes derive from volume and remanence."""

    T_world_magnet: np.ndarray
    remanence: float
    kind: ClassVar[str]

    def __post_init__(self) -> None:
        check_fields(self, type(self).__name__)
        check_pose("T_world_magnet", self.T_world_magnet)

    @property
    def volume(self) -> float:
        """Volume [m³]."""
        raise NotImplementedError

    @property
    def moment(self) -> float:
        """Magnetic moment B_r V/μ₀ [A·m²]."""
        return self.remanence * self.volume / MAGNETIC_CONSTANT

    @property
    def mass(self) -> float:
        """Mass [kg], assuming NdFeB."""
        return NEODYMIUM_DENSITY * self.volume

    def _pose(self) -> np.ndarray:
        return np.asarray(self.T_world_magnet, float)


class _RoundShape(_Shape):
    """Properties of a cylinder with or without a hole."""

    diameter: float
    length: float
    magnetization: Literal["axial", "diametric"]

    @property
    def bounds(self) -> tuple[float, float]:
        """Diameter and length of the smallest cylinder about the moment that holds it [m]."""
        if self.magnetization == "axial":
            return self.diameter, self.length
        return math.hypot(self.diameter, self.length), self.diameter


@dataclass(frozen=True)
class Cylinder(_RoundShape):
    """Permanent magnet: a cylinder, magnetized along its axis or across it.

    Attributes:
        diameter: Diameter [m].
        length: Length along the axis [m].
        remanence: Remanence B_r [T]; magnetization times μ₀.
        T_world_magnet: Pose of its center, with +z along the moment. Comparisons ignore it.
        magnetization: `axial`: the axis is z; `diametric`: the axis is x.
    """

    diameter: _Size = field(metadata=_MM)
    length: _Size = field(metadata=_MM)
    remanence: _Remanence = field(metadata=_T)
    T_world_magnet: np.ndarray = field(
        default_factory=_identity, compare=False, metadata=_NOT_STORED
    )
    magnetization: Literal["axial", "diametric"] = "axial"

    kind: ClassVar[str] = "cylinder"

    @property
    def volume(self) -> float:
        """Volume [m³]."""
        return 0.25 * math.pi * self.diameter**2 * self.length

    def add_to(self, core: FieldSources) -> int:
        """Add this source to the core's; return the number of core sources used."""
        radius = 0.5 * self.diameter
        if self.magnetization == "axial":
            core.add_shell(self._pose(), radius, self.length, self.remanence, True)
        else:
            core.add_magnet_ring(self._pose(), (radius, 0.0), self.length, self.remanence, True)
        return 1


@dataclass(frozen=True)
class Ring(_RoundShape):
    """Permanent magnet: a cylinder with a hole, magnetized along its axis or across it.

    Attributes:
        diameter: Outer diameter [m].
        hole_diameter: Diameter of the hole [m], below `diameter`.
        length: Length along the axis [m].
        remanence: Remanence B_r [T]; magnetization times μ₀.
        T_world_magnet: Pose of its center, with +z along the moment. Comparisons ignore it.
        magnetization: `axial`: the axis is z; `diametric`: the axis is x.
    """

    diameter: _Size = field(metadata=_MM)
    hole_diameter: _Size = field(metadata=_MM)
    length: _Size = field(metadata=_MM)
    remanence: _Remanence = field(metadata=_T)
    T_world_magnet: np.ndarray = field(
        default_factory=_identity, compare=False, metadata=_NOT_STORED
    )
    magnetization: Literal["axial", "diametric"] = "axial"

    kind: ClassVar[str] = "ring"

    def __post_init__(self) -> None:
        super().__post_init__()
        allowed = f"below the outer diameter, {self.diameter:g} m"
        is_valid = self.hole_diameter < self.diameter
        require(is_valid, "Ring's hole_diameter", f"{self.hole_diameter:g} m", allowed)

    @property
    def volume(self) -> float:
        """Volume [m³]."""
        return 0.25 * math.pi * (self.diameter**2 - self.hole_diameter**2) * self.length

    def add_to(self, core: FieldSources) -> int:
        """Add this source to the core's; return the number of core sources used."""
        radii = (0.5 * self.diameter, 0.5 * self.hole_diameter)
        across = self.magnetization == "diametric"
        core.add_magnet_ring(self._pose(), radii, self.length, self.remanence, across)
        return 1


@dataclass(frozen=True)
class Block(_Shape):
    """Permanent magnet: a block, magnetized along its third edge.

    Attributes:
        size: Edges along x, y and z [m].
        remanence: Remanence B_r [T]; magnetization times μ₀.
        T_world_magnet: Pose of its center, with +z along the moment. Comparisons ignore it.
    """

    size: tuple[float, float, float] = field(metadata=_MM)
    remanence: _Remanence = field(metadata=_T)
    T_world_magnet: np.ndarray = field(
        default_factory=_identity, compare=False, metadata=_NOT_STORED
    )

    kind: ClassVar[str] = "block"

    def __post_init__(self) -> None:
        super().__post_init__()
        is_size = len(self.size) == 3 and all(0.0 < edge <= 1.0 for edge in self.size)
        require(is_size, "Block's size", self.size, "three edges above 0 to 1 m")

    @property
    def volume(self) -> float:
        """Volume [m³]."""
        return math.prod(self.size)

    @property
    def bounds(self) -> tuple[float, float]:
        """Diameter and length of the smallest cylinder about the moment that holds it [m]."""
        return math.hypot(self.size[0], self.size[1]), self.size[2]

    def add_to(self, core: FieldSources) -> int:
        """Add this source to the core's; return the number of core sources used."""
        core.add_block(self._pose(), self.size, self.remanence)
        return 1


@dataclass(frozen=True)
class Sphere(_Shape):
    """Permanent magnet: a sphere; its field outside is exactly that of a dipole.

    Attributes:
        diameter: Diameter [m].
        remanence: Remanence B_r [T]; magnetization times μ₀.
        T_world_magnet: Pose of its center, with +z along the moment. Comparisons ignore it.
    """

    diameter: _Size = field(metadata=_MM)
    remanence: _Remanence = field(metadata=_T)
    T_world_magnet: np.ndarray = field(
        default_factory=_identity, compare=False, metadata=_NOT_STORED
    )

    kind: ClassVar[str] = "sphere"

    @property
    def volume(self) -> float:
        """Volume [m³]."""
        return math.pi / 6.0 * self.diameter**3

    @property
    def bounds(self) -> tuple[float, float]:
        """Diameter and length of the smallest cylinder about the moment that holds it [m]."""
        return self.diameter, self.diameter

    def add_to(self, core: FieldSources) -> int:
        """Add this source to the core's; return the number of core sources used."""
        core.add_ball(self._pose(), 0.5 * self.diameter, self.remanence)
        return 1


Magnet = Cylinder | Ring | Block | Sphere
"""Any permanent magnet."""
SHAPES: tuple[type[Magnet], ...] = (Cylinder, Ring, Block, Sphere)


def _with_remanence(cls: type[Magnet]) -> Callable[[dict[str, Any]], dict[str, Any]]:
    """Return the expansion of a magnet whose file states a grade or a moment."""
    own = {
        f.name if f.name == "magnetization" else f"{f.name}_{f.metadata['unit']}": f.name
        for f in stored_fields(cls)
        if f.name != "remanence"
    }

    def expand(plain: dict[str, Any]) -> dict[str, Any]:
        given = [name for name in _STRENGTHS if name in plain]
        unknown = sorted(set(plain) - {*own, *_STRENGTHS})
        if unknown or len(given) != 1:
            what = f"Unknown key {unknown[0]}" if unknown else f"{len(given)} strengths are given"
            raise InputError(
                f"{what}. Allowed: kind, {', '.join(own)}, and one of {', '.join(_STRENGTHS)}."
            )
        strength = plain.pop(given[0])
        if given[0] == "grade":
            strength = remanence_of(str(strength))
        elif given[0] == "moment_a_m2":
            return {**plain, "remanence_t": _remanence_for(cls, plain, strength)}
        return {**plain, "remanence_t": strength}

    return expand


def _remanence_for(cls: type[Magnet], plain: dict[str, Any], moment: Any) -> float:
    """Remanence [T] with which a magnet of a size has a moment [A·m²]."""
    one = from_plain(cls, {**plain, "remanence_t": 1.0}, at="", units=True)
    remanence = from_plain(float, moment, at="moment_a_m2") / one.moment
    if not 0.0 < remanence <= 2.0:
        raise InputError(
            f"moment_a_m2 is {moment}, which takes a remanence of {remanence:.3g} T. Allowed: "
            f"above 0 to {2.0 * one.moment:.4g} A·m², 2 T, for this size."
        )
    return remanence


for _shape in SHAPES:
    register_shorthand(_shape, _with_remanence(_shape))


def magnet_mesh(magnet: Magnet) -> trimesh.Trimesh:
    """Closed surface of a magnet in its frame [m], for pictures and scene files.

    Raises:
        MissingExtraError: If trimesh is not installed.
    """
    creation = import_extra("trimesh", "robots").creation
    if isinstance(magnet, Block):
        return creation.box(magnet.size)
    if isinstance(magnet, Sphere):
        return creation.icosphere(3, 0.5 * magnet.diameter)
    radius, length = 0.5 * magnet.diameter, magnet.length
    if isinstance(magnet, Ring):
        mesh = creation.annulus(0.5 * magnet.hole_diameter, radius, length, sections=48)
    else:
        mesh = creation.cylinder(radius, length, sections=48)
    if magnet.magnetization == "diametric":  # the axis from z to x
        mesh.apply_transform(np.array([[0, 0, 1, 0], [0, -1, 0, 0], [1, 0, 0, 0], [0, 0, 0, 1.0]]))
    return mesh
