"""Placement of bubbles and chyme in an organ, and of bubbles on the round ends of a capsule.

Spheres form clusters: flat rafts of bubbles, round clumps of chyme.
"""

from __future__ import annotations

from statistics import NormalDist
from typing import TYPE_CHECKING

import numpy as np

from vrcaps._core import Wall
from vrcaps.core.errors import require
from vrcaps.core.geometry import unit
from vrcaps.core.rng import normal_along
from vrcaps.core.units import MM
from vrcaps.lumen.contents import Bubbles, Chyme
from vrcaps.lumen.particles import BUBBLE, FIRST_CLUMP, WHITE, YELLOW, Spheres, no_spheres
from vrcaps.organ.surface import OrganSurface

if TYPE_CHECKING:
    from jaxtyping import Float, Int

_SPACING = 2.0 * MM
_PATCH = 40.0 * MM
"""Correlation length along the gut of the presence of bubbles or particles [m]."""
_LIFT_BUBBLE, _EMERGED = 0.85, 0.35
"""Height of a bubble's center above the wall it clings to, as a fraction of its radius: of a bubble
in liquid and of a large one. A film meets a wet wall at a right angle (Plateau), so a bubble that
has emerged from the liquid is a hemisphere."""
_LAYER = 0.2
"""Thickness of the liquid on a wall relative to the size of the meniscus that it forms around a
bubble."""
_TOUCH = 0.93
"""Distance between neighbors in a raft as a fraction of the sum of their radii; they share a flat
wall."""
_LONGEST = 5.0
"""Maximum ratio of the length of a raft, along a crease, to its width."""
_MANY = 16.0
"""Number of bubbles from which a raft may contain any size; in smaller rafts the maximum radius is
proportional to the root of their number, because large bubbles form where small ones coalesce."""
_LIFT_CHYME = 0.4
_BOUND = 0.45
"""Distance between neighbors in a clump of chyme as a fraction of the sum of their radii."""
_SCATTER = 0.7
"""Random deviation of directions from up or down, relative to the unit direction."""
_MAX_ON_DOME = 0.6 * MM
"""Maximum radius of a bubble on the capsule [m]; the wall wipes larger ones off. The flow of the
image takes a bubble whose near side is within 1 mm of the shell to move with the capsule."""
_TRIES = {2: 12, 3: 2}
"""Random positions tried for each sphere of a raft or a clump: few, so that clumps branch."""
_SLENDER = 4.0
"""Maximum ratio of the length of a clump, around the gut, to its width."""
_CREASES, _FOLD = 10, 4.0 * MM
"""Positions tried for each raft of bubbles, and half their distance along the gut [m]."""
_MOST = 10_000_000
"""Maximum expected number of bubbles or of particles in an organ, which limits memory."""
_FLATTENING = 0.35
"""Height of a clump on the wall relative to that of a hemisphere."""


def sizes(total: int, mean: float, rng: np.random.Generator) -> Int[np.ndarray, " k"]:
    """Sizes of clusters with `total` spheres in all: geometric, at most four times `mean`.

    Args:
        total: Number of spheres.
        mean: Mean size before the last cluster is cut to fit, 1 or more.
        rng: Random generator.
    """
    drawn = np.minimum(rng.geometric(1.0 / mean, total), max(1, round(4.0 * mean)))
    ends = np.cumsum(drawn)
    count = int(np.searchsorted(ends, total)) + 1 if total else 0
    counts = drawn[:count]
    if count:
        counts[-1] -= ends[count - 1] - total
    return counts


def lifts(bubbles: Bubbles, radius: Float[np.ndarray, " n"]) -> Float[np.ndarray, " n"]:
    """Heights of the centers of bubbles above the wall they cling to [m], by their radii [m]."""
    sunk = np.minimum(_LAYER * bubbles.meniscus / radius, 1.0)
    return radius * (_EMERGED + (_LIFT_BUBBLE - _EMERGED) * sunk)


