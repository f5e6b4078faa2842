"""Organs from a scan: from its gas, or from a label map."""

from __future__ import annotations

from dataclasses import asdict, dataclass, replace
from typing import TYPE_CHECKING, Literal

import numpy as np

from vrcaps.core.errors import InputError, UnknownNameError
from vrcaps.core.fields import check_fields
from vrcaps.core.units import CM, MM
from vrcaps.tools.ct.collapse_bridging import (
    CHANNEL_RADIUS,
    Gap,
    bridge_gaps,
    connected_by_gaps,
    find_gaps,
)
from vrcaps.tools.ct.fraction import LumenFraction, gas_fraction, mask_fraction, number_parts
from vrcaps.tools.ct.lumen import GAS_THRESHOLD, SPECKS, GasPiece, find_gas, renumbered
from vrcaps.tools.ct.volume import Volume

if TYPE_CHECKING:
    from collections.abc import Callable

    from vrcaps.organ.surface import OrganSurface
    from vrcaps.tools.ct.lumen import Gas
    from vrcaps.tools.ct.volume import Volume

_SPECK = 0.2 * CM**3  # parts of a lumen smaller than this are dropped
_MANY_PARTS = 40  # maximum number of parts of a lumen for which gaps are searched


@dataclass(frozen=True)
class WallOptions:
    """Settings of the wall extraction.

    Attributes:
        edge: Mean edge length of the triangles [m].
        blur: Standard deviation of a Gaussian over the scan beforehand [voxels]; None means 0.5
            for gas, 0.7 for a mask.
        pass_band: Fraction of the surface's spatial frequencies that smoothing keeps, up to 2;
            0.1 removes voxel steps and keeps a polyp.
        bridge: Maximum width of collapsed stretches to open to a channel [m]; 0 opens none.
        open_ends: Close the lumen (`cap`) or leave it open (`keep`) where the scan cuts it.
        reverse: Whether the narrower end of the lumen is the oral one.
        anatomy: Anatomy of the lumen: a whole `colon` is divided into segments, and its lower end
            is the anal one.
    """

    edge: float = 1.6 * MM
    blur: float | None = None
    pass_band: float = 0.1
    bridge: float = 0.0
    open_ends: Literal["cap", "keep"] = "cap"
    reverse: bool = False
    anatomy: Literal["any", "colon"] = "any"

    def __post_init__(self) -> None:
        check_fields(self)
        if not 0.1 * MM <= self.edge <= 20 * MM:
            raise InputError(f"The edge length is {self.edge / MM:g} mm. Allowed: 0.1 to 20 mm.")
        if not (self.blur is None or 0.0 <= self.blur <= 5.0):
            raise InputError(f"The blur is {self.blur:g} voxels. Allowed: 0 to 5.")
        if not 0.001 <= self.pass_band <= 2.0:
            raise InputError(f"The pass band is {self.pass_band:g}. Allowed: 0.001 to 2.")
        if not 0.0 <= self.bridge <= 0.2:
            raise InputError(f"The bridge width is {self.bridge / MM:g} mm. Allowed: 0 to 200 mm.")


def organ_from_gas(
    scan: Volume,
    gas: Gas,
    piece: GasPiece,
    *,
    wall: WallOptions,
    name: str,
    tagged_fluid: str | None = None,
    report: Callable[[str], None] = lambda step: None,
) -> OrganSurface:
    """Organ around a piece of gas and all that belongs to the same lumen.

    Args:
        scan: Hounsfield units.
        gas: All gas in it (`find_gas`).
        piece: Piece to start from, one of `gas.gut`.
        wall: Settings of the wall extraction.
        name: Name of the organ.
        tagged_fluid: Posture of the patient (`cleansing.DOWN`), if tagged fluid counts as lumen.
        report: Called with a line at the start of each step.

    Raises:
        InputError: If no wall can be extracted.
    """
    from vrcaps.tools.ct.cleansing import find_fluid

    fluid, pieces, pools = None, {piece.label}, set()
    if tagged_fluid is not None:
        report("segmenting tagged fluid")
        fluid = find_fluid(scan, gas, posture=tagged_fluid)
        pieces, pools = fluid.reached(piece.label)
    report("detecting collapsed segments")
    gaps, notes = _gaps_of_gas(gas, scan, pieces, piece.label, wall.bridge)
    notes = [*scan.notes, *notes]
    for gap in gaps:
        pieces |= set(gap.parts)
    if fluid is not None:
        for number in tuple(pieces):
            more, more_pools = fluid.reached(number)
            pieces, pools = pieces | more, pools | more_pools
    report("measuring partial volume")
    lumen = gas_fraction(scan, gas, tuple(pieces), fluid=fluid, pools=tuple(pools))
    if fluid is not None:
        notes.append(f"{len(pools)} pools of tagged fluid added to the lumen")
    blur = 0.5 if wall.blur is None else wall.blur
    source = {"source": scan.source, "input_mode": "gas", "tagged_fluid": tagged_fluid}
    return _organ(lumen, gaps, notes, replace(wall, blur=blur), (name, "wall"), source, report)


