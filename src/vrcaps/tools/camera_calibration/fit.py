"""Fit of a lens model to photographs of a chessboard, and the device with the fitted lens."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
import scipy

from vrcaps.camera.camera import Camera
from vrcaps.camera.lens.base import angles_to_axis
from vrcaps.capsule.device import Device
from vrcaps.core.errors import InputError, UnknownNameError, require
from vrcaps.core.geometry import transform_from, transform_points
from vrcaps.tools.camera_calibration.board import MIN_VIEWS, Board, BoardView
from vrcaps.tools.camera_calibration.parameterization import (
    LensParameterization,
    Size,
    find_parameterization,
    initial_lens,
    values_of,
    with_values,
)

if TYPE_CHECKING:
    from jaxtyping import Float

    from vrcaps.camera.lens import Lens

HUBER = 1.345
"""Number of deviations beyond which residuals count linearly: 95 % as efficient as least squares on
normal errors (Huber, Robust Statistics, 1981)."""
MAX_RMS_PX, MAX_RMS = 1.5, 0.005
"""Maximum RMS error of a fit: in pixels, or as a fraction of the image's shorter side."""
_STEP = 1e-6
_RIM_WEIGHT = 10.0
_RIM_MARGIN = 1.005
_ANGLES = np.linspace(0.0, 2.0, 401)
_FAN = np.stack([np.sin(_ANGLES), np.zeros_like(_ANGLES), np.cos(_ANGLES)], axis=-1)
"""Rays up to 115° from the axis: the maximum radius is flat in the angle, so steps do no harm."""
_SINGULAR = 1e-9
"""Reciprocal condition number below which the scaled equations do not determine a lens."""


@dataclass(frozen=True)
class Calibration:
    """Fitted lens and the quality of the fit.

    Attributes:
        lens: The lens.
        names: Fitted fields of the lens.
        covariance: Covariance of their errors, from the scatter of the corners.
        views: The photographs used.
        board: Board that they show.
        size: Width and height of the photographs [px].
        Ts_camera_board: Pose of the board in each photograph.
        residuals: Detected minus projected corner [px], for each photograph.
    """

    lens: Lens
    names: tuple[str, ...]
    covariance: Float[np.ndarray, "p p"]
    views: tuple[BoardView, ...]
    board: Board
    size: Size
    Ts_camera_board: Float[np.ndarray, "v 4 4"]
    residuals: Float[np.ndarray, "v n 2"]

    @property
    def deviations(self) -> Float[np.ndarray, " p"]:
        """Standard deviation of each parameter."""
        return np.sqrt(np.diag(self.covariance))

    @property
    def errors(self) -> Float[np.ndarray, "v n"]:
        """Distance of each corner from its projection [px]."""
        return np.linalg.norm(self.residuals, axis=-1)

    @property
    def rms_px(self) -> float:
        """Root mean square distance of the corners from their projections [px]."""
        return float(np.sqrt(np.mean(self.errors**2)))

    @property
    def angles(self) -> Float[np.ndarray, "v n"]:
        """Angle of each corner to the optical axis [rad]."""
        return angles_to_axis(transform_points(self.Ts_camera_board, self.board.points))


