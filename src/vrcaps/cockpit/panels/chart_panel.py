"""Chart panel: strip charts of speed, forces, angle to the field, coverage and exposure."""

from __future__ import annotations

import time as wall_clock
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from vrcaps.core.units import DEG, MM

if TYPE_CHECKING:
    from vrcaps.cockpit.page import Page
    from vrcaps.cockpit.view import View

_SHOWN = 60.0
"""Simulated time [s] on the charts."""
_SPACING = 0.1
"""Simulated time [s] between points."""
_SECONDS_PER_UPDATE = 0.5
_HEIGHT = 120


@dataclass(frozen=True)
class Quantity:
    """Quantity shown in a chart.

    Attributes:
        title: Title with unit.
        color: Color of the line.
        of: Returns its value for a view.
    """

    title: str
    color: str
    of: Callable[[Page, View], float]


def _coupling(view: View) -> float:
    coupling = view.state.coupling
    return np.nan if coupling is None else float(1e3 * np.linalg.norm(coupling.force_world))


def _angle(view: View) -> float:
    coupling = view.state.coupling
    return np.nan if coupling is None else coupling.angle / DEG


def _contact(view: View) -> float:
    contact = view.state.contact
    return np.nan if contact is None else 1e3 * contact.normal_force_total


QUANTITIES = (
    Quantity(
        "speed [mm/s]",
        "#4dabf7",
        lambda page, view: float(np.linalg.norm(view.state.linear_velocity_world)) / MM,
    ),
    Quantity("contact force [mN]", "#ff922b", lambda page, view: _contact(view)),
    Quantity("magnetic force [mN]", "#e64980", lambda page, view: _coupling(view)),
    Quantity("angle to the field [°]", "#cc5de8", lambda page, view: _angle(view)),
    Quantity("coverage [%]", "#51cf66", lambda page, view: 100.0 * page.seen.fraction),
    Quantity("exposure [1]", "#fcc419", lambda page, view: page.images.exposure),
)
"""Charts from top to bottom."""


class ChartPanel:
    """Charts of the last minute of measured quantities."""

    def __init__(self, page: Page) -> None:
        from viser import uplot

        self._page, self._shown = page, 0.0
        self._rows: deque[tuple[float, ...]] = deque(maxlen=round(_SHOWN / _SPACING))
        nothing = np.zeros(1)
        with page.side_panel.add_tab("Charts"):
            self._charts = [
                page.server.gui.add_uplot(
                    (nothing, nothing),
                    (
                        uplot.Series(label="s"),
                        uplot.Series(label=each.title, stroke=each.color, width=1.5),
                    ),
                    title=each.title,
                    height=_HEIGHT,
                    scales={"x": uplot.Scale(time=False)},
                    legend=uplot.Legend(show=False),
                )
                for each in QUANTITIES
            ]

    def update(self, view: View) -> None:
        """Add a point if enough time has passed; draw twice a second."""
        time = view.state.time
        if time < 0.0:  # the capsule is settling on the wall
            return
        if self._rows and time < self._rows[-1][0]:
            kept = [row for row in self._rows if row[0] < time]
            self._rows.clear()
            self._rows.extend(kept)
        if not self._rows or time - self._rows[-1][0] >= _SPACING:
            self._rows.append((time, *(each.of(self._page, view) for each in QUANTITIES)))
        now = wall_clock.monotonic()
        if now - self._shown < _SECONDS_PER_UPDATE:
            return
        self._shown = now
        times, *values = np.array(self._rows, float).T
        for chart, column in zip(self._charts, values, strict=True):
            chart.data = (times, column)
