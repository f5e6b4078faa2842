"""Errors of the elements against closed forms and against scikit-fem."""

from __future__ import annotations

import numpy as np
from scipy import sparse
from scipy.sparse.linalg import eigsh, spsolve
from scipy.spatial import cKDTree

from tests.support.fem_shapes import bumpy, cylinder, plate, whole_matrices
from vrcaps.tissue.fem.deformation import FemDeformation
from vrcaps.tissue.fem.layer import (
    CoarseSurface,
    Layer,
    extrude,
    integration_points,
    quadrature,
    shapes,
)

FREE = FemDeformation(support=0.0, youngs_modulus=1e5, density=1000.0)


def clamped(layer: Layer) -> np.ndarray:
    """Numbers of the degrees of freedom that are free where the nodes at x = 0 are held."""
    return np.flatnonzero(np.repeat(layer.nodes[:, 0] > 1e-9, 3))


def patch_error() -> float:
    """Relative error at inner nodes of curved elements under linear boundary displacements."""
    rng = np.random.default_rng(3)
    layer = extrude(bumpy(rng), 4e-3, 2)
    _, stiffness, _ = whole_matrices(layer, FREE)
    wanted = layer.nodes @ rng.normal(size=(3, 3)).T
    edges = np.sort(layer.surface.triangles[:, [0, 1, 1, 2, 0, 2]].reshape(-1, 3, 2), axis=2)
    _, place, times = np.unique(
        edges.reshape(-1, 2), axis=0, return_inverse=True, return_counts=True
    )
    rim = times[place].reshape(-1, 3) == 1
    outer = np.zeros(len(layer.surface.nodes), bool)
    outer[layer.surface.triangles[:, 3:][rim]] = True
    outer[edges[rim].ravel()] = True
    border = np.tile(outer, (5, 1))
    border[[0, -1]] = True
    free = np.flatnonzero(np.repeat(~border.ravel(), 3))
    held = np.setdiff1d(np.arange(wanted.size), free)
    u = wanted.ravel().copy()
    u[free] = spsolve(stiffness[free][:, free].tocsc(), -stiffness[free][:, held] @ u[held])
    return np.abs(u - wanted.ravel()).max() / np.abs(wanted).max()


def scikit_fem_cantilever(layer: Layer) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Displacements, places and components of the degrees of freedom, all by scikit-fem.

    The change of volume is projected onto linear functions over each prism of three elements, from
    discontinuous linear functions: λ Cᵀ H⁻¹ C with C = R ∫ q div u and H = R ∫ q q Rᵀ.
    """
    import skfem
    from skfem.helpers import ddot, div, dot, sym_grad

    corners, number = np.unique(layer.tetrahedra[:, :4], return_inverse=True)
    mesh = skfem.MeshTet(layer.nodes[corners].T, number.reshape(-1, 4).T)
    basis = skfem.Basis(mesh, skfem.ElementVector(skfem.ElementTetP2()), intorder=4)
    volume = basis.with_element(skfem.ElementDG(skfem.ElementTetP1()))
    distort = skfem.BilinearForm(lambda u, v, w: 2.0 * FREE.shear * ddot(sym_grad(u), sym_grad(v)))
    widen = skfem.BilinearForm(lambda u, q, w: div(u) * q)
    product = skfem.BilinearForm(lambda p, q, w: p * q)
    weight = skfem.LinearForm(
        lambda v, w: dot(np.array([0.0, 0.0, FREE.density * 9.81])[:, None, None], v)
    )
    place = 1e3 * volume.doflocs
    row = 4 * (np.arange(len(number.reshape(-1, 4))) // 3) + np.arange(4)[:, None, None]
    values = np.concatenate([np.ones((1, place.shape[1])), place])[:, volume.element_dofs]
    ends = np.broadcast_arrays(row, volume.element_dofs)
    linear = sparse.csr_matrix((values.ravel(), [end.ravel() for end in ends]))
    change = linear @ widen.assemble(basis, volume)
    inverse = sparse.linalg.splu((linear @ product.assemble(volume) @ linear.T).tocsc())
    matrix = distort.assemble(basis) + FREE.lame * change.T @ inverse.solve(change.toarray())
    held = basis.get_dofs(lambda x: x[0] < 1e-9)
    u = skfem.solve(*skfem.condense(sparse.csr_matrix(matrix), weight.assemble(basis), D=held))
    component = np.empty(basis.N, int)
    for k in range(3):
        component[basis.nodal_dofs[k]] = component[basis.edge_dofs[k]] = k
    return u, basis.doflocs.T, component


def cantilever_error() -> float:
    """Against scikit-fem on the same mesh, under its weight: the worst node's, relative."""
    layer = extrude(plate((8, 2), (0.04, 0.008)), 2e-3, 1)
    theirs, places, component = scikit_fem_cantilever(layer)
    matrices, stiffness, _ = whole_matrices(layer, FREE)
    free = clamped(layer)
    load = np.outer(matrices.node_mass, [0.0, 0.0, 9.81]).ravel()
    u = np.zeros(3 * len(layer.nodes))
    u[free] = spsolve(stiffness[free][:, free].tocsc(), load[free])
    _, node = cKDTree(layer.nodes).query(places, distance_upper_bound=1e-9)
    return np.abs(theirs - u[3 * node + component]).max() / np.abs(theirs).max()


