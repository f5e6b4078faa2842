"""Registry of colorings: what the organ in a page can be colored by."""

from __future__ import annotations

from typing import TYPE_CHECKING

from vrcaps.cockpit.contact_colors import PressureColoring, StiffnessColoring
from vrcaps.cockpit.organ_colors import (
    Coloring,
    CoverageColoring,
    LesionColoring,
    LiveWall,
    SegmentColoring,
)

if TYPE_CHECKING:
    from vrcaps.cockpit.page_mesh import PageMesh
    from vrcaps.organ.surface import OrganSurface

_STATIC: dict[str, type[Coloring]] = {each.name: each for each in (SegmentColoring, LesionColoring)}
_LIVE = {each.name: each for each in (CoverageColoring, PressureColoring, StiffnessColoring)}


def coloring_names(organ: OrganSurface, *, is_live: bool) -> tuple[str, ...]:
    """Names of the colorings of an organ, with those of a running simulation or without."""
    fitting = tuple(name for name, kind in _STATIC.items() if kind.fits(organ))
    return (*fitting, *_LIVE) if is_live else fitting


def make_coloring(
    name: str, organ: OrganSurface, mesh: PageMesh, live: LiveWall | None = None
) -> Coloring:
    """A coloring by its name.

    Args:
        name: One of `coloring_names`.
        organ: What is colored.
        mesh: As the page draws it.
        live: The simulation's, for those that need it.
    """
    if name in _STATIC:
        return _STATIC[name](organ, mesh)
    assert live is not None
    return _LIVE[name](organ, mesh, live)
