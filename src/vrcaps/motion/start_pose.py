"""Start pose of a simulated capsule: the first position on the centerline where it fits."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from vrcaps.core.errors import InputError
from vrcaps.core.units import MM
from vrcaps.world.clearance import capsule_clearance, fit_text
from vrcaps.world.model import Model

if TYPE_CHECKING:
    from jaxtyping import Float

_SPACING = 2.0 * MM
"""Distance between the positions that are tried."""

_CLEARANCE = 0.5
"""Minimum distance of the capsule's axis from the wall, as a fraction of its radius."""


def start_pose(
    model: Model, start: float, angle: float
) -> tuple[Float[np.ndarray, "4 4"], float, tuple[str, ...]]:
    """Pose where the capsule fits, its arc length [m], and notes on changes.

    Args:
        model: The lumen and the capsule.
        start: Desired position as a fraction of the centerline; moved towards the far end.
        angle: Angle about the x axis of the centerline's frame [rad].

    Raises:
        InputError: If it does not fit anywhere.
    """
    line = model.organ.centerline
    wanted = start * line.length
    # Towards the far end: a capsule that does not fit at one end fits further in.
    end = line.length if start <= 0.5 else 0.0
    places = np.linspace(wanted, end, max(2, math.ceil(abs(end - wanted) / _SPACING) + 1))
    poses = model.centerline_poses(places, angle=angle)
    clearance = capsule_clearance(model, poses).min(axis=1)
    fitting = np.flatnonzero(clearance > _CLEARANCE * model.device.radius)
    if len(fitting) == 0:
        raise InputError(
            f"{model.device.name} in {model.organ.name}: the capsule fits nowhere from start "
            f"{start:g} on: {fit_text(model)} Start elsewhere, inflate the gut, or take a smaller "
            "capsule."
        )
    place = float(places[fitting[0]])
    moved = abs(place - wanted)
    note = f"Set the capsule {moved / MM:.1f} mm further along, where it fits."
    return poses[fitting[0]], place, (note,) if moved > 0.0 else ()
