import numpy as np
import pytest

from vrcaps.core.units import MM
from vrcaps.lesion import Polyp, draw_lesions
from vrcaps.lesion.library import COLON_PREVALENCE, Prevalence


@pytest.mark.slow
def test_means():
    """A Poisson count of mean m has a standard error √(m / n)."""
    rng = np.random.default_rng(0)
    patients = [draw_lesions(None, rng) for _ in range(800)]
    expected = sum(row.mean for row in COLON_PREVALENCE)
    mean = np.mean([len(lesions) for lesions in patients])
    assert mean == pytest.approx(expected, abs=4 * (expected / 800) ** 0.5)


def test_sizes_and_segments(tube):
    row = Prevalence("polyp-Is", 3.0, (4 * MM, 9 * MM), {"upper": 1.0, "appendix": 1.0})
    lesions = draw_lesions(tube, np.random.default_rng(0), table=[row], exaggerate=20.0)
    assert 30 < len(lesions) < 90
    assert {lesion.location.segment for lesion in lesions} == {"upper", None}
    for lesion in lesions:
        assert isinstance(lesion, Polyp)
        assert 4 * MM <= lesion.size <= 9 * MM


def test_same_seed_same_lesions():
    one, two = (draw_lesions(None, np.random.default_rng(4)) for _ in range(2))
    assert one == two
