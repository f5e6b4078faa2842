"""Placement of vessels on a texture at random positions, rotations and sizes."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
import scipy

if TYPE_CHECKING:
    from jaxtyping import Float

    from vrcaps.tools.mucosa_from_photos.vessels import VesselPiece

_MAX_PIECES = 4000
_CANDIDATES = 12  # candidate positions compared for each piece
_IS_VESSEL = 0.04  # optical density in green above which a texel counts as vessel


@dataclass(frozen=True)
class VesselPlacement:
    """Normal distributions of position, rotation and size of vessels, as in VR-Caps.

    Attributes:
        position_std: Standard deviation of the offset from the emptiest of some random positions,
            in side lengths of the piece.
        rotation_std_deg: Standard deviation of the rotation relative to the photograph [°]; mean 0.
        size_std: Standard deviation of the size relative to the photograph; mean 1.
    """

    position_std: float = 0.3
    rotation_std_deg: float = 60.0
    size_std: float = 0.15


def place_vessels(
    pieces: list[VesselPiece],
    coverage: float,
    size: int,
    placement: VesselPlacement,
    rng: np.random.Generator,
) -> Float[np.ndarray, "size size 3"]:
    """Optical density of vessels placed on a tileable texture.

    Pieces are drawn with a probability proportional to their length until the covered fraction
    equals that in the photographs. Where two cross, the denser counts.

    Args:
        pieces: Vessel pieces to choose from.
        coverage: Fraction of the texture to cover.
        size: Side of the texture [px].
        placement: Distributions of position, rotation and size.
        rng: Random generator.
    """
    density = np.zeros((size, size, 3), np.float32)
    if not pieces or coverage <= 0.0:
        return density
    chance = np.array([piece.length for piece in pieces], float)
    chance /= chance.sum()
    grain = max(4, size // 64)
    occupancy = np.zeros((-(-size // grain),) * 2)
    covered = 0
    for _ in range(_MAX_PIECES):
        piece = pieces[int(rng.choice(len(pieces), p=chance))]
        rotated = _transformed(piece.density, placement, rng)
        position = _draw_position(occupancy, grain, max(rotated.shape), placement.position_std, rng)
        rows = (int(position[0]) - rotated.shape[0] // 2 + np.arange(rotated.shape[0])) % size
        columns = (int(position[1]) - rotated.shape[1] // 2 + np.arange(rotated.shape[1])) % size
        there = density[np.ix_(rows, columns)]
        new = rotated[..., None] * piece.color.astype(np.float32)
        is_new = (rotated > _IS_VESSEL) & (there[..., 1] <= _IS_VESSEL)
        density[np.ix_(rows, columns)] = np.maximum(there, new)
        np.add.at(occupancy, (rows[:, None] // grain, columns[None] // grain), rotated > _IS_VESSEL)
        covered += int(is_new.sum())
        if covered >= coverage * size**2:
            break
    return density


def _transformed(
    density, placement: VesselPlacement, rng: np.random.Generator
) -> Float[np.ndarray, "h w"]:
    """Rotate, scale and, with probability 1/2, mirror a piece."""
    angle = np.deg2rad(rng.normal(0.0, placement.rotation_std_deg))
    scale = float(np.clip(rng.normal(1.0, placement.size_std), 0.5, 1.5))
    matrix = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    if rng.random() < 0.5:
        matrix = matrix @ np.diag([1.0, -1.0])
    shape = np.array(density.shape)
    size = np.ceil(np.abs(matrix) @ shape * scale).astype(int) + 2
    back = matrix.T / scale
    rows, columns = np.indices((int(size[0]), int(size[1]))) - 0.5 * (size - 1)[:, None, None]
    middle = 0.5 * (shape - 1)
    places = [back[k, 0] * rows + back[k, 1] * columns + middle[k] for k in (0, 1)]
    rotated = scipy.ndimage.map_coordinates(density, places, order=1, mode="constant")
    return np.maximum(rotated, 0.0)


def _draw_position(occupancy, grain: int, reach: int, std: float, rng: np.random.Generator):
    """Draw a position near the emptiest of some random positions [px]."""
    size = occupancy.shape[0]
    smooth = scipy.ndimage.gaussian_filter(occupancy, max(1.0, 0.35 * reach / grain), mode="wrap")
    candidates = rng.integers(0, size, (_CANDIDATES, 2))
    best = candidates[np.argmin(smooth[candidates[:, 0], candidates[:, 1]])]
    return (best + rng.random(2)) * grain + rng.normal(0.0, std * reach, 2)
