from __future__ import annotations

import numpy as np
import pytest
from scipy import ndimage

from vrcaps.tools.mucosa_from_photos.vessels import VesselPlacement, find_vessels, place_vessels

BLOOD = np.array([0.2, 1.0, 0.8])


def wall(color: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Log reflectance with a winding line of 3 px in a color, and the line's mask."""
    rng = np.random.default_rng(0)
    noise = ndimage.gaussian_filter(rng.normal(size=(300, 300)), 1.0)
    x = np.arange(40, 260)
    y = 150.0 + 40.0 * np.sin(x / 25.0)
    line = np.zeros((300, 300), bool)
    line[y.astype(int), x] = True
    distance = ndimage.distance_transform_edt(~line)
    density = 0.35 * np.exp(-0.5 * (distance / 1.5) ** 2)
    return 0.02 * noise[..., None] - density[..., None] * color, distance < 2.0


def test_a_vessel_is_found_where_it_is() -> None:
    flat, truth = wall(BLOOD)
    found = find_vessels(flat, np.ones(truth.shape, bool), 300)
    assert len(found.pieces) >= 1
    near = ndimage.binary_dilation(truth, iterations=2)
    assert (found.mask & near).sum() > 0.9 * found.mask.sum()
    core = ndimage.binary_erosion(truth)
    assert (ndimage.binary_dilation(found.mask) & core).sum() > 0.8 * core.sum()
    assert found.pieces[0].color[0] == pytest.approx(0.2, abs=0.08)
    assert found.pieces[0].density.max() == pytest.approx(0.3, abs=0.12)


def test_the_shadow_of_a_fold_is_no_vessel() -> None:
    flat, truth = wall(np.ones(3))
    assert not find_vessels(flat, np.ones(truth.shape, bool), 300).pieces


def test_nothing_usable_gives_no_vessels() -> None:
    flat, truth = wall(BLOOD)
    assert not find_vessels(flat, np.zeros(truth.shape, bool), 300).pieces


def test_laid_vessels_cover_the_share_asked_for_and_continue_over_the_edges() -> None:
    flat, truth = wall(BLOOD)
    pieces = find_vessels(flat, np.ones(truth.shape, bool), 300).pieces
    density = place_vessels(pieces, 0.05, 512, VesselPlacement(), np.random.default_rng(0))
    assert (density[..., 1] > 0.04).mean() == pytest.approx(0.05, abs=0.01)
    quarters = density[..., 1].reshape(2, 256, 2, 256).mean(axis=(1, 3))
    assert quarters.max() < 2.0 * quarters.mean()
    assert density[[0, -1]].max() > 0.04
    again = place_vessels(pieces, 0.05, 512, VesselPlacement(), np.random.default_rng(0))
    assert density.tobytes() == again.tobytes()


def test_no_pieces_leave_the_texture_as_it_is() -> None:
    assert not place_vessels([], 0.1, 64, VesselPlacement(), np.random.default_rng(0)).any()
