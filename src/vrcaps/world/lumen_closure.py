"""Closure of a slack lumen around the capsule.

The fasting small bowel has no gas: its walls touch, and the lumen is open only where the capsule
holds it open. Opening it takes almost no pressure, so that the mechanics use the organ as it lies
around the capsule, and the closure is a displacement of the wall in images, labels and flow.
"""

from __future__ import annotations

from dataclasses import dataclass, fields, replace
from functools import cached_property
from statistics import NormalDist
from typing import TYPE_CHECKING

import numpy as np

from vrcaps.core.errors import require
from vrcaps.core.geometry import fold_profile, smoothstep, transform_points
from vrcaps.core.rng import stream
from vrcaps.core.units import MM
from vrcaps.mesh.untangle import HarmonicPatch, relaxed, untangle
from vrcaps.organ.surface import POCKETS, interpolate
from vrcaps.organ.waves import sum_waves
from vrcaps.world.model import Model

if TYPE_CHECKING:
    from typing import Self

    from jaxtyping import Float, Int

_LEAST = 0.4 * MM
"""Minimum radius of a closed lumen [m]: the film of fluid between folds in contact."""
_SOFT = 2.2 * MM
"""Radius below which folds that meet are compressed [m]."""
_REACH = 45 * MM
"""Distance from the capsule, along the gut, within which the lumen is closed [m]."""
_FADE = 25 * MM
"""Distance over which it opens beyond; a closed lumen hides that part."""
_RECENTER = 9 * MM
"""Distance over which the lumen returns from the capsule's axis to its own course [m]."""
_SWAY, _PITCHES = 8.0 * MM, (13 * MM, 18 * MM)
"""Amplitude and wavelengths / 2π of the course of the closed lumen about the centerline [m]."""
_BEND_LIMIT = 0.25
"""Maximum distance of that course from the centerline, relative to its radius of curvature."""
_TONE_PITCHES = (26 * MM, 41 * MM)
"""Wavelengths / 2π of the tone, which shortens the funnel and narrows the lumen [m]."""
_SLIT, _BEND = 4.0 * MM, 0.2
"""Half length of the slit in which the closed wall meets [m], and its relative sagitta."""
_TWIST = 20 * MM
"""Arc length in which the slit turns by half a radian [m]."""
_FOLD_WAVES = 32
"""Number of waves of each of the two parts of the field whose zeros are the creases."""
_FOLD_PITCHES, _MAX_LOBES = (1.4 * MM, 2.8 * MM), (2, 4)
"""Wavelengths / 2π of these waves along the gut [m], and maximum numbers of waves around it."""
_SMOOTHED = 0.7
"""Fraction by which the relief at rest is reduced in a closed section."""
_FOLD_SHARE, _FOLD_HEIGHT = 0.4, 2.6 * MM
"""Height of the folds relative to √(R² − r²), and its maximum [m]."""
_CREASE_DEPTH = 0.6
"""Depth of creases below the mean wall, relative to the height of the folds."""
_POCKET_PITCHES = (17 * MM, 27 * MM, 41 * MM)
"""Wavelengths / 2π of the field whose crests are pockets of gas, a few centimeters long [m]."""
_POCKET_EDGE = 0.9
"""Standard deviations of that field over which a pocket opens."""
_FUNNEL = 13 * MM
"""Mean distance over which the lumen closes beyond the cylinder of the capsule [m]."""
_ONSET = 7 * MM
"""Distance beyond the cylinder of the capsule, which stretches the wall, at which it is folded."""
_PLAY = 1.12
"""Mean radius of the lumen around the capsule, between folds, relative to the capsule's."""
_SECTION = 4 * MM
"""Length over which the radius is averaged [m]."""
_NUM_SAMPLES = 17


@dataclass(frozen=True)
class _PerVertex:
    """Arrays with a row per vertex."""

    def at(self, index: slice | Int[np.ndarray, " k"]) -> Self:
        """Return the rows of some vertices."""
        return replace(
            self, **{each.name: getattr(self, each.name)[index] for each in fields(self)}
        )


