"""Scores of classes, masks, images and surfaces against closed forms and independent software."""

import numpy as np
import pytest

from vrcaps.core.errors import InputError
from vrcaps.mesh.mesh import Mesh
from vrcaps.metrics.bootstrap import bootstrap, mean_band
from vrcaps.metrics.depth import surface_distances, surface_errors
from vrcaps.metrics.images import psnr, ssim
from vrcaps.metrics.labels import (
    accuracy,
    boundary_f_score,
    confusion_matrix,
    dice,
    f1_scores,
    hausdorff_95,
    iou,
    matthews,
    roc_auc,
)
from vrcaps.metrics.simcol3d import score_depth


@pytest.fixture(scope="module")
def labels():
    rng = np.random.default_rng(0)
    truth = rng.integers(0, 4, 300)
    return np.where(rng.random(300) < 0.6, truth, rng.integers(0, 4, 300)), truth


def test_class_scores_are_those_of_scikit_learn(labels):
    oracle = pytest.importorskip("sklearn.metrics", reason="scikit-learn is not installed")
    estimate, truth = labels
    confusion = confusion_matrix(estimate, truth, 4)
    np.testing.assert_array_equal(confusion, oracle.confusion_matrix(truth, estimate))
    np.testing.assert_allclose(f1_scores(confusion), oracle.f1_score(truth, estimate, average=None))
    assert matthews(confusion) == pytest.approx(oracle.matthews_corrcoef(truth, estimate))
    assert accuracy(confusion) == pytest.approx(oracle.accuracy_score(truth, estimate))
    score = np.round(np.random.default_rng(1).random(300), 1)  # with ties
    assert roc_auc(score, truth == 2) == pytest.approx(oracle.roc_auc_score(truth == 2, score))


def test_empty_cases_of_class_scores():
    zero = np.zeros(5, int)
    confusion = confusion_matrix(zero, zero, 3)
    assert f1_scores(confusion).tolist() == [1.0, 0.0, 0.0]
    assert matthews(confusion) == 0.0
    assert np.isnan(roc_auc(np.ones(5), np.ones(5, bool)))
    with pytest.raises(InputError, match="a class is 3"):
        confusion_matrix(zero + 3, zero, 3)


def _disk(radius, center=(40, 40)):
    y, x = np.mgrid[:90, :90]
    return (x - center[0]) ** 2 + (y - center[1]) ** 2 <= radius**2


def test_masks_in_closed_form():
    small, large = _disk(20), _disk(30)
    assert dice(small, large) == pytest.approx(2 * 20**2 / (20**2 + 30**2), rel=0.01)
    assert iou(small, large) == pytest.approx(20**2 / 30**2, rel=0.01)
    assert hausdorff_95(small, large) == pytest.approx(10.0, abs=0.8)
    assert boundary_f_score(small, large, tolerance=5.0) == 0.0
    assert boundary_f_score(small, large, tolerance=11.0) == 1.0
    assert boundary_f_score(small, _disk(20, (41, 40))) == 1.0


def test_empty_masks():
    empty, disk = np.zeros((90, 90), bool), _disk(10)
    assert dice(empty, empty) == iou(empty, empty) == boundary_f_score(empty, empty) == 1.0
    assert dice(empty, disk) == iou(empty, disk) == boundary_f_score(disk, empty) == 0.0
    assert hausdorff_95(empty, empty) == 0.0
    assert np.isinf(hausdorff_95(empty, disk))


def test_psnr_in_closed_form_and_ssim_of_equal_and_noisy_images():
    rng = np.random.default_rng(2)
    image = rng.integers(0, 200, (48, 60, 3)).astype(np.uint8)
    assert psnr(image + np.uint8(5), image, data_range=255) == pytest.approx(
        20 * np.log10(255 / 5), rel=1e-12
    )
    assert psnr(image, image, data_range=255) == np.inf
    assert ssim(image, image, data_range=255) == pytest.approx(1.0)
    noisy = np.clip(image + rng.normal(0, 40, image.shape), 0, 255)
    assert ssim(noisy, image, data_range=255, crop=4) < 0.95
    with pytest.raises(InputError, match="crop is 30"):
        psnr(image, image, data_range=255, crop=30)


def test_challenge_score_of_depth_finds_one_scale_per_trajectory():
    truth = np.random.default_rng(3).uniform(0.01, 0.15, (4, 6, 7))
    score = score_depth(0.5 * truth, truth)
    assert score.scale == pytest.approx(2.0)
    assert max(score.l1, score.relative, score.rmse) < 1e-12
    score = score_depth(truth + 0.001, truth)
    assert score.l1 == pytest.approx(score.rmse, rel=0.2)


def test_points_off_a_plane_have_their_height_as_distance():
    square = np.array([[-1, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]], float)
    plane = Mesh(square, np.array([[0, 1, 2], [0, 2, 3]]))
    rng = np.random.default_rng(4)
    height = rng.normal(0.0, 0.05, 500)
    points = np.column_stack([rng.uniform(-0.9, 0.9, (500, 2)), height])
    found = surface_errors(surface_distances(points, plane))
    assert found.rmse == pytest.approx(np.sqrt(np.mean(height**2)), rel=1e-5)
    assert found.median == pytest.approx(np.median(np.abs(height)), rel=1e-5)


def test_interval_of_a_mean_has_the_width_of_its_standard_error():
    values = np.random.default_rng(5).normal(1.0, 2.0, 400)
    found = bootstrap(lambda items: float(values[items].mean()), 400, resamples=2000)
    assert found.value == pytest.approx(values.mean())
    assert found.high - found.low == pytest.approx(2 * 1.96 * values.std() / 20, rel=0.08)


def test_groups_that_are_alike_widen_the_interval():
    groups = np.repeat(np.arange(20), 20)
    values = np.random.default_rng(6).normal(size=20)[groups]

    def mean(items):
        return float(values[items].mean())

    alone, together = bootstrap(mean, 400), bootstrap(mean, 400, groups=groups)
    ratio = (together.high - together.low) / (alone.high - alone.low)
    assert ratio == pytest.approx(np.sqrt(20), rel=0.25)


def test_a_band_has_the_interval_of_each_of_its_places():
    curves, groups = np.random.default_rng(7).normal(size=(40, 3)), np.repeat(np.arange(8), 5)
    low, high = mean_band(curves, groups=groups, resamples=100, seed=3)
    for place, values in enumerate(curves.T):
        alone = bootstrap(
            lambda items, of=values: float(of[items].mean()),
            40,
            groups=groups,
            resamples=100,
            seed=3,
        )
        assert (low[place], high[place]) == pytest.approx((alone.low, alone.high))
