"""What a repair did, for programs and for people."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np

from vrcaps.units import MM

if TYPE_CHECKING:
    from jaxtyping import Float

_MAX_PLACES = 4


@dataclass(frozen=True)
class Repair:
    """One kind of defect that was repaired.

    Attributes:
        kind: Name of the defect, e.g. `hole`.
        count: How many there were.
        action: What was done, in words.
        places: Where [m], in the mesh's frame; one row each, or empty where it was everywhere.
    """

    kind: str
    count: int
    action: str
    places: Float[np.ndarray, "k 3"] = field(default_factory=lambda: np.zeros((0, 3)))

    def line(self) -> str:
        """The repair in one line, with the first few places."""
        text = f"{self.count} × {self.kind}: {self.action}"
        return text if len(self.places) == 0 else f"{text}, {format_points(self.places)}"


@dataclass(frozen=True)
class RepairReport:
    """Everything a repair changed; empty for a clean mesh.

    Attributes:
        repairs: In the order they were made.
        open_ends: Middle of each lumen end left open on request [m].
    """

    repairs: tuple[Repair, ...]
    open_ends: Float[np.ndarray, "k 3"] = field(default_factory=lambda: np.zeros((0, 3)))

    def count(self, kind: str) -> int:
        """Number of defects of a kind that were repaired."""
        return sum(repair.count for repair in self.repairs if repair.kind == kind)

    def lines(self) -> list[str]:
        """One line for each kind of repair, and one for the ends left open."""
        lines = [repair.line() for repair in self.repairs]
        if len(self.open_ends):
            left = Repair("open end", len(self.open_ends), "left open", self.open_ends)
            lines.append(left.line())
        return lines


def format_point(point: Float[np.ndarray, " 3"]) -> str:
    """A position [m] for people: ``(1.2, -3.4, 5.6) mm``."""
    x, y, z = np.asarray(point) / MM
    return f"({x:.1f}, {y:.1f}, {z:.1f}) mm"


def format_points(points: Float[np.ndarray, "k 3"]) -> str:
    """The first few positions [m] for people: ``at (1.2, -3.4, 5.6) mm, …``."""
    places = ", ".join(format_point(point) for point in points[:_MAX_PLACES])
    return f"at {places}" + (", …" if len(points) > _MAX_PLACES else "")
