"""Upper tract: stomach and small bowel as one tube, from the fundus to the ileocaecal valve."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
import scipy

from vrcaps.anatomy.full_tract.patient import (
    GAP,
    ColonPlacement,
    make_neighboring_organs,
    place_stomach,
    pylorus_sample,
)
from vrcaps.anatomy.small_bowel import lay_small_bowel, wanted_edge, with_local_bend
from vrcaps.anatomy.small_bowel.shape import SmallBowelWall, small_bowel_radius
from vrcaps.anatomy.stomach.shape import (
    StomachWall,
    draw_stomach_wall,
    stomach_radius,
    stomach_wall_rng,
)
from vrcaps.anatomy.tube_mesh.swept_surface import SweptSurface, dome
from vrcaps.anatomy.tube_mesh.tube import Course, Tube, make_tube
from vrcaps.core.geometry import smoothstep
from vrcaps.core.units import MM

if TYPE_CHECKING:
    from jaxtyping import Float

    from vrcaps.anatomy.small_bowel.parameters import SmallBowelParameters
    from vrcaps.anatomy.stomach.parameters import StomachParameters

_BLEND = 3 * MM
VALVE_ALONG, VALVE_ACROSS = 5.4 * MM, 9.0 * MM
"""Half axes of the open ileocaecal valve (two lips) along and around the colon [m]."""
_TAPER = 24 * MM
CAP = 3 * MM
"""Length of the closed end that is cut off at the valve [m]."""


@dataclass(frozen=True)
class UpperTract:
    """Stomach and small bowel on one course.

    Attributes:
        stomach: Wall of the stomach.
        bowel: Wall of the small bowel.
        tube: Course of both.
        pylorus: Arc length of the pyloric ring on the course [m].
        valve_angle: Angle in the tube's frame, at its end, of the colon's onward direction [rad].
    """

    stomach: StomachWall
    bowel: SmallBowelWall
    tube: Tube
    pylorus: float
    valve_angle: float

    @property
    def end(self) -> float:
        """Arc length at which the small bowel enters the colon [m]."""
        return float(self.tube.arc_length[-1])

    def surface(self) -> SweptSurface:
        """Wall of both, closed at the top of the fundus and at the valve."""
        return SweptSurface(self.tube, self.end, self._envelope, self._radius, self._edge)

    def _envelope(self, s: Float[np.ndarray, " n"]) -> Float[np.ndarray, " n"]:
        above = smoothstep((self.pylorus - s) / (2.0 * _BLEND) + 0.5)
        plain = above * self.stomach.envelope(np.minimum(s, self.pylorus + _BLEND))
        plain = plain + (1.0 - above) * self.bowel.envelope(s - self.pylorus)
        narrow = self._narrowing(s)
        mean = (VALVE_ALONG * VALVE_ACROSS) ** 0.5
        return self._closed(s) * (plain + narrow * (mean - plain))

    def _radius(
        self, s: Float[np.ndarray, " n"], theta: Float[np.ndarray, " n"]
    ) -> Float[np.ndarray, " n"]:
        radius = np.empty_like(s)
        above = smoothstep((self.pylorus - s) / (2.0 * _BLEND) + 0.5)
        upper, lower = above > 0.0, above < 1.0
        bowel = small_bowel_radius(
            self.bowel, self.tube, s[lower] - self.pylorus, theta[lower], self.pylorus
        )
        radius[lower] = (1.0 - above[lower]) * bowel
        radius[~lower] = 0.0
        radius[upper] += above[upper] * stomach_radius(self.stomach, s[upper], theta[upper])
        narrow = self._narrowing(s)
        around = theta - self.valve_angle
        lips = (
            VALVE_ALONG
            * VALVE_ACROSS
            / np.hypot(VALVE_ACROSS * np.cos(around), VALVE_ALONG * np.sin(around))
        )
        return self._closed(s) * (radius + narrow * (lips - radius))

    def _narrowing(self, s: np.ndarray) -> np.ndarray:
        """Blending weight of the valve's shape: 0 up to the last part of the ileum, then to 1."""
        return smoothstep((s - (self.end - CAP - _TAPER)) / (_TAPER - 4 * MM))

    def _closed(self, s: np.ndarray) -> np.ndarray:
        return dome(self.end - s, CAP)

    def _edge(self, s: Float[np.ndarray, " n"]) -> Float[np.ndarray, " n"]:
        below = wanted_edge(self.bowel, np.maximum(s - self.pylorus, 0.0))
        fraction = smoothstep((self.pylorus - s) / (6 * MM) + 0.5)
        return below + fraction * (self.stomach.parameters.edge - below)


def lay_upper_tract(
    stomach: StomachParameters,
    bowel: SmallBowelParameters,
    colon: ColonPlacement,
    *,
    seed: int,
    rng: np.random.Generator,
    gap: float = GAP,
) -> UpperTract:
    """Lay a patient's stomach and small bowel next to the colon.

    Args:
        stomach: The patient's stomach.
        bowel: The patient's small bowel.
        colon: Placement of the colon.
        seed: Seed of the stomach, as in `generate_stomach`.
        rng: Random generator of the small bowel, as in `generate_small_bowel`.
        gap: Clearance between stomach and colon [m].

    Raises:
        InputError: If the organs do not fit.
    """
    axis = place_stomach(stomach, colon, seed, gap=gap)
    around = make_neighboring_organs(colon, stomach, axis)
    bowel_wall, bowel_tube = lay_small_bowel(bowel, around, rng)
    upper = axis.points[: pylorus_sample(stomach, axis)]
    points = np.concatenate([upper, bowel_tube.curve(bowel_tube.arc_length)])
    chord = np.append(0.0, np.cumsum(np.linalg.norm(np.diff(points, axis=0), axis=1)))
    even = np.linspace(0.0, chord[-1], round(chord[-1] / MM) + 1)
    plain = make_tube(Course(scipy.interpolate.CubicSpline(chord, points)(even), even))
    tube = with_local_bend(plain, float(chord[len(upper)]))
    return UpperTract(
        stomach=draw_stomach_wall(stomach, tube, stomach_wall_rng(seed)),
        bowel=bowel_wall,
        tube=tube,
        pylorus=float(chord[len(upper)]),
        valve_angle=tube.angle_of(float(even[-1]), colon.along),
    )
