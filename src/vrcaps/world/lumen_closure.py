"""Closure of a slack lumen around the capsule.

The fasting small bowel has no gas: its walls touch, and the lumen is open only where the capsule
holds it open. Opening it takes almost no pressure, so that the mechanics use the organ as it lies
around the capsule, and the closure is a displacement of the wall in images, labels and flow.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np

from vrcaps.core.errors import require
from vrcaps.core.geometry import smoothstep, transform_points
from vrcaps.core.units import MM
from vrcaps.mesh.untangle import HarmonicPatch, relax, untangle
from vrcaps.organ.surface import POCKETS, interpolate
from vrcaps.world.closed_course import FOLD_SHARE, SOFT, Course, PerVertex, closed_course
from vrcaps.world.model import Model

if TYPE_CHECKING:
    from jaxtyping import Float, Int

_LEAST = 0.4 * MM
"""Minimum radius of a closed lumen [m]: the film of fluid between folds in contact."""
_BEND = 0.2
"""Sagitta of the slit relative to its half length."""
_REACH = 45 * MM
"""Distance from the capsule, along the gut, within which the lumen is closed [m]."""
_FADE = 25 * MM
"""Distance over which it opens beyond; a closed lumen hides that part."""
_RECENTER = 9 * MM
"""Distance over which the lumen returns from the capsule's axis to its own course [m]."""
_SMOOTHED = 0.7
"""Fraction by which the relief at rest is reduced in a closed section."""
_FUNNEL = 13 * MM
"""Mean distance over which the lumen closes beyond the cylinder of the capsule [m]."""
_ONSET = 7 * MM
"""Distance beyond the cylinder of the capsule, which stretches the wall, at which it is folded."""
_BESIDE = 20 * MM
"""Distance from the capsule, along the gut, within which intersections depend on its pose [m]."""
_PLAY = 1.12
"""Mean radius of the lumen around the capsule, between folds, relative to the capsule's."""
_SECTION = 4 * MM
"""Length over which the radius is averaged [m]."""
_NUM_SAMPLES = 17


@dataclass(frozen=True)
class _OpenWall(PerVertex):
    """A wall before it closes, in polar coordinates about the centers of its sections.

    Attributes:
        outward: Direction from the center.
        radius: Distance from the center [m].
        mean: Mean radius of the section [m].
    """

    outward: Float[np.ndarray, "n 3"]
    radius: Float[np.ndarray, " n"]
    mean: Float[np.ndarray, " n"]


@dataclass(frozen=True)
class _Contraction:
    """Place and degree of the contraction at each vertex.

    Attributes:
        weight: Fraction of the displacement that applies.
        offset: Offset of the lumen from the centers of the sections at rest [m].
        away: Distance along the gut from the cylinder of the capsule [m].
        shell_radius: Radius of the capsule [m].
    """

    weight: Float[np.ndarray, " n"]
    offset: Float[np.ndarray, "n 3"]
    away: Float[np.ndarray, " n"]
    shell_radius: float


