"""Samples along the gut at which muscle and gas scale the lumen."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from vrcaps.core.units import MM
from vrcaps.organ.centerline.curve import polyline_points
from vrcaps.organ.surface import Centerline, OrganSurface

if TYPE_CHECKING:
    from jaxtyping import Float

_SPACING = 1.0 * MM


def arc_length_samples(centerline: Centerline) -> Float[np.ndarray, " k"]:
    """Arc lengths [m] of the samples: evenly spaced from end to end, about 1 mm apart."""
    return np.linspace(0.0, centerline.length, max(2, math.ceil(centerline.length / _SPACING) + 1))


def sample_coordinates(
    organ: OrganSurface,
) -> tuple[Float[np.ndarray, "n 3"], Float[np.ndarray, " n"]]:
    """Offset of each vertex to the centerline [m], and its position in samples [spacings]."""
    curve = organ.centerline
    nearest = polyline_points(curve, organ.arc_length)
    place = organ.arc_length / arc_length_samples(curve)[1]
    return nearest - organ.vertices, np.ascontiguousarray(place, float)
