"""Self-intersections against an independent oracle."""

from __future__ import annotations

import numpy as np

from vrcaps.organ.colon.crossing import self_intersections


def test_self_intersections_agrees_with_exact_volumes():
    """Random pairs of triangles against signs of tetrahedron volumes."""
    rng = np.random.default_rng(0)
    vertices = rng.uniform(size=(180, 3))
    faces = np.arange(180).reshape(-1, 3)
    found = {tuple(sorted(pair)) for pair in self_intersections(vertices, faces)}

    def volume(a, b, c, d):
        return np.sign(np.dot(np.cross(b - a, c - a), d - a))

    def pierces(edge, triangle):
        a, b, c = triangle
        if volume(a, b, c, edge[0]) == volume(a, b, c, edge[1]):
            return False
        sides = {volume(edge[0], edge[1], p, q) for p, q in ((a, b), (b, c), (c, a))}
        return len(sides) == 1

    expected = set()
    for i in range(60):
        for j in range(i + 1, 60):
            one, other = vertices[faces[i]], vertices[faces[j]]
            if any(
                pierces(one[[k, k - 1]], other) or pierces(other[[k, k - 1]], one) for k in range(3)
            ):
                expected.add((i, j))
    assert found == expected