def pack(
    counts: Int[np.ndarray, " k"],
    radius: Float[np.ndarray, " n"],
    rng: np.random.Generator,
    *,
    dimensions: int,
    touch: float,
    stretch: Float[np.ndarray, " k"] | float = 1.0,
) -> Float[np.ndarray, "n 3"]:
    """Place spheres side by side in clusters; each touches an earlier sphere of its cluster.

    Of a few random positions next to earlier spheres, each takes the one nearest to the cluster's
    first sphere without overlap, or else the one with the least overlap.

    Args:
        counts: Number of spheres in each cluster.
        radius: Radii of all spheres, cluster after cluster [m].
        rng: Random generator.
        dimensions: 2 for rafts in the plane z = 0, 3 for clumps on it, which branch.
        touch: Distance between neighbors as a fraction of the sum of their radii.
        stretch: Length of each cluster along its second axis over its width.

    Returns:
        Positions relative to the first sphere of each cluster [m].
    """
    positions = np.zeros((len(radius), 3))
    first = np.concatenate([[0], np.cumsum(counts)])[:-1].astype(int)
    stretches = np.broadcast_to(np.asarray(stretch, float), counts.shape)
    for member in range(1, int(counts.max(initial=0))):
        start = first[counts > member]
        shape = (len(start), _TRIES[dimensions])
        neighbor = start[:, None] + rng.integers(0, member, shape)
        direction = rng.standard_normal((*shape, 3))
        direction[..., 2] = _FLATTENING * np.abs(direction[..., 2]) if dimensions == 3 else 0.0
        direction /= np.linalg.norm(direction, axis=-1, keepdims=True)
        own = radius[start + member]
        reach = touch * (radius[neighbor] + own[:, None])
        tried = positions[neighbor] + reach[..., None] * direction
        others = start[:, None] + np.arange(member)
        apart = np.linalg.norm(tried[:, :, None] - positions[others][:, None], axis=-1)
        gap = apart - touch * (radius[others][:, None] + own[:, None, None])
        least = gap.min(axis=-1)
        narrow = tried.copy()
        narrow[..., 1] /= stretches[counts > member, None]
        far = np.linalg.norm(narrow, axis=-1)
        is_free = least > -0.02 * own[:, None]
        best = np.argmax(np.where(is_free, 1.0 - far, least - 10.0), axis=1)
        positions[start + member] = tried[np.arange(len(start)), best]
    return positions


def smooth_area(organ: OrganSurface) -> tuple[Float[np.ndarray, " k"], Float[np.ndarray, " k"]]:
    """Arc lengths [m] and area of a smooth wall up to there [m²], from its mean girth."""
    length = organ.centerline.length
    edges = np.linspace(0.0, length, max(2, round(length / _SPACING)) + 1)
    middle = 0.5 * (edges[1:] + edges[:-1])
    count, _ = np.histogram(organ.arc_length, edges)
    total, _ = np.histogram(organ.arc_length, edges, weights=organ.radius)
    known = count > 0
    radius = np.interp(middle, middle[known], total[known] / count[known])
    return edges, np.append(0.0, np.cumsum(2.0 * np.pi * radius * np.diff(edges)))


def cut_log_normal(
    kind: Bubbles | Chyme, count: int, rng: np.random.Generator
) -> Float[np.ndarray, " n"]:
    """Radii [m] from the truncated log-normal distribution of a kind."""
    drawn = kind.radius * np.exp(kind.spread * rng.standard_normal(count))
    return np.clip(drawn, kind.smallest, kind.largest)


def place_bubbles(
    organ: OrganSurface,
    wall: Wall,
    bubbles: Bubbles,
    up: Float[np.ndarray, " 3"],
    rng: np.random.Generator,
) -> Spheres:
    """Place bubbles that cling to the wall, in the organ frame.

    Args:
        organ: The wall at rest.
        wall: Hierarchy of the wall, in the same frame.
        bubbles: Number and sizes.
        up: Unit direction against gravity.
        rng: Random generator.

    Raises:
        InputError: If more than 10 million bubbles are expected.
    """
    rafts = _Seeds(organ, wall, bubbles, bubbles.raft_size, rng)
    if rafts.total == 0:
        return no_spheres()
    rafts.settle(up, bubbles.rising, creases=_CREASES)
    few = np.sqrt(np.minimum(rafts.counts / _MANY, 1.0))[rafts.owner]
    radius = np.minimum(rafts.radii(bubbles), np.maximum(few * bubbles.largest, bubbles.radius))
    stretch = _LONGEST ** rng.random(len(rafts.counts))
    positions = rafts.spread(radius, dimensions=2, touch=_TOUCH, stretch=stretch)
    centers = _on_wall(organ, wall, positions, lifts(bubbles, radius))
    instance = 1 + np.arange(len(radius)) % 65535
    return Spheres(
        centers=centers,
        radius=radius,
        kind=np.full(len(radius), BUBBLE, np.uint8),
        instance=instance.astype(np.uint16),
        color=np.tile(bubbles.color, (len(radius), 1)),
        arc_length=rafts.arc_length[rafts.owner],
    )


