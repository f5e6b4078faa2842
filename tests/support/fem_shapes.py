"""Surfaces of simple shape, fine and coarse, and whole matrices, for tests of finite elements."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from scipy import sparse

from vrcaps.mesh.mesh import vertex_normals
from vrcaps.organ.surface import Centerline, OrganSurface
from vrcaps.tissue.fem.assembly import Matrices, assemble
from vrcaps.tissue.fem.deformation import FemDeformation
from vrcaps.tissue.fem.layer import CoarseSurface, Layer


def grid_surface(
    shape: tuple[int, int],
    place: Callable[[np.ndarray, np.ndarray], tuple[np.ndarray, np.ndarray]],
    *,
    wraps: bool = False,
) -> CoarseSurface:
    """Curved triangles over a grid; `place` maps s and t in [0, 1] to positions and directions."""
    num_s, num_t = shape
    columns = 2 * num_s + (not wraps)
    s, t = np.meshgrid(
        np.arange(columns) / (2.0 * num_s), np.linspace(0.0, 1.0, 2 * num_t + 1), indexing="ij"
    )
    nodes, outward = place(s.ravel(), t.ravel())
    number = np.arange(s.size).reshape(s.shape)
    triangles = []
    for i in range(0, 2 * num_s, 2):
        for j in range(0, 2 * num_t, 2):
            p = number[np.ix_(np.arange(i, i + 3) % columns, range(j, j + 3))]
            triangles.append([p[0, 0], p[0, 2], p[2, 2], p[0, 1], p[1, 2], p[1, 1]])
            triangles.append([p[0, 0], p[2, 2], p[2, 0], p[1, 1], p[2, 1], p[1, 0]])
    return CoarseSurface(nodes, outward, np.array(triangles))


def plate(shape: tuple[int, int], size: tuple[float, float]) -> CoarseSurface:
    """A flat plate in x and y, outwards along z."""

    def place(s: np.ndarray, t: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        zero = np.zeros_like(s)
        return np.stack([size[0] * s, size[1] * t, zero], 1), np.stack([zero, zero, zero + 1.0], 1)

    return grid_surface(shape, place)


def cylinder(shape: tuple[int, int], radius: float, length: float) -> CoarseSurface:
    """A tube about z; nodes lie exactly on it."""

    def place(s: np.ndarray, t: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        out = np.stack([np.cos(2 * np.pi * s), np.sin(2 * np.pi * s), 0.0 * s], 1)
        return radius * out + np.outer(length * t, [0.0, 0.0, 1.0]), out

    return grid_surface(shape, place, wraps=True)


def bumpy(rng: np.random.Generator) -> CoarseSurface:
    """A plate with nodes out of line and directions that differ."""
    flat = plate((4, 3), (0.04, 0.03))
    nodes = flat.nodes + rng.uniform(-8e-4, 8e-4, flat.nodes.shape)
    outward = flat.outward + rng.uniform(-0.1, 0.1, flat.nodes.shape)
    return CoarseSurface(nodes, outward, flat.triangles)


def straight_tube(radius: float, length: float, edge: float, bend: float = 0.0) -> OrganSurface:
    """An open tube, straight along z or bent about the y axis by a radius, normals inwards."""
    around, rings = int(np.ceil(2.0 * np.pi * radius / edge)), int(length / edge) + 1
    line = np.linspace(0.0, length, rings)
    angle, along = np.meshgrid(2.0 * np.pi * np.arange(around) / around, line)
    x, y = (radius * np.cos(angle)).ravel(), (radius * np.sin(angle)).ravel()
    z = along.ravel()
    turn = z / bend if bend else np.zeros_like(z)
    points = np.stack([x, y, z], 1)
    if bend:
        points = np.stack([bend - (bend - x) * np.cos(turn), y, (bend - x) * np.sin(turn)], 1)
    number = np.arange(z.size).reshape(rings, around)
    number = np.column_stack([number, number[:, 0]])
    a, b, c, d = number[:-1, :-1], number[1:, :-1], number[1:, 1:], number[:-1, 1:]
    faces = np.concatenate([np.stack(k, -1).reshape(-1, 3) for k in ((a, b, c), (a, c, d))])
    course = np.outer(line, [0.0, 0.0, 1.0])
    frames = np.broadcast_to(np.eye(3), (rings, 3, 3))
    return OrganSurface(
        name="tube",
        vertices=points,
        faces=faces,
        normals=vertex_normals(points, faces),
        uv=np.zeros((len(faces), 3, 2)),
        label=np.ones(len(points), np.uint8),
        label_names=("background", "tube"),
        instance=np.zeros(len(points), np.uint16),
        arc_length=z,
        theta=angle.ravel(),
        radius=np.full(len(points), radius),
        centerline=Centerline(course, line, np.full(rings, radius), frames),
    )


def whole_matrices(
    layer: Layer, deformation: FemDeformation
) -> tuple[Matrices, sparse.csr_matrix, sparse.csr_matrix]:
    """Matrices over all nodes, and stiffness and mass in full, three rows a node."""
    count = len(layer.nodes)
    m = assemble(layer, deformation, np.arange(count), count)
    return m, *full(m)


def full(m: Matrices) -> tuple[sparse.csr_matrix, sparse.csr_matrix]:
    """Stiffness and mass in full, three rows a node."""
    blocks = (m.stiffness, m.columns, m.starts)
    size = 3 * (len(m.starts) - 1)
    lower = sparse.bsr_matrix(blocks, shape=(size, size)).tocsr()
    scalar = sparse.csr_matrix((m.mass, m.columns, m.starts))
    scalar = scalar + sparse.tril(scalar, -1).T
    diagonal = sparse.block_diag(list(m.stiffness[m.starts[1:] - 1]))
    return lower + lower.T - diagonal, sparse.kron(scalar, sparse.eye(3)).tocsr()


def vertex_areas(organ: OrganSurface) -> np.ndarray:
    """Area of each vertex times the direction away from the lumen [m²]."""
    corners = organ.vertices[organ.faces]
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]) / 6.0
    areas = np.zeros_like(organ.vertices)
    np.add.at(areas, organ.faces.ravel(), -np.repeat(normal, 3, axis=0))
    return areas
