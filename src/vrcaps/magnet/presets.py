"""Magnets by name, from a file or in memory."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from vrcaps.config.convert import from_plain
from vrcaps.config.plain_files import read_plain
from vrcaps.core.errors import InputError, UnknownNameError, require
from vrcaps.core.units import MM
from vrcaps.magnet.field import field
from vrcaps.magnet.magnets import GRADES, Cylinder, Magnet, remanence_of
from vrcaps.magnet.sources import Dipole

if TYPE_CHECKING:
    from jaxtyping import Float

__all__ = [
    "GRADES",
    "MAGNETS",
    "MagnetPreset",
    "dipole_distance",
    "magnet_names",
    "magnet_of",
    "read_magnet",
    "remanence_of",
]


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


def read_magnet(
    given: str | Path | Magnet, T_world_magnet: Float[np.ndarray, "4 4"] | None = None
) -> Magnet:
    """Return a magnet by name or from a file, or a magnet in memory, at a pose.

    Args:
        given: Name of a preset, path of a TOML file (`docs/how-to/bring-your-own-hardware.md`), or
            a magnet.
        T_world_magnet: Pose; None is the world frame, or a given magnet's own pose.

    Raises:
        UnknownNameError: If there is no magnet with that name.
        InputError: If the file cannot be read, describes no possible magnet, or the value is of
            another type.
    """
    magnet = magnet_of(given)
    if isinstance(magnet, str):
        preset = MAGNETS[magnet]
        magnet = Cylinder(preset.diameter, preset.length, preset.remanence)
    return magnet if T_world_magnet is None else replace(magnet, T_world_magnet=T_world_magnet)


def magnet_of(given: str | Path | Magnet) -> str | Magnet:
    """Convert a magnet's file to an object; names and magnets are checked and returned unchanged.

    Settings apply it to their magnet once, so that an episode contains the magnet and not its path.

    Raises:
        UnknownNameError: If there is no magnet with that name.
        InputError: If the file cannot be read, describes no possible magnet, or the value is of
            another type.
    """
    if isinstance(given, Magnet):
        return given
    if not isinstance(given, str | Path):
        raise InputError(
            f"magnet is of type {type(given).__name__}. Allowed: a name ({', '.join(MAGNETS)}), "
            "the path of a TOML file, or a Cylinder, Ring, Block or Sphere."
        )
    path = Path(given)
    if path.suffix == ".toml" or len(path.parts) > 1:
        plain = read_plain(path, "magnet")
        return from_plain(Magnet, plain, at=f"{path.name}:", units=True)
    if given not in MAGNETS:
        raise UnknownNameError("magnet", str(given), MAGNETS)
    return str(given)


def dipole_distance(magnet: Magnet, *, error: float = 0.05) -> float:
    """Distance from the center [m] beyond which the error of a dipole is at most `error`.

    The error is |B − B_dipole|/|B|, the maximum over the directions in the planes xz and yz. It
    eventually falls with the square of the distance, but not necessarily monotonically.

    Raises:
        InputError: If the error is not from 1e-6 to below 1.
    """
    require(1e-6 <= error < 1.0, "error", error, "1e-6 to below 1")
    size = 0.5 * np.hypot(*magnet.bounds)
    angles = np.linspace(0.0, 0.5 * np.pi, 91)
    sine, cosine, zero = np.sin(angles), np.cos(angles), np.zeros_like(angles)
    directions = np.stack([[sine, zero, cosine], [zero, sine, cosine]]).transpose(0, 2, 1)
    directions = directions.reshape(-1, 3)
    distances = 1.001 * size * np.geomspace(1.0, 2.0 / np.sqrt(error), 2001)
    points = (distances[:, None, None] * directions).reshape(-1, 3)
    exact = field([replace(magnet, T_world_magnet=np.eye(4))], points)[0]
    approximate = field([Dipole(magnet.moment)], points)[0]
    wrong = np.linalg.norm(exact - approximate, axis=1) / np.linalg.norm(exact, axis=1)
    too_near = np.nonzero(wrong.reshape(len(distances), -1).max(axis=1) > error)[0]
    return float(distances[too_near[-1] + 1]) if too_near.size else float(size)
