"""Observable parameters of each lens model, and the initial guess of a fit.

The focal length is found by grid search, the poses by linear algebra.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, fields, replace
from itertools import product
from typing import TYPE_CHECKING

import numpy as np

from vrcaps.camera.lens import Lens, LensKannalaBrandt, LensPinhole, LensScaramuzza
from vrcaps.core.errors import UnknownNameError

if TYPE_CHECKING:
    from jaxtyping import Float

    from vrcaps.camera.lens import Lens

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


FOCALS = np.geomspace(0.12, 3.0, 25)
"""Candidate focal lengths, in image widths: fields of 19° to 180° and more across."""

_NUM_TRIED = 4
"""Maximum number of photographs on which focal lengths are tried."""


def initial_lens(
    family: LensParameterization,
    size: Size,
    points: Float[np.ndarray, "n 3"],
    pixels: Float[np.ndarray, "v n 2"],
) -> tuple[Lens, Float[np.ndarray, "v 4 4"]]:
    """Best-fitting undistorted lens over all candidate focal lengths, and the board poses.

    Args:
        family: Parameterization of the lens model.
        size: Width and height of the image [px].
        points: Corners in the board's frame.
        pixels: Corner positions in each photograph.

    Returns:
        The lens with its axis in the middle of the image, and ``Ts_camera_board``.
    """
    center = (0.5 * (size[0] - 1), 0.5 * (size[1] - 1))
    tried = [
        family.start(float(focal), shape, *center)
        for focal, shape in product(FOCALS * size[0], family.shapes)
    ]
    some = pixels[:: -(-len(pixels) // _NUM_TRIED)]

    def error(lens: Lens) -> float:
        poses = np.array([plane_pose(lens, points, view) for view in some])
        return float(np.median(np.nan_to_num(errors(lens, poses, points, some), nan=sum(size))))

    best = min(tried, key=error)
    return best, np.array([plane_pose(best, points, view) for view in pixels])


def errors(
    lens: Lens,
    poses: Float[np.ndarray, "v 4 4"],
    points: Float[np.ndarray, "n 3"],
    pixels: Float[np.ndarray, "v n 2"],
) -> Float[np.ndarray, "v n"]:
    """Distances of projected from detected corners [px]; NaN outside the field of view."""
    seen = points @ np.swapaxes(poses[:, :3, :3], 1, 2) + poses[:, None, :3, 3]
    return np.linalg.norm(lens.project(seen) - pixels, axis=-1)


def plane_pose(
    lens: Lens, points: Float[np.ndarray, "n 3"], pixels: Float[np.ndarray, "n 2"]
) -> Float[np.ndarray, "4 4"]:
    """Fit ``T_camera_board`` linearly to the rays through the corners of a board.

    A ray ρ passes through ``H (x, y, 1)`` with ``H = [r1 r2 t]`` up to a factor:
    ``ρ × H (x, y, 1) = 0`` (Zhang 2000, appendix A, with rays for image points, so that any field
    of view works). The nearest rotation follows by singular value decomposition.

    Args:
        lens: The lens.
        points: Corners in the board's frame; z = 0.
        pixels: Corner positions in the photograph; those outside the lens's field are ignored.
    """
    rays = lens.unproject(pixels)
    valid = np.isfinite(rays).all(axis=-1)
    if valid.sum() < 4:
        return np.eye(4)
    scale = np.abs(points).max()
    flat = np.column_stack([points[:, :2] / scale, np.ones(len(points))])[valid]
    cross = np.cross(rays[valid][:, :, None], np.eye(3), axisa=1, axisb=0, axisc=-1)
    rows = np.einsum("nia,nk->niak", cross.reshape(-1, 3, 3), flat).reshape(-1, 9)
    matrix = np.linalg.svd(rows, full_matrices=False)[2][-1].reshape(3, 3)
    along = np.einsum("ni,ij,nj->n", rays[valid], matrix, flat)
    matrix = matrix * np.sign(along.sum() or 1.0) / np.linalg.norm(matrix[:, :2], axis=0).mean()
    columns = np.column_stack([matrix[:, 0], matrix[:, 1], np.cross(matrix[:, 0], matrix[:, 1])])
    u, _, vt = np.linalg.svd(columns)
    pose = np.eye(4)
    pose[:3, :3] = u @ np.diag([1.0, 1.0, np.linalg.det(u @ vt)]) @ vt
    pose[:3, 3] = matrix[:, 2] * scale
    return pose
