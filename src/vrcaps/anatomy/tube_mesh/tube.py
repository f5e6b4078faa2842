"""Tubes: rotation-minimizing frames along a course, and packing by position-based dynamics.

A packed tube grows and buckles without contact. A chain of nodes (Müller et al. 2007) is
constrained by spacing, minimum bend radius, clearance to itself and to obstacles, tethers and a
box.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np
import scipy

from vrcaps.core.units import MM

if TYPE_CHECKING:
    from jaxtyping import Bool, Float, Int


@dataclass(frozen=True)
class Course:
    """Course of a tubular organ.

    Attributes:
        points: Samples from the oral to the anal end [m], patient frame, evenly spaced.
        arc_length: Arc length of each sample [m].
    """

    points: Float[np.ndarray, "n 3"]
    arc_length: Float[np.ndarray, " n"]


@dataclass(frozen=True)
class Tube:
    """Smooth curve with transverse axes.

    Attributes:
        curve: Function from arc length [m] to position [m], patient frame.
        arc_length: Samples of the frames [m].
        frames: Rotation at each sample; columns are two transverse axes and the tangent.
        bend: Curvature vector at each sample, averaged over about 2 cm [1/m].
    """

    curve: scipy.interpolate.CubicSpline
    arc_length: Float[np.ndarray, " n"]
    frames: Float[np.ndarray, "n 3 3"]
    bend: Float[np.ndarray, "n 3"]

    def points(
        self,
        arc_length: Float[np.ndarray, " n"],
        theta: Float[np.ndarray, " n"],
        radius: Float[np.ndarray, " n"],
    ) -> Float[np.ndarray, "n 3"]:
        """Convert tube coordinates to positions [m].

        Args:
            arc_length: Arc length along the course [m].
            theta: Angle around it [rad].
            radius: Distance from it [m].
        """
        return self.curve(arc_length) + radius[:, None] * self._outward(arc_length, theta)

    def curvature_towards(
        self, arc_length: Float[np.ndarray, " n"], theta: Float[np.ndarray, " n"]
    ) -> Float[np.ndarray, " n"]:
        """Curvature [1/m] averaged over about 2 cm, positive where it bends towards the angle θ."""
        bend = [np.interp(arc_length, self.arc_length, self.bend[:, k]) for k in range(3)]
        return np.einsum("ji,ij->i", np.array(bend), self._outward(arc_length, theta))

    def angle_of(self, arc_length: float, direction: Float[np.ndarray, " 3"]) -> float:
        """Angle θ [rad] whose transverse direction is nearest to a direction."""
        frame = self.frames[np.argmin(np.abs(self.arc_length - arc_length))]
        return float(np.arctan2(direction @ frame[:, 1], direction @ frame[:, 0]))

    def _outward(self, arc_length: np.ndarray, theta: np.ndarray) -> np.ndarray:
        """Unit transverse direction at the angle θ."""
        tangent = self.curve(arc_length, 1)
        tangent /= np.linalg.norm(tangent, axis=1, keepdims=True)
        first = np.stack(
            [np.interp(arc_length, self.arc_length, self.frames[:, k, 0]) for k in range(3)], axis=1
        )
        first -= np.einsum("ij,ij->i", first, tangent)[:, None] * tangent
        first /= np.linalg.norm(first, axis=1, keepdims=True)
        second = np.cross(tangent, first)
        return np.cos(theta)[:, None] * first + np.sin(theta)[:, None] * second


def make_tube(course: Course) -> Tube:
    """Frames along a course by the double reflection method (Wang et al. 2008)."""
    curve = scipy.interpolate.CubicSpline(course.arc_length, course.points)
    points, tangents = course.points, curve(course.arc_length, 1)
    tangents /= np.linalg.norm(tangents, axis=1, keepdims=True)
    axes = np.empty_like(points)
    # Angle 0 starts posteriorly, where the ascending colon is fixed.
    axes[0] = np.cross(tangents[0], np.cross([0.0, 1.0, 0.0], tangents[0]))
    axes[0] /= np.linalg.norm(axes[0])
    for i in range(len(points) - 1):
        step = points[i + 1] - points[i]
        axis = axes[i] - 2.0 * (step @ axes[i]) / (step @ step) * step
        tangent = tangents[i] - 2.0 * (step @ tangents[i]) / (step @ step) * step
        mirror = tangents[i + 1] - tangent
        square = mirror @ mirror
        axes[i + 1] = axis - 2.0 * (mirror @ axis) / square * mirror if square > 0.0 else axis
    frames = np.stack([axes, np.cross(tangents, axes), tangents], axis=-1)
    spacing = course.arc_length[1]
    bend = scipy.ndimage.gaussian_filter1d(
        curve(course.arc_length, 2), 7 * MM / spacing, axis=0, mode="nearest"
    )
    return Tube(curve, course.arc_length, frames, bend)


@dataclass(frozen=True)
class Unbending:
    """Relaxation of tight bends, see `unbend`.

    Attributes:
        reaches: Half lengths of the chords over which bends are measured [nodes].
        strength: Fraction of the excess that one step removes.
        creep: Minimum fraction of the sagitta that counts as excess.
    """

    reaches: tuple[int, ...]
    strength: float
    creep: float


_NUM_NEAREST = 10
_MARGIN = 4 * MM
_BEND = 1.55
"""Minimum radius of curvature relative to the radius of the tube."""
_UNBENDING = Unbending((1, 2, 3), strength=0.4, creep=0.01)
"""Minimum bend radius in radii of the tube."""


@dataclass(frozen=True)
class ObstacleSpheres:
    """Spheres that cover the space of other organs.

    Attributes:
        center: Center of each sphere [m].
        radius: Radius of each sphere [m].
    """

    center: Float[np.ndarray, "k 3"]
    radius: Float[np.ndarray, " k"]

    @cached_property
    def tree(self) -> scipy.spatial.KDTree:
        """Tree for queries of nearest centers."""
        return scipy.spatial.KDTree(self.center)

    def __add__(self, other: ObstacleSpheres) -> ObstacleSpheres:
        """Union of both sets."""
        return ObstacleSpheres(
            np.concatenate([self.center, other.center]), np.concatenate([self.radius, other.radius])
        )


@dataclass(frozen=True)
class TubeChain:
    """Constraints on the course of a tube, per node.

    Attributes:
        radius: Outer radius of the tube [m].
        anchor: Position towards which each node is pulled [m].
        hold: Strength of the pull, 0 to 1 per step.
        reach: Maximum distance of each node from its anchor [m].
        is_fixed: Nodes that stay on their anchors and may touch obstacles.
        low: Minimum coordinates of the box [m].
        high: Maximum coordinates of the box [m].
        gap: Clearance between walls [m].
    """

    radius: Float[np.ndarray, " n"]
    anchor: Float[np.ndarray, "n 3"]
    hold: Float[np.ndarray, " n"]
    reach: Float[np.ndarray, " n"]
    is_fixed: Bool[np.ndarray, " n"]
    low: Float[np.ndarray, " 3"]
    high: Float[np.ndarray, " 3"]
    gap: float


def relax_chain(
    chain: TubeChain,
    nodes: Float[np.ndarray, "n 3"],
    spacing: float,
    obstacles: ObstacleSpheres,
    *,
    num_steps: int,
    spread: float = 1.0,
) -> Float[np.ndarray, "n 3"]:
    """Grow a chain to a spacing while it keeps clear of itself and of obstacles.

    Args:
        chain: Constraints on the course.
        nodes: Initial positions [m].
        spacing: Final distance between neighboring nodes [m].
        obstacles: Obstacles to keep clear of.
        num_steps: Number of steps; growth takes the first 40 % of them.
        spread: Girth of the growing tube relative to its final girth. Above 1 the tube starts thin,
            so that it passes through itself and untangles, and then reserves space early.
    """
    nodes = nodes.copy()
    start = np.linalg.norm(np.diff(nodes, axis=0), axis=1)
    free = ~chain.is_fixed
    hold = chain.hold[:, None]
    girth = [1.0 if spread == 1.0 else 0.5, spread, spread, 1.0]
    for i in range(num_steps):
        growth = min(1.0, i / (0.4 * num_steps))
        lengths = start + growth * (spacing - start)
        nodes[free] += ((1.0 - 0.97 * growth) * hold * (chain.anchor - nodes))[free]
        fraction = float(np.interp(i / num_steps, [0.0, 0.3, 0.5, 0.7], girth))
        near = _neighbors(nodes, chain, spacing, obstacles)
        for _ in range(2):
            nodes[free] += _push_apart(nodes, chain, obstacles, near, fraction)[free]
            nodes[free] = _within_reach(nodes, chain)[free]
            bend = np.maximum(_BEND * chain.radius, 1.7 * lengths.mean())
            move = unbend(nodes, bend, lengths.mean(), _UNBENDING) + restore_spacing(nodes, lengths)
            nodes[free] += move[free]
            nodes[free] += restore_spacing(nodes, lengths)[free]
    return nodes


def min_clearance(
    course: Course, radius: Float[np.ndarray, " n"], obstacles: ObstacleSpheres, ignored: float
) -> float:
    """Minimum distance [m] of a tube to itself and to obstacles.

    Args:
        course: Course of the tube.
        radius: Outer radius at each sample [m].
        obstacles: Obstacles to keep clear of.
        ignored: Length at each end that may touch obstacles [m].
    """
    step = max(1, round(4 * MM / course.arc_length[1]))
    points, s, radius = course.points[::step], course.arc_length[::step], radius[::step]
    tree = scipy.spatial.KDTree(points)
    i, j = tree.query_pairs(2.0 * radius.max(), output_type="ndarray").T
    apart = np.abs(s[i] - s[j]) > 0.65 * np.pi * (radius[i] + radius[j])
    i, j = i[apart], j[apart]
    clearance = [np.linalg.norm(points[i] - points[j], axis=1) - radius[i] - radius[j]]
    inner = (s > ignored) & (s < s[-1] - ignored)
    offset = np.linalg.norm(points[inner, None] - obstacles.center, axis=2)
    clearance.append((offset - obstacles.radius - radius[inner, None]).ravel())
    return float(np.concatenate([*clearance, [0.1]]).min())


def sharpest_bend(course: Course, radius: Float[np.ndarray, " n"]) -> float:
    """Maximum ratio of the radius of the tube to the radius of its bend."""
    velocity = np.gradient(course.points, course.arc_length, axis=0)
    curvature = np.linalg.norm(np.gradient(velocity, course.arc_length, axis=0), axis=1)
    return float((curvature * radius)[3:-3].max())


def smooth_course(nodes: Float[np.ndarray, "n 3"], *, step: float = 1 * MM) -> Course:
    """Smooth curve through a chain, evenly sampled about every `step` [m], with the same ends."""
    nodes = nodes.copy()
    for _ in range(2):
        nodes[2:-2] += 0.25 * (nodes[1:-3] - 2.0 * nodes[2:-2] + nodes[3:-1])
    chord = np.append(0.0, np.cumsum(np.linalg.norm(np.diff(nodes, axis=0), axis=1)))
    num = round(chord[-1] / step) + 1
    for sigma in (0.0, 6 * MM, 0.0):
        nodes = scipy.interpolate.CubicSpline(chord, nodes)(np.linspace(0.0, chord[-1], num))
        nodes = _blurred(nodes, sigma / step)
        chord = np.append(0.0, np.cumsum(np.linalg.norm(np.diff(nodes, axis=0), axis=1)))
    return Course(nodes, np.linspace(0.0, float(chord[-1]), num))


def _blurred(points: Float[np.ndarray, "n 3"], sigma: float) -> Float[np.ndarray, "n 3"]:
    """Blur points along a curve that is extended straight; its ends are kept."""
    if sigma == 0.0:
        return points
    num = round(4.0 * sigma)
    before = 2.0 * points[0] - points[num:0:-1]
    after = 2.0 * points[-1] - points[-2 : -num - 2 : -1]
    return scipy.ndimage.gaussian_filter1d(np.concatenate([before, points, after]), sigma, axis=0)[
        num:-num
    ]


def _neighbors(
    nodes: np.ndarray, chain: TubeChain, spacing: float, obstacles: ObstacleSpheres
) -> tuple[Int[np.ndarray, " p"], Int[np.ndarray, " p"], Int[np.ndarray, "n k"]]:
    """Pairs of nodes that may come into contact, and the nearest obstacles of each node."""
    radius = chain.radius
    reach = 2.0 * radius.max() + chain.gap + _MARGIN
    i, j = scipy.spatial.KDTree(nodes).query_pairs(reach, output_type="ndarray").T
    apart = (j - i) * spacing > 0.65 * np.pi * (radius[i] + radius[j])
    num = min(_NUM_NEAREST, len(obstacles.radius))
    nearest = np.zeros((len(nodes), 0), int)
    if num:
        nearest = obstacles.tree.query(nodes, num)[1].reshape(len(nodes), num)
    return i[apart], j[apart], nearest


def _push_apart(
    nodes: np.ndarray,
    chain: TubeChain,
    obstacles: ObstacleSpheres,
    near: tuple[np.ndarray, np.ndarray, np.ndarray],
    fraction: float,
) -> Float[np.ndarray, "n 3"]:
    """Displacement away from other parts of the tube and from obstacles [m].

    `fraction` scales the clearance of the tube to itself.
    """
    radius, gap = chain.radius, chain.gap
    i, j, nearest = near
    offset = nodes[i] - nodes[j]
    distance = np.sqrt(np.einsum("ij,ij->i", offset, offset)) + 1e-9
    depth = fraction * (radius[i] + radius[j] + gap) - distance
    touch = depth > 0.0
    i, j, step = i[touch], j[touch], (depth / distance)[touch, None] * offset[touch]
    push, num = np.empty_like(nodes), len(nodes)
    for k in range(3):
        push[:, k] = np.bincount(i, 0.5 * step[:, k], num) - np.bincount(j, 0.5 * step[:, k], num)
    offset = nodes[:, None] - obstacles.center[nearest]
    distance = np.sqrt(np.einsum("ijk,ijk->ij", offset, offset)) + 1e-9
    depth = np.maximum(radius[:, None] + obstacles.radius[nearest] + gap - distance, 0.0)
    push += np.einsum("ij,ijk->ik", depth / distance, offset)
    count = np.bincount(i, minlength=num) + np.bincount(j, minlength=num)
    count += (depth > 0.0).sum(axis=1)
    return 1.3 * push / np.maximum(count, 1)[:, None] ** 0.7


def _within_reach(nodes: np.ndarray, chain: TubeChain) -> Float[np.ndarray, "n 3"]:
    """Nodes moved back into the box and to within reach of their anchors [m]."""
    nodes = nodes + 0.12 * (np.clip(nodes, chain.low, chain.high) - nodes)
    offset = nodes - chain.anchor
    distance = np.linalg.norm(offset, axis=1) + 1e-12
    fraction = np.minimum(chain.reach / distance, 1.0)
    return chain.anchor + offset * (1.0 - 0.4 * (1.0 - fraction))[:, None]


def unbend(
    nodes: Float[np.ndarray, "n 3"],
    bend_radius: Float[np.ndarray, " n"],
    spacing: float,
    unbending: Unbending,
) -> Float[np.ndarray, "n 3"]:
    """Displacement that opens bends tighter than the tube permits [m].

    Args:
        nodes: Chain of nodes [m].
        bend_radius: Minimum radius of curvature at each node [m].
        spacing: Mean distance of neighbors [m].
        unbending: Parameters of the relaxation.
    """
    move = np.zeros_like(nodes)
    for reach in unbending.reaches:
        middle = nodes[reach:-reach]
        sagitta = 0.5 * (nodes[: -2 * reach] + nodes[2 * reach :]) - middle
        depth = np.linalg.norm(sagitta, axis=1) + 1e-12
        # A circle of radius R has the sagitta d²/2R over chords of length about d.
        limit = (reach * spacing) ** 2 / (2.0 * bend_radius[reach:-reach])
        excess = np.clip(depth - limit, unbending.creep * depth, None) / depth
        pull = unbending.strength * sagitta * excess[:, None]
        move[reach:-reach] += pull
        move[: -2 * reach] -= 0.5 * pull
        move[2 * reach :] -= 0.5 * pull
    return 0.5 * move


def restore_spacing(
    nodes: Float[np.ndarray, "n 3"], lengths: float | Float[np.ndarray, " n-1"]
) -> Float[np.ndarray, "n 3"]:
    """Displacement that restores the distances of neighbors [m].

    Args:
        nodes: Chain of nodes [m].
        lengths: Distance of each two neighbors, or of all [m].
    """
    edges = np.diff(nodes, axis=0)
    pull = 0.5 * edges * (1.0 - lengths / (np.linalg.norm(edges, axis=1) + 1e-12))[:, None]
    move = np.zeros_like(nodes)
    move[:-1] += pull
    move[1:] -= pull
    return 0.7 * move
