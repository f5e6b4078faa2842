"""Bubbles and particles as arrays of spheres."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from jaxtyping import Float, UInt8, UInt16

BUBBLE, YELLOW, WHITE = 0, 1, 2
"""Kinds of spheres."""

FIRST_CLUMP = 1000
"""Instance of the first clump of chyme; lesions have smaller numbers."""


@dataclass(frozen=True)
class Spheres:
    """Everything round that floats in a lumen.

    Attributes:
        centers: [m], in the frame that the owner says.
        radius: [m].
        kind: `BUBBLE`, `YELLOW` or `WHITE` chyme.
        instance: Bubbles count from 1, clumps of chyme from `FIRST_CLUMP`; beyond 65535 numbers
            come again.
        color: Linear base color of chyme, of what a bubble's surroundings reflect.
        arc_length: Gut coordinate of the center [m].
    """

    centers: Float[np.ndarray, "n 3"]
    radius: Float[np.ndarray, " n"]
    kind: UInt8[np.ndarray, " n"]
    instance: UInt16[np.ndarray, " n"]
    color: Float[np.ndarray, "n 3"]
    arc_length: Float[np.ndarray, " n"]

    def __len__(self) -> int:
        return len(self.radius)

    @property
    def has_chyme(self) -> bool:
        """Whether any of them is opaque."""
        return any(self.kind.tobytes())  # a bubble's kind is 0

    def at(self, centers: Float[np.ndarray, "n 3"]) -> Spheres:
        """The same spheres in other places."""
        rest = self.kind, self.instance, self.color, self.arc_length
        return Spheres(centers, self.radius, *rest)


def no_spheres() -> Spheres:
    """None."""
    none = np.zeros(0)
    rows = np.zeros((0, 3))
    return Spheres(rows, none, none.astype(np.uint8), none.astype(np.uint16), rows, none)


def joined(*parts: Spheres) -> Spheres:
    """Several sets as one."""
    names = ("centers", "radius", "kind", "instance", "color", "arc_length")
    return Spheres(*(np.concatenate([getattr(part, name) for part in parts]) for name in names))
