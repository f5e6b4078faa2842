"""Interface of lens models, and their common arithmetic on arrays and tensors.

A lens model is a frozen dataclass of plain numbers. Pixels are (column, row); pixel (0, 0) is the
center of the top-left pixel. The camera frame is x right, y down, z forward.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import fields
from functools import lru_cache, partial
from typing import TYPE_CHECKING, Any, ClassVar, Protocol

import numpy as np

from vrcaps.camera.lens.tensors import namespace, solved
from vrcaps.core.errors import InputError
from vrcaps.core.fields import plain_fields

if TYPE_CHECKING:
    from jaxtyping import Bool, Float

ANGLE_SLACK = 1e-9
"""Rounding tolerance at the edge of the field [rad]: a ray on the edge still projects."""


LENGTH_PX = {"unit": "px", "px_power": 1}
"""Metadata of a parameter in pixels that scales with the image, such as a focal length."""
ANGLE = {"unit": "deg"}
"""Metadata of an angle [rad], stored in degrees in files."""


class Lens(Protocol):
    """A lens model; `LENSES` lists all of them.

    The metadata of a field control files and scaled images: `unit` is its unit in a device file and
    the suffix of its key; `px_power` is the power of the image scale by which it scales. `project`
    and `unproject` also accept PyTorch tensors and then return tensors with gradients.

    Attributes:
        kind: Name of the model in files.
    """

    kind: ClassVar[str]

    @property
    def cx(self) -> float:
        """Column where the optical axis meets the image [px]."""
        ...

    @property
    def cy(self) -> float:
        """Row where the optical axis meets the image [px]."""
        ...

    @property
    def max_angle(self) -> float | None:
        """Half-field limit [rad], or None for the full range of the model."""
        ...

    def project(
        self, points_camera: Float[np.ndarray, "*batch 3"]
    ) -> Float[np.ndarray, "*batch 2"]:
        """Pixels of points in the camera frame (any length unit); NaN outside the field."""
        ...

    def unproject(self, pixels: Float[np.ndarray, "*batch 2"]) -> Float[np.ndarray, "*batch 3"]:
        """Unit rays in the camera frame through pixels; NaN outside the field."""
        ...


def check_lens(lens: Any, positive: tuple[str, ...]) -> None:
    """Check a lens dataclass on construction.

    Args:
        lens: The lens.
        positive: Fields that must be positive.

    Raises:
        InputError: If a parameter is not finite, one that must be positive is not, or `max_angle`
            is outside (0, π].
    """
    plain_fields(lens)
    for name in (f.name for f in fields(lens)):
        value = getattr(lens, name)
        if name == "max_angle" and value is None:
            continue
        if isinstance(value, bool) or not isinstance(value, (int, float, np.number)):
            raise InputError(f"Lens {lens.kind}: {name} = {value!r}. Allowed: a finite number.")
        if not math.isfinite(value):
            raise InputError(f"Lens {lens.kind}: {name} = {value}. Allowed: a finite number.")
        if name in positive and not value > 0.0:
            raise InputError(f"Lens {lens.kind}: {name} = {value}. Allowed: above 0.")
    if lens.max_angle is not None and not 0.0 < lens.max_angle <= math.pi:
        raise InputError(
            f"Lens {lens.kind}: max_angle = {lens.max_angle}. Allowed: above 0 to π rad."
        )


def angles_to_axis(points: Float[np.ndarray, "*batch 3"]) -> Float[np.ndarray, "*batch"]:
    """Angle [rad] between the directions of points and the optical axis; NaN for the origin."""
    xp = namespace(points)
    angle = xp.arctan2(xp.hypot(points[..., 0], points[..., 1]), points[..., 2])
    return xp.where((points == 0.0).all(-1), xp.nan, angle)


def rays_at_angles(
    angle: Float[np.ndarray, "*batch"], direction: Float[np.ndarray, "*batch 2"]
) -> Float[np.ndarray, "*batch 3"]:
    """Unit rays at an angle [rad] to the optical axis, towards a lateral `direction` of any length.

    If the direction is zero, the ray is the optical axis.
    """
    xp = namespace(angle)
    length = xp.hypot(direction[..., 0], direction[..., 1])
    scale = xp.sin(angle) / xp.where(length > 0.0, length, 1.0)
    z = xp.where(length > 0.0, xp.cos(angle), xp.where(xp.isnan(angle), xp.nan, 1.0))
    return xp.stack([direction[..., 0] * scale, direction[..., 1] * scale, z], axis=-1)


def masked(
    values: Float[np.ndarray, "*batch c"], valid: Bool[np.ndarray, "*batch"]
) -> Float[np.ndarray, "*batch c"]:
    """Values with NaN where invalid."""
    return namespace(values).where(valid[..., None], values, np.nan)


def polynomial(x: Any, coefficients: Sequence[float]) -> Any:
    """Evaluate Σ cᵢ xⁱ by Horner's rule."""
    total = x * 0.0 + coefficients[-1]
    for coefficient in coefficients[-2::-1]:
        total = coefficient + total * x
    return total


@lru_cache(maxsize=256)
def first_positive_root(coefficients: tuple[float, ...]) -> float:
    """Smallest positive real root of Σ cᵢ xⁱ; infinite if there is none.

    A double root, where the polynomial touches zero without a change of sign, does not count.
    """
    roots = np.polynomial.Polynomial(coefficients).trim().roots()
    real = roots.real[(np.abs(roots.imag) <= 1e-9 * np.abs(roots)) & (roots.real > 0.0)]
    return float(real.min()) if real.size else math.inf


def invert_monotone(
    function: Callable[[np.ndarray], np.ndarray],
    derivative: Callable[[np.ndarray], np.ndarray],
    values: Float[np.ndarray, "*batch"],
    upper: float,
) -> Float[np.ndarray, "*batch"]:
    """Solve ``function(x) = value`` on [0, `upper`], where the function increases, to rounding.

    Newton's method from a table, with bisection if a step leaves the bracket.

    Args:
        function: Vectorized and increasing, zero at 0.
        derivative: Derivative of the function.
        values: Target values; those out of range give the nearer end, NaN gives NaN.
        upper: End of the interval.
    """

    def newton_step(x: Any, values: Any) -> Any:
        slope = derivative(x)
        error = function(x) - values.clip(0.0, float(function(np.array(upper))))
        return error / namespace(slope).where(slope > 0.0, slope, np.inf)

    solve = partial(_invert_array, function, derivative, upper)
    return solved(solve, newton_step, values)


def _invert_array(
    function: Callable[[np.ndarray], np.ndarray],
    derivative: Callable[[np.ndarray], np.ndarray],
    upper: float,
    values: np.ndarray,
) -> np.ndarray:
    grid = upper * np.linspace(0.0, 1.0, 257)
    table = function(grid)
    values = np.clip(values, 0.0, table[-1])
    x = np.interp(values, table, grid)
    low, high = np.zeros_like(values), np.full_like(values, upper)
    for _ in range(100):
        error = function(x) - values
        low = np.where(error < 0.0, x, low)
        high = np.where(error > 0.0, x, high)
        slope = derivative(x)
        step = error / np.where(slope > 0.0, slope, np.inf)
        newton = x - step
        inside = (newton >= low) & (newton <= high) & (slope > 0.0)
        moved = np.where(error == 0.0, x, np.where(inside, newton, 0.5 * (low + high)))
        settled = ~(np.abs(moved - x) > 1e-14 * upper)  # also true for NaN
        x = moved
        if np.all(settled):
            break
    return np.where(np.isnan(values), np.nan, x)