def bending_error(nu: float, slenderness: float) -> float:
    """Relative error of the sag of a wide cantilever, in elements so many times as long as thick.

    It is ρ g t L⁴/(8 D), D = E t³/12(1 − ν²); shear adds less than 1e-3.
    """
    length, thick = 0.1, 2e-3
    layer = extrude(plate((round(50 / slenderness), 1), (length, 0.01)), thick, 1)
    deformation = FemDeformation(support=0.0, youngs_modulus=1e6, poisson_ratio=nu, density=1e3)
    matrices, stiffness, _ = whole_matrices(layer, deformation)
    held = np.zeros(layer.nodes.shape, bool)
    held[:, 1] = True
    held[layer.nodes[:, 0] < 1e-9, 0] = True
    held[(layer.nodes[:, 0] < 1e-9) & np.isclose(layer.nodes[:, 2], thick / 2.0), 2] = True
    free = np.flatnonzero(~held.ravel())
    load = np.outer(matrices.node_mass, [0.0, 0.0, 1.0]).ravel()
    u = np.zeros(3 * len(layer.nodes))
    u[free] = spsolve(stiffness[free][:, free].tocsc(), load[free])
    tip = u.reshape(-1, 3)[layer.nodes[:, 0] > length - 1e-9, 2].mean()
    expected = 1e3 * length**4 / (8.0 * 1e6 * thick**2 / (12.0 * (1.0 - nu**2)))
    return abs(tip / expected - 1.0)


def mode_errors() -> np.ndarray:
    """Relative errors of the first two bending frequencies of a cantilever.

    f = (βL)² / 2π · √(E I / ρ A L⁴) with βL = 1.8751, 4.6941 (Rao, Mechanical Vibrations).
    """
    length, thick = 0.1, 2e-3
    layer = extrude(plate((16, 1), (length, 0.004)), thick, 1)
    deformation = FemDeformation(support=0.0, youngs_modulus=1e6, poisson_ratio=0.0, density=1000.0)
    _, stiffness, mass = whole_matrices(layer, deformation)
    free = clamped(layer)
    square, shape = eigsh(
        stiffness[free][:, free].tocsc(), 6, mass[free][:, free].tocsc(), sigma=0.0
    )
    whole = np.zeros((3 * len(layer.nodes), 6))
    whole[free] = shape
    moving = np.abs(whole.reshape(-1, 3, 6)).max(axis=0)
    flat = moving[2] > 3.0 * moving[1]  # bending out of the plate; its neighbors bend within it
    found = np.sqrt(np.sort(square[flat])[:2]) / (2.0 * np.pi)
    unit = np.sqrt(1e6 * thick**2 / (12.0 * 1000.0 * length**4)) / (2.0 * np.pi)
    return np.abs(found / (unit * np.array([1.87510, 4.69409]) ** 2) - 1.0)


def inner_pressure(surface: CoarseSurface, pressure: float) -> np.ndarray:
    """Forces at the surface's nodes of a pressure from the lumen [N]."""
    places, shares = quadrature(2, 3)
    values, slopes = shapes(places)
    tangents = np.einsum("eai,qaj->eqji", surface.nodes[surface.triangles], slopes)
    out = -np.cross(tangents[..., 0, :], tangents[..., 1, :]) * shares[:, None]
    force = np.zeros_like(surface.nodes)
    np.add.at(force, surface.triangles, pressure * np.einsum("qa,eqi->eai", values, out))
    return force


def lame_error(fineness: int, nu: float) -> tuple[float, float]:
    """Relative errors of the inner widening and of the displacement (L2), in plane strain."""
    inner, outer, pressure = 0.010, 0.016, 1e3
    surface = cylinder((6 * fineness, fineness), inner, 0.006)
    layer = extrude(surface, outer - inner, fineness)
    deformation = FemDeformation(support=0.0, youngs_modulus=1e5, poisson_ratio=nu)
    _, stiffness, _ = whole_matrices(layer, deformation)
    load = np.zeros_like(layer.nodes)
    load[: len(surface.nodes)] = inner_pressure(surface, pressure)
    # No motion along the tube; three more ties against turning and shifting, free by symmetry.
    held = np.zeros(layer.nodes.shape, bool)
    held[:, 2] = True
    on_x = np.isclose(layer.nodes[:, 1], 0.0, atol=1e-12)
    on_y = np.isclose(layer.nodes[:, 0], 0.0, atol=1e-12)
    held[on_x, 1] = held[on_y, 0] = True
    free = np.flatnonzero(~held.ravel())
    u = np.zeros(load.size)
    u[free] = spsolve(stiffness[free][:, free].tocsc(), load.ravel()[free])
    u = u.reshape(-1, 3)

    def exact(r: np.ndarray) -> np.ndarray:
        """Lamé's u(r), inner pressure (Timoshenko, Goodier, Theory of Elasticity, 1970, 28)."""
        factor = pressure * inner**2 * (1.0 + nu) / (1e5 * (outer**2 - inner**2))
        return factor * ((1.0 - 2.0 * nu) * r + outer**2 / r)

    inside = np.linalg.norm(u[: len(surface.nodes), :2], axis=1).mean()
    points = integration_points(layer.nodes, layer.tetrahedra, 3)
    x = np.einsum("qa,eai->eqi", points.values, layer.nodes[layer.tetrahedra])
    found = np.einsum("qa,eai->eqi", points.values, u[layer.tetrahedra])
    r = np.linalg.norm(x[..., :2], axis=-1, keepdims=True)
    wanted = exact(r) * x / r * np.array([1.0, 1.0, 0.0])
    square = (points.weights[..., None] * (found - wanted) ** 2).sum()
    return abs(inside / exact(np.array(inner)) - 1.0), np.sqrt(
        square / (points.weights[..., None] * wanted**2).sum()
    )
