"""Gas in a scan: connected pieces, classification as gut, and selection."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal

import numpy as np
from scipy import ndimage

from vrcaps.core.errors import InputError
from vrcaps.core.units import CM, MM

if TYPE_CHECKING:
    from jaxtyping import Bool, Float, Int, UInt16

    from vrcaps.tools.ct.volume import Volume


def connected_parts(mask: Bool[np.ndarray, "k j i"]) -> tuple[Int[np.ndarray, "k j i"], int]:
    """Label the connected parts: ID of each voxel (0 for none), and the number of parts.

    Voxels are connected across faces only, so that thin walls separate parts.
    """
    label = np.empty(mask.shape, np.int32)
    num = ndimage.label(mask, output=label)
    assert isinstance(num, int)
    return label, num


def part_sizes(label: Int[np.ndarray, "k j i"], num: int) -> Int[np.ndarray, " n"]:
    """Number of voxels of each part; index 0 is the background."""
    sizes = np.zeros(num + 1, np.int64)
    for plane in label:
        sizes += np.bincount(plane.ravel(), minlength=num + 1)
    return sizes


def renumbered(
    label: Int[np.ndarray, "k j i"], new_ids: Int[np.ndarray, " n"]
) -> UInt16[np.ndarray, "k j i"]:
    """Replace the ID of each voxel's part.

    Args:
        label: ID of the part of each voxel.
        new_ids: New ID of each part, below 65,536.
    """
    assert new_ids.max(initial=0) < 2**16
    return new_ids.astype(np.uint16)[label]


def grown(mask: Bool[np.ndarray, "k j i"], num_voxels: int = 1) -> Bool[np.ndarray, "k j i"]:
    """Dilate a mask, each step across one face."""
    for _ in range(num_voxels):
        wider = mask.copy()
        for axis in range(3):
            here, there = np.moveaxis(wider, axis, 0), np.moveaxis(mask, axis, 0)
            here[1:] |= there[:-1]
            here[:-1] |= there[1:]
        mask = wider
    return mask


def shrunk(mask: Bool[np.ndarray, "k j i"], num_voxels: int = 1) -> Bool[np.ndarray, "k j i"]:
    """Erode a mask; it is not eroded at the border of the array."""
    return ~grown(~mask, num_voxels)


GAS_THRESHOLD = -800
"""Hounsfield units below which a voxel is entirely gas. Isosurfaces at the middle value join two
loops with a thin wall in between; their cores stay separate."""

OUTSIDE, SPECKS = 1, 2  # IDs of gas that is not a piece

_SPECK = 1 * CM**3  # minimum volume of a piece of gut
_COARSE = 4 * MM  # grid of the body mask
_TISSUE = -300  # Hounsfield units that separate body from air, on the coarse grid
_IN_BODY = 0.9  # minimum fraction of a piece's voxels that lie in the body
_LUNG_EXCESS = 80  # Hounsfield units by which lung is denser than gas
_LUNG_VOLUME = 100 * CM**3
_LEAK_VOLUME = 20 * CM**3

Kind = Literal["gut", "lung", "outside"]


@dataclass(frozen=True)
class GasPiece:
    """Connected piece of gas.

    Attributes:
        label: ID of its voxels in `Gas.label`.
        kind: Gut, lung (denser than gas; large, or reaching the top slice), or outside the body.
        volume: Volume of its voxels [m³].
        center: Position of one of its voxels near their mean, patient frame [m].
        hounsfield: Median of its voxels.
        box: Bounding box in the scan.
    """

    label: int
    kind: Kind
    volume: float
    center: Float[np.ndarray, " 3"]
    hounsfield: float
    box: tuple[slice, slice, slice]


@dataclass(frozen=True)
class Gas:
    """All gas of a scan.

    Attributes:
        label: ID of the piece of each voxel, 0 where there is no gas, `OUTSIDE` where the gas
            reaches the sides of the scan, `SPECKS` in components of less than 1 ml.
        pieces: Those of at least 1 ml except for the outside air; the largest first.
        hounsfield: Value of the outside air, −1000 except for errors of the scanner's calibration.
        leak: Volume [m³] and middle [m] of the largest part of the outside air that lies
            within the body.
    """

    label: UInt16[np.ndarray, "k j i"]
    pieces: tuple[GasPiece, ...]
    hounsfield: float
    leak: tuple[float, Float[np.ndarray, " 3"]]

    @property
    def gut(self) -> tuple[GasPiece, ...]:
        """Pieces that may be gut."""
        return tuple(piece for piece in self.pieces if piece.kind == "gut")


def find_gas(scan: Volume, *, threshold: int = GAS_THRESHOLD) -> Gas:
    """Find connected pieces of gas (by faces) and classify each as gut, lung or outside.

    Gas that reaches the left, right, front or back side of the scan, or lies outside the body, is
    outside. Pieces that reach the first or last slice are cut off there, not outside.

    Args:
        scan: Hounsfield units, axes superior, posterior, left.
        threshold: Hounsfield units below which a voxel is gas.
    """
    body, stride = body_mask(scan)
    label = _numbered_gas(scan, threshold)
    air = scan.values[::4, ::4, ::4][label[::4, ::4, ::4] == OUTSIDE]
    air = air[(air > -1100) & (air < -900)]
    air_hu = float(np.median(air)) if len(air) > 100 else -1000.0
    pieces = tuple(
        _classify(scan, label, number, box, air_hu, (body, stride))
        for number, box in enumerate(ndimage.find_objects(label), start=1)
        if number > SPECKS and box is not None
    )
    coarse = label[tuple(slice(None, None, s) for s in stride)]
    return Gas(label, pieces, air_hu, _leak(scan, coarse == OUTSIDE, body))


def _numbered_gas(scan: Volume, threshold: int) -> UInt16[np.ndarray, "k j i"]:
    """Compute `Gas.label`; pieces from 3 on, the largest first."""
    label, num = connected_parts(scan.values < threshold)
    sizes = part_sizes(label, num)
    sides = (label[:, 0], label[:, -1], label[:, :, 0], label[:, :, -1])
    new_label = np.full(num + 1, SPECKS)
    new_label[np.unique(np.concatenate([np.unique(side) for side in sides]))] = OUTSIDE
    new_label[0] = 0
    big = np.flatnonzero((new_label == SPECKS) & (sizes * scan.voxel_volume >= _SPECK))
    new_label[big[np.argsort(-sizes[big], kind="stable")]] = SPECKS + 1 + np.arange(len(big))
    return renumbered(label, new_label)


def body_mask(scan: Volume) -> tuple[Bool[np.ndarray, "k j i"], tuple[int, int, int]]:
    """Mask of the patient's trunk and its contents, on a grid coarser by a stride along each axis.

    Objects thinner than three coarse voxels, such as the table top, and objects connected to the
    trunk by less, such as an arm, are excluded.
    """
    k, j, i = (max(1, round(_COARSE / d)) for d in scan.spacing.tolist())
    tissue = scan.values[::k, ::j, ::i] > _TISSUE
    trunk = ndimage.binary_erosion(tissue)
    label, num = connected_parts(trunk)
    if num == 0:
        return np.zeros(tissue.shape, bool), (k, j, i)
    largest = 1 + int(np.argmax(np.bincount(label.ravel())[1:]))
    trunk = np.asarray(ndimage.binary_dilation(label == largest), bool) & tissue
    for plane in trunk:
        plane[:] = np.asarray(ndimage.binary_fill_holes(ndimage.binary_closing(plane)))
    return trunk, (k, j, i)


def _classify(
    scan: Volume,
    label: UInt16[np.ndarray, "k j i"],
    piece_id: int,
    box: tuple[slice, slice, slice],
    air_hu: float,
    body: tuple[Bool[np.ndarray, "k j i"], tuple[int, int, int]],
) -> GasPiece:
    """Classify a piece of gas."""
    part = label[box]
    own = np.flatnonzero(part == piece_id)
    some = np.unravel_index(own[:: max(1, len(own) // 20_000)], part.shape)
    at = np.stack(some, axis=1) + [side.start for side in box]
    median = float(np.median(scan.values[tuple(at.T)]))
    mask, stride = body
    coarse = np.minimum(np.rint(at / stride).astype(int), np.array(mask.shape) - 1)
    volume = len(own) * scan.voxel_volume
    kind, top = "gut", scan.values.shape[0] - 1
    if mask[tuple(coarse.T)].mean() < _IN_BODY:
        kind = "outside"
    elif median > air_hu + _LUNG_EXCESS and (volume > _LUNG_VOLUME or at[:, 0].max() == top):
        kind = "lung"
    middle = at[np.argmin(np.linalg.norm(at - at.mean(axis=0), axis=1))]
    return GasPiece(piece_id, kind, volume, scan.points(middle[None])[0], median, box)


def _leak(
    scan: Volume, outside: Bool[np.ndarray, "k j i"], body: Bool[np.ndarray, "k j i"]
) -> tuple[float, Float[np.ndarray, " 3"]]:
    """The largest part of the outside air deep in the body: volume [m³] and middle [m]."""
    deep = outside & ndimage.binary_erosion(body, iterations=3, border_value=1)
    label, num = connected_parts(deep)
    if num == 0:
        return 0.0, np.zeros(3)
    counts = np.bincount(label.ravel())[1:]
    largest = int(np.argmax(counts))
    middle = np.array(ndimage.center_of_mass(label == largest + 1))
    stride = np.ceil(np.array(scan.values.shape) / deep.shape)
    fraction = scan.voxel_volume * stride.prod()
    return float(counts[largest] * fraction), scan.points(middle[None] * stride)[0]


def choose_gas(
    gas: Gas, scan: Volume, *, seed: Float[np.ndarray, " 3"] | None = None
) -> tuple[GasPiece, ...]:
    """Choose the pieces to build organs from: the one at the seed, or all gut, largest first.

    Args:
        gas: Gas of the scan.
        scan: Hounsfield units.
        seed: A point in the lumen, patient frame [m].

    Raises:
        InputError: If there is no gut gas, it leaks to the outside, or the seed is not in it.
    """
    if seed is not None:
        return (_at_seed(gas, scan, seed),)
    volume, position = gas.leak
    largest = gas.gut[0].volume if gas.gut else 0.0
    if volume > max(_LEAK_VOLUME, largest):
        raise InputError(
            f"The lumen leaks: {volume / CM**3:.0f} ml of gas around {mm_text(position)} are "
            "connected to the air outside. Lower --threshold, or give a mask with --labels."
        )
    if not gas.gut:
        low, high = int(scan.values.min()), int(scan.values.max())
        hint = (
            "Air has -1000 HU in a CT: check that the values are in Hounsfield units"
            if low > _TISSUE
            else "Change --threshold, or give a mask with --labels"
        )
        raise InputError(
            f"No lumen in {scan.source}: no gas of 1 ml or more enclosed by the body at that "
            f"threshold. The values go from {low} to {high} HU. {hint}."
        )
    return gas.gut


def _at_seed(gas: Gas, scan: Volume, seed: Float[np.ndarray, " 3"]) -> GasPiece:
    """Return the piece of gas at a point."""
    index = np.rint(scan.index(np.asarray(seed, float)[None])[0]).astype(int)
    if not np.isfinite(seed).all() or (index < 0).any() or (index >= scan.values.shape).any():
        corners = scan.points(np.array([[0, 0, 0], scan.values.shape]) - 0.5)
        low, high = corners.min(axis=0), corners.max(axis=0)
        raise InputError(
            f"The seed {mm_text(seed)} lies outside the scan, which goes from "
            f"{mm_text(low)} to {mm_text(high)} (LPS)."
        )
    label = int(gas.label[tuple(index)])
    if label == OUTSIDE:
        raise InputError(
            f"The gas at the seed {mm_text(seed)} leaks to the air outside. Lower --threshold, "
            "give another seed, or a mask with --labels."
        )
    matches = [piece for piece in gas.pieces if piece.label == label]
    if not matches:
        value = int(scan.values[tuple(index)])
        known = "; ".join(f"{mm_text(p.center)}, {p.volume / CM**3:.0f} ml" for p in gas.gut[:4])
        raise InputError(
            f"The seed {mm_text(seed)} is outside the lumen ({value} HU there). "
            f"Gas lies at: {known or 'no position of 1 ml or more'}."
        )
    return matches[0]


def mm_text(point: Float[np.ndarray, " 3"]) -> str:
    """Format a position [m] as an argument of --seed-mm."""
    return "({:.1f}, {:.1f}, {:.1f}) mm".format(*(np.asarray(point, float) / MM))
