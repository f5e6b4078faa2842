"""Footprints of lesions found again on the original wall, apart from how they were put in.

Rays are cast by Embree on the wall with the lesion. Its clean twin has the same faces, so a hit
has a point on the clean wall, and the nearest point of the organ as it was before. There a focal
lesion's log map about its center, a circumferential one's arc length and a flow's distance from its
path are measured anew, and the lesion's outline says whether that lies inside.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from itertools import combinations

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components, dijkstra
from scipy.spatial import KDTree

from vrcaps._core import Wall
from vrcaps.core.units import MM
from vrcaps.lesion import LESIONS, sites
from vrcaps.lesion.base import Form, LesionSite, WallSamples

_STEINER = 12
"""Points on each edge that paths over faces may pass: they are too long by 0.2 % on a cylinder."""


@dataclass
class Witness:
    """Forms and paths of blood as they are drawn; use it while lesions are added."""

    forms: list[tuple[Form, LesionSite]] = field(default_factory=list)
    paths: list[np.ndarray] = field(default_factory=list)

    def __enter__(self) -> Witness:
        self._kept = {cls: cls.form for cls in LESIONS.values()}, sites.trace_down
        for cls, make in self._kept[0].items():
            cls.form = self._watched(make)
        trace = self._kept[1]
        sites.trace_down = lambda *given: self.paths.append(trace(*given)) or self.paths[-1]
        return self

    def _watched(self, make):
        def form(lesion, site, rng):
            self.forms.append((make(lesion, site, rng), site))
            return self.forms[-1][0]

        return form

    def __exit__(self, *_) -> None:
        for cls, make in self._kept[0].items():
            cls.form = make
        sites.trace_down = self._kept[1]


class Footprint:
    """Return whether points of the clean wall lie in a lesion's footprint.

    Args:
        organ: Before any lesion.
        clean: Clean twin of the organ with one lesion.
        witness: That watched it being put in.
    """

    def __init__(self, organ, clean, witness: Witness) -> None:
        self.form, site = witness.forms[-1]
        if hasattr(self.form, "normalized_radius"):
            self._measure = Polar(organ, site, self.form.radius)
        elif site.bottom is None:
            self._measure = Along(organ)
        else:
            path = next(p for p in witness.paths[::-1] if np.array_equal(p[-1], site.bottom))
            self._measure = Stream(clean, path, self.form, site)

    def signed_distance(self, points: np.ndarray) -> np.ndarray:
        """Distance inside the outline [m] of points on the clean wall."""
        xy, nothing = self._measure(points), np.zeros_like(points)
        return self.form.signed_distance(WallSamples(xy, points, nothing, nothing))


class Polar:
    """Distance and direction from a focal lesion's center.

    The path is the shortest over faces through Steiner points on their edges (Lanthier, Maheshwari
    and Sack 1997); the direction is the vector heat method's on the wall subdivided evenly.
    """

    def __init__(self, organ, site: LesionSite, radius: float) -> None:
        self.center, self.reach = site.center, 1.5 * radius + 3.0 * MM
        near = self._is_near(organ.vertices)
        faces = organ.faces[near[organ.faces].all(axis=1)]
        kept, local = np.unique(faces, return_inverse=True)
        vertices, faces = organ.vertices[kept], local.reshape(-1, 3)
        faces = faces[_component(faces, len(vertices), vertices, site.center)]
        self._wall = Wall(vertices, faces.astype(np.int64))
        self._nodes, self._around, self._way = steiner_ways(vertices, faces, site.center)
        self._points, self._directions = _directions(vertices, faces, site, radius)
        self._near = KDTree(self._points)

    def _is_near(self, points: np.ndarray) -> np.ndarray:
        return np.linalg.norm(points - self.center, axis=1) < self.reach

    def __call__(self, points: np.ndarray) -> np.ndarray:
        """Log map of points [m], in the site's axes; (1, 0) far away."""
        xy, near = np.tile([1.0, 0.0], (len(points), 1)), self._is_near(points)
        nearest, face = self._wall.closest_point(points[near])
        nodes = self._around[face]
        straight = np.linalg.norm(self._nodes[nodes] - nearest[:, None], axis=2)
        rho = (straight + self._way[nodes]).min(axis=1)
        apart, node = self._near.query(points[near], k=4)
        weight = 1.0 / (apart + 1e-6) ** 2
        direction = (weight[..., None] * self._directions[node]).sum(axis=1)
        direction /= np.maximum(np.linalg.norm(direction, axis=1, keepdims=True), 1e-12)
        xy[near] = np.where(np.isfinite(rho), rho, 1.0)[:, None] * direction
        return xy


def _component(faces, count, vertices, center) -> np.ndarray:
    """Mask of the faces connected to the vertex nearest to the center."""
    ends = np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]]])
    graph = coo_array((np.ones(len(ends)), ends.T), shape=(count, count))
    _, part = connected_components(graph, directed=False)
    return part[faces[:, 0]] == part[np.argmin(np.linalg.norm(vertices - center, axis=1))]


