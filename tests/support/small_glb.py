"""Small GLB files, array by array, with any document around them."""

from __future__ import annotations

import json
import struct
from pathlib import Path
from typing import Any

import numpy as np

_KINDS = {"i1": 5120, "u1": 5121, "i2": 5122, "u2": 5123, "u4": 5125, "f4": 5126}


class SmallGlb:
    """Arrays of a GLB file as they are added, and its document."""

    def __init__(self) -> None:
        self.data = b""
        self.views: list[dict[str, Any]] = []
        self.accessors: list[dict[str, Any]] = []

    def add(self, values: np.ndarray, kind: str, *, stride: int = 0, **more: Any) -> int:
        """Add an accessor with a buffer view of its own; gives its number."""
        view = {"buffer": 0, "byteOffset": len(self.data), "byteLength": values.nbytes}
        self.views.append(view | ({"byteStride": stride} if stride else {}))
        component = _KINDS[values.dtype.str[1:]]
        accessor = {"componentType": component, "count": len(values), "type": kind, **more}
        self.accessors.append({"bufferView": len(self.views) - 1, **accessor})
        self.data += values.tobytes() + b"\0" * (-values.nbytes % 4)
        return len(self.accessors) - 1

    def write(self, path: Path, primitives: list[dict[str, Any]], **document: Any) -> Path:
        """Write one mesh; `document` replaces or adds entries of the document."""
        whole = {
            "asset": {"version": "2.0"},
            "scenes": [{"nodes": [0]}],
            "nodes": [{"mesh": 0}],
            "meshes": [{"primitives": primitives}],
            "buffers": [{"byteLength": len(self.data)}],
            "bufferViews": self.views,
            "accessors": self.accessors,
            **document,
        }
        text = json.dumps(whole).encode()
        text += b" " * (-len(text) % 4)
        head = struct.pack("<4sII", b"glTF", 2, 28 + len(text) + len(self.data))
        chunks = struct.pack("<I4s", len(text), b"JSON") + text
        path.write_bytes(head + chunks + struct.pack("<I4s", len(self.data), b"BIN\0") + self.data)
        return path
