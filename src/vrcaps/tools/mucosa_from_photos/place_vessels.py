"""Vessels laid onto a texture at random places, turns and sizes."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from scipy import ndimage

if TYPE_CHECKING:
    from jaxtyping import Float

    from vrcaps.tools.mucosa_from_photos.vessels import VesselPiece

_MAX_PIECES = 4000
_CANDIDATES = 12  # places compared for each piece
_IS_VESSEL = 0.04  # optical density in green from which a texel counts as vessel


@dataclass(frozen=True)
class VesselSpread:
    """Normal distributions of how vessels lie, as VR-Caps has them.

    Attributes:
        place_std: Of the offset from the emptiest of some random places, in lengths of the
            piece's side.
        rotation_std_deg: Of the turn against the photograph [°]; mean 0.
        size_std: Of the size against the photograph; mean 1.
    """

    place_std: float = 0.3
    rotation_std_deg: float = 60.0
    size_std: float = 0.15


def place_vessels(
    pieces: list[VesselPiece],
    share: float,
    size: int,
    spread: VesselSpread,
    rng: np.random.Generator,
) -> Float[np.ndarray, "size size 3"]:
    """Optical density of vessels on a texture that continues over its edges.

    Pieces are drawn with a chance that grows with their length until vessels cover the share
    that they cover in the photographs. Where two cross, the denser counts.

    Args:
        pieces: To choose from.
        share: Of the texture to cover.
        size: [px].
        spread: How they lie.
        rng: Draws them.
    """
    density = np.zeros((size, size, 3), np.float32)
    if not pieces or share <= 0.0:
        return density
    chance = np.array([piece.length for piece in pieces], float)
    chance /= chance.sum()
    grain = max(4, size // 64)
    crowd = np.zeros((-(-size // grain),) * 2)
    covered = 0
    for _ in range(_MAX_PIECES):
        piece = pieces[int(rng.choice(len(pieces), p=chance))]
        turned = _turned(piece.density, spread, rng)
        place = _place(crowd, grain, max(turned.shape), spread.place_std, rng)
        rows = (int(place[0]) - turned.shape[0] // 2 + np.arange(turned.shape[0])) % size
        columns = (int(place[1]) - turned.shape[1] // 2 + np.arange(turned.shape[1])) % size
        there = density[np.ix_(rows, columns)]
        new = turned[..., None] * piece.color.astype(np.float32)
        is_new = (turned > _IS_VESSEL) & (there[..., 1] <= _IS_VESSEL)
        density[np.ix_(rows, columns)] = np.maximum(there, new)
        np.add.at(crowd, (rows[:, None] // grain, columns[None] // grain), turned > _IS_VESSEL)
        covered += int(is_new.sum())
        if covered >= share * size**2:
            break
    return density


def _turned(density, spread: VesselSpread, rng: np.random.Generator) -> Float[np.ndarray, "h w"]:
    """A piece turned, scaled and, every other time, mirrored."""
    angle = np.deg2rad(rng.normal(0.0, spread.rotation_std_deg))
    scale = float(np.clip(rng.normal(1.0, spread.size_std), 0.5, 1.5))
    matrix = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    if rng.random() < 0.5:
        matrix = matrix @ np.diag([1.0, -1.0])
    shape = np.array(density.shape)
    size = np.ceil(np.abs(matrix) @ shape * scale).astype(int) + 2
    back = matrix.T / scale
    rows, columns = np.indices((int(size[0]), int(size[1]))) - 0.5 * (size - 1)[:, None, None]
    middle = 0.5 * (shape - 1)
    places = [back[k, 0] * rows + back[k, 1] * columns + middle[k] for k in (0, 1)]
    turned = ndimage.map_coordinates(density, places, order=1, mode="constant")
    return np.maximum(turned, 0.0)


def _place(crowd, grain: int, reach: int, std: float, rng: np.random.Generator):
    """Near the emptiest of some random places [px]."""
    size = crowd.shape[0]
    smooth = ndimage.gaussian_filter(crowd, max(1.0, 0.35 * reach / grain), mode="wrap")
    candidates = rng.integers(0, size, (_CANDIDATES, 2))
    best = candidates[np.argmin(smooth[candidates[:, 0], candidates[:, 1]])]
    return (best + rng.random(2)) * grain + rng.normal(0.0, std * reach, 2)