@dataclass(frozen=True)
class _Course(_PerVertex):
    """The closed lumen at each vertex, which does not depend on the capsule.

    Attributes:
        s: Arc length [m].
        center: Center of the section, on the centerline [m].
        major: Axis of the slit.
        minor: Axis of the section perpendicular to it.
        sway: Offset of the closed lumen from the center [m].
        tone: Tone of the muscle.
        radius: Mean radius of the closed section [m].
        slit: Half length of the slit [m].
        top: Maximum height of folds [m].
        folds: Relief of the buckled wall: rounded folds between creases, mean 0.
        openness: Fraction of its opening at rest that the lumen keeps.
    """

    s: Float[np.ndarray, " n"]
    center: Float[np.ndarray, "n 3"]
    major: Float[np.ndarray, "n 3"]
    minor: Float[np.ndarray, "n 3"]
    sway: Float[np.ndarray, "n 3"]
    tone: Float[np.ndarray, " n"]
    radius: Float[np.ndarray, " n"]
    slit: Float[np.ndarray, " n"]
    top: Float[np.ndarray, " n"]
    folds: Float[np.ndarray, " n"]
    openness: Float[np.ndarray, " n"]


@dataclass(frozen=True)
class _OpenWall(_PerVertex):
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
    are relaxed (`vrcaps.mesh.untangle`).

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
        return moved, relaxed(closed, self._patches, weight, first=near.start)

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
    def _sorted(self) -> tuple[Int[np.ndarray, " n"], _Course, _OpenWall]:
        """Vertices in order of arc length; the closed lumen and the wall at rest in that order."""
        organ = self.model.organ
        order = np.argsort(organ.arc_length, kind="stable")
        at, frames, _ = interpolate(organ.centerline, organ.arc_length)
        center = transform_points(self.model.T_world_patient, at)
        plane = (self.model.T_world_patient[:3, :3] @ frames)[:, :, :2]
        wall = _open_wall(self.model.vertices_world, organ.arc_length, center)
        return order, self._course(center, plane, wall.mean).at(order), wall.at(order)

    def _folds(self) -> Float[np.ndarray, " n"]:
        """Relief of the buckled wall at each vertex: rounded folds between creases, mean 0."""
        rng, waves = self._rng("folds"), []
        low, high = np.log(_FOLD_PITCHES)
        for lobes, least in zip(_MAX_LOBES, (0, 2), strict=True):
            lobe = rng.integers(least, lobes + 1, _FOLD_WAVES) * rng.choice([-1, 1], _FOLD_WAVES)
            turns = np.exp(-rng.uniform(low, high, _FOLD_WAVES))
            phase = rng.uniform(0.0, 2.0 * np.pi, _FOLD_WAVES)
            amplitude = np.full(_FOLD_WAVES, _FOLD_WAVES**-0.5)
            waves.append(np.stack([amplitude, turns, lobe, phase], axis=1))
        organ = self.model.organ
        field = sum_waves(np.concatenate(waves), organ.arc_length, organ.theta)
        relief = fold_profile(field)
        return relief - relief.mean()

    def _openness(self) -> Float[np.ndarray, " n"]:
        """Fraction of its opening at rest that each vertex keeps, 0 to 1."""
        s = self.model.organ.arc_length
        if self.pockets <= 0.0:
            return np.zeros(len(s))
        phases = self._rng("pockets").uniform(0.0, 2.0 * np.pi, len(_POCKET_PITCHES))
        waves = np.sin(s[:, None] / np.array(_POCKET_PITCHES) + phases)
        level = waves.sum(axis=1) * (2.0 / len(_POCKET_PITCHES)) ** 0.5
        return smoothstep((level - NormalDist().inv_cdf(1.0 - self.pockets)) / _POCKET_EDGE)

    def _rng(self, purpose: str) -> np.random.Generator:
        seed = self.model.organ.metadata.get("seed", 0)
        return stream(seed if isinstance(seed, int) else 0, f"closure/{purpose}")

    def _curvature(self) -> Float[np.ndarray, " n"]:
        """Curvature of the centerline at each vertex [1/m]."""
        line = self.model.organ.centerline
        tangent = np.gradient(line.points, line.arc_length, axis=0)
        curvature = np.linalg.norm(np.gradient(tangent, line.arc_length, axis=0), axis=1)
        return np.interp(self.model.organ.arc_length, line.arc_length, curvature)

    def _course(
        self,
        center: Float[np.ndarray, "n 3"],
        plane: Float[np.ndarray, "n 3 2"],
        mean: Float[np.ndarray, " n"],
    ) -> _Course:
        """The closed lumen of sections with centers, planes and mean radii at rest [m]."""
        s = self.model.organ.arc_length
        phases = self._rng("course").uniform(0.0, 2.0 * np.pi, 2)
        sway = _SWAY * np.sin(s[:, None] / np.array(_PITCHES) + phases)
        tone = np.sin(s / _TONE_PITCHES[0])
        tone *= np.sin(s / _TONE_PITCHES[1] + 1.0)
        narrow = self.radius * np.exp(-0.9 * tone)
        slit = min(_SLIT, 2.0 * self.radius) * np.exp(-0.4 * tone)
        top = np.minimum(_FOLD_SHARE * mean, _FOLD_HEIGHT)
        # A quarter of the softness bounds what the smooth maximum adds to radii above 2 mm.
        reach = narrow + 0.5 * slit + _CREASE_DEPTH * top + 0.25 * _SOFT
        fit = np.minimum(mean / reach, 1.0)
        # The closed lumen stays within the wall at rest, and its sections do not cross in bends.
        room = mean - fit * reach
        room = np.minimum(room, _BEND_LIMIT / np.maximum(self._curvature(), 1e-6))
        sway *= (room / np.hypot(room, np.linalg.norm(sway, axis=1)))[:, None]
        turn = 0.5 * s / _TWIST + self._rng("slit").uniform(0.0, np.pi)
        axes = np.stack([np.cos(turn), np.sin(turn)], axis=1)
        major = np.einsum("ijk,ik->ij", plane, axes)
        minor = np.einsum("ijk,ik->ij", plane, np.stack([-axes[:, 1], axes[:, 0]], axis=1))
        sway = np.einsum("ijk,ik->ij", plane, sway)
        sizes = tone, fit * narrow, fit * slit, fit * top
        return _Course(s, center, major, minor, sway, *sizes, self._folds(), self._openness())


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


