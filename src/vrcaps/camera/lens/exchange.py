"""Lens parameters in the conventions of other tools, and lenses from them.

| convention | pinhole | fisheye (`kannala-brandt`, `equidistant`) | center of the first pixel |
|---|---|---|---|
| OpenCV, EuRoC, Kalibr | radial-tangential | equidistant | (0, 0), as here |
| VSLAM-LAB | radtan4, radtan5 | equid4 | (0, 0) |
| Foxglove, ROS | plumb_bob | kannala_brandt | (0, 0) |
| COLMAP, nerfstudio | PINHOLE, OPENCV, … | OPENCV_FISHEYE, … | (0.5, 0.5) |

Distortion is OpenCV's in all of them: k1 k2 p1 p2 k3 of a pinhole, k1 k2 k3 k4 of a fisheye.
Parameters of COLMAP's models: https://colmap.github.io/cameras.html.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from vrcaps.camera.lens import LENSES, AnyLens, LensKannalaBrandt, LensPinhole
from vrcaps.core.errors import InputError, UnknownNameError

if TYPE_CHECKING:
    from jaxtyping import Float

RECTIFY = "Add --rectify DEGREES to resample to a pinhole of that field of view."
"""Remedy for a lens that a format does not support."""

OPENCV_LENSES = ("pinhole", "kannala-brandt", "equidistant")
"""Kinds of lenses that OpenCV's models represent exactly."""

HALF = 0.5
"""Offset from the index of a pixel to its center in COLMAP and nerfstudio [px]."""

DISTORTIONS = {
    "euroc": {
        "radial-tangential": (False, 4),
        "radtan": (False, 4),
        "equidistant": (True, 4),
        "none": (False, 0),
    },
    "vslam-lab": {"radtan4": (False, 4), "radtan5": (False, 5), "equid4": (True, 4)},
    "foxglove": {"plumb_bob": (False, 5), "kannala_brandt": (True, 4)},
}
"""Distortion models of conventions: whether it is of a fisheye, and the number of coefficients."""

_ONE, _TWO = ("f", "cx", "cy"), ("fx", "fy", "cx", "cy")
COLMAP_MODELS: dict[str, tuple[str, ...]] = {
    "SIMPLE_PINHOLE": _ONE,
    "PINHOLE": _TWO,
    "SIMPLE_RADIAL": (*_ONE, "k1"),
    "RADIAL": (*_ONE, "k1", "k2"),
    "OPENCV": (*_TWO, "k1", "k2", "p1", "p2"),
    "FULL_OPENCV": (*_TWO, "k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6"),
    "SIMPLE_RADIAL_FISHEYE": (*_ONE, "k1"),
    "RADIAL_FISHEYE": (*_ONE, "k1", "k2"),
    "OPENCV_FISHEYE": (*_TWO, "k1", "k2", "k3", "k4"),
}
"""Parameter names of COLMAP's camera models, in order."""

_COEFFICIENTS = {False: ("k1", "k2", "p1", "p2", "k3"), True: ("k1", "k2", "k3", "k4")}
"""Distortion coefficients of a pinhole and of a fisheye, in OpenCV's order."""


@dataclass(frozen=True)
class OpenCvLens:
    """Parameters of a lens in OpenCV's models.

    Attributes:
        is_fisheye: Whether the model is the fisheye's.
        focal: Focal lengths along columns and rows [px].
        center: Column and row of the optical axis [px].
        distortion: Coefficients: k1 k2 p1 p2 k3 of a pinhole, k1 k2 k3 k4 of a fisheye.
    """

    is_fisheye: bool
    focal: tuple[float, float]
    center: tuple[float, float]
    distortion: tuple[float, ...]

    @classmethod
    def of(cls, lens: Any, name: str, *, count: int = 5) -> OpenCvLens:
        """Parameters of a lens.

        Args:
            lens: Lens of a kind in `OPENCV_LENSES`.
            name: Name of the lens, for messages.
            count: Number of coefficients of a pinhole in the layout, 4 or 5.

        Raises:
            InputError: If a pinhole has skew, or k3 and there are only four coefficients.
        """
        center = (lens.cx, lens.cy)
        if lens.kind == "equidistant":
            return cls(True, (lens.focal, lens.focal), center, (0.0,) * 4)
        is_fisheye = lens.kind == "kannala-brandt"
        if not is_fisheye:
            _require_zero(name, "a skew of", lens.skew, " px")
            _require_zero(name, "k3 =", lens.k3 if count == 4 else 0.0)
        values = tuple(getattr(lens, key) for key in _COEFFICIENTS[is_fisheye])
        return cls(is_fisheye, (lens.fx, lens.fy), center, values if is_fisheye else values[:count])

    def lens(self) -> LensPinhole | LensKannalaBrandt:
        """Lens with these parameters; missing coefficients are 0."""
        names = ("fx", "fy", "cx", "cy", *_COEFFICIENTS[self.is_fisheye])
        values = (*self.focal, *self.center, *self.distortion)
        kind = LensKannalaBrandt if self.is_fisheye else LensPinhole
        return kind(**dict(zip(names, values, strict=False)))


