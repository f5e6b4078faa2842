"""Wavefront OBJ files: vertices, texture coordinates and polygons."""

from __future__ import annotations

import re
from typing import TYPE_CHECKING

import numpy as np

from vrcaps.mesh.mesh import Mesh
from vrcaps.mesh.text import decoded
from vrcaps.mesh.triangulate import triangulate_fans

if TYPE_CHECKING:
    from pathlib import Path

_CONTINUED = re.compile(r"\\[ \t]*(\r\n|\n|\r)")


def read_obj(path: Path) -> Mesh:
    """Mesh of all objects and groups of a file, in its own unit; materials are ignored.

    Raises:
        ValueError, IndexError: If a line is not valid OBJ.
    """
    vertices, uvs = [], []
    counts, corners, uv_corners = [], [], []
    for line in _CONTINUED.sub(" ", decoded(path.read_bytes())).splitlines():
        words = line.partition("#")[0].split()
        if not words:
            continue
        kind = words[0].lower()
        if kind == "v":
            vertices.append([float(words[1]), float(words[2]), float(words[3])])
        elif kind == "vt":
            uvs.append([float(words[1]), float(words[2]) if len(words) > 2 else 0.0])
        elif kind in ("f", "fo"):
            counts.append(len(words) - 1)
            for word in words[1:]:
                parts = word.split("/")
                corners.append(_index(parts[0], len(vertices)))
                has_uv = len(parts) > 1 and parts[1]
                uv_corners.append(_index(parts[1], len(uvs)) if has_uv else -1)
    triangles = triangulate_fans(np.array(counts, np.int64))
    faces = np.array(corners, np.int64)[triangles]
    points = np.array(vertices, float).reshape(-1, 3)
    is_textured = bool(uvs) and bool(uv_corners) and min(uv_corners) >= 0
    uv = np.array(uvs)[np.array(uv_corners)[triangles]] if is_textured else None
    return Mesh(points, faces, uv)


def _index(word: str, count: int) -> int:
    """Zero-based index of a one-based or, if negative, relative OBJ index."""
    index = int(word)
    if index == 0:
        raise ValueError("index 0, but OBJ counts from 1")
    return index - 1 if index > 0 else count + index
