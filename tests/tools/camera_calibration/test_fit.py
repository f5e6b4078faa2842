"""Lenses come back from corners: exactly, within their deviations, and from photographs."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.stats import chi2

from tests.support.boards import corners, held
from vrcaps.camera.lens import LensKannalaBrandt, LensPinhole, LensScaramuzza
from vrcaps.capsule.device_file import read_device, read_device_file, write_device
from vrcaps.core.errors import InputError, UnknownNameError
from vrcaps.tools.camera_calibration.board import Board, BoardView, find_views
from vrcaps.tools.camera_calibration.circle import image_circle
from vrcaps.tools.camera_calibration.fit import (
    Calibration,
    _Problem,
    calibrate,
    calibrated_device,
    check_fit,
    sees_image,
)
from vrcaps.tools.camera_calibration.parameterization import PARAMETERIZATIONS, plane_pose
from vrcaps.tools.photos import read_photos

BOARD = Board(7, 8, 2e-3)
SIZE = (320, 320)
PATTERN = read_device("mirocam").cameras[0]
LENSES = {
    "pinhole": LensPinhole(158.0, 161.0, 157.2, 163.1, k1=-0.2, k2=0.04, k3=-0.003),
    "kannala-brandt": LensKannalaBrandt(
        *(118.0, 119.5, 162.0, 158.3), k1=0.05, k2=-0.02, k3=0.01, k4=-0.002
    ),
    "scaramuzza": LensScaramuzza(136.0, -5.7e-3, 5.8e-5, -2.3e-7, 162.2, 160.5),
}
KINDS = tuple(LENSES)


def seen(kind: str, seed: int, noise: float, count: int = 8) -> tuple[BoardView, ...]:
    """Corners of boards held before a lens, with normal errors of a deviation [px]."""
    rng = np.random.default_rng(seed)
    camera = replace(PATTERN, lens=LENSES[kind], image_circle_px=None)
    true = corners(camera, held(camera, BOARD, count, rng), BOARD)
    return tuple(
        BoardView(str(k), pixels + noise * rng.normal(size=pixels.shape))
        for k, pixels in enumerate(true)
    )


def scores(fit: Calibration, kind: str) -> np.ndarray:
    """Errors of the parameters in stated deviations."""
    off = [getattr(fit.lens, name) - getattr(LENSES[kind], name) for name in fit.names]
    return np.array(off) / fit.deviations


@pytest.mark.slow
@pytest.mark.parametrize("kind", KINDS)
def test_exact_corners_give_the_lens_and_the_poses_back(kind: str) -> None:
    rng = np.random.default_rng(5)
    camera = replace(PATTERN, lens=LENSES[kind], image_circle_px=None)
    poses = held(camera, BOARD, 5, rng)
    views = [BoardView(str(k), p) for k, p in enumerate(corners(camera, poses, BOARD))]
    fit = calibrate(views, BOARD, SIZE, kind)
    for name in fit.names:
        assert getattr(fit.lens, name) == pytest.approx(getattr(LENSES[kind], name), rel=1e-5)
    np.testing.assert_allclose(fit.Ts_camera_board, poses, atol=1e-7)
    assert fit.errors.max() < 1e-5


@pytest.mark.slow
@pytest.mark.parametrize("kind", KINDS)
def test_noisy_corners_give_parameters_within_their_stated_deviations(kind: str) -> None:
    """``eᵀ C⁻¹ e`` of errors e with covariance C, summed over draws, is chi-squared."""
    fits = [calibrate(seen(kind, seed, 0.15, 6), BOARD, SIZE, kind) for seed in range(2)]
    total, freedom = 0.0, 0
    for fit in fits:
        error = scores(fit, kind) * fit.deviations
        total += float(error @ np.linalg.solve(fit.covariance, error))
        freedom += error.size
    low, high = chi2.ppf([0.001, 0.999], freedom)
    assert low < total < high
    rms = np.sqrt(np.mean([fit.residuals**2 for fit in fits]))
    # Each view's pose and the lens take up some of the noise.
    share = 1.0 - (6 * 6 + len(fits[0].names)) / (6 * 42 * 2)
    assert rms == pytest.approx(0.15 * np.sqrt(share), rel=0.06)


@pytest.mark.slow
def test_badly_found_corners_do_little_harm() -> None:
    clean = seen("kannala-brandt", 1, 0.1)
    views = list(clean)
    rng = np.random.default_rng(0)
    for k in range(3):  # 5 % of all corners, up to 40 px away
        bad = views[k].pixels.copy()
        bad[rng.choice(42, 6, replace=False)] += rng.uniform(-40.0, 40.0, (6, 2))
        views[k] = replace(views[k], pixels=bad)
    fit = calibrate(views, BOARD, SIZE, "kannala-brandt")
    assert np.abs(scores(fit, "kannala-brandt")).max() < 4.0
    without = calibrate(clean, BOARD, SIZE, "kannala-brandt")
    shift = [getattr(fit.lens, name) - getattr(without.lens, name) for name in fit.names]
    assert np.abs(shift / without.deviations).max() < 2.0


def test_a_fit_that_misses_its_corners_is_refused() -> None:
    """A wrong board fits to 2 px and worse; photographs of 2000 px may be off by more."""
    fit = calibrate(seen("kannala-brandt", 1, 0.5, 3), BOARD, SIZE, "kannala-brandt")
    check_fit(fit)
    wrong = replace(fit, residuals=5.0 * fit.residuals)
    with pytest.raises(
        InputError, match=r"misses the corners by 3\.\d+ px .* Allowed: up to 1\.6 px"
    ):
        check_fit(wrong)
    check_fit(replace(wrong, size=(2000, 1500)))


@pytest.mark.slow
def test_a_lens_is_held_to_a_ray_for_every_pixel_of_the_image() -> None:
    """Corners near the axis leave the polynomial free to turn back inside the image."""
    camera = replace(PATTERN, lens=LENSES["kannala-brandt"], image_circle_px=75.0)
    rng = np.random.default_rng(4)
    true = corners(camera, held(camera, BOARD, 6, rng), BOARD)
    noise = 0.3 * np.random.default_rng(0).normal(size=true.shape)
    views = [BoardView(str(k), pixels) for k, pixels in enumerate(true + noise)]
    free = calibrate(views, BOARD, SIZE, "kannala-brandt")
    assert not sees_image(free.lens, SIZE, 160.0)
    fit = calibrate(views, BOARD, SIZE, "kannala-brandt", circle_px=160.0)
    assert sees_image(fit.lens, SIZE, 160.0)
    assert fit.errors.mean() < 1.1 * free.errors.mean()


@pytest.mark.parametrize("kind", KINDS)
def test_the_pose_of_a_board_follows_from_its_rays(kind: str) -> None:
    rng = np.random.default_rng(3)
    camera = replace(PATTERN, lens=LENSES[kind], image_circle_px=None)
    poses = held(camera, BOARD, 5, rng)
    for pose, pixels in zip(poses, corners(camera, poses, BOARD), strict=True):
        np.testing.assert_allclose(plane_pose(LENSES[kind], BOARD.points, pixels), pose, atol=1e-9)


def test_fewer_terms_fit_fewer_fields() -> None:
    views = seen("kannala-brandt", 0, 0.1, count=3)
    fit = calibrate(views, BOARD, SIZE, "kannala-brandt", num_terms=1)
    assert fit.names == ("fx", "fy", "cx", "cy", "k1")
    assert isinstance(fit.lens, LensKannalaBrandt)
    assert fit.lens.k2 == fit.lens.k4 == 0.0


@pytest.mark.slow
def test_what_fixes_no_lens_is_an_error() -> None:
    views = seen("pinhole", 0, 0.1)
    with pytest.raises(InputError, match=r"boards seen is 2\. Allowed: 3 or more"):
        calibrate(views[:2], BOARD, SIZE, "pinhole")
    with pytest.raises(InputError, match=r"terms of pinhole is 4\. Allowed: 0 to 3"):
        calibrate(views, BOARD, SIZE, "pinhole", num_terms=4)
    with pytest.raises(UnknownNameError, match="No lens model to calibrate named 'equidistant'"):
        calibrate(views, BOARD, SIZE, "equidistant")
    problem = _Problem(
        PARAMETERIZATIONS["pinhole"], BOARD, SIZE, np.stack([v.pixels for v in views])
    )
    behind = np.tile(np.diag([1.0, -1.0, -1.0, 1.0]), (len(views), 1, 1))
    with pytest.raises(InputError, match=r"No pinhole lens reaches all corners\. Allowed: another"):
        problem.covariance(LENSES["pinhole"], behind, 3)
    flat = [BoardView(str(k), 20.0 * BOARD.points[:, :2] / 2e-3 + 90.0 + 9 * k) for k in range(3)]
    with pytest.raises(
        InputError, match="do not determine the lens: the board is always at the same tilt"
    ):
        calibrate(flat, BOARD, SIZE, "pinhole", num_terms=0)


STORED = {
    ("MiroCam", "pinhole"): 0.594,
    ("MiroCam", "kannala-brandt"): 0.4745,
    ("MiroCam", "scaramuzza"): 0.4745,
    ("PillCam_Cam1", "pinhole"): 0.4443,
    ("PillCam_Cam1", "kannala-brandt"): 0.2241,
    ("PillCam_Cam1", "scaramuzza"): 0.2241,
}
"""Mean errors of the fits stored with the photographs [px]: MATLAB's pinhole and fisheye."""