def organ_from_label(
    labels: Volume,
    label: int,
    *,
    wall: WallOptions,
    name: str,
    label_name: str = "wall",
    report: Callable[[str], None] = lambda step: None,
) -> OrganSurface:
    """Organ around one label of a label map, or around a mask (label 1).

    Args:
        labels: The label map.
        label: ID of the label.
        wall: Settings of the wall extraction.
        name: Name of the organ.
        label_name: Name of the wall's label.
        report: Called with a line at the start of each step.

    Raises:
        InputError: If the label does not occur, or no wall can be extracted.
    """
    lumen = mask_fraction(labels, (label,))
    if lumen is None:
        raise InputError(f"No voxel of {labels.source} has label {label}.")
    report("detecting collapsed segments")
    part, volumes = number_parts(lumen, _SPECK)
    if not volumes:
        raise InputError(
            f"Label {label} of {labels.source} has no part of 0.2 ml or more. Give another label."
        )
    parts = Volume(part, lumen.T_patient_index, labels.source)
    gaps, notes = _choose_gaps(parts, 1, wall.bridge, volumes)
    notes = [*labels.notes, *notes]
    blur = 0.7 if wall.blur is None else wall.blur
    source = {"source": labels.source, "input_mode": "label", "label": label}
    wall = replace(wall, blur=blur)
    return _organ(lumen, gaps, notes, wall, (name, label_name), source, report)


def find_lumens(scan: Volume, *, threshold: int = GAS_THRESHOLD) -> Gas:
    """Find all gas of a scan, see `find_gas`.

    Raises:
        InputError: If the threshold lies outside −1000 to −300 HU.
    """
    require_threshold(threshold)
    return find_gas(scan, threshold=threshold)


def require_threshold(threshold: int) -> None:
    """Check the gas threshold.

    Raises:
        InputError: If it lies outside −1000 to −300 HU.
    """
    if not -1000 <= threshold <= -300:
        raise InputError(f"The gas threshold is {threshold} HU. Allowed: -1000 to -300.")


def _gaps_of_gas(
    gas: Gas, scan: Volume, pieces: set[int], start: int, bridge: float
) -> tuple[list[Gap], list[str]]:
    """Gaps to open between pieces of gut gas, and messages about those left closed."""
    new_label = np.zeros(SPECKS + 1 + len(gas.pieces), np.int32)
    gut = [piece for piece in gas.gut if piece.label == start or piece.label not in pieces]
    new_label[[piece.label for piece in gut]] = np.arange(1, len(gut) + 1)
    new_label[list(pieces)] = new_label[start]
    parts = Volume(renumbered(gas.label, new_label), scan.T_patient_index, scan.source)
    gaps, notes = _choose_gaps(
        parts, int(new_label[start]), bridge, [piece.volume for piece in gut]
    )
    back = {int(new_label[piece.label]): piece.label for piece in gut}
    return [replace(gap, parts=tuple(back[p] for p in gap.parts)) for gap in gaps], notes


def _choose_gaps(
    parts: Volume, start: int, bridge: float, volumes: list[float]
) -> tuple[list[Gap], list[str]]:
    """Choose the gaps that join all reachable parts to a part, and describe them and the rest."""
    if len(volumes) < 2:
        return [], []
    if len(volumes) > _MANY_PARTS:
        return [], [f"{len(volumes)} parts: too many to search for gaps between them"]
    gaps = find_gaps(parts, max(bridge, 50 * MM))
    narrow = [gap for gap in gaps if gap.width <= bridge]
    kept = connected_by_gaps(narrow, start)
    opened = [gap for gap in narrow if set(gap.parts) <= kept]
    notes = [f"collapsed segment opened: {gap.line()}" for gap in opened]
    for gap in gaps:
        if len(set(gap.parts) & kept) == 1:
            (other,) = set(gap.parts) - kept
            notes.append(
                f"collapsed segment left closed: {gap.line()}, beyond it "
                f"{volumes[other - 1] / CM**3:.1f} ml; --bridge-mm {np.ceil(gap.width / MM):.0f} "
                "opens it"
            )
    lost = sum(volume for n, volume in enumerate(volumes, start=1) if n not in kept)
    if lost > 0.0:
        notes.append(f"{len(volumes) - len(kept)} other parts left out ({lost / CM**3:.1f} ml)")
    return opened, notes