@dataclass(frozen=True)
class LumenClosure:
    """Displacement that closes the lumen before and behind the capsule.

    Every cross-section contracts: towards the axis of the capsule where it lies, and towards a slit
    on a course close to the centerline elsewhere. A point at a distance r from the centerline moves
    to the smooth maximum of r − d and a minimum radius, which increases with r; d is the difference
    between the section's mean radius and the desired one: that of the capsule around it, about
    `radius` beyond a funnel before and behind it, both by the local tone. Folds therefore keep
    their height until they meet and stay in order, and sections do not cross. Points then move
    along the slit, by a one-to-one map: (r, φ) to ((r + L) cos φ, r sin φ), for a slit of
    half length L, and a slight bend.

    The circular muscle shortens the wall, and the mucosa, which does not, buckles into folds. Their
    height is proportional to √(R² − r²) for a section that closes from a radius R to r, as for
    sinusoidal pleats that preserve the perimeter, r² + n² A² / 2 = R². They replace most of the
    relief at rest, which would become radial pleats. In pockets of gas or fluid the wall stays at
    rest, in part or in full. Lengths, shares and sizes are estimates from capsule frames.

    Where a fold is too steep for the triangles of the wall, a few of them intersect; their vertices
    are relaxed (`vrcaps.mesh.untangle`): first in all of the closed wall, then around the capsule
    for each pose.

    Attributes:
        model: Model whose wall is displaced.
        radius: Median radius of the closed lumen between its folds [m].
        pockets: Fraction of the gut's length with pockets of gas or fluid, below 1.
    """

    model: Model
    radius: float
    pockets: float = 0.0

    def close(
        self,
        T_world_capsule: Float[np.ndarray, "4 4"],
        half_length: float,
        shell_radius: float,
        vertices_world: Float[np.ndarray, "n 3"] | None = None,
    ) -> tuple[Int[np.ndarray, " k"], Float[np.ndarray, "k 3"]]:
        """Displaced vertices around a capsule.

        Args:
            T_world_capsule: Pose of the capsule.
            half_length: Half length of the capsule [m].
            shell_radius: Radius of the capsule [m].
            vertices_world: Vertices of the wall before it closes [m]; None is the wall at rest.

        Returns:
            Indices of the moved vertices and their positions in the world frame [m].
        """
        s_axis, offset_axis = self._axis(T_world_capsule, half_length)
        order, course, wall = self._sorted
        span = _REACH + _FADE
        near = slice(*np.searchsorted(course.s, [s_axis[0] - span, s_axis[-1] + span]))
        moved, at = order[near], course.at(near)
        if vertices_world is None:
            wall = wall.at(near)
        else:
            wall = _open_wall(vertices_world[moved], at.s, at.center)
        beyond = np.maximum(np.maximum(s_axis[0] - at.s, at.s - s_axis[-1]), 0.0)
        weight = smoothstep((span - beyond) / _FADE) * (1.0 - at.openness)
        own = np.exp(-((beyond / _RECENTER) ** 2))
        offset = own[:, None] * _linear(at.s, s_axis, offset_axis)
        offset += (1.0 - own)[:, None] * at.sway
        cylinder = 1.0 - shell_radius / half_length
        low, high = np.interp([-cylinder, cylinder], np.linspace(-1, 1, _NUM_SAMPLES), s_axis)
        away = np.maximum(np.maximum(low - at.s, at.s - high), 0.0)
        closed = _closed(at, wall, _Contraction(weight, offset, away, shell_radius))
        relax(closed, self._patches, weight, first=near.start)
        return moved, closed

    def patches_near(
        self,
        vertices_world: Float[np.ndarray, "n 3"],
        T_world_capsule: Float[np.ndarray, "4 4"],
        half_length: float,
    ) -> tuple[HarmonicPatch, ...]:
        """Parts of the wall to relax, next to a capsule and where the lumen opens beyond it.

        Folds intersect there depending on the pose.

        Args:
            vertices_world: Vertices of the wall around the capsule [m].
            T_world_capsule: Pose of the capsule.
            half_length: Half length of the capsule [m].
        """
        s_axis, _ = self._axis(T_world_capsule, half_length)
        faces, s = self._faces_by_arc_length
        reach = np.array([_BESIDE, _REACH, _REACH + _FADE])
        before, beyond = np.searchsorted(s, [s_axis[0] - reach, s_axis[-1] + reach])
        ranges = (before[2], before[1]), (before[0], beyond[0]), (beyond[1], beyond[2])
        return untangle(vertices_world, np.concatenate([faces[i:j] for i, j in ranges]))

    @cached_property
    def _faces_by_arc_length(self) -> tuple[Int[np.ndarray, "m 3"], Float[np.ndarray, " m"]]:
        """Triangles in order of the arc length of their first vertices, and these lengths [m]."""
        faces, s = self.model.organ.faces, self.model.organ.arc_length
        order = np.argsort(s[faces[:, 0]], kind="stable")
        return faces[order], s[faces[order, 0]]

    @cached_property
    def _patches(self) -> tuple[HarmonicPatch, ...]:
        """Parts of the closed wall to relax, as folds there are too steep for its triangles.

        Indices are in the order of arc length.
        """
        order, at, wall = self._sorted
        away = np.full(len(order), np.inf)
        contraction = _Contraction(1.0 - at.openness, at.sway, away, self.model.device.radius)
        rank = np.empty_like(order)
        rank[order] = np.arange(len(order))
        return untangle(_closed(at, wall, contraction), rank[self.model.organ.faces])

    def _axis(
        self, T_world_capsule: Float[np.ndarray, "4 4"], half_length: float
    ) -> tuple[Float[np.ndarray, " k"], Float[np.ndarray, "k 3"]]:
        """Arc length of points of the body's axis, increasing, and their offset from the course."""
        along = np.linspace(-half_length, half_length, _NUM_SAMPLES)
        points = T_world_capsule[:3, 3] + along[:, None] * T_world_capsule[:3, 2]
        line, course = self.model.organ.centerline, self._centerline_world
        middle = np.linalg.norm(course - T_world_capsule[:3, 3], axis=1).argmin()
        near = np.abs(line.arc_length - line.arc_length[middle]) < 3.0 * half_length
        index = np.linalg.norm(points[:, None] - course[near], axis=2).argmin(axis=1)
        s, nearest = line.arc_length[near][index], course[near][index]
        tangent = (self.model.T_world_patient[:3, :3] @ line.frames[near][index])[:, :, 2]
        offset = points - nearest
        ahead = np.einsum("ij,ij->i", offset, tangent)
        offset -= ahead[:, None] * tangent
        order = np.argsort(s + ahead, kind="stable")
        return np.maximum.accumulate((s + ahead)[order]), offset[order]

    @cached_property
    def _centerline_world(self) -> Float[np.ndarray, "m 3"]:
        """Points of the centerline [m]."""
        return transform_points(self.model.T_world_patient, self.model.organ.centerline.points)

    @cached_property
    def _sorted(self) -> tuple[Int[np.ndarray, " n"], Course, _OpenWall]:
        """Vertices in order of arc length; the closed lumen and the wall at rest in that order."""
        organ = self.model.organ
        order = np.argsort(organ.arc_length, kind="stable")
        at, frames, _ = interpolate(organ.centerline, organ.arc_length)
        center = transform_points(self.model.T_world_patient, at)
        plane = (self.model.T_world_patient[:3, :3] @ frames)[:, :, :2]
        wall = _open_wall(self.model.vertices_world, organ.arc_length, center)
        course = closed_course(
            self.model.organ, (center, plane, wall.mean), self.radius, self.pockets
        )
        return order, course.at(order), wall.at(order)


