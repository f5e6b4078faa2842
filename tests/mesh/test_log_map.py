import sys
from dataclasses import replace

import numpy as np
import pytest

from vrcaps.core.errors import InputError, MissingExtraError
from vrcaps.core.units import MM
from vrcaps.lesion.mesh_patch import extract, whole_wall, within
from vrcaps.mesh.patch import log_map


def piece_of(tube):
    wall = whole_wall(tube)
    vertex = int(np.argmin(np.abs(tube.arc_length - 80.0 * MM) + np.abs(tube.theta)))
    piece = extract(wall, within(wall, np.array([vertex]), 25.0 * MM))
    return piece.patch, int(np.searchsorted(piece.vertices, vertex))


def test_developable(tube):
    """A cylinder unrolls: the log map about (θ₀, s₀) is (R (θ − θ₀), s − s₀), turned."""
    patch, center = piece_of(tube)
    xy, axes = log_map(patch, center, radius=12.0 * MM, edge_length=1.5 * MM)
    theta = np.arctan2(patch.moved[:, 1], patch.moved[:, 0])
    flat = np.stack([18.0 * MM * (theta - theta[center]), patch.moved[:, 2] - 80.0 * MM], axis=1)
    near = (np.linalg.norm(flat, axis=1) < 12.0 * MM) & (np.arange(len(flat)) != center)
    assert np.linalg.norm(xy[near], axis=1) == pytest.approx(
        np.linalg.norm(flat[near], axis=1), rel=2e-3
    )
    around, along = axes[:, :2].T @ np.array([0.0, 1.0, 0.0]), axes[:, :2].T @ np.array([0.0, 0, 1])
    expected = flat[:, :1] * around + flat[:, 1:] * along
    apart = np.linalg.norm(xy - expected, axis=1)[near]
    assert np.median(apart) < 0.05 * MM
    assert apart.max() < 0.6 * MM


def test_axes_are_right_handed_about_the_normal_into_the_lumen(tube):
    patch, center = piece_of(tube)
    _, axes = log_map(patch, center, radius=5.0 * MM, edge_length=1.5 * MM)
    assert axes.T @ axes == pytest.approx(np.eye(3), abs=1e-6)
    assert np.linalg.det(axes) == pytest.approx(1.0)
    assert axes[:2, 2] @ patch.moved[center, :2] < 0.0


def test_needles_are_an_error(tube):
    patch, center = piece_of(tube)
    flat = replace(patch, moved=patch.moved * [0.0, 0.0, 1.0])
    with pytest.raises(InputError, match="too thin"):
        log_map(flat, center, radius=5.0 * MM, edge_length=1.5 * MM)


def test_missing_extra(tube, monkeypatch):
    patch, center = piece_of(tube)
    monkeypatch.setitem(sys.modules, "potpourri3d", None)
    with pytest.raises(MissingExtraError, match=r"vrcaps\[lesions\]"):
        log_map(patch, center, radius=5.0 * MM, edge_length=1.5 * MM)