def calibrate(
    views: Sequence[BoardView],
    board: Board,
    size: Size,
    kind: str,
    *,
    num_terms: int | None = None,
    circle_px: float | None = None,
) -> Calibration:
    """Fit a lens model and the board poses to detected corners.

    Minimizes Huber's function of the residuals with a scale of 1.4826 times their median, so that a
    badly detected board has little influence.

    Args:
        views: Boards found in photographs of one camera.
        board: Board that the photographs show.
        size: Width and height of the photographs [px].
        kind: Lens model: ``kannala-brandt``, ``pinhole`` or ``scaramuzza``.
        num_terms: Distortion coefficients to fit, from the lowest order; by default all.
        circle_px: Radius beyond which the image is dark. A polynomial may turn back where there are
            no corners: if given, the fit is restricted to lenses with a ray for every pixel inside.

    Raises:
        UnknownNameError: If there is no such lens model.
        InputError: If views are too few or do not determine a lens, or the model cannot fit them.
    """
    family = find_parameterization(kind)
    most = len(family.terms)
    terms = most if num_terms is None else num_terms
    require(0 <= terms <= most, f"The number of terms of {kind}", terms, f"0 to {most}")
    many = f"{MIN_VIEWS} or more"
    require(len(views) >= MIN_VIEWS, "The number of boards seen", len(views), many)
    problem = _Problem(family, board, size, np.stack([view.pixels for view in views]))
    lens, poses = initial_lens(family, size, board.points, problem.pixels)
    for count in sorted({min(1, terms), terms}):
        lens, poses = problem.solve(lens, poses, count)
    lens, poses = _robust(problem, lens, poses, terms)
    if circle_px is not None and not sees_image(lens, size, circle_px):
        problem = replace(problem, rim_px=_RIM_MARGIN * _farthest(lens, size, circle_px))
        lens, poses = _robust(problem, lens, poses, terms)
    residuals = problem.residuals(lens, poses)
    names, covariance = problem.covariance(lens, poses, terms)
    return Calibration(lens, names, covariance, tuple(views), board, size, poses, residuals)


def check_fit(fit: Calibration) -> None:
    """Check that a lens fits its corners.

    Corners of real photographs fit to 0.3 to 0.9 px; boards with wrong square counts, of which only
    part is detected, to 2 px and worse.

    Raises:
        InputError: If the RMS error is above `MAX_RMS_PX`, or in large photographs
            above `MAX_RMS` of the shorter side.
    """
    most = max(MAX_RMS_PX, MAX_RMS * min(fit.size))
    if fit.rms_px > most:
        worst = fit.views[int(np.argmax(fit.errors.mean(axis=1)))].name
        raise InputError(
            f"The lens misses the corners by {fit.rms_px:.2f} px (root mean square), most of all "
            f"in {worst}. Allowed: up to {most:.3g} px. Check that --board counts the squares "
            "along both sides, take out bad photographs, or give another --lens."
        )


def sees_image(lens: Lens, size: Size, circle_px: float | None = None) -> bool:
    """Check whether a lens has a ray for every pixel inside the image and its circle.

    Args:
        lens: The lens.
        size: Width and height of the image [px].
        circle_px: Radius about the lens's center beyond which the image is dark.
    """
    rim, length = _rim(lens, size)
    inside = np.minimum(1.0, (circle_px or np.inf) / np.maximum(length, 1e-9))
    pixels = (lens.cx, lens.cy) + rim * inside[:, None]
    return bool(np.isfinite(lens.unproject(pixels)).all())


def _rim(lens: Lens, size: Size) -> tuple[Float[np.ndarray, "n 2"], Float[np.ndarray, " n"]]:
    """Pixels along the image border relative to the lens's center, and their distances [px]."""
    width, height = size
    columns, rows = np.meshgrid(np.arange(width), np.arange(height))
    border = (columns % (width - 1) == 0) | (rows % (height - 1) == 0)
    away = np.stack([columns[border] - lens.cx, rows[border] - lens.cy], axis=-1)
    return away, np.linalg.norm(away, axis=1)


def _farthest(lens: Lens, size: Size, circle_px: float) -> float:
    """Distance of the farthest lit pixel from the lens's center [px]."""
    return min(float(_rim(lens, size)[1].max()), circle_px)


def _robust(
    problem: _Problem, lens: Lens, poses: np.ndarray, terms: int
) -> tuple[Lens, np.ndarray]:
    """Robust fit from a plain one; the scale of the residuals is updated in each iteration."""
    for _ in range(3):
        scale = 1.4826 * float(np.median(np.abs(problem.residuals(lens, poses))))
        lens, poses = problem.solve(lens, poses, terms, robust=HUBER * max(scale, 1e-9))
    return lens, poses


