"""Vessels of a photograph, and their placement on a texture.

Vessels are dark red ridges, cut out as pieces; they are placed at random positions, rotations and
sizes.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
import scipy

from vrcaps.core.errors import import_extra
from vrcaps.core.fields import check_fields

if TYPE_CHECKING:
    from jaxtyping import Bool, Float

_RADII = (0.0035, 0.006, 0.010)  # radii of the vessels, as fractions of the field's width
_NOISE = 99.0  # percentile of bright ridges, which are noise, used as threshold of a vessel
_LOW = 0.5  # fraction of that threshold down to which a vessel is followed
_MIN_LENGTH = 0.045  # minimum length of a piece, as a fraction of the field's width
_MIN_DENSITY = 0.07  # minimum mean optical density in green of a piece over its surroundings
_MAX_REDNESS = 0.42  # maximum density in red over that in green; shadows 1, blood about 0.2


@dataclass(frozen=True)
class VesselPiece:
    """Connected piece of a vessel network, without its background.

    Attributes:
        density: Optical density that it adds in green light, smooth, 0 at the rim.
        color: Optical density in red, green, blue light relative to green.
        length: Length of its skeleton [px].
        radius: Mean half width [px].
    """

    density: Float[np.ndarray, "h w"]
    color: Float[np.ndarray, " 3"]
    length: int
    radius: float


@dataclass(frozen=True)
class Vessels:
    """Vessels of one photograph.

    Attributes:
        pieces: Vessel pieces, largest first.
        mask: Pixels of vessels.
        coverage: Fraction of the searched pixels that the pieces cover.
    """

    pieces: list[VesselPiece]
    mask: Bool[np.ndarray, "h w"]
    coverage: float


def find_vessels(
    flat: Float[np.ndarray, "h w 3"], usable: Bool[np.ndarray, "h w"], width: int
) -> Vessels:
    """Segment vessels: gray, median, CLAHE, ridges, hysteresis, skeleton; then reject non-vessels.

    The gray value is the optical density in green, absorbed by blood but hardly by other tissue.
    Ridges are Sato's (Sato et al. 1998, Med. Image Anal. 2(2):143–168). A piece is kept if it is
    long enough, dark enough, and redder than the shadow of a fold.

    Args:
        flat: Logarithm of reflectance, see `remove_shading`.
        usable: Pixels that show the wall.
        width: Width of the field [px].
    """
    exposure, filters, measure, morphology = (
        import_extra(f"skimage.{name}", "organs", package="scikit-image")
        for name in ("exposure", "filters", "measure", "morphology")
    )

    density = scipy.ndimage.median_filter(-flat[..., 1], 3)
    inside = scipy.ndimage.binary_erosion(usable, iterations=max(3, width // 80), border_value=1)
    if not inside.any():
        return Vessels([], np.zeros_like(usable), 0.0)
    low, high = np.percentile(density[inside], [1.0, 99.0])
    gray = np.clip((density - low) / max(float(high - low), 1e-6), 0.0, 1.0)
    gray = exposure.equalize_adapthist(gray, kernel_size=max(16, width // 8), clip_limit=0.01)
    sigmas: Any = [max(0.8, fraction * width) for fraction in _RADII]
    ridge, opposite = (
        filters.sato(gray.astype(np.float32), sigmas=sigmas, black_ridges=is_dark, mode="reflect")
        for is_dark in (False, True)
    )
    strong = float(np.percentile(opposite[inside], _NOISE))
    ridges = filters.apply_hysteresis_threshold(ridge, _LOW * strong, strong) & inside
    skeleton = morphology.skeletonize(ridges)
    part = np.asarray(measure.label(skeleton, connectivity=2))
    member = np.where(ridges, part[_nearest(part > 0)], 0)
    around = scipy.ndimage.gaussian_filter(flat, (0.02 * width, 0.02 * width, 0.0))
    extra = around - flat
    pieces, kept = [], np.zeros_like(ridges)
    sizes = np.bincount(part.ravel())
    for number, box in enumerate(scipy.ndimage.find_objects(part), start=1):
        if box is None or sizes[number] < _MIN_LENGTH * width:
            continue
        piece = _piece(member, part, extra, number, box)
        if piece is not None:
            pieces.append(piece)
            kept |= member == number
    pieces.sort(key=lambda piece: -piece.length)
    return Vessels(pieces, kept, float(kept.sum() / inside.sum()))


def _piece(member, part, extra, index: int, box) -> VesselPiece | None:
    """Build a piece; None if it is too faint or too gray for a vessel."""
    margin = 6
    window = tuple(
        slice(max(0, s.start - margin), min(n, s.stop + margin))
        for s, n in zip(box, member.shape, strict=True)
    )
    mask, line = member[window] == index, part[window] == index
    depth = extra[window]
    mean = depth[mask].mean(axis=0)
    core = depth[line].mean(axis=0)
    if core[1] < _MIN_DENSITY or mean[1] <= 0.0 or mean[0] > _MAX_REDNESS * mean[1]:
        return None
    color = np.clip(mean / mean[1], [0.0, 1.0, 0.5], [_MAX_REDNESS, 1.0, 1.1])
    half = _distance(~np.pad(mask, 1))[1:-1, 1:-1]
    distance, nearest = _distance(line), _nearest(line)
    radius = _along(np.maximum(half, 0.7), line, 4.0)[nearest]
    peak = _along(np.clip(depth[..., 1], 0.0, 1.2), line, 4.0)[nearest]
    profile = np.exp(-0.5 * (distance / np.maximum(0.75 * radius, 0.6)) ** 2)
    density = peak * profile * _taper(line, float(radius[line].mean()))
    density = scipy.ndimage.gaussian_filter(np.pad(density, 2), 0.6).astype(np.float32)
    return VesselPiece(density, color, int(line.sum()), float(radius[line].mean()))


def _along(values, line, sigma: float) -> Float[np.ndarray, "h w"]:
    """Smooth values on a line along it."""
    weight = scipy.ndimage.gaussian_filter(line.astype(np.float32), sigma)
    return scipy.ndimage.gaussian_filter(values * line, sigma) / np.maximum(weight, 1e-6)


def _taper(line, radius: float) -> Float[np.ndarray, "h w"]:
    """Weight of 1 that falls to 0 at the free ends of a line."""
    neighbors = scipy.ndimage.convolve(
        line.astype(np.int16), np.ones((3, 3), np.int16), mode="constant"
    )
    ends = line & (neighbors == 2)
    if not ends.any():
        return np.ones(line.shape, np.float32)
    return np.minimum(_distance(ends) / (6.0 * radius), 1.0)


def _distance(mask: Bool[np.ndarray, "h w"]) -> Float[np.ndarray, "h w"]:
    """Distance of each pixel to the nearest pixel of a mask [px]."""
    return np.asarray(scipy.ndimage.distance_transform_edt(~mask))


def _nearest(mask: Bool[np.ndarray, "h w"]) -> tuple[np.ndarray, np.ndarray]:
    """Row and column of the nearest pixel of a mask, for each pixel."""
    rows, columns = np.asarray(
        scipy.ndimage.distance_transform_edt(~mask, return_distances=False, return_indices=True)
    )
    return rows, columns


_MAX_PIECES = 4000
_CANDIDATES = 12  # candidate positions compared for each piece
_IS_VESSEL = 0.04  # optical density in green above which a texel counts as vessel


@dataclass(frozen=True)
class VesselPlacement:
    """Normal distributions of position, rotation and size of vessels, as in VR-Caps.

    Attributes:
        position_std: Standard deviation of the offset from the emptiest of several random
            positions, relative to the side length of the vessel piece.
        rotation_std_deg: Standard deviation of the rotation relative to the photograph [°]; mean 0.
        size_std: Standard deviation of the size relative to the photograph; mean 1.
    """

    position_std: float = 0.3
    rotation_std_deg: float = 60.0
    size_std: float = 0.15

    def __post_init__(self) -> None:
        check_fields(self, of="VesselPlacement")


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
    weights = np.array([piece.length for piece in pieces], float)
    weights /= weights.sum()
    grain = max(4, size // 64)
    occupancy = np.zeros((-(-size // grain),) * 2)
    covered = 0
    for _ in range(_MAX_PIECES):
        piece = pieces[int(rng.choice(len(pieces), p=weights))]
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
    positions = [back[k, 0] * rows + back[k, 1] * columns + middle[k] for k in (0, 1)]
    rotated = scipy.ndimage.map_coordinates(density, positions, order=1, mode="constant")
    return np.maximum(rotated, 0.0)


def _draw_position(occupancy, grain: int, reach: int, std: float, rng: np.random.Generator):
    """Draw a position near the emptiest of some random positions [px]."""
    size = occupancy.shape[0]
    smooth = scipy.ndimage.gaussian_filter(occupancy, max(1.0, 0.35 * reach / grain), mode="wrap")
    candidates = rng.integers(0, size, (_CANDIDATES, 2))
    best = candidates[np.argmin(smooth[candidates[:, 0], candidates[:, 1]])]
    return (best + rng.random(2)) * grain + rng.normal(0.0, std * reach, 2)
