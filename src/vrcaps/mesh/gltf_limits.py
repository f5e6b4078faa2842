"""Checks of a glTF document before reading its data: paths, sizes, required extensions."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any
from urllib.parse import unquote

from vrcaps.mesh.glb import read_document

_LISTS = ("accessors", "buffers", "bufferViews", "images", "meshes", "nodes", "scenes", "skins")
DRACO = "KHR_draco_mesh_compression"
_COMPRESSIONS = (DRACO, "EXT_meshopt_compression", "KHR_meshopt_compression")
_KNOWN = ("KHR_mesh_quantization", "EXT_mesh_gpu_instancing")
_NOT_GEOMETRY = (  # prefixes of extensions that do not change the surface
    *("KHR_materials_", "KHR_texture_", "KHR_lights_", "KHR_xmp", "KHR_animation_"),
    *("EXT_texture_", "EXT_lights_", "MSFT_texture_", "ADOBE_materials_"),
)


def require_safe_gltf(path: Path) -> None:
    """Check the paths, sizes and required extensions declared in a GLB or glTF file.

    Raises:
        ValueError, struct.error: If it names a file outside its folder, a size beyond its own or
            an unsupported extension, or is not a glTF file of UTF-8 text.
    """
    is_binary = path.suffix.lower() == ".glb"
    document = read_document(path) if is_binary else json.loads(path.read_text("utf-8-sig"))
    if not isinstance(document, dict):
        raise ValueError("its document is no object")
    for name in _LISTS:
        entries = document.get(name, [])
        if not (isinstance(entries, list) and all(isinstance(entry, dict) for entry in entries)):
            raise ValueError(f"{name} is no list of objects")
    _require_extensions(document.get("extensionsRequired", []))
    size = path.stat().st_size
    for entry in [*document.get("buffers", []), *document.get("images", [])]:
        size += _external_size(entry.get("uri"), path.parent)
    for name, key in (("buffers", "byteLength"), ("bufferViews", "byteLength")):
        for number, entry in enumerate(document.get(name, [])):
            _require_number(entry.get(key), size, f"{name}[{number}].{key}")
    for number, entry in enumerate(document.get("accessors", [])):
        _require_number(entry.get("count"), size, f"accessors[{number}].count")


def _require_extensions(names: list[str]) -> None:
    for name in names:
        if name in _COMPRESSIONS:
            raise ValueError(compression_text(name))
        if name not in _KNOWN and not name.startswith(_NOT_GEOMETRY):
            raise ValueError(
                f"it requires the extension {name}, which is not supported; export it without "
                "this extension, or as PLY"
            )


def compression_text(extension: str) -> str:
    """Error text for a compressed mesh, with the remedy."""
    return (
        f"its mesh is compressed ({extension}), which is not supported; "
        "export it without compression, or as PLY"
    )


def _external_size(uri: Any, folder: Path) -> int:
    """Size in bytes of an external file of a glTF file, 0 for data in the document itself."""
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