@dataclass(frozen=True)
class _Problem:
    """Least-squares problem of the corners.

    The unknowns are the fitted fields of the lens, then for each view a rotation vector and the
    board's position, all divided by their scales. The rim's residual follows those of the corners.
    """

    family: LensParameterization
    board: Board
    size: Size
    pixels: Float[np.ndarray, "v n 2"]
    rim_px: float = 0.0

    @property
    def unseen(self) -> float:
        """Residual of a corner outside the lens's field [px]: too large for a step to pass."""
        return 10.0 * sum(self.size)

    def residuals(self, lens: Lens, poses: np.ndarray) -> Float[np.ndarray, "v n 2"]:
        projected = lens.project(transform_points(poses, self.board.points))
        return np.where(np.isnan(projected), self.unseen, self.pixels - projected)

    def shortfall(self, lens: Lens) -> float:
        """Weighted difference between `rim_px` and the maximum image radius of the lens [px].

        Where a free fit stays below, a constrained fit reaches exactly the rim.
        """
        if self.rim_px == 0.0:
            return 0.0
        pixels = lens.project(_FAN) - (lens.cx, lens.cy)
        return _RIM_WEIGHT * (self.rim_px - float(np.nanmax(np.hypot(*pixels.T))))

    def solve(
        self, lens: Lens, poses: np.ndarray, num_terms: int, *, robust: float | None = None
    ) -> tuple[Lens, np.ndarray]:
        """Lens and poses by least squares, or by Huber's function with its knee at `robust`."""
        names = self.family.names(num_terms)
        solution = scipy.optimize.least_squares(
            lambda x: self._all(x, lens, names),
            self._packed(lens, poses, names),
            jac=lambda x: self._jacobian(x, lens, names),  # type: ignore[arg-type]
            loss="linear" if robust is None else "huber",
            f_scale=robust or 1.0,
            x_scale="jac",
            max_nfev=200,
        )
        return self._unpacked(solution.x, lens, names)

    def covariance(
        self, lens: Lens, poses: np.ndarray, num_terms: int
    ) -> tuple[tuple[str, ...], np.ndarray]:
        """Fitted fields and the covariance of their errors (M-estimate; Huber 1981, eq. 7.6.5).

        Raises:
            InputError: If the views do not determine a lens, or the lens does not see all corners.
        """
        residuals = self.residuals(lens, poses).ravel()
        if np.abs(residuals).max() >= self.unseen:
            raise InputError(
                f"No {lens.kind} lens reaches all corners. Allowed: another --lens, fewer --terms."
            )
        names = self.family.names(num_terms)
        jacobian = self._jacobian(self._packed(lens, poses, names), lens, names)[:-1]
        column = np.linalg.norm(jacobian, axis=0)
        scaled = jacobian / np.where(column > 0.0, column, 1.0)
        values, rotation = np.linalg.svd(scaled, full_matrices=False)[1:]
        if not values[-1] > _SINGULAR * values[0]:
            raise InputError(
                "The photographs do not determine the lens: the board is always at the same tilt. "
                "Allowed: some tilted by 20° to 45° to different sides."
            )
        knee = HUBER * 1.4826 * np.median(np.abs(residuals))
        inside = float(np.mean(np.abs(residuals) <= knee))
        spare = residuals.size - jacobian.shape[1]
        variance = float(np.sum(np.clip(residuals, -knee, knee) ** 2)) / spare / inside**2
        spread = (rotation / values[:, None] / column)[:, : len(names)]
        spread = spread * self.family.scales(names, self.size)
        return names, variance * spread.T @ spread

    def _packed(self, lens: Lens, poses: np.ndarray, names: tuple[str, ...]) -> np.ndarray:
        turns = scipy.spatial.transform.Rotation.from_matrix(poses[:, :3, :3]).as_rotvec()
        scaled = values_of(lens, names) / self.family.scales(names, self.size)
        return np.concatenate([scaled, np.hstack([turns, poses[:, :3, 3] / self._reach]).ravel()])

    def _unpacked(
        self, x: np.ndarray, lens: Lens, names: tuple[str, ...]
    ) -> tuple[Lens, np.ndarray]:
        count = len(names)
        moved = x[count:].reshape(-1, 6)
        poses = transform_from(
            scipy.spatial.transform.Rotation.from_rotvec(moved[:, :3]).as_matrix(),
            moved[:, 3:] * self._reach,
        )
        scaled = x[:count] * self.family.scales(names, self.size)
        positive = [name in self.family.focal for name in names]
        return with_values(lens, names, np.where(positive, np.abs(scaled), scaled)), poses

    @property
    def _reach(self) -> float:
        return self.board.square * max(self.board.grid)

    def _all(self, x: np.ndarray, lens: Lens, names: tuple[str, ...]) -> Float[np.ndarray, " r"]:
        moved, poses = self._unpacked(x, lens, names)
        return np.append(self.residuals(moved, poses), self.shortfall(moved))

    def _jacobian(
        self, x: np.ndarray, lens: Lens, names: tuple[str, ...]
    ) -> Float[np.ndarray, "r p"]:
        """Central differences; one step moves all views at once, since each has its own pose."""
        count, num_views = len(names), len(self.pixels)

        def slope(step: np.ndarray) -> np.ndarray:
            after, before = (self._all(x + s * step, lens, names) for s in (1.0, -1.0))
            return (after - before) / (2.0 * _STEP)

        jacobian = np.zeros((self.pixels.size + 1, x.size))
        for k in range(count):
            jacobian[:, k] = slope(_STEP * (np.arange(x.size) == k))
        by_view = jacobian[:-1].reshape(num_views, -1, x.size)
        views = np.arange(num_views)
        for k in range(6):
            step = np.zeros(x.size)
            step[count + k :: 6] = _STEP
            by_view[views, :, count + k + 6 * views] = slope(step)[:-1].reshape(num_views, -1)
        return jacobian