def _largest_part(lumen: LumenFraction) -> LumenFraction:
    """The largest part of a lumen.

    Raises:
        InputError: If all parts are too small.
    """
    part, volumes = number_parts(lumen, _SPECK)
    if not volumes:
        raise InputError("The lumen has no part of 0.2 ml or more. Choose a larger one.")
    fraction = np.where(lumen.fraction > 0.5, lumen.fraction * (part == 1), lumen.fraction)
    return replace(lumen, fraction=fraction)


def _organ(
    lumen: LumenFraction,
    gaps: list[Gap],
    notes: list[str],
    wall: WallOptions,
    names: tuple[str, str],
    source: dict,
    report: Callable[[str], None],
) -> OrganSurface:
    """Organ around the largest part of a lumen after opening its gaps."""
    from vrcaps.mesh.repair import repair
    from vrcaps.organ.centerline import compute_centerline, reversed_centerline
    from vrcaps.organ.read_organ import organ_from_mesh
    from vrcaps.tools.ct.surface import colon_labels, extract_wall, runs_upwards

    lumen = _largest_part(bridge_gaps(lumen, gaps, CHANNEL_RADIUS) if gaps else lumen)
    report("extracting the wall")
    assert wall.blur is not None
    mesh = extract_wall(lumen, blur=wall.blur, pass_band=wall.pass_band, edge=wall.edge)
    mesh, repairs = repair(mesh, open_ends=wall.open_ends)
    report("computing the centerline")
    default = compute_centerline(mesh)
    backwards = runs_upwards(default) if wall.anatomy == "colon" else False
    backwards ^= wall.reverse
    centerline = reversed_centerline(default) if backwards else default
    report("computing gut coordinates")
    mesh = replace(mesh, label=np.ones(len(mesh.vertices), np.uint8))
    organ = organ_from_mesh(mesh, centerline, name=names[0], label_names=("background", names[1]))
    if wall.anatomy == "colon":
        label, label_names = colon_labels(centerline, organ.arc_length)
        organ = replace(organ, label=label, label_names=label_names)
    details = {"wall": asdict(wall), "notes": notes, "backwards": backwards}
    return replace(organ, metadata={**source, **details, "repairs": repairs.lines()})


TOTALSEGMENTATOR = {"esophagus": 15, "stomach": 6, "duodenum": 19, "small_bowel": 18, "colon": 20}
"""Gut labels of TotalSegmentator version 2, task `total` (Wasserthal et al. 2023)."""

_AIR = -900  # Hounsfield units of the air around a patient
_MISPLACED = 0.05  # fraction of a label's voxels in air outside the body above which it is suspect


def label_number(label: str) -> int:
    """ID of a label given by ID or name.

    Raises:
        UnknownNameError: If it is neither.
        InputError: If the ID is not a label.
    """
    if label.lstrip("-").isdigit():
        if int(label) < 1:
            raise InputError(f"Label {label} is background. Allowed: 1, 2, 3, …")
        return int(label)
    if label not in TOTALSEGMENTATOR:
        raise UnknownNameError("label", label, [*TOTALSEGMENTATOR, "or a number"])
    return TOTALSEGMENTATOR[label]


def check_label(labels: Volume, label: str) -> int:
    """Return the ID of a label after checking that the map contains it.

    Raises:
        InputError: If it does not, or the file contains Hounsfield units.
        UnknownNameError: If the label's name is unknown.
    """
    label_id = label_number(label)
    if labels.values.min() < 0:
        raise InputError(
            f"{labels.source} has values down to {labels.values.min()}: it is not a label map. "
            "Give the label map with --labels, or omit --label to segment gas."
        )
    if not (labels.values == label_id).any():
        labels_present = np.unique(labels.values[labels.values > 0])
        text = ", ".join(map(str, labels_present[:40])) + (
            ", …" if len(labels_present) > 40 else ""
        )
        raise InputError(
            f"No voxel of {labels.source} has label {label} ({label_id}). Found: {text or 'none'}."
        )
    return label_id


def misplaced(scan: Volume, labels: Volume, label: int) -> str | None:
    """Message if part of a label lies in the air outside the body; otherwise None.

    Args:
        scan: Hounsfield units, on the label map's grid.
        labels: The label map.
        label: ID of the label.
    """
    from vrcaps.tools.ct.lumen import body_mask

    body, stride = body_mask(scan)
    coarse = tuple(slice(None, None, s) for s in stride)
    own = labels.values[coarse] == label
    out = own & ~body & (scan.values[coarse] < _AIR)
    fraction = np.count_nonzero(out) / max(np.count_nonzero(own), 1)
    if fraction <= _MISPLACED:
        return None
    volume = fraction * np.count_nonzero(labels.values == label) * labels.voxel_volume
    return (
        f"{fraction:.0%} of the label ({volume / CM**3:.0f} ml) lies in the air outside the body: "
        "it may belong to another scan"
    )
