"""Mechanical settings of an organ's wall."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

from vrcaps.tissue.contact_laws import Drag, SpringWall, WinklerFoundation
from vrcaps.tissue.fem.deformation import FemDeformation
from vrcaps.tissue.motility.motility import Motility


@dataclass(frozen=True)
class Tissue:
    """Mechanical behavior of an organ's wall.

    Example:
        >>> world = vrcaps.World(model, vrcaps.Tissue(deformation=None))  # a rigid wall

    Attributes:
        foundation: Pressure of the wall on an indenting capsule, as on a rigid base.
        drag: Resistance to a sliding capsule.
        deformation: Deformation of the wall, by springs per vertex or as an elastic layer; None is
            a rigid wall.
        motility: Contractions of the muscle; None leaves the lumen at rest.
    """

    foundation: WinklerFoundation = field(default_factory=WinklerFoundation)
    drag: Drag = field(default_factory=Drag)
    deformation: SpringWall | FemDeformation | None = field(default_factory=SpringWall)
    motility: Motility | None = None

    @property
    def foundation_in_series(self) -> WinklerFoundation:
        """Foundation used for contact: stiffened in series with a spring wall."""
        deformation = self.deformation
        is_spring_wall = isinstance(deformation, SpringWall)
        return deformation.in_series(self.foundation) if is_spring_wall else self.foundation

    @property
    def longest_substep(self) -> float:
        """Maximum stable substep of the deformation [s]; infinite for a rigid wall."""
        return math.inf if self.deformation is None else self.deformation.longest_step
