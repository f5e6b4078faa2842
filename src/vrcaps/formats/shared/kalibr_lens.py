"""Lenses of EuRoC, Kalibr and VSLAM-LAB: focal length, center, four or five coefficients.

Pixel (0, 0) is the center of the top-left pixel, as in OpenCV. Radial-tangential distortion is
k1 k2 p1 p2 and, in lists of five, k3; equidistant distortion is k1 k2 k3 k4 of Kannala and Brandt.
"""

from __future__ import annotations

from collections.abc import Sequence

from vrcaps.camera.lens import AnyLens, LensEquidistant, LensKannalaBrandt, LensPinhole
from vrcaps.core.errors import InputError
from vrcaps.formats.shared.opencv_lens import OPENCV_LENSES as KALIBR_LENSES
from vrcaps.formats.shared.opencv_lens import require_no_skew

__all__ = ["KALIBR_LENSES", "is_fisheye", "kalibr_values", "lens_from"]


def is_fisheye(lens: AnyLens) -> bool:
    """Whether the distortion model of a lens is equidistant."""
    return isinstance(lens, (LensKannalaBrandt, LensEquidistant))


def kalibr_values(lens: AnyLens, name: str, count: int) -> tuple[list[float], list[float]]:
    """``fx fy cx cy`` [px] and the distortion of a lens.

    Args:
        lens: One of `KALIBR_LENSES`.
        name: Name of the lens, for messages.
        count: Number of radial-tangential coefficients in the layout, 4 or 5.

    Raises:
        InputError: If it is a pinhole with skew, or with k3 if there are only four coefficients.
    """
    center = [lens.cx, lens.cy]
    if isinstance(lens, LensEquidistant):
        return [lens.focal, lens.focal, *center], [0.0] * 4
    if isinstance(lens, LensKannalaBrandt):
        return [lens.fx, lens.fy, *center], [lens.k1, lens.k2, lens.k3, lens.k4]
    assert isinstance(lens, LensPinhole)
    require_no_skew(lens, name)
    if count == 4 and lens.k3 != 0.0:
        raise InputError(
            f"The lens of {name} has k3 = {lens.k3:g}, which this format cannot hold. "
            "Add --rectify DEGREES to resample to a pinhole of that field of view."
        )
    values = [lens.k1, lens.k2, lens.p1, lens.p2, lens.k3]
    return [lens.fx, lens.fy, *center], values[:count]


def lens_from(values: Sequence[float], distortion: Sequence[float], *, fisheye: bool) -> AnyLens:
    """Lens from ``fx fy cx cy`` and up to five distortion coefficients."""
    fx, fy, cx, cy = values
    padded = [*distortion, 0.0, 0.0, 0.0, 0.0, 0.0][:5]
    if fisheye:
        k1, k2, k3, k4, _ = padded
        return LensKannalaBrandt(fx=fx, fy=fy, cx=cx, cy=cy, k1=k1, k2=k2, k3=k3, k4=k4)
    k1, k2, p1, p2, k3 = padded
    return LensPinhole(fx=fx, fy=fy, cx=cx, cy=cy, k1=k1, k2=k2, p1=p1, p2=p2, k3=k3)
