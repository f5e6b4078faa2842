"""Collapse bridging: find gaps between the parts of one lumen and open them to a channel."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise
from typing import TYPE_CHECKING

import numpy as np
from scipy import ndimage
from scipy.spatial import KDTree

from vrcaps.core.errors import import_extra
from vrcaps.core.units import MM
from vrcaps.tools.ct.fraction import LumenFraction
from vrcaps.tools.ct.lumen import mm_text
from vrcaps.tools.ct.volume import index_to_patient

if TYPE_CHECKING:
    from jaxtyping import Float

    from vrcaps.tools.ct.volume import Volume

CHANNEL_RADIUS = 6 * MM
"""Radius of an opened stretch: just wide enough for a capsule of 11 mm."""

_COARSE = 2.5 * MM  # grid on which the ends of a part are searched
_END_ZONE = 25 * MM  # length along a part that counts as its end
_DEEP = 12 * MM  # from the gap: reach of the search for the middle of the lumen


@dataclass(frozen=True)
class Gap:
    """Collapsed stretch between the ends of two parts of a lumen.

    Attributes:
        parts: IDs of the two parts.
        ends: The two wall points that face each other [m].
        channel: Points along the channel that would open it [m], from inside one part to
            inside the other.
    """

    parts: tuple[int, int]
    ends: Float[np.ndarray, "2 3"]
    channel: Float[np.ndarray, "4 3"]

    @property
    def width(self) -> float:
        """Distance between the two ends [m]."""
        return float(np.linalg.norm(self.ends[1] - self.ends[0]))

    def line(self) -> str:
        """Description of the gap."""
        return f"{self.width / MM:.1f} mm at {mm_text(self.ends.mean(axis=0))}"


def find_gaps(parts: Volume, max_width: float) -> list[Gap]:
    """Find the gaps that join parts of a lumen when opened; each end is used at most once.

    The ends of a part are its two points with the greatest geodesic distance inside it, so that
    loops that lie side by side are not joined through their walls. Nearer ends are joined first.

    Args:
        parts: ID of the part of each voxel, 0 for none.
        max_width: Maximum gap width [m].
    """
    boxes = ndimage.find_objects(parts.values)
    ends = [
        end
        for number, box in enumerate(boxes, start=1)
        if box is not None
        for end in _ends(parts.crop(box), number)
    ]
    pairs = []
    for a, one in enumerate(ends):
        tree = KDTree(one.points)
        for b, other in enumerate(ends[:a]):
            if other.label != one.label:
                distance, nearest = tree.query(other.points)
                best = int(np.argmin(distance))
                pairs.append((float(distance[best]), a, b, int(np.asarray(nearest)[best]), best))
    group = np.arange(len(boxes) + 1)
    used: set[int] = set()
    gaps = []
    for width, a, b, at_a, at_b in sorted(pairs):
        one, other = ends[a], ends[b]
        joined = group[one.label] == group[other.label]
        if width > max_width or joined or {a, b} & used:
            continue
        used |= {a, b}
        group[group == group[one.label]] = group[other.label]
        face = np.array([one.points[at_a], other.points[at_b]])
        inner = [_middle(parts, end.label, at) for end, at in zip((one, other), face, strict=True)]
        gaps.append(Gap((one.label, other.label), face, np.array([inner[0], *face, inner[1]])))
    return gaps


def connected_by_gaps(gaps: list[Gap], start: int) -> set[int]:
    """IDs of the parts that gaps join to a part, including itself."""
    reached = {start}
    while True:
        more = {part for gap in gaps if reached & set(gap.parts) for part in gap.parts} - reached
        if not more:
            return reached
        reached |= more


def bridge_gaps(lumen: LumenFraction, gaps: list[Gap], radius: float) -> LumenFraction:
    """Open a round channel through each gap of the lumen.

    Args:
        lumen: The lumen fraction.
        gaps: Gaps to open.
        radius: Radius of the channels [m].
    """
    fraction = lumen.fraction.copy()
    soft = float(lumen.spacing.mean())
    for gap in gaps:
        index = index_to_patient(np.linalg.inv(lumen.T_patient_index), gap.channel)
        pad = (radius + 2.0 * soft) / lumen.spacing
        low = np.maximum(np.floor(index.min(axis=0) - pad), 0).astype(int)
        high = np.minimum(np.ceil(index.max(axis=0) + pad) + 1, fraction.shape).astype(int)
        box = tuple(slice(a, b) for a, b in zip(low, high, strict=True))
        grid = np.stack(np.meshgrid(*(np.arange(s.start, s.stop) for s in box), indexing="ij"), -1)
        distance = _distance_to_line(lumen.points(grid.reshape(-1, 3)), gap.channel)
        inside = np.clip(0.5 + (radius - distance) / soft, 0.0, 1.0).reshape(grid.shape[:3])
        fraction[box] = np.maximum(fraction[box], inside.astype(np.float32))
    return LumenFraction(fraction, lumen.T_patient_index)


@dataclass(frozen=True)
class _End:
    """One end of a part: the wall voxels there [m]."""

    label: int
    points: Float[np.ndarray, "n 3"]


def _ends(part: Volume, label: int) -> list[_End]:
    """Find the two ends of a part; those of a short part may overlap."""
    MCP_Geometric = import_extra("skimage.graph", "ct", package="scikit-image").MCP_Geometric

    own = part.values == label
    stride = np.maximum(np.rint(_COARSE / part.spacing), 1).astype(int)
    steps = tuple(slice(None, None, s) for s in stride.tolist())
    coarse = ndimage.maximum_filter(own, stride.tolist())[steps]
    walk = MCP_Geometric(np.where(coarse, 1.0, -1.0), sampling=(part.spacing * stride).tolist())
    seed = np.argwhere(coarse)[0]
    sweeps = []
    for _ in range(3):
        away, _ = walk.find_costs([tuple(seed)])
        away = np.where(np.isfinite(away), away, 0.0)
        sweeps.append(away)
        seed = np.array(np.unravel_index(np.argmax(away), away.shape))
    wall = np.argwhere(own & ~np.asarray(ndimage.binary_erosion(own), bool))
    at = np.minimum(np.rint(wall / stride).astype(int), np.array(coarse.shape) - 1)
    ends = []
    for away in sweeps[1:]:
        # Measured from the far end: voxels nearly at the maximum distance are the near end.
        is_end = away[tuple(at.T)] >= away.max() - min(_END_ZONE, 0.5 * float(away.max()))
        ends.append(_End(label, part.points(wall[is_end])))
    return ends


def _middle(parts: Volume, label: int, point: Float[np.ndarray, " 3"]) -> Float[np.ndarray, " 3"]:
    """Point of a part farthest from its wall, within 12 mm of a point."""
    reach = np.ceil(_DEEP / parts.spacing)
    index = parts.index(point[None])[0]
    low = np.maximum(np.floor(index - reach), 0).astype(int)
    high = np.minimum(np.ceil(index + reach) + 1, parts.values.shape).astype(int)
    near = parts.crop(tuple(slice(a, b) for a, b in zip(low, high, strict=True)))
    own = near.values == label
    clearance = np.asarray(ndimage.distance_transform_edt(own, near.spacing.tolist()))
    deepest = np.unravel_index(np.argmax(clearance), clearance.shape)
    return near.points(np.array([deepest], float))[0]


def _distance_to_line(
    points: Float[np.ndarray, "n 3"], line: Float[np.ndarray, "k 3"]
) -> Float[np.ndarray, " n"]:
    """Distance from points to a polyline."""
    best = np.full(len(points), np.inf)
    for start, stop in pairwise(line):
        along = stop - start
        length = max(float(along @ along), np.finfo(float).tiny)
        fraction = np.clip((points - start) @ along / length, 0.0, 1.0)
        away = np.linalg.norm(points - start - fraction[:, None] * along, axis=1)
        best = np.minimum(best, away)
    return best
