"""Contents of a colon by the quality of its bowel preparation."""

from __future__ import annotations

from vrcaps.core.errors import require
from vrcaps.core.units import MM
from vrcaps.lumen.contents import CM2, Bubbles, Chyme, Contents, Liquid

_STOOL, _FOOD = (0.18, 0.10, 0.028), (0.30, 0.21, 0.08)
"""Linear colors of stool and of undigested food, matched to real frames by eye."""

_CLEAR, _TURBID = (14.0, 13.0, 6.0), (70.0, 55.0, 20.0)
"""Scattering coefficients of clean and of stained liquid [1/m]."""


def _left(
    froth: float, per_area: float, clump: float, sizes: tuple[float, float], fill: float
) -> Contents:
    """Contents with stool; `froth` and `per_area` in spheres per cm², `sizes` radius and spread."""
    turbid = fill > 0.02
    return Contents(
        bubbles=Bubbles(per_area=froth / CM2, raft_size=8.0, radius=0.5 * MM),
        chyme=Chyme(
            per_area=per_area / CM2,
            clump_size=clump,
            radius=sizes[0] * MM,
            spread=sizes[1],
            largest=4.0 * MM,
            settled=0.6,
            white=0.2,
            yellow_color=_STOOL,
            white_color=_FOOD,
        ),
        liquid=Liquid(
            fill=fill,
            absorption=(40.0, 85.0, 300.0) if turbid else (25.0, 45.0, 150.0),
            scattering=_TURBID if turbid else _CLEAR,
        ),
    )


PREPARATIONS: tuple[Contents, ...] = (
    _left(2.0, 40.0, 80.0, (0.8, 0.40), 0.25),
    _left(1.5, 12.6, 50.0, (0.45, 0.45), 0.10),
    _left(0.8, 1.3, 12.0, (0.25, 0.7), 0.025),
    _left(0.3, 0.085, 4.0, (0.20, 0.7), 0.015),
)
"""Contents by segment score on the Boston bowel preparation scale (Lai et al., Gastrointest.
Endosc. 69(3), 2009): 0 unprepared, solid stool hides the mucosa; 1 parts are hidden by stain, stool
and opaque liquid; 2 minor stain, small fragments or opaque liquid, the mucosa seen well; 3 the
whole mucosa seen well. The scale states no amounts: these are chosen by eye."""


def prepared(score: int) -> Contents:
    """Contents of a colon with a score on the Boston bowel preparation scale.

    Raises:
        InputError: If there is no such score.
    """
    require(score in range(len(PREPARATIONS)), "Preparation", score, "a Boston score, 0 to 3")
    return PREPARATIONS[score]
