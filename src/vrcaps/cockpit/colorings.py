"""Registry of colorings of the organ in a page."""

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
    """Names of the colorings of an organ; those of a running simulation only if it is live."""
    fitting = tuple(name for name, kind in _STATIC.items() if kind.fits(organ))
    return (*fitting, *_LIVE) if is_live else fitting


def make_coloring(
    name: str, organ: OrganSurface, mesh: PageMesh, live: LiveWall | None = None
) -> Coloring:
    """Create a coloring by name.

    Args:
        name: One of `coloring_names`.
        organ: Organ to color.
        mesh: Its mesh in the page.
        live: Live data of the wall, for the colorings that need it.
    """
    if name in _STATIC:
        return _STATIC[name](organ, mesh)
    assert live is not None
    return _LIVE[name](organ, mesh, live)