def place_chyme(
    organ: OrganSurface,
    wall: Wall,
    chyme: Chyme,
    up: Float[np.ndarray, " 3"],
    rng: np.random.Generator,
) -> Spheres:
    """Place particles that lie on the wall, in the organ frame; arguments as in `place_bubbles`."""
    clumps = _Seeds(organ, wall, chyme, chyme.clump_size, rng)
    if clumps.total == 0:
        return no_spheres()
    clumps.settle(-up, chyme.settled)
    radius = clumps.radii(chyme)
    stretch = _SLENDER ** rng.random(len(clumps.counts))
    positions = clumps.spread(radius, dimensions=3, touch=_BOUND, stretch=stretch)
    distance = wall.signed_distance(positions)
    lifted = _on_wall(organ, wall, positions, _LIFT_CHYME * radius)
    centers = np.where((distance < _LIFT_CHYME * radius)[:, None], lifted, positions)
    white = (rng.random(len(clumps.counts)) < chyme.white)[clumps.owner]
    shade = rng.uniform(0.75, 1.1, len(radius))[:, None]
    color = np.where(white[:, None], chyme.white_color, chyme.yellow_color)
    instance = FIRST_CLUMP + clumps.owner % (65536 - FIRST_CLUMP)
    return Spheres(
        centers=centers,
        radius=radius,
        kind=np.where(white, WHITE, YELLOW).astype(np.uint8),
        instance=instance.astype(np.uint16),
        color=np.clip(shade * color, 0.0, 1.0),
        arc_length=clumps.arc_length[clumps.owner],
    )


class _Seeds:
    """Clusters and their anchors on the wall."""

    def __init__(
        self,
        organ: OrganSurface,
        wall: Wall,
        kind: Bubbles | Chyme,
        mean_size: float,
        rng: np.random.Generator,
    ) -> None:
        self.organ, self.wall = organ, wall
        self.rng = rng
        edges, area = smooth_area(organ)
        expected = kind.per_area * float(area[-1])
        name = f"number of {'bubbles' if isinstance(kind, Bubbles) else 'particles'}"
        allowed = f"up to {_MOST:,}. Give a smaller per_area"
        require(expected <= _MOST, name, f"{expected:.3g}", allowed)
        total = int(rng.poisson(expected))
        self.counts = sizes(total, mean_size, rng)
        at = np.sort(rng.uniform(0.0, area[-1], len(self.counts)))
        self.arc_length = np.interp(at, area, edges)
        if kind.prevalence < 1.0:
            own, distances = int(rng.integers(2**31)), self.arc_length / _PATCH
            noise = [normal_along(one, own, "lumen/patches") for one in distances.tolist()]
            limit = NormalDist().inv_cdf(max(kind.prevalence, 1e-9))
            kept = np.array(noise) < limit
            self.counts, self.arc_length = self.counts[kept], self.arc_length[kept]
        self.total = int(self.counts.sum())
        self.owner = np.repeat(np.arange(len(self.counts)), self.counts)

    def settle(self, towards: Float[np.ndarray, " 3"], fraction: float, creases: int = 1) -> None:
        """Anchor a fraction of the clusters in direction `towards`, the others all around.

        Args:
            towards: Unit direction.
            fraction: Fraction of the clusters that gather there.
            creases: Positions tried for each cluster, within a fold's spacing along the gut; it
                takes the one farthest from the centerline, which lies between folds.
        """
        first = self.arc_length
        best: tuple[np.ndarray, ...] | None = None
        for _ in range(creases):
            if creases > 1:
                shifted = first + self.rng.uniform(-_FOLD, _FOLD, len(first))
                self.arc_length = np.clip(shifted, 0.0, self.organ.centerline.length)
            tried = self._cast(towards, fraction)
            if best is None:
                best = tried
                continue
            deeper = tried[0] > best[0]
            best = tuple(
                np.where(deeper.reshape(-1, *[1] * (new.ndim - 1)), new, old)
                for new, old in zip(tried, best, strict=True)
            )
        assert best is not None
        _, self.anchor, self.inward, self.lumen_radius, self.arc_length, self.tangent = best

    def _cast(self, towards: Float[np.ndarray, " 3"], fraction: float) -> tuple[np.ndarray, ...]:
        """Draw places on the wall.

        Returns:
            Distance from the centerline relative to the lumen's radius, places, inward directions,
            radii of the lumen, arc lengths, and directions along the gut.
        """
        from vrcaps.organ.surface import interpolate

        points, frames, lumen_radius = interpolate(self.organ.centerline, self.arc_length)
        count = len(points)
        direction = self.rng.standard_normal((count, 3))
        drawn = self.rng.random(count) < fraction
        direction = np.where(drawn[:, None], _SCATTER * direction + 2.0 * towards, direction)
        tangent = frames[..., 2]
        direction -= _along(direction, tangent)
        direction = unit(direction)
        distance, face = self.wall.cast(points, direction)
        distance = np.where(face >= 0, distance, 0.0)
        anchor = points + distance[:, None] * direction
        inward = _inward(self.organ, np.maximum(face, 0))
        inward = np.where((face >= 0)[:, None], inward, -direction)
        return (
            distance / np.maximum(lumen_radius, 1e-9),
            anchor,
            inward,
            lumen_radius,
            self.arc_length,
            tangent,
        )

    def radii(self, kind: Bubbles | Chyme) -> Float[np.ndarray, " n"]:
        """Radii [m] from the truncated log-normal law, at most half the distance to the wall."""
        lumen_radius = np.maximum(0.5 * self.lumen_radius[self.owner], kind.smallest)
        return np.minimum(cut_log_normal(kind, self.total, self.rng), lumen_radius)

    def spread(
        self,
        radius: Float[np.ndarray, " n"],
        *,
        dimensions: int,
        touch: float,
        stretch: Float[np.ndarray, " k"] | float = 1.0,
    ) -> Float[np.ndarray, "n 3"]:
        """Positions of all spheres around their anchors [m], slightly off the wall.

        The second axis of a cluster, along which it may be stretched, is around the gut, as folds
        are.
        """
        flat = pack(
            self.counts, radius, self.rng, dimensions=dimensions, touch=touch, stretch=stretch
        )
        first = self.tangent - _along(self.tangent, self.inward)
        least = np.eye(3)[np.argmin(np.abs(self.inward), axis=1)]
        is_end = np.linalg.norm(first, axis=1, keepdims=True) < 0.1
        first = np.where(is_end, np.cross(self.inward, least), first)
        first /= np.linalg.norm(first, axis=1, keepdims=True)
        axes = np.stack([first, np.cross(self.inward, first), self.inward], axis=-1)[self.owner]
        lift = np.minimum(radius, 0.5 * self.lumen_radius[self.owner])
        start = self.anchor[self.owner] + lift[:, None] * self.inward[self.owner]
        return start + np.einsum("nij,nj->ni", axes, flat)


