"""Tissue: all mechanical settings of an organ's wall."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

from vrcaps.tissue.drag import Drag
from vrcaps.tissue.fem.deformation import FemDeformation
from vrcaps.tissue.motility.motility import Motility
from vrcaps.tissue.spring_wall import SpringWall
from vrcaps.tissue.winkler_foundation import WinklerFoundation


@dataclass(frozen=True)
class Tissue:
    """How the wall of an organ behaves.

    Example:
        >>> world = vrcaps.World(model, vrcaps.Tissue(deformation=None))  # a rigid wall

    Attributes:
        foundation: Pressure against a capsule that presses in, as on a rigid base.
        drag: Resistance against a capsule that slides along.
        deformation: How the wall gives way, vertex by vertex or as an elastic layer; None holds it
            where it is.
        motility: How the muscle contracts; None leaves the lumen at rest.
    """

    foundation: WinklerFoundation = field(default_factory=WinklerFoundation)
    drag: Drag = field(default_factory=Drag)
    deformation: SpringWall | FemDeformation | None = field(default_factory=SpringWall)
    motility: Motility | None = None

    @property
    def foundation_in_series(self) -> WinklerFoundation:
        """The foundation under which contact takes place: stiffer where springs carry it."""
        deformation = self.deformation
        is_spring_wall = isinstance(deformation, SpringWall)
        return deformation.in_series(self.foundation) if is_spring_wall else self.foundation

    @property
    def longest_substep(self) -> float:
        """Longest stable substep of the deformation [s]; infinite for a wall without."""
        return math.inf if self.deformation is None else self.deformation.longest_step
