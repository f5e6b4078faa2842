"""Lens models against OpenCV, and against published calibrations of real capsules."""

import json
from dataclasses import astuple

import numpy as np
import pytest

from vrcaps.camera.lens import LensKannalaBrandt, LensPinhole, LensScaramuzza
from vrcaps.capsule.device_file import read_device


def rotation_from_vector(vector) -> np.ndarray:
    """Rodrigues' formula: R = I + sin θ K + (1 - cos θ) K²."""
    angle = np.linalg.norm(vector)
    x, y, z = np.asarray(vector) / angle
    cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    return np.eye(3) + np.sin(angle) * cross + (1.0 - np.cos(angle)) * cross @ cross


def points_ahead(rng: np.random.Generator, widest: float) -> np.ndarray:
    radius, turn = rng.uniform(0, widest, 5000), rng.uniform(0, 2 * np.pi, 5000)
    plane = np.stack([radius * np.cos(turn), radius * np.sin(turn), np.ones(5000)], axis=-1)
    return plane * rng.uniform(0.5, 2.0, (5000, 1))


@pytest.mark.parametrize("seed", range(10))
def test_kannala_brandt_agrees_with_opencv(seed):
    cv2 = pytest.importorskip("cv2")
    rng = np.random.default_rng(seed)
    k = rng.uniform(-0.1, 0.1, 4)
    lens = LensKannalaBrandt(135.0, 131.0, 160.3, 158.1, *k)
    points = points_ahead(rng, np.tan(min(lens.limit, 1.4)))
    camera = np.array([[135.0, 0, 160.3], [0, 131.0, 158.1], [0, 0, 1]])
    theirs, _ = cv2.fisheye.projectPoints(points[:, None], np.zeros(3), np.zeros(3), camera, k)
    np.testing.assert_allclose(lens.project(points), theirs[:, 0], rtol=0, atol=1e-6)


@pytest.mark.parametrize("seed", range(10))
def test_pinhole_agrees_with_opencv(seed):
    cv2 = pytest.importorskip("cv2")
    rng = np.random.default_rng(seed)
    k1, k2, k3 = rng.uniform(-0.3, 0.3, 3) * (1.0, 0.5, 0.2)
    p1, p2 = rng.uniform(-0.01, 0.01, 2)
    lens = LensPinhole(159.6, 159.2, 160.9, 162.2, 0.0, k1, k2, p1, p2, k3)
    points = points_ahead(rng, min(lens.limit, 5.0))
    camera = np.array([[159.6, 0, 160.9], [0, 159.2, 162.2], [0, 0, 1]])
    theirs, _ = cv2.projectPoints(
        points, np.zeros(3), np.zeros(3), camera, np.array([k1, k2, p1, p2, k3])
    )
    np.testing.assert_allclose(lens.project(points), theirs[:, 0], rtol=0, atol=1e-6)


@pytest.mark.parametrize(
    ("folder", "model", "published", "num_past_fold"),
    [
        ("MiroCam", "fisheye", 0.474, 0),
        ("PillCam_Cam1", "fisheye", 0.224, 0),
        ("MiroCam", "pinhole", 0.594, 0),
        ("PillCam_Cam1", "pinhole", 0.444, 1),
    ],
)
def test_published_models_reproject_real_corners_as_published(
    shared_data, folder, model, published, num_past_fold
):
    """One of PillCam's 480 corners lies where its pinhole model has folded over.

    The fit evaluated the polynomial there too; our field ends at the fold, so that corner is
    taken from the equation.
    """
    record = json.loads((shared_data / "calibration" / folder / "calibration.json").read_text())
    fit, session = record[model], record["session"]
    board = np.array([[*xy, 0.0] for xy in session["world_points_xy"]])
    poses = zip(fit["rotation_vectors_rodrigues"], fit["translation_vectors"], strict=True)
    points = np.array([board @ rotation_from_vector(v).T + shift for v, shift in poses])
    pixels = _lens(fit).project(points)
    past_fold = np.isnan(pixels[..., 0])
    assert np.count_nonzero(past_fold) == num_past_fold
    if num_past_fold:
        pixels[past_fold] = _brown_conrady(fit, points[past_fold])
    corners = np.array(session["corner_pixels_matlab_1based"]) - 1.0
    errors = np.linalg.norm(pixels - corners, axis=-1)
    np.testing.assert_allclose(errors.mean(axis=1), fit["per_image_mean_error_px"], atol=1e-9)
    assert errors.mean() == pytest.approx(published, abs=5e-4)


@pytest.mark.parametrize(
    ("folder", "name"), [("MiroCam", "mirocam"), ("PillCam_Cam1", "pillcam-colon2")]
)
def test_catalog_holds_the_published_lens(shared_data, folder, name):
    record = json.loads((shared_data / "calibration" / folder / "calibration.json").read_text())
    lens = read_device(name).cameras[0].lens
    assert isinstance(lens, LensScaramuzza)
    published, ours = astuple(_lens(record["fisheye"])), astuple(lens)
    np.testing.assert_allclose(ours[:-1], published[:-1], rtol=1e-14)


def _brown_conrady(fit: dict, points: np.ndarray) -> np.ndarray:
    plane = points[:, :2] / points[:, 2:]
    square = np.sum(plane**2, axis=1, keepdims=True)
    plane = plane * (1.0 + fit["radial"][0] * square + fit["radial"][1] * square**2)
    return plane * (fit["fx"], fit["fy"]) + (fit["cx"] - 1.0, fit["cy"] - 1.0)


def _lens(fit: dict) -> LensPinhole | LensScaramuzza:
    """A lens from MATLAB's figures, whose pixels count from 1."""
    if "mapping_a0_a2_a3_a4" in fit:
        (c, d), (e, _) = fit["stretch"]
        cx, cy = (value - 1.0 for value in fit["distortion_center"])
        return LensScaramuzza(*fit["mapping_a0_a2_a3_a4"], cx, cy, c, d, e)
    k1, k2 = fit["radial"]
    p1, p2 = fit["tangential"]
    center = fit["cx"] - 1.0, fit["cy"] - 1.0
    return LensPinhole(fit["fx"], fit["fy"], *center, fit["skew"], k1, k2, p1, p2)


def test_pinhole_model_of_pillcam_folds_over_at_94_pixels():
    """Camera 1's published pinhole model; beyond the fold two angles would share a pixel."""
    focal, center = 74.309, 128.0
    lens = LensPinhole(focal, focal, center, center, k1=0.1993626943701672, k2=-0.127914944844721)
    assert np.degrees(np.arctan(lens.limit)) == pytest.approx(53.3, abs=0.1)
    columns = center + np.arange(0.0, 128.0, 0.01)
    rays = lens.unproject(np.stack([columns, np.full_like(columns, center)], axis=-1))
    seen = np.isfinite(rays[:, 0])
    assert columns[seen].max() - center == pytest.approx(94.0, abs=1.5)
    assert not seen[np.argmin(seen) :].any()
    assert np.all(np.diff(rays[seen, 0]) > 0.0)
