"""The schematic patient lies around the organ, wherever its frame has its origin."""

from __future__ import annotations

import numpy as np
import pytest

from vrcaps.cockpit.scene.patient_node import patient_outline

STOMACH = np.array([[-0.04, -0.09, 0.05], [0.11, 0.06, 0.22], [0.03, 0.0, 0.12]])


@pytest.mark.parametrize("offset", [(0.0, 0.0, 0.0), (0.15, -0.3, -1.2)])
def test_the_trunk_encloses_the_organ_at_its_height(offset):
    organ = STOMACH + np.array(offset)
    lines = patient_outline(organ)
    assert lines.shape[1:] == (2, 3)
    assert np.ptp(lines[..., 2]) == pytest.approx(1.73)
    near = lines.reshape(-1, 3)
    height = np.abs(near[:, 2] - organ[:, 2].mean()) < 0.1
    assert (near[height].min(axis=0) < organ.min(axis=0))[:2].all()
    assert (near[height].max(axis=0) > organ.max(axis=0))[:2].all()


def test_left_and_right_are_alike_and_a_large_organ_widens_the_trunk():
    lines = patient_outline(STOMACH)
    ends = np.sort(lines.reshape(-1, 3)[:, 0])
    np.testing.assert_allclose(ends, -ends[::-1], atol=1e-12)
    wide = patient_outline(STOMACH * (2.5, 1.0, 1.0))
    assert wide[..., 0].max() > 1.2 * lines[..., 0].max()
    np.testing.assert_allclose(wide[..., 2], lines[..., 2] + wide[0, 0, 2] - lines[0, 0, 2])