def _along(
    vectors: Float[np.ndarray, "n 3"], directions: Float[np.ndarray, "n 3"]
) -> Float[np.ndarray, "n 3"]:
    """Components of vectors along unit directions."""
    return np.sum(vectors * directions, axis=1, keepdims=True) * directions


def _inward(organ: OrganSurface, face: np.ndarray) -> Float[np.ndarray, "n 3"]:
    normal = organ.normals[organ.faces[face]].mean(axis=1)
    return unit(normal)


def _on_wall(
    organ: OrganSurface, wall: Wall, positions: Float[np.ndarray, "n 3"], height: np.ndarray
) -> Float[np.ndarray, "n 3"]:
    """Points of the wall nearest to given positions, lifted into the lumen [m]."""
    nearest, face = wall.closest_point(positions)
    return nearest + height[:, None] * _inward(organ, face)


def place_dome_bubbles(
    organ: OrganSurface, bubbles: Bubbles, rng: np.random.Generator, *, before: int
) -> Spheres:
    """Create the bubbles for both ends of a capsule; when they burst, they reform on the wall.

    Args:
        organ: The wall at rest; the bubbles are in its frame.
        bubbles: Number and sizes.
        rng: Random generator.
        before: Number of preceding bubble instances.
    """
    count = 2 * bubbles.on_dome
    radius = np.minimum(cut_log_normal(bubbles, count, rng), _MAX_ON_DOME)
    vertex = rng.integers(0, len(organ.vertices), count)
    lift = lifts(bubbles, radius)[:, None] * organ.normals[vertex]
    return Spheres(
        centers=organ.vertices[vertex] + lift,
        radius=radius,
        kind=np.full(count, BUBBLE, np.uint8),
        instance=(1 + (before + np.arange(count)) % 65535).astype(np.uint16),
        color=np.tile(bubbles.color, (count, 1)),
        arc_length=organ.arc_length[vertex],
    )