@pytest.mark.parametrize(
    "camera", [pytest.param("MiroCam", marks=pytest.mark.validation), "PillCam_Cam1"]
)
def test_photographs_fit_no_worse_than_published(shared_data: Path, tmp_path, camera: str) -> None:
    """The device that comes of it is read back equal and sees its whole image circle."""
    folder = shared_data / "calibration" / camera
    columns, rows = json.loads((folder / "calibration.json").read_text())["session"][
        "board_size_squares"
    ]
    board = Board(int(columns), int(rows), 2e-3)
    photos = read_photos([folder])
    views, missed = find_views(photos, board)
    assert (len(views), missed) == (10, [])
    circle = image_circle([photo.rgb for photo in photos])
    assert circle is not None
    height, width = photos[0].rgb.shape[:2]
    for kind in PARAMETERIZATIONS:
        fit = calibrate(views, board, (width, height), kind, circle_px=circle.radius)
        assert fit.errors.mean() <= STORED[camera, kind]
        edge = circle.radius_about(fit.lens.cx, fit.lens.cy)
        device = calibrated_device(read_device("mirocam"), fit, circle_px=edge)
        write_device(tmp_path / "mine.toml", device)
        assert read_device_file(tmp_path / "mine.toml").cameras[0].lens == fit.lens
        assert sees_image(fit.lens, fit.size, edge)