def _require_zero(name: str, parameter: str, value: float, unit: str = "") -> None:
    if value != 0.0:
        raise InputError(
            f"The lens of {name} has {parameter} {value:g}{unit}, which this format cannot hold. "
            f"{RECTIFY}"
        )


def colmap_model(lens: AnyLens, name: str) -> tuple[str, dict[str, float]]:
    """Simplest COLMAP model that represents a lens exactly, and its parameters [px, as a multiple].

    Args:
        lens: Lens of a kind in `OPENCV_LENSES`.
        name: Name of the lens, for messages.

    Raises:
        InputError: If it is a pinhole with skew, which no model supports.
    """
    given = OpenCvLens.of(lens, name)
    center = (given.center[0] + HALF, given.center[1] + HALF)
    coefficients = _COEFFICIENTS[given.is_fisheye]
    parameters = (*given.focal, *center, *given.distortion)
    values = dict(zip((*_TWO, *coefficients), parameters, strict=True))
    model = "OPENCV_FISHEYE"
    if not given.is_fisheye:
        model = "OPENCV" if any(given.distortion[:4]) else "PINHOLE"
        model = "FULL_OPENCV" if values["k3"] != 0.0 else model
    return model, {key: values.get(key, 0.0) for key in COLMAP_MODELS[model]}


def lens_from_colmap(model: str, parameters: Mapping[str, float], where: str) -> AnyLens:
    """Lens from a COLMAP model and its parameters.

    Args:
        model: One of `COLMAP_MODELS`.
        parameters: Parameters by name; distortion is optional.
        where: Source file, for messages.

    Raises:
        UnknownNameError: If the model is not supported.
        InputError: If a parameter is missing, or no lens here has such a distortion.
    """
    if model not in COLMAP_MODELS:
        raise UnknownNameError("camera model", model, COLMAP_MODELS)
    given, is_fisheye = dict(parameters), "FISHEYE" in model
    if any(given.get(name, 0.0) != 0.0 for name in ("k4", "k5", "k6")) and not is_fisheye:
        raise InputError(f"{where} has distortion k4 to k6 of a pinhole. Allowed: k1 to k3.")
    try:
        center = (given["cx"] - HALF, given["cy"] - HALF)
    except KeyError as error:
        raise InputError(f"{where} has no {error.args[0]} of its camera.") from error
    focal: Any = (given.get("fx", given.get("f")), given.get("fy", given.get("f")))
    distortion = tuple(given.get(name, 0.0) for name in _COEFFICIENTS[is_fisheye])
    return OpenCvLens(is_fisheye, focal, center, distortion).lens()


def as_pinhole(lens: AnyLens | None) -> LensPinhole | None:
    """Return the lens if it is a pinhole; otherwise None."""
    return lens if isinstance(lens, LensPinhole) else None


def undistorted_pinhole(lens: AnyLens | None, user: str, name: str) -> LensPinhole:
    """Return a lens, which must be a pinhole without distortion.

    Args:
        lens: The lens; None if it is unknown.
        user: Format that requires it, for messages.
        name: Name of the lens, for messages.

    Raises:
        InputError: If the lens is of another kind; the message states the remedy.
    """
    pinhole = as_pinhole(lens)
    if pinhole is not None and not any(getattr(pinhole, key) for key in _COEFFICIENTS[False]):
        return pinhole
    given = "no camera" if lens is None else f"a lens of kind {lens.kind!r}"
    given = given if pinhole is None else "a pinhole with distortion"
    raise InputError(f"{user} supports pinholes without distortion; {name} has {given}. {RECTIFY}")


def camera_matrix(lens: Any) -> Float[np.ndarray, "3 3"]:
    """``K = [[fx, skew, cx], [0, fy, cy], [0, 0, 1]]`` of a pinhole [px]."""
    return np.array([[lens.fx, lens.skew, lens.cx], [0.0, lens.fy, lens.cy], [0.0, 0.0, 1.0]])


def lens_from_matrix(numbers: Sequence[float]) -> LensPinhole:
    """Pinhole from the nine numbers of K, row by row [px]."""
    fx, skew, cx, _, fy, cy, *_ = numbers
    return LensPinhole(fx=fx, fy=fy, cx=cx, cy=cy, skew=skew)


def lens_values(lens: Any, names: str) -> list[float]:
    """Parameters of a lens in a given order, such as ``"fx fy cx cy"``."""
    return [getattr(lens, name) for name in names.split()]


def lens_from_values(kind: str, names: str, values: Sequence[float]) -> Any:
    """Lens of a kind from parameters in a given order; inverse of `lens_values`."""
    return LENSES[kind](**dict(zip(names.split(), values, strict=True)))
