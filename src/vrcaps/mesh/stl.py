"""STL files, text or binary, including common deviations of exporters."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from vrcaps.mesh.mesh import Mesh
from vrcaps.mesh.text import decoded
from vrcaps.mesh.triangulate import triangulate_fans

if TYPE_CHECKING:
    from pathlib import Path

_FACET = np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attribute", "<u2")])
_HEAD = 84


def read_stl(path: Path) -> Mesh:
    """Mesh of a file, in its own unit: each triangle has three separate vertices.

    Text may be in capitals, have several solids, no `endsolid` and a byte order mark. A binary
    file may start with the word `solid`, and less than one facet may follow its last.

    Raises:
        ValueError: If it is neither, or truncated.
    """
    data = path.read_bytes()
    size = _HEAD + _FACET.itemsize * int.from_bytes(data[_HEAD - 4 : _HEAD], "little")
    if len(data) < _HEAD or len(data) != size:
        text = decoded(data)
        if text.lstrip().lower().startswith("solid") and "facet" in text.lower():
            return _from_text(text)
    if len(data) < _HEAD or not size <= len(data) < size + _FACET.itemsize:
        raise ValueError("neither ASCII nor binary STL, or cut short")
    points = np.frombuffer(data[_HEAD:size], _FACET)["corners"].reshape(-1, 3).astype(float)
    return Mesh(points, np.arange(len(points)).reshape(-1, 3))


def _from_text(text: str) -> Mesh:
    rows: list[list[float]] = []
    ends = [0]
    for line in text.lower().splitlines():
        words = line.split()
        if words[:1] == ["vertex"]:
            rows.append([float(words[1]), float(words[2]), float(words[3])])
        elif words[:1] == ["endloop"]:
            ends.append(len(rows))
    if ends[-1] != len(rows):
        raise ValueError("it is cut short: the last facet has no end")
    points = np.array(rows, float).reshape(-1, 3)
    return Mesh(points, triangulate_fans(np.diff(ends)))
