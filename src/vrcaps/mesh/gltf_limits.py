"""What a glTF document may ask for before anything of it is read: files beside it, sizes it has."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any
from urllib.parse import unquote

from vrcaps.mesh.glb import read_document

_MOST_VALUES = 200_000_000  # rows of an accessor, which hold more than any wall
_MOST_EXPANSION = 1040  # bytes that one byte of a compressed buffer can stand for
_LISTS = ("accessors", "buffers", "bufferViews", "images", "meshes", "nodes")


def require_safe_gltf(path: Path) -> None:
    """Check that a GLB or glTF file names no file outside its folder and no size beyond its own.

    Raises:
        ValueError, struct.error: If it does, or is no glTF of UTF-8 text.
    """
    is_binary = path.suffix.lower() == ".glb"
    document = read_document(path) if is_binary else json.loads(path.read_text("utf-8"))
    if not isinstance(document, dict):
        raise ValueError("its document is no object")
    for name in _LISTS:
        entries = document.get(name, [])
        if not (isinstance(entries, list) and all(isinstance(entry, dict) for entry in entries)):
            raise ValueError(f"{name} is no list of objects")
    size = path.stat().st_size
    for entry in [*document.get("buffers", []), *document.get("images", [])]:
        size += _external_size(entry.get("uri"), path.parent)
    for name, key in (("buffers", "byteLength"), ("bufferViews", "byteLength")):
        for number, entry in enumerate(document.get(name, [])):
            _require_number(entry.get(key), size, f"{name}[{number}].{key}")
    for number, entry in enumerate(document.get("accessors", [])):
        most = min(size * _MOST_EXPANSION, _MOST_VALUES)
        _require_number(entry.get("count"), most, f"accessors[{number}].count")


def _external_size(uri: Any, folder: Path) -> int:
    """Bytes of a file that a glTF file names, 0 for data in the document itself."""
    if uri is None or (isinstance(uri, str) and uri.startswith("data:")):
        return 0
    if not isinstance(uri, str) or "\0" in uri:
        raise ValueError(f"uri is {uri!r}, not a path")
    named = (folder / unquote(uri)).resolve()
    if "://" in uri or not named.is_relative_to(folder.resolve()):
        raise ValueError(f"it names {uri!r}, which lies outside its folder")
    return named.stat().st_size if named.is_file() else 0


def _require_number(value: Any, most: int, name: str) -> None:
    if type(value) is not int or not 0 <= value <= most:
        raise ValueError(f"{name} is {value!r}, allowed are whole numbers from 0 to {most}")
