"""Colorings of the organ by contact with the capsule: pressure, stiffness.

The contact law is the same everywhere, so the wall is plain except where the capsule presses. The
touched part of the fine wall is drawn in color bands.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, ClassVar

import numpy as np

from vrcaps.cockpit.organ_colors import PLAIN, Color, Coloring, LiveWall, Patch, legend_of
from vrcaps.world.indentation import indentation

if TYPE_CHECKING:
    from jaxtyping import Float

    from vrcaps.cockpit.page_mesh import PageMesh
    from vrcaps.organ.surface import OrganSurface

_COLORS: tuple[Color, ...] = (
    *((255, 236, 130), (254, 178, 76), (253, 106, 50), (227, 26, 28), (128, 0, 60)),
)
"""Colors of the bands, from the lowest."""
_KILO_MM = 1e6
"""Pascal per meter in a kilopascal per millimeter."""


class ContactColoring(Coloring):
    """Coloring of the touched part of the wall, in bands.

    Attributes:
        limits: Lower limit of each band.
    """

    limits: ClassVar[tuple[float, ...]]
    hides_capsule = True

    def __init__(self, organ: OrganSurface, mesh: PageMesh, live: LiveWall) -> None:
        super().__init__(organ, mesh)
        self._live = live

    def values(self, depth: Float[np.ndarray, " k"]) -> Float[np.ndarray, " k"]:
        """Values in the unit of `limits` at indentations [m]."""
        raise NotImplementedError

    def patches(
        self, points: Float[np.ndarray, "n 3"], T_world_capsule: Float[np.ndarray, "4 4"]
    ) -> tuple[Patch, ...]:
        """Touched part of the wall, one patch per band."""
        found = indentation(points, self.organ.faces, self._live.body, T_world_capsule)
        band = np.searchsorted(self.limits, self.values(found.depth), side="right") - 1
        return tuple(
            Patch(_COLORS[k], found.corners[band == k]) for k in np.unique(band[band >= 0])
        )


class PressureColoring(ContactColoring):
    """Coloring by the pressure of the wall on the capsule, for quasi-static indentation."""

    name = "contact pressure"
    limits = (0.0, 0.5, 1.0, 2.0, 4.0)

    def values(self, depth: np.ndarray) -> np.ndarray:
        """Pressure [kPa]."""
        return 1e-3 * self._live.foundation.static_pressure(depth)

    def legend(self) -> str:
        """Lower pressure limits of the bands."""
        entries = [
            (color, f"{low:g} kPa") for color, low in zip(_COLORS[1:], self.limits[1:], strict=True)
        ]
        least = (_COLORS[0], f"below {self.limits[1]:g} kPa")
        return f"{legend_of([least, *entries])} and more"


class StiffnessColoring(ContactColoring):
    """Coloring by the stiffening of the wall under the capsule."""

    name = "stiffness"
    limits = (1.02, 1.1, 1.25, 1.5, 2.0)

    def values(self, depth: np.ndarray) -> np.ndarray:
        """Stiffness relative to that without indentation."""
        foundation = self._live.foundation
        return foundation.stiffness_at(depth) / foundation.stiffness

    def legend(self) -> str:
        """Lower stiffness limits of the bands."""
        at_rest = self._live.foundation.stiffness / _KILO_MM
        entries = [
            (color, f"{factor * at_rest:.3g}")
            for color, factor in zip(_COLORS, self.limits, strict=True)
        ]
        return f"{legend_of([(PLAIN, f'{at_rest:.3g}'), *entries])} kPa/mm and more"
