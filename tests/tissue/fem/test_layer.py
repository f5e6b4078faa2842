"""From a fine surface to a coarse layer that carries it."""

from __future__ import annotations

import numpy as np
import pytest

from tests.support.fem_shapes import bumpy, straight_tube
from vrcaps.core.errors import InputError
from vrcaps.organ.surface import OrganSurface
from vrcaps.tissue.fem.coarse import coarsen, low_pass
from vrcaps.tissue.fem.layer import extrude, integration_points
from vrcaps.tissue.fem.wall import embed


def test_layer_of_a_tube_has_its_volume(tube: OrganSurface) -> None:
    """π ((r + h)² − r²) L, and every node of the surface lies at r."""
    coarsened = coarsen(tube.vertices, tube.faces, 0.012, 2e-3)
    layer = extrude(coarsened.surface, 2e-3, 1)
    volume = integration_points(layer.nodes, layer.tetrahedra, 3).weights.sum()
    assert volume == pytest.approx(np.pi * (0.022**2 - 0.02**2) * 0.12, rel=0.02)
    distance = np.linalg.norm(layer.surface.nodes[:, :2], axis=1)
    middle = np.abs(layer.surface.nodes[:, 2] - 0.06) < 0.03
    np.testing.assert_allclose(distance[middle], 0.02, rtol=0.01)
    np.testing.assert_allclose(distance, 0.02, rtol=0.05)
    assert set(np.round(layer.surface.nodes[coarsened.border, 2], 3)) == {0.0, 0.12}


def test_neighboring_elements_share_whole_faces() -> None:
    """Every inner face is met twice, by elements whose middles of edges agree."""
    layer = extrude(bumpy(np.random.default_rng(0)), 3e-3, 2)
    faces = layer.tetrahedra[:, [[0, 1, 2, 4, 5, 6], [0, 1, 3, 4, 8, 7]]].reshape(-1, 6)
    more = layer.tetrahedra[:, [[1, 2, 3, 5, 9, 8], [0, 2, 3, 6, 9, 7]]].reshape(-1, 6)
    faces = np.sort(np.concatenate([faces, more]), axis=1)
    _, whole = np.unique(faces, axis=0, return_counts=True)
    assert set(whole) == {1, 2}
    num_sides = 2 * (4 + 3) * 2 * 2 + 2 * 24
    assert (whole == 1).sum() == num_sides


def test_embedding_is_exact_for_linear_fields(tube: OrganSurface) -> None:
    """Also for vertices that stand off: a fold 6 mm high and rough noise."""
    rng = np.random.default_rng(5)
    inward = -tube.vertices * [1.0, 1.0, 0.0] / 0.02
    fold = 6e-3 * np.exp(-(((tube.vertices[:, 2:] - 0.06) / 3e-3) ** 2))
    vertices = tube.vertices + fold * inward + rng.uniform(-3e-4, 3e-4, tube.vertices.shape)
    coarsened = coarsen(vertices, tube.faces, 0.012, 2e-3)
    layer = extrude(coarsened.surface, 2e-3, 1)
    embedding = embed(vertices, coarsened, layer)
    matrix, shift = rng.normal(size=(3, 3)), rng.normal(size=3)
    carried = np.einsum(
        "na,nai->ni", embedding.weights, (layer.nodes @ matrix.T + shift)[embedding.nodes]
    )
    np.testing.assert_allclose(carried, vertices @ matrix.T + shift, atol=1e-12)
    assert np.abs(embedding.weights).max() < 10.0


def test_low_pass_keeps_what_is_broad() -> None:
    """An undulation of length d keeps the fraction 1 − s² with s = 1/(1 + (d/wavelength)⁴)."""
    tube = straight_tube(0.02, 0.12, 0.002)
    line = tube.vertices[:, 2]
    for wave in (0.04, 0.02):
        ripple = 1e-4 * np.cos(2.0 * np.pi * line / wave)
        out = tube.vertices * [1.0, 1.0, 0.0] / 0.02
        change = low_pass(tube.vertices + ripple[:, None] * out, tube.faces, 0.02)
        change = change - low_pass(tube.vertices, tube.faces, 0.02)
        middle = np.abs(line - 0.06) < 0.5 * wave
        left = (change * out).sum(1)[middle] @ ripple[middle] / (ripple[middle] ** 2).sum()
        share = 1.0 - (1.0 - 1.0 / (1.0 + (0.02 / wave) ** 4)) ** 2
        assert left == pytest.approx(share, abs=0.05)


def test_edges_too_long_for_the_organ_are_refused(tube: OrganSurface) -> None:
    with pytest.raises(InputError, match=r"edge is 100 mm: too long for this organ"):
        coarsen(tube.vertices, tube.faces, 0.1, 2e-3)


def test_a_layer_that_folds_over_itself_is_refused() -> None:
    """A tube bent by 30 mm: outside of its inner bend is no room for 14 mm."""
    bent = straight_tube(0.02, 0.06, 0.003, bend=0.03)
    coarsened = coarsen(bent.vertices, bent.faces, 0.012, 2e-3)
    extrude(coarsened.surface, 2e-3, 1)
    with pytest.raises(InputError, match=r"folds over itself.*thickness is 14 mm.*smaller"):
        extrude(coarsened.surface, 14e-3, 1)