def steiner_ways(vertices, faces, center) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Points on a wall's edges, those of each face, and the shortest path to each point [m]."""
    pairs = np.sort(faces[:, [[0, 1], [1, 2], [2, 0]]], axis=-1)
    ends, edge = np.unique(pairs.reshape(-1, 2), axis=0, return_inverse=True)
    fraction = np.arange(1, _STEINER + 1)[:, None] / (_STEINER + 1)
    between = vertices[ends[:, :1]] + fraction * (vertices[ends[:, 1:]] - vertices[ends[:, :1]])
    nodes = np.concatenate([vertices, between.reshape(-1, 3)])
    number = len(vertices) + np.arange(len(ends) * _STEINER).reshape(len(ends), _STEINER)
    around = np.concatenate([faces, number[edge.reshape(-1, 3)].reshape(len(faces), -1)], axis=1)
    pick = np.array(list(combinations(range(around.shape[1]), 2)))
    links = np.sort(around[:, pick].reshape(-1, 2), axis=1)
    links = np.stack(np.divmod(np.unique(links @ [len(nodes), 1]), len(nodes)), axis=1)
    length = np.linalg.norm(nodes[links[:, 0]] - nodes[links[:, 1]], axis=1)
    graph = coo_array((length, links.T), shape=(len(nodes), len(nodes))).tocsr()
    start = int(np.argmin(np.linalg.norm(vertices - center, axis=1)))
    return nodes, around, dijkstra(graph, directed=False, indices=start)


def _subdivided(vertices, faces, longest: float) -> tuple[np.ndarray, np.ndarray]:
    """The same wall in triangles cut in four until their mean edge is short enough."""
    from trimesh.remesh import subdivide

    edge = np.linalg.norm(vertices[faces[:, 0]] - vertices[faces[:, 1]], axis=1).mean()
    for _ in range(int(np.ceil(np.log2(max(1.0, edge / longest))))):
        vertices, faces = subdivide(vertices, faces)
    used, local = np.unique(faces, return_inverse=True)
    return vertices[used], local.reshape(-1, 3)


def _directions(vertices, faces, site: LesionSite, radius: float) -> tuple[np.ndarray, np.ndarray]:
    """Points of the subdivided wall, and the unit direction of each in the site's axes."""
    import potpourri3d as pp3d

    vertices, faces = _subdivided(vertices, faces, radius / 8.0)
    start = int(np.argmin(np.linalg.norm(vertices - site.center, axis=1)))
    solver = pp3d.MeshVectorHeatSolver(vertices, faces)
    xy = np.asarray(solver.compute_log_map(start, strategy="AffineLocal"))
    x, y, _ = (np.asarray(axis)[start] for axis in solver.get_tangent_frames())
    turned = (xy[:, :1] * x + xy[:, 1:] * y) @ site.axes[:, :2]
    return vertices, turned / np.maximum(np.linalg.norm(turned, axis=1, keepdims=True), 1e-12)


class Along:
    """Arc length on the wall before the lesion."""

    def __init__(self, organ) -> None:
        self.organ = organ
        self._wall = Wall(organ.vertices.copy(), organ.faces.astype(np.int64))

    def __call__(self, points: np.ndarray) -> np.ndarray:
        """Arc length and zero [m]."""
        from trimesh.triangles import points_to_barycentric

        nearest, face = self._wall.closest_point(points)
        corners = self.organ.faces[face]
        weights = points_to_barycentric(self.organ.vertices[corners], nearest)
        along = (weights * self.organ.arc_length[corners]).sum(axis=1)
        return np.stack([along, 0.0 * along], axis=1)


class Stream:
    """Distance along a path, distance from it, and whether a point is in the hollow."""

    def __init__(self, clean, path, form, site: LesionSite) -> None:
        self.path, self.step = path, 1.0 * MM
        offset = clean.vertices - site.bottom
        under = (offset @ site.down + form.flow.pool > 0.0) & (
            np.linalg.norm(offset, axis=1) < site.reach
        )
        wet = clean.faces[under[clean.faces].all(axis=1)]
        self._hollow = None
        if form.flow.pool > 0.0 and len(wet):
            joined = _component(wet, len(under), clean.vertices, site.bottom)
            self._hollow = KDTree(clean.vertices[np.unique(wet[joined])])

    def __call__(self, points: np.ndarray) -> np.ndarray:
        """Way, distance, distance from the hollow [m]."""
        start, leg = self.path[:-1], np.diff(self.path, axis=0)
        apart, along = np.full(len(points), np.inf), np.zeros(len(points))
        for k in range(len(start)):
            fraction = np.clip((points - start[k]) @ leg[k] / (leg[k] @ leg[k]), 0.0, 1.0)
            here = np.linalg.norm(points - start[k] - fraction[:, None] * leg[k], axis=1)
            closer = here < apart
            apart[closer], along[closer] = here[closer], (k + fraction[closer]) * self.step
        beyond = np.full(len(points), 1.0)
        if self._hollow is not None:
            beyond = self._hollow.query(points)[0]
        return np.stack([along, apart, beyond], axis=1)
