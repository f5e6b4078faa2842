"""Observable parameters of each lens model, and starting points of the search."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, fields, replace

import numpy as np

from vrcaps.camera.lens import Lens, LensKannalaBrandt, LensPinhole, LensScaramuzza
from vrcaps.core.errors import UnknownNameError

Size = tuple[int, int]


@dataclass(frozen=True)
class LensParameterization:
    """Lens model as a vector of parameters of order 1.

    Attributes:
        focal: Focal lengths, or fields of the same role.
        terms: Distortion coefficients, from low order to high.
        start: Creates a lens from a focal length [px], a shape and a center (column, row).
        shapes: Shapes that a search tries: the first coefficient, times a power of the focal
            length if it has a unit.
    """

    focal: tuple[str, ...]
    terms: tuple[str, ...]
    start: Callable[[float, float, float, float], Lens]
    shapes: tuple[float, ...]

    def names(self, num_terms: int) -> tuple[str, ...]:
        """Names of the fitted fields, with the given number of distortion coefficients."""
        return (*self.focal, "cx", "cy", *self.terms[:num_terms])

    def scales(self, names: tuple[str, ...], size: Size) -> np.ndarray:
        """Step in each field that moves pixels by about half the image's width."""
        half, lens = 0.5 * size[0], self.start(1.0, 0.0, 0.0, 0.0)
        powers = {
            f.name: f.metadata.get("px_power", 0)
            for f in fields(lens)  # type: ignore[arg-type]
        }
        return np.array([half ** float(powers[name]) for name in names])


PARAMETERIZATIONS = {
    "pinhole": LensParameterization(
        ("fx", "fy"),
        ("k1", "k2", "k3"),
        lambda focal, shape, cx, cy: LensPinhole(focal, focal, cx, cy, k1=shape),
        (-0.3, -0.1, 0.0, 0.1, 0.3),
    ),
    "kannala-brandt": LensParameterization(
        ("fx", "fy"),
        ("k1", "k2", "k3", "k4"),
        lambda focal, shape, cx, cy: LensKannalaBrandt(focal, focal, cx, cy, shape),
        (-0.1, 0.0, 0.1, 0.3),
    ),
    "scaramuzza": LensParameterization(
        ("a0",),
        ("a2", "a3", "a4"),
        lambda focal, shape, cx, cy: LensScaramuzza(focal, shape / focal, 0.0, 0.0, cx, cy),
        (-0.5, -1.0 / 3.0, -0.1, 0.0),  # -1/3 is equidistant to second order, 0 a pinhole
    ),
}
"""Parameterizations by the `kind` of the lens model."""


def find_parameterization(kind: str) -> LensParameterization:
    """Return the parameterization of a lens model.

    Raises:
        UnknownNameError: If there is none, or photographs of a board cannot determine it.
    """
    if kind not in PARAMETERIZATIONS:
        raise UnknownNameError("lens model to calibrate", kind, PARAMETERIZATIONS)
    return PARAMETERIZATIONS[kind]


def with_values(lens: Lens, names: tuple[str, ...], values: np.ndarray) -> Lens:
    """Copy of a lens with some of its fields changed."""
    changes = dict(zip(names, map(float, values), strict=True))
    return replace(lens, **changes)  # type: ignore[type-var]


def values_of(lens: Lens, names: tuple[str, ...]) -> np.ndarray:
    """Values of some fields of a lens."""
    return np.array([getattr(lens, name) for name in names], float)
