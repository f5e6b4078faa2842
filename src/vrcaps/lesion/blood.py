"""Optics of blood and fibrin films on the mucosa."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from vrcaps.core.units import MM

if TYPE_CHECKING:
    from jaxtyping import Float

FRESH = np.array([0.084, 0.0078, 0.0080])
"""Linear reflectance of a thick layer of fresh blood."""

OLD = np.array([0.025, 0.0050, 0.0050])
"""Linear reflectance of a thick layer of clotted blood."""

FIBRIN = np.array([0.39, 0.30, 0.21])
"""Linear reflectance of fibrin and slough on an ulcer."""

_EXTINCTION = np.array([0.8, 9.0, 8.5]) / MM
"""Two-way optical density per length of a film of whole blood: red, green, blue. Hemoglobin
at 150 g/l absorbs green and blue about ten times as much as red (Prahl 1999, tabulated
extinction); the scale is fitted visually to thin films in endoscopic images."""


@dataclass(frozen=True)
class BloodFlow:
    """Dimensions of a bleeding severity.

    Attributes:
        source: Radius of the bleeding source [m].
        run: Maximum path length of blood from it [m].
        width: Half-width of the flow [m].
        film: Thickness of the flow [m].
        pool: Depth of the pool at the end [m].
        clots: Height of clots over source and pool [m].
    """

    source: float
    run: float = 0.0
    width: float = 0.0
    film: float = 0.0
    pool: float = 0.0
    clots: float = 0.0


def under_blood(
    color: Float[np.ndarray, "n 3"],
    thickness: Float[np.ndarray, " n"],
    age: Float[np.ndarray, " n"] | float = 0.0,
) -> Float[np.ndarray, "n 3"]:
    """Reflectance of a wall under a film of blood, from its transmittance.

    Args:
        color: Linear reflectance without the film.
        thickness: Thickness of the film [m].
        age: Age of the blood, 0 (fresh) to 1 (clotted).
    """
    body = FRESH + (OLD - FRESH) * np.broadcast_to(age, len(color))[:, None]
    return body + (color - body) * np.exp(-thickness[:, None] * _EXTINCTION)
