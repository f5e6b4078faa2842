"""Route: the passable part of a patient's centerline, in the world frame."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from vrcaps.core.units import MM

if TYPE_CHECKING:
    from jaxtyping import Bool, Float

    from vrcaps.env.parts import EnvView
    from vrcaps.env.patients import Patient
    from vrcaps.world.model import Model

_SPACING = 2.0 * MM
_PROBES = 8
"""Number of points of a straight path at which its clearance is tested."""


@dataclass(frozen=True)
class Route:
    """Passable part of an organ's centerline.

    Attributes:
        model: The organ and the capsule.
        ends: Arc lengths of the first and the last position at which the capsule fits [m].
    """

    model: Model
    ends: tuple[float, float]

    def poses(self, arc_length: Float[np.ndarray, " n"]) -> Float[np.ndarray, "n 4 4"]:
        """Poses that look towards the anal end, at arc lengths [m] clamped to the ends."""
        return self.model.centerline_poses(np.clip(arc_length, *self.ends))

    def fits(self, points: Float[np.ndarray, "n 3"]) -> Bool[np.ndarray, " n"]:
        """Return whether a sphere of the capsule's radius fits at points in the world frame."""
        return np.asarray(self.model.wall.signed_distance(points)) > self.model.device.radius

    def is_free(
        self, points: Float[np.ndarray, "n 3"], headings: Float[np.ndarray, "n 3"]
    ) -> Bool[np.ndarray, " n"]:
        """Return whether the whole capsule fits at points with the given headings."""
        device = self.model.device
        half = (0.5 * device.length - device.radius) * headings
        ends = np.concatenate([points + half, points - half])
        return np.all(self.fits(ends).reshape(2, -1), axis=0)

    def is_clear(
        self, start: Float[np.ndarray, " 3"], points: Float[np.ndarray, "n 3"]
    ) -> Bool[np.ndarray, " n"]:
        """Return whether that sphere can move straight from a start to each of the points."""
        part = np.linspace(1.0, 0.0, _PROBES, endpoint=False)[:, None, None]
        way = start + part * (points - start)
        return np.all(self.fits(way.reshape(-1, 3)).reshape(_PROBES, -1), axis=0)


def make_route(model: Model) -> Route:
    """Create the route through an organ."""
    whole = Route(model, (0.0, model.organ.centerline.length))
    arc_length = np.linspace(*whole.ends, max(2, round(whole.ends[1] / _SPACING)))
    fitting = np.flatnonzero(whole.fits(whole.poses(arc_length)[:, :3, 3]))
    if len(fitting) == 0:
        return whole
    return Route(model, (float(arc_length[fitting[0]]), float(arc_length[fitting[-1]])))


class Routes:
    """Routes of an environment's patients, created on first use."""

    def __init__(self) -> None:
        self._made: dict[int, tuple[Patient, Route]] = {}

    def of(self, view: EnvView, index: int) -> Route:
        """Return the route of the patient of one world."""
        patient = view.patient(index)
        if id(patient) not in self._made:
            self._made[id(patient)] = (patient, make_route(patient.model))
        return self._made[id(patient)][1]
