"""Look around: along the centerline while the front turns on a cone about the way."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from vrcaps.policy.centerline import CenterlinePolicy
from vrcaps.units import MM

if TYPE_CHECKING:
    from jaxtyping import Float

_TILT = math.radians(70.0)
"""Between the front and the way."""

_TURN = 4.0
"""Time of a turn about the way [s]."""


class LookAroundPolicy(CenterlinePolicy):
    """The centerline's way, slower, with a spiral of looks at the wall around."""

    speed = 15.0 * MM
    ahead = 8.0 * MM

    def heading(
        self, R_world_line: Float[np.ndarray, "3 3"], sign: int, time: float
    ) -> Float[np.ndarray, " 3"]:
        """Where to look: on the cone, a turn every few seconds; see `CenterlinePolicy.heading`."""
        phase = 2.0 * math.pi * time / _TURN
        around = np.array([math.cos(phase), math.sin(phase), 0.0]) * math.sin(_TILT)
        return R_world_line @ (around + np.array([0.0, 0.0, sign * math.cos(_TILT)]))
