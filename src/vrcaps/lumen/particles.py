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
"""Instance ID of the first clump of chyme; lesions have smaller IDs."""


@dataclass(frozen=True)
class Spheres:
    """All bubbles and particles in a lumen.

    Attributes:
        centers: Centers [m], in the frame of the owner.
        radius: Radii [m].
        kind: `BUBBLE`, `YELLOW` or `WHITE` chyme.
        instance: Instance IDs: bubbles from 1, clumps of chyme from `FIRST_CLUMP`; IDs wrap beyond
            65535.
        color: Linear base color of chyme, or reflected color of a bubble's surroundings.
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
        """Check that any sphere is opaque."""
        return any(self.kind.tobytes())  # a bubble's kind is 0

    def at(self, centers: Float[np.ndarray, "n 3"]) -> Spheres:
        """The same spheres at other centers."""
        rest = self.kind, self.instance, self.color, self.arc_length
        return Spheres(centers, self.radius, *rest)


def no_spheres() -> Spheres:
    """Return an empty set."""
    none = np.zeros(0)
    rows = np.zeros((0, 3))
    return Spheres(rows, none, none.astype(np.uint8), none.astype(np.uint16), rows, none)


def joined(*parts: Spheres) -> Spheres:
    """Concatenate several sets."""
    names = ("centers", "radius", "kind", "instance", "color", "arc_length")
    return Spheres(*(np.concatenate([getattr(part, name) for part in parts]) for name in names))
