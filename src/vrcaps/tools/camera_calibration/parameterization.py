"""Which parameters of each lens model photographs can tell, and where a search starts."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, fields, replace

import numpy as np

from vrcaps.camera.lens import Lens, LensKannalaBrandt, LensPinhole, LensScaramuzza
from vrcaps.errors import UnknownNameError

Size = tuple[int, int]


@dataclass(frozen=True)
class LensParameterization:
    """A lens model as a vector of numbers of about 1.

    Attributes:
        focal: Fields that are focal lengths or play their part.
        terms: Distortion coefficients, from low order to high.
        start: Lens of a focal length [px], a shape and a center (column, row).
        shapes: Shapes that a search tries: the first coefficient, times a power of the focal
            length where it has a unit.
    """

    focal: tuple[str, ...]
    terms: tuple[str, ...]
    start: Callable[[float, float, float, float], Lens]
    shapes: tuple[float, ...]

    def names(self, num_terms: int) -> tuple[str, ...]:
        """Fields that are fitted, with the first so many distortion coefficients."""
        return (*self.focal, "cx", "cy", *self.terms[:num_terms])

    def scales(self, names: tuple[str, ...], size: Size) -> np.ndarray:
        """Size of a step in each field that moves pixels by about half the image's width."""
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
"""By the `kind` of the lens model."""


def find_parameterization(kind: str) -> LensParameterization:
    """The family of a lens model.

    Raises:
        UnknownNameError: If there is none, or photographs of a board cannot fit it.
    """
    if kind not in PARAMETERIZATIONS:
        raise UnknownNameError("lens model to calibrate", kind, PARAMETERIZATIONS)
    return PARAMETERIZATIONS[kind]


def with_values(lens: Lens, names: tuple[str, ...], values: np.ndarray) -> Lens:
    """A lens with some of its fields changed."""
    changes = dict(zip(names, map(float, values), strict=True))
    return replace(lens, **changes)  # type: ignore[type-var]


def values_of(lens: Lens, names: tuple[str, ...]) -> np.ndarray:
    """Some fields of a lens."""
    return np.array([getattr(lens, name) for name in names], float)
