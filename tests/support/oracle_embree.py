"""Embree as an independent ray caster."""

from __future__ import annotations

import numpy as np


class EmbreeCaster:
    """Nearest hits by Embree; distances and weights are then found again in double precision."""

    def __init__(self, vertices: np.ndarray, faces: np.ndarray) -> None:
        from embreex.mesh_construction import TriangleMesh
        from embreex.rtcore_scene import EmbreeScene

        self.vertices, self.faces = np.asarray(vertices, float), np.asarray(faces)
        self._center = 0.5 * (self.vertices.min(axis=0) + self.vertices.max(axis=0))
        self._scene = EmbreeScene()
        local = (self.vertices - self._center).astype(np.float32)
        self._mesh = TriangleMesh(self._scene, local, self.faces.astype(np.int32))

    def cast(
        self, origins: np.ndarray, directions: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Distance [n], face [n] (−1: none) and corner weights [n 3] of rays [n 3].

        Rays with NaN hit nothing.
        """
        face = np.full(len(directions), -1)
        valid = np.isfinite(directions).all(axis=1)
        face[valid] = self._scene.run(
            (origins[valid] - self._center).astype(np.float32),
            directions[valid].astype(np.float32),
        )
        a, b, c = np.moveaxis(self.vertices[self.faces[face]], 1, 0)
        normal = np.cross(b - a, c - a)
        with np.errstate(invalid="ignore", divide="ignore"):
            distance = _dot(normal, a - origins) / _dot(normal, directions)
            points = origins + distance[:, None] * directions
            of_a = _dot(np.cross(b - points, c - points), normal)
            of_b = _dot(np.cross(c - points, a - points), normal)
            weights = np.stack([of_a, of_b], 1) / _dot(normal, normal)[:, None]
        weights = np.column_stack([weights, 1.0 - weights.sum(axis=1)])
        miss = face < 0
        distance[miss], weights[miss] = np.nan, np.nan
        return distance, face, weights


def _dot(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    return np.einsum("nx,nx->n", a, b)
