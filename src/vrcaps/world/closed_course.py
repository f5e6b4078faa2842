"""Course of the closed lumen of a slack gut: where it runs, how wide it is and how it is folded."""

from __future__ import annotations

from dataclasses import dataclass, fields, replace
from statistics import NormalDist
from typing import TYPE_CHECKING

import numpy as np

from vrcaps.core.geometry import fold_profile, smoothstep
from vrcaps.core.rng import stream
from vrcaps.core.units import MM
from vrcaps.organ.waves import sum_waves

if TYPE_CHECKING:
    from typing import Self

    from jaxtyping import Float, Int

    from vrcaps.organ.surface import OrganSurface


SOFT = 2.2 * MM
"""Radius below which folds that meet are compressed [m]."""
FOLD_SHARE, _FOLD_HEIGHT = 0.4, 2.6 * MM
"""Height of the folds relative to √(R² − r²), and its maximum [m]."""
_CREASE_DEPTH = 0.85
"""Depth of creases below the mean wall, relative to the height of the folds."""
_SWAY, _PITCHES = 8.0 * MM, (13 * MM, 18 * MM)
"""Amplitude and wavelengths / 2π of the course of the closed lumen about the centerline [m]."""
_BEND_LIMIT = 0.25
"""Maximum distance of that course from the centerline, relative to its radius of curvature."""
_TONE_PITCHES = (26 * MM, 41 * MM)
"""Wavelengths / 2π of the tone, which shortens the funnel and narrows the lumen [m]."""
_SLIT = 4.0 * MM
"""Half length of the slit in which the closed wall meets [m]."""
_TWIST = 20 * MM
"""Arc length in which the slit turns by half a radian [m]."""
_FOLD_WAVES = 32
"""Number of waves of each of the two parts of the field whose zeros are the creases."""
_FOLD_PITCHES, _MAX_LOBES = (1.4 * MM, 2.8 * MM), (2, 4)
"""Wavelengths / 2π of these waves along the gut [m], and maximum numbers of waves around it."""
_DEPTH_PITCHES, _DEPTH_LOBES = (3.0 * MM, 7.0 * MM), (0, 3)
"""The same of the waves of the field by which the depth of creases differs."""
_DEPTHS = (-0.8, 0.8)
"""Values of that field, in standard deviations, between which creases deepen from none to full."""
_HEIGHT_PITCHES, _HEIGHT_SPREAD = (19 * MM, 31 * MM), 0.7
"""Wavelengths / 2π of the height of folds along the gut [m], and the amplitude of its logarithm."""
_POCKET_PITCHES = (17 * MM, 27 * MM, 41 * MM)
"""Wavelengths / 2π of the field whose crests are pockets of gas, a few centimeters long [m]."""
_POCKET_EDGE = 0.9
"""Standard deviations of that field over which a pocket opens."""


@dataclass(frozen=True)
class PerVertex:
    """Arrays with a row per vertex."""

    def at(self, index: slice | Int[np.ndarray, " k"]) -> Self:
        """Return the rows of some vertices."""
        return replace(
            self, **{each.name: getattr(self, each.name)[index] for each in fields(self)}
        )


@dataclass(frozen=True)
class Course(PerVertex):
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


