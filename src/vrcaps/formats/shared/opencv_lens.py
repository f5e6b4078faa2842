"""Lenses of COLMAP and nerfstudio: OpenCV's models, with pixel centers at 0.5.

There the center of the top-left pixel is (0.5, 0.5); here it is (0, 0). Parameters by model are
those of https://colmap.github.io/cameras.html; distortion is OpenCV's.
"""

from __future__ import annotations

from collections.abc import Mapping

from vrcaps.camera.lens import AnyLens, LensEquidistant, LensKannalaBrandt, LensPinhole
from vrcaps.core.errors import InputError, UnknownNameError

OPENCV_LENSES = ("pinhole", "kannala-brandt", "equidistant")
"""Lenses supported by these models."""

HALF = 0.5
"""Offset from a pixel's index to its center's coordinate [px]."""

_ONE, _TWO = ("f", "cx", "cy"), ("fx", "fy", "cx", "cy")
MODELS: dict[str, tuple[str, ...]] = {
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
"""Parameter names of each model, in order."""


def opencv_model(lens: AnyLens, name: str) -> tuple[str, dict[str, float]]:
    """Simplest model that represents a lens exactly, and its parameters [px, as a multiple].

    Args:
        lens: One of `OPENCV_LENSES`.
        name: Name of the lens, for messages.

    Raises:
        InputError: If it is a pinhole with skew, which no model supports.
    """
    center = {"cx": lens.cx + HALF, "cy": lens.cy + HALF}
    if isinstance(lens, LensEquidistant):
        return "OPENCV_FISHEYE", {"fx": lens.focal, "fy": lens.focal, **center, **_zeros("1234")}
    if isinstance(lens, LensKannalaBrandt):
        distortion = {"k1": lens.k1, "k2": lens.k2, "k3": lens.k3, "k4": lens.k4}
        return "OPENCV_FISHEYE", {"fx": lens.fx, "fy": lens.fy, **center, **distortion}
    assert isinstance(lens, LensPinhole)
    require_no_skew(lens, name)
    focal = {"fx": lens.fx, "fy": lens.fy, **center}
    distortion = {"k1": lens.k1, "k2": lens.k2, "p1": lens.p1, "p2": lens.p2}
    if lens.k3 != 0.0:
        return "FULL_OPENCV", {**focal, **distortion, "k3": lens.k3, **_zeros("456")}
    return ("OPENCV", {**focal, **distortion}) if any(distortion.values()) else ("PINHOLE", focal)


def require_no_skew(lens: LensPinhole, name: str) -> None:
    """Check that a pinhole has no skew, which OpenCV's models do not support.

    Args:
        lens: The lens.
        name: Name of the lens, for messages.

    Raises:
        InputError: If it has skew.
    """
    if lens.skew != 0.0:
        raise InputError(
            f"The lens of {name} has a skew of {lens.skew:g} px, which this format cannot hold. "
            "Add --rectify DEGREES to resample to a pinhole of that field of view."
        )


def lens_of(model: str, parameters: Mapping[str, float], where: str) -> AnyLens:
    """Lens from a model and its parameters.

    Args:
        model: One of `MODELS`.
        parameters: Parameters by name; distortion is optional.
        where: Source file, for messages.

    Raises:
        UnknownNameError: If the model is not supported.
        InputError: If a parameter is missing, or no lens here has such a distortion.
    """
    if model not in MODELS:
        raise UnknownNameError("camera model", model, MODELS)
    given = dict(parameters)
    if any(given.get(name, 0.0) != 0.0 for name in ("k4", "k5", "k6")) and "FISHEYE" not in model:
        raise InputError(f"{where} has distortion k4 to k6 of a pinhole. Allowed: k1 to k3.")
    try:
        focal = {"fx": given.get("fx", given.get("f")), "fy": given.get("fy", given.get("f"))}
        center = {"cx": given["cx"] - HALF, "cy": given["cy"] - HALF}
    except KeyError as error:
        raise InputError(f"{where} has no {error.args[0]} of its camera.") from error
    distortion = {name: given.get(name, 0.0) for name in ("k1", "k2", "k3")}
    if "FISHEYE" in model:
        distortion["k4"] = given.get("k4", 0.0)
        return LensKannalaBrandt(**focal, **center, **distortion)  # type: ignore[arg-type]
    distortion |= {name: given.get(name, 0.0) for name in ("p1", "p2")}
    return LensPinhole(**focal, **center, **distortion)  # type: ignore[arg-type]


def _zeros(numbers: str) -> dict[str, float]:
    return {f"k{number}": 0.0 for number in numbers}