def _closed(at: _Course, wall: _OpenWall, to: _Contraction) -> Float[np.ndarray, "n 3"]:
    """Positions of vertices after a contraction [m]."""
    far = smoothstep(to.away / (_FUNNEL * np.exp(-0.8 * at.tone)))
    wanted = (1.0 - far) * _PLAY * to.shell_radius + far * at.radius
    slit = far * np.minimum(at.slit, wall.mean)  # less where muscle has contracted the section
    offset = to.offset + slit[:, None] * along_slit(at, wall.outward)
    height = np.sqrt(np.maximum(wall.mean**2 - wanted**2, 0.0)) * _FOLD_SHARE
    height = np.minimum(height, at.top) * smoothstep(to.away / _ONSET)
    relief = (1.0 - _SMOOTHED * far) * (wall.radius - wall.mean)
    free = np.minimum(wall.mean, wanted) + relief - height * at.folds - 0.5 * slit - _LEAST
    closed = _LEAST + 0.5 * (free + np.hypot(free, _SOFT))
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


def along_slit(at: _Course, outward: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "n 3"]:
    """Displacement of each vertex to the slit, relative to the slit's half length.

    A point at the angle φ from the slit's axis moves by (cos φ, b (cos² φ − ½)): a circle becomes a
    bent ellipse, and the center becomes a segment, in which the wall meets.
    """
    cosine = np.einsum("ij,ij->i", outward, at.major)[:, None]
    return cosine * at.major + _BEND * (cosine**2 - 0.5) * at.minor
