"""Repair report, machine- and human-readable."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np

from vrcaps.core.units import MM

if TYPE_CHECKING:
    from jaxtyping import Float

_MAX_POSITIONS = 4


@dataclass(frozen=True)
class Repair:
    """Repaired defects of one kind.

    Attributes:
        kind: Kind of defect, e.g. `hole`.
        count: Number of defects.
        action: Description of the repair.
        positions: Positions [m], in the mesh's frame; one row each, or empty for the whole mesh.
    """

    kind: str
    count: int
    action: str
    positions: Float[np.ndarray, "k 3"] = field(default_factory=lambda: np.zeros((0, 3)))

    def line(self) -> str:
        """One-line summary, with the first few positions."""
        text = f"{self.count} × {self.kind}: {self.action}"
        return text if len(self.positions) == 0 else f"{text}, {format_points(self.positions)}"


@dataclass(frozen=True)
class RepairReport:
    """All changes of a repair; empty for a clean mesh.

    Attributes:
        repairs: Repairs in the order of execution.
        open_ends: Center of each lumen end left open on request [m].
    """

    repairs: tuple[Repair, ...]
    open_ends: Float[np.ndarray, "k 3"] = field(default_factory=lambda: np.zeros((0, 3)))

    def count(self, kind: str) -> int:
        """Number of defects of a kind that were repaired."""
        return sum(repair.count for repair in self.repairs if repair.kind == kind)

    def lines(self) -> list[str]:
        """Return one line for each kind of repair, and one for the ends left open."""
        lines = [repair.line() for repair in self.repairs]
        if len(self.open_ends):
            left = Repair("open end", len(self.open_ends), "left open", self.open_ends)
            lines.append(left.line())
        return lines


def format_point(point: Float[np.ndarray, " 3"]) -> str:
    """Human-readable position [m]: ``(1.2, -3.4, 5.6) mm``."""
    x, y, z = np.asarray(point) / MM
    return f"({x:.1f}, {y:.1f}, {z:.1f}) mm"


def format_points(points: Float[np.ndarray, "k 3"]) -> str:
    """Human-readable list of the first few positions [m]: ``at (1.2, -3.4, 5.6) mm, …``."""
    positions = ", ".join(format_point(point) for point in points[:_MAX_POSITIONS])
    return f"at {positions}" + (", …" if len(points) > _MAX_POSITIONS else "")
