"""Quantities of a drive that the page shows as numbers and charts."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from vrcaps.core.units import DEG, MM

if TYPE_CHECKING:
    from vrcaps.cockpit.session.camera_images import CameraImages
    from vrcaps.cockpit.session.clock import View
    from vrcaps.cockpit.session.seen_wall import SeenWall

SPAN = 60.0
"""Simulated time [s] on the charts."""
_SPACING = 0.1
"""Simulated time [s] between points."""


@dataclass(frozen=True)
class Quantity:
    """Quantity of a drive.

    Attributes:
        name: Name in the page.
        unit: Unit; empty for a ratio.
        min_span: Minimum span of its chart, so that noise does not fill it.
        digits: Digits after the point.
        of: Returns its value; NaN where there is none.
    """

    name: str
    unit: str
    min_span: float
    digits: int
    of: Callable[[View, SeenWall, CameraImages], float]

    def plain(self) -> dict[str, Any]:
        """Description for the page."""
        return {
            "name": self.name,
            "unit": self.unit,
            "minSpan": self.min_span,
            "digits": self.digits,
        }


def _coupling(view: View) -> float:
    coupling = view.state.coupling
    return np.nan if coupling is None else float(1e3 * np.linalg.norm(coupling.force_world))


def _angle(view: View) -> float:
    coupling = view.state.coupling
    return np.nan if coupling is None else coupling.angle / DEG


def _contact(view: View) -> float:
    contact = view.state.contact
    return np.nan if contact is None else 1e3 * contact.normal_force_total


def _speed(view: View) -> float:
    return float(np.linalg.norm(view.state.linear_velocity_world)) / MM


QUANTITIES = (
    Quantity("Contact force", "mN", 20.0, 1, lambda view, seen, images: _contact(view)),
    Quantity("Speed", "mm/s", 5.0, 1, lambda view, seen, images: _speed(view)),
    Quantity("Magnetic force", "mN", 50.0, 1, lambda view, seen, images: _coupling(view)),
    Quantity("Angle to the field", "°", 10.0, 1, lambda view, seen, images: _angle(view)),
    Quantity("Coverage", "%", 5.0, 1, lambda view, seen, images: 100.0 * seen.fraction),
    Quantity("Exposure", "× nominal", 0.5, 2, lambda view, seen, images: images.exposure),
)
"""Quantities of a drive; the page shows the first two at first."""


class Readings:
    """Values of the quantities in the last minute.

    Attributes:
        latest: Last values.
    """

    def __init__(self, seen: SeenWall, images: CameraImages) -> None:
        self._seen, self._images = seen, images
        self.latest: tuple[float, ...] = (np.nan,) * len(QUANTITIES)
        self._rows: deque[tuple[float, ...]] = deque(maxlen=round(SPAN / _SPACING))

    def update(self, view: View) -> None:
        """Take the values of a view; after a rewind, drop later ones."""
        time = view.state.time
        if time < 0.0:  # the capsule is settling on the wall
            return
        self.latest = tuple(each.of(view, self._seen, self._images) for each in QUANTITIES)
        if self._rows and time < self._rows[-1][0]:
            kept = [row for row in self._rows if row[0] < time]
            self._rows.clear()
            self._rows.extend(kept)
        if not self._rows or time - self._rows[-1][0] >= _SPACING:
            self._rows.append((time, *self.latest))

    def history(self) -> list[list[float]]:
        """Rows of time [s] and values."""
        return [[round(float(value), 4) for value in row] for row in list(self._rows)]