def closed_course(
    organ: OrganSurface,
    sections: tuple[Float[np.ndarray, "n 3"], Float[np.ndarray, "n 3 2"], Float[np.ndarray, " n"]],
    radius: float,
    pockets: float,
) -> Course:
    """Return the closed lumen at each vertex of an organ.

    Args:
        organ: Slack organ.
        sections: Center [m], axes and mean radius at rest [m] of the section of each vertex.
        radius: Median radius of the closed lumen between its folds [m].
        pockets: Fraction of the gut's length with pockets of gas or fluid, below 1.
    """
    (center, plane, mean), s = sections, organ.arc_length
    phases = _rng(organ, "course").uniform(0.0, 2.0 * np.pi, 2)
    sway = _SWAY * np.sin(s[:, None] / np.array(_PITCHES) + phases)
    tone = np.sin(s / _TONE_PITCHES[0])
    tone *= np.sin(s / _TONE_PITCHES[1] + 1.0)
    narrow = radius * np.exp(-0.9 * tone)
    slit = min(_SLIT, 2.0 * radius) * np.exp(-0.4 * tone)
    phases = _rng(organ, "fold-height").uniform(0.0, 2.0 * np.pi, 2)
    height = _HEIGHT_SPREAD * np.sin(s[:, None] / np.array(_HEIGHT_PITCHES) + phases).prod(axis=1)
    top = np.minimum(FOLD_SHARE * mean, _FOLD_HEIGHT * np.exp(height))
    # A quarter of the softness bounds what the smooth maximum adds to radii above 2 mm.
    reach = narrow + 0.5 * slit + _CREASE_DEPTH * top + 0.25 * SOFT
    fit = np.minimum(mean / reach, 1.0)
    # The closed lumen stays within the wall at rest, and its sections do not cross in bends.
    room = mean - fit * reach
    room = np.minimum(room, _BEND_LIMIT / np.maximum(_curvature(organ), 1e-6))
    sway *= (room / np.hypot(room, np.linalg.norm(sway, axis=1)))[:, None]
    turn = 0.5 * s / _TWIST + _rng(organ, "slit").uniform(0.0, np.pi)
    axes = np.stack([np.cos(turn), np.sin(turn)], axis=1)
    major = np.einsum("ijk,ik->ij", plane, axes)
    minor = np.einsum("ijk,ik->ij", plane, np.stack([-axes[:, 1], axes[:, 0]], axis=1))
    sway = np.einsum("ijk,ik->ij", plane, sway)
    sizes = tone, fit * narrow, fit * slit, fit * top
    relief, openness = _folds(organ), _openness(organ, pockets)
    return Course(s, center, major, minor, sway, *sizes, relief, openness)


def _folds(organ: OrganSurface) -> Float[np.ndarray, " n"]:
    """Relief of the buckled wall at each vertex: rounded folds between creases, mean 0.

    Creases end where their depth falls to zero.
    """
    rng = _rng(organ, "folds")
    parts = [_waves(rng, _FOLD_PITCHES, ends) for ends in ((0, _MAX_LOBES[0]), (2, _MAX_LOBES[1]))]
    field = sum_waves(np.concatenate(parts), organ.arc_length, organ.theta)
    waves = _waves(_rng(organ, "crease-depth"), _DEPTH_PITCHES, _DEPTH_LOBES)
    level = sum_waves(waves, organ.arc_length, organ.theta) * 2.0**0.5
    depth = smoothstep((level - _DEPTHS[0]) / (_DEPTHS[1] - _DEPTHS[0]))
    relief = 1.0 - depth * (1.0 - fold_profile(field))
    return relief - relief.mean()


def _waves(
    rng: np.random.Generator, pitches: tuple[float, float], lobes: tuple[int, int]
) -> Float[np.ndarray, "n 4"]:
    """Waves of half the variance of a field of unit standard deviation, see `sum_waves`."""
    lobe = rng.integers(lobes[0], lobes[1] + 1, _FOLD_WAVES) * rng.choice([-1, 1], _FOLD_WAVES)
    low, high = np.log(pitches)
    turns = np.exp(-rng.uniform(low, high, _FOLD_WAVES))
    phase = rng.uniform(0.0, 2.0 * np.pi, _FOLD_WAVES)
    return np.stack([np.full(_FOLD_WAVES, _FOLD_WAVES**-0.5), turns, lobe, phase], axis=1)


def _openness(organ: OrganSurface, pockets: float) -> Float[np.ndarray, " n"]:
    """Fraction of its opening at rest that each vertex keeps, 0 to 1."""
    s = organ.arc_length
    if pockets <= 0.0:
        return np.zeros(len(s))
    phases = _rng(organ, "pockets").uniform(0.0, 2.0 * np.pi, len(_POCKET_PITCHES))
    waves = np.sin(s[:, None] / np.array(_POCKET_PITCHES) + phases)
    level = waves.sum(axis=1) * (2.0 / len(_POCKET_PITCHES)) ** 0.5
    return smoothstep((level - NormalDist().inv_cdf(1.0 - pockets)) / _POCKET_EDGE)


def _rng(organ: OrganSurface, purpose: str) -> np.random.Generator:
    seed = organ.metadata.get("seed", 0)
    return stream(seed if isinstance(seed, int) else 0, f"closure/{purpose}")


def _curvature(organ: OrganSurface) -> Float[np.ndarray, " n"]:
    """Curvature of the centerline at each vertex [1/m]."""
    line = organ.centerline
    tangent = np.gradient(line.points, line.arc_length, axis=0)
    curvature = np.linalg.norm(np.gradient(tangent, line.arc_length, axis=0), axis=1)
    return np.interp(organ.arc_length, line.arc_length, curvature)
