"""Magnet presets: permanent magnets by name, and the remanence of NdFeB grades."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from vrcaps.core.errors import UnknownNameError, require
from vrcaps.core.units import MM
from vrcaps.magnet.field import field
from vrcaps.magnet.sources import Cylinder, Dipole

if TYPE_CHECKING:
    from jaxtyping import Float

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


@dataclass(frozen=True)
class MagnetPreset:
    """Commercially available magnet.

    Attributes:
        title: Description and use.
        diameter: Diameter [m].
        length: Length [m].
        grade: Grade of its material, a key of `GRADES`.
        remanence: Remanence [T], within its grade.
    """

    title: str
    diameter: float
    length: float
    grade: str
    remanence: float


MAGNETS = {
    "cylinder-152.4": MagnetPreset(
        "On an industrial arm: 6 inch cylinder, 3274 A·m², 21 kg",
        152.4 * MM,
        152.4 * MM,
        "N52",
        1.48,
    ),
    "cylinder-101.6": MagnetPreset(
        "On a strong arm: 4 inch cylinder, 970.1 A·m², 6.2 kg", 101.6 * MM, 101.6 * MM, "N52", 1.48
    ),
    "cylinder-76.2": MagnetPreset(
        "On an arm for 3 kg: 3 inch cylinder, 409 A·m², 2.6 kg", 76.2 * MM, 76.2 * MM, "N52", 1.48
    ),
    "cylinder-50.8": MagnetPreset(
        "On a small arm: 2 inch cylinder, 121 A·m², 0.8 kg", 50.8 * MM, 50.8 * MM, "N52", 1.48
    ),
    "capsule-11x10": MagnetPreset(
        "In a wide capsule: 11 mm across, 10 mm long, 1.12 A·m²", 11 * MM, 10 * MM, "N52", 1.48
    ),
    "capsule-6x6": MagnetPreset(
        "In a usual capsule, next to its electronics: 6 mm, 0.2 A·m²", 6 * MM, 6 * MM, "N52", 1.48
    ),
}
"""Magnets by name. Force estimates are published for `cylinder-101.6` and `capsule-11x10`."""


def magnet_names() -> tuple[str, ...]:
    """Names of the magnets, sorted."""
    return tuple(sorted(MAGNETS))


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


def read_magnet(name: str, T_world_magnet: Float[np.ndarray, "4 4"] | None = None) -> Cylinder:
    """Return a magnet by name, at a pose (by default the world frame).

    Raises:
        UnknownNameError: If there is no magnet with that name.
    """
    if name not in MAGNETS:
        raise UnknownNameError("magnet", name, MAGNETS)
    preset = MAGNETS[name]
    pose = np.eye(4) if T_world_magnet is None else T_world_magnet
    return Cylinder(preset.diameter, preset.length, preset.remanence, pose)


def dipole_distance(magnet: Cylinder, *, error: float = 0.05) -> float:
    """Distance from the center [m] beyond which the error of a dipole is at most `error`.

    The error is |B_cylinder − B_dipole|/|B_cylinder|, the maximum over all directions. It
    eventually falls with the square of the distance, but not necessarily monotonically.

    Raises:
        InputError: If the error is not from 1e-6 to below 1.
    """
    require(1e-6 <= error < 1.0, "error", error, "1e-6 to below 1")
    size = np.hypot(0.5 * magnet.diameter, 0.5 * magnet.length)
    angles = np.linspace(0.0, 0.5 * np.pi, 91)
    directions = np.stack([np.sin(angles), np.zeros_like(angles), np.cos(angles)], axis=-1)
    distances = 1.001 * size * np.geomspace(1.0, 2.0 / np.sqrt(error), 2001)
    points = (distances[:, None, None] * directions).reshape(-1, 3)
    exact = field([Cylinder(magnet.diameter, magnet.length, magnet.remanence)], points)[0]
    approximate = field([Dipole(magnet.moment)], points)[0]
    wrong = np.linalg.norm(exact - approximate, axis=1) / np.linalg.norm(exact, axis=1)
    too_near = np.nonzero(wrong.reshape(len(distances), -1).max(axis=1) > error)[0]
    return float(distances[too_near[-1] + 1]) if too_near.size else float(size)