def find_camera(device: Device, name: str | None) -> Camera:
    """Return a camera of a device by name; the first if the name is None.

    Raises:
        UnknownNameError: If the device has no such camera.
    """
    cameras = {camera.name: camera for camera in device.cameras}
    if name is not None and name not in cameras:
        raise UnknownNameError(f"camera of {device.name}", name, cameras)
    return device.cameras[0] if name is None else cameras[name]


def with_camera(device: Device, old: Camera, new: Camera) -> Device:
    """Copy of a device with one camera replaced."""
    cameras = tuple(new if camera is old else camera for camera in device.cameras)
    return replace(device, cameras=cameras)


def calibrated_device(
    pattern: Device, fit: Calibration, *, camera: str | None = None, circle_px: float | None = None
) -> Device:
    """Copy of a device whose camera has the fitted lens and the photographs' size.

    Args:
        pattern: Provides body, magnets, LEDs, positions and exposure.
        fit: The lens.
        camera: Name of the camera to change; by default the first.
        circle_px: Radius about the lens's center beyond which the sensor is dark.

    Raises:
        UnknownNameError: If the pattern has no such camera.
    """
    old = find_camera(pattern, camera)
    width, height = fit.size
    new = replace(
        old,
        **{"lens": fit.lens, "width": width, "height": height},
        image_circle_px=circle_px,
        nominal_field=None,
    )
    source = (
        f"Lens of camera {old.name}: {fit.lens.kind} model fitted to {len(fit.views)} photographs "
        f"of a chessboard, mean error {fit.errors.mean():.3f} px. All else as in {pattern.name}: "
        f"{pattern.source.strip()}"
    )
    names = (view.name for view in fit.views)
    facts = {
        "photographs": list(names),
        "mean_error_px": round(float(fit.errors.mean()), 4),
        "deviations": {
            name: float(f"{spread:.3g}")
            for name, spread in zip(fit.names, fit.deviations.tolist(), strict=True)
        },
    }
    changed = with_camera(pattern, old, new)
    metadata = {**pattern.metadata, "calibration": facts}
    title = f"{pattern.title}, lens calibrated"
    return replace(changed, title=title, source=source, metadata=metadata)
