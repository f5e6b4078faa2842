"""Low-pass filter of a surface: its broad shape without fine folds."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import scipy

from vrcaps.core.geometry import triangle_areas

if TYPE_CHECKING:
    from jaxtyping import Float, Int

# The cotangent of a needle triangle would tie its corners together.
_LARGEST_COTANGENT = 20.0


def low_pass(
    vertices: Float[np.ndarray, "n 3"], faces: Int[np.ndarray, "m 3"], wavelength: float
) -> Float[np.ndarray, "n 3"]:
    """Positions without undulations shorter than a wavelength [m].

    Minimizes ∫|x − x₀|² + τ² |Δx|² dA with τ = (wavelength/2π)², then filters the residual in the
    same way and adds it back (twicing: Tukey, Exploratory Data Analysis, 1977, 16). An undulation
    of length d is scaled by 1 − s² with s = 1/(1 + (d/wavelength)⁴), so that a wide tube keeps
    its radius. Flat regions are unchanged up to an open border. Δ is the cotangent Laplacian
    (Pinkall, Polthier, Exp. Math. 2(1):15-36, 1993).
    """
    area, stiffness = cotangent_laplacian(vertices, faces)
    inner = np.ones(len(vertices))
    inner[border_edges(faces).ravel()] = 0.0
    bending = stiffness @ scipy.sparse.diags(inner / area) @ stiffness
    tau = (0.5 * wavelength / np.pi) ** 2
    matrix = (scipy.sparse.diags(area) + tau**2 * bending).tocsc()
    options = {"SymmetricMode": True}
    solver = scipy.sparse.linalg.splu(
        matrix, permc_spec="MMD_AT_PLUS_A", diag_pivot_thresh=0.0, options=options
    )
    center = vertices.mean(axis=0)
    around = vertices - center
    once = solver.solve(area[:, None] * around)
    return once + solver.solve(area[:, None] * (around - once)) + center


def cotangent_laplacian(
    vertices: Float[np.ndarray, "n 3"], faces: Int[np.ndarray, "m 3"]
) -> tuple[Float[np.ndarray, " n"], scipy.sparse.csr_matrix]:
    """Area of each vertex [m²], and the cotangent stiffness matrix, positive semidefinite."""
    corners, count = vertices[faces], len(vertices)
    double_area = 2.0 * triangle_areas(corners)
    tiny = 1e-12 * double_area.mean()
    area = np.bincount(faces.ravel(), np.repeat(double_area / 6.0, 3), count)
    matrix = scipy.sparse.csr_matrix((count, count))
    for k in range(3):
        a, b = corners[:, (k + 1) % 3] - corners[:, k], corners[:, (k + 2) % 3] - corners[:, k]
        cotangent = (a * b).sum(1) / np.maximum(double_area, tiny)
        half = 0.5 * np.clip(cotangent, -_LARGEST_COTANGENT, _LARGEST_COTANGENT)
        i, j = faces[:, (k + 1) % 3], faces[:, (k + 2) % 3]
        ends = (np.concatenate([i, j, i, j]), np.concatenate([j, i, i, j]))
        matrix += scipy.sparse.csr_matrix(
            (np.concatenate([-half, -half, half, half]), ends), shape=(count, count)
        )
    return np.maximum(area, tiny), matrix


def border_edges(faces: Int[np.ndarray, "m 3"]) -> Int[np.ndarray, "k 2"]:
    """Directed edges that belong to only one face."""
    edges = np.concatenate([faces[:, [k, (k + 1) % 3]] for k in range(3)])
    count = int(faces.max()) + 1
    forth, back = edges[:, 0] * count + edges[:, 1], edges[:, 1] * count + edges[:, 0]
    return edges[~np.isin(forth, back)]
