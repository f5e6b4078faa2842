"""Depth errors in closed form."""

import numpy as np
import pytest

from vrcaps.core.errors import InputError, UnknownNameError
from vrcaps.metrics.depth import DepthErrors, depth_errors, mean_depth_errors


def test_constant_factor_has_errors_in_closed_form():
    truth = np.array([[0.01, 0.02], [0.04, np.nan]])
    found = depth_errors(1.3 * truth, truth)
    assert found.abs_rel == pytest.approx(0.3)
    assert found.sq_rel == pytest.approx(0.09 * np.nanmean(truth))
    assert found.rmse == pytest.approx(0.3 * np.sqrt(np.nanmean(truth**2)))
    assert found.rmse_log == pytest.approx(np.log(1.3))
    assert (found.delta_1, found.delta_2, found.delta_3) == (0.0, 1.0, 1.0)


@pytest.mark.parametrize("align", ["median", "scale", "scale-and-shift"])
def test_alignment_takes_away_a_factor(align):
    truth = np.random.default_rng(0).uniform(0.005, 0.1, (8, 9))
    found = depth_errors(0.37 * truth, truth, align=align)
    assert found.abs_rel == pytest.approx(0.0, abs=1e-12)
    assert found.delta_1 == 1.0


def test_shift_is_taken_away_by_its_own_alignment_only():
    truth = np.random.default_rng(1).uniform(0.02, 0.1, 50)
    estimate = 2.0 * truth + 0.01
    assert depth_errors(estimate, truth, align="scale-and-shift").rmse < 1e-15
    assert depth_errors(estimate, truth, align="scale").rmse > 1e-3


def test_least_squares_scale_is_the_best_one():
    rng = np.random.default_rng(2)
    truth, estimate = rng.uniform(0.01, 0.1, 100), rng.uniform(0.01, 0.1, 100)
    best = depth_errors(estimate, truth, align="scale").rmse
    factor = np.dot(estimate, truth) / np.dot(estimate, estimate)
    for other in (0.99 * factor, 1.01 * factor):
        assert depth_errors(other * estimate, truth).rmse > best


def test_means_count_images_alike():
    one, two = DepthErrors(*[0.1] * 7), DepthErrors(*[0.3] * 7)
    assert mean_depth_errors([one, two]).rmse == pytest.approx(0.2)
    with pytest.raises(InputError, match="no image"):
        mean_depth_errors([])


def test_bad_input_is_one_clear_line():
    depth = np.full((2, 2), 0.1)
    with pytest.raises(InputError, match=r"shape \(2,\), the truth \(2, 2\)"):
        depth_errors(depth[0], depth)
    with pytest.raises(InputError, match="No pixel has both"):
        depth_errors(depth, np.full_like(depth, np.nan))
    with pytest.raises(UnknownNameError, match=r"'mean'.*Known: median, none"):
        depth_errors(depth, depth, align="mean")  # type: ignore[arg-type]
