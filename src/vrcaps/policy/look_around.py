"""Look-around policy: follow the centerline while the front rotates on a cone about the path."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from vrcaps.core.units import MM
from vrcaps.policy.centerline import CenterlinePolicy

if TYPE_CHECKING:
    from jaxtyping import Float

_TILT = math.radians(70.0)
"""Angle between the front and the direction of travel."""

_TURN = 4.0
"""Period of a rotation about the direction of travel [s]."""


class LookAroundPolicy(CenterlinePolicy):
    """Follow the centerline at lower speed, with views that spiral along the wall."""

    speed = 15.0 * MM
    ahead = 8.0 * MM

    def heading(
        self, R_world_line: Float[np.ndarray, "3 3"], sign: int, time: float
    ) -> Float[np.ndarray, " 3"]:
        """Viewing direction, rotating on the cone; see `CenterlinePolicy.heading`."""
        phase = 2.0 * math.pi * time / _TURN
        around = np.array([math.cos(phase), math.sin(phase), 0.0]) * math.sin(_TILT)
        return R_world_line @ (around + np.array([0.0, 0.0, sign * math.cos(_TILT)]))