def closure_of(model: Model) -> LumenClosure | None:
    """Closure that the metadata of a model's organ request; None leaves the lumen open.

    Raises:
        InputError: If the metadata are invalid.
    """
    radius = model.closed_radius
    pockets = model.organ.metadata.get(POCKETS, 0.0)
    is_valid = isinstance(pockets, int | float) and 0.0 <= pockets < 1.0
    require(is_valid, f"{POCKETS} in the metadata of {model.organ.name}", pockets, "0 to below 1")
    return LumenClosure(model, radius, float(pockets)) if radius > 0.0 else None


def _closed(at: Course, wall: _OpenWall, to: _Contraction) -> Float[np.ndarray, "n 3"]:
    """Positions of vertices after a contraction [m]."""
    far = smoothstep(to.away / (_FUNNEL * np.exp(-0.8 * at.tone)))
    wanted = (1.0 - far) * _PLAY * to.shell_radius + far * at.radius
    slit = far * np.minimum(at.slit, wall.mean)  # less where muscle has contracted the section
    offset = to.offset + slit[:, None] * along_slit(at, wall.outward)
    height = np.sqrt(np.maximum(wall.mean**2 - wanted**2, 0.0)) * FOLD_SHARE
    height = np.minimum(height, at.top) * smoothstep(to.away / _ONSET)
    relief = (1.0 - _SMOOTHED * far) * (wall.radius - wall.mean)
    free = np.minimum(wall.mean, wanted) + relief - height * at.folds - 0.5 * slit - _LEAST
    closed = _LEAST + 0.5 * (free + np.hypot(free, SOFT))
    closed = wall.radius + to.weight * (np.minimum(closed, wall.radius) - wall.radius)
    return at.center + to.weight[:, None] * offset + closed[:, None] * wall.outward


def _linear(
    s: Float[np.ndarray, " k"], knots: Float[np.ndarray, " m"], values: Float[np.ndarray, "m 3"]
) -> Float[np.ndarray, "k 3"]:
    return np.stack([np.interp(s, knots, column) for column in values.T], axis=1)


def _open_wall(
    vertices: Float[np.ndarray, "n 3"], s: Float[np.ndarray, " n"], center: Float[np.ndarray, "n 3"]
) -> _OpenWall:
    """Polar coordinates of vertices [m] with arc lengths and centers of their sections [m]."""
    offset = vertices - center
    radius = np.linalg.norm(offset, axis=1)
    outward = offset / np.maximum(radius, 1e-9)[:, None]
    filled, part = np.unique(np.floor(s / _SECTION), return_inverse=True)
    means = np.bincount(part, radius) / np.bincount(part)
    return _OpenWall(outward, radius, np.interp(s, _SECTION * (filled + 0.5), means))


def along_slit(at: Course, outward: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "n 3"]:
    """Displacement of each vertex to the slit, relative to the slit's half length.

    A point at the angle φ from the slit's axis moves by (cos φ, b (cos² φ − ½)): a circle becomes a
    bent ellipse, and the center becomes a segment, in which the wall meets.
    """
    cosine = np.einsum("ij,ij->i", outward, at.major)[:, None]
    return cosine * at.major + _BEND * (cosine**2 - 0.5) * at.minor
