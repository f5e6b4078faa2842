"""The elements against closed forms and against scikit-fem."""

from __future__ import annotations

import numpy as np
import pytest

from tests.support.fem_errors import (
    bending_error,
    cantilever_error,
    lame_error,
    mode_errors,
    patch_error,
)
from tests.support.fem_shapes import bumpy, plate, whole_matrices
from vrcaps.tissue.fem.deformation import FemDeformation
from vrcaps.tissue.fem.layer import extrude, integration_points

FREE = FemDeformation(support=0.0, youngs_modulus=1e5, density=1000.0)


def test_patch_test_on_curved_elements() -> None:
    """Under linear displacements of the border every inside node follows."""
    assert patch_error() < 1e-9


def test_cantilever_is_that_of_scikit_fem() -> None:
    """The same mesh of the same elements under its weight, node by node."""
    pytest.importorskip("skfem")
    assert cantilever_error() < 1e-6


@pytest.mark.parametrize("nu", [0.0, 0.45, 0.49])
@pytest.mark.parametrize("slenderness", [2.5, 5.0, 10.0])
def test_thin_bending_does_not_lock(nu: float, slenderness: float) -> None:
    assert bending_error(nu, slenderness) < (0.02 if slenderness < 10.0 else 0.05)


def test_first_modes_of_a_cantilever() -> None:
    assert mode_errors().max() < 0.005


def test_rigid_motions_cost_nothing_and_mass_is_all_there() -> None:
    layer = extrude(bumpy(np.random.default_rng(1)), 2e-3, 1)
    matrices, stiffness, mass = whole_matrices(layer, FREE)
    turn = np.cross([0.2, -0.5, 0.3], layer.nodes).ravel()
    shift = np.tile([1.0, 2.0, 3.0], len(layer.nodes))
    for motion in (turn, shift):
        assert np.abs(stiffness @ motion).max() < 1e-10 * np.abs(stiffness).max()
    volume = integration_points(layer.nodes, layer.tetrahedra, 3).weights.sum()
    assert matrices.node_mass.sum() == pytest.approx(FREE.density * volume)
    assert shift @ mass @ shift == pytest.approx(14.0 * FREE.density * volume)


def test_support_pushes_back_by_area() -> None:
    """A shift of the whole plate by u is held by k A u."""
    layer = extrude(plate((3, 2), (0.03, 0.02)), 2e-3, 1)
    _, stiffness, _ = whole_matrices(layer, FemDeformation(support=1e6))
    force = stiffness @ np.tile([0.0, 1e-3, 2e-3], len(layer.nodes))
    np.testing.assert_allclose(force.reshape(-1, 3).sum(0), [0, 0.6, 1.2], rtol=1e-9, atol=1e-12)


@pytest.mark.slow
@pytest.mark.parametrize("nu", [0.3, 0.49])
def test_tube_under_pressure_is_lames(nu: float) -> None:
    """Within 2 % on a coarse mesh, and the displacement converges with the third power."""
    (coarse, coarse_l2), (_, fine_l2) = lame_error(2, nu), lame_error(4, nu)
    assert coarse < 0.02
    assert np.log2(coarse_l2 / fine_l2) > 2.7
