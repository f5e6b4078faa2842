"""Reader of organ files: GLB files written by `write_organ`."""

from __future__ import annotations

import struct
import zlib
from typing import TYPE_CHECKING, Any

import numpy as np

from vrcaps import _core
from vrcaps.core.errors import InputError
from vrcaps.core.narrow import narrow
from vrcaps.core.transforms import invert, rotate_vectors, transform_points
from vrcaps.mesh.glb import array_of, read_document, read_glb, vertices_of, view_of
from vrcaps.organ.arrays import organ_from_arrays
from vrcaps.organ.compact_textures import decode_webps, relief_from_image
from vrcaps.organ.write_organ import GENERATOR, ORGAN_FORMAT

if TYPE_CHECKING:
    from pathlib import Path

    from jaxtyping import Int

    from vrcaps.organ.surface import OrganSurface

_WEBP = "image/webp"

_DAMAGED = (
    ValueError,
    LookupError,
    TypeError,
    AttributeError,
    OSError,
    RecursionError,
    struct.error,
    zlib.error,
)
"""Exceptions raised by parsing a truncated or modified file."""


def is_organ_file(path: Path) -> bool:
    """Check for an organ file of `write_organ`, in meters, not rewritten by other software."""
    return path.suffix.lower() == ".glb" and _format(path) is not None


def read_organ_file(path: Path) -> OrganSurface:
    """Read an organ of `write_organ`, in the patient frame: identical to the last bit, or compact.

    Positions in the file are in the world frame; their pose is not applied. The organ of an
    episode is returned as it was before the patient took the posture of the recording.

    Raises:
        InputError: If the file has another format version or is damaged.
    """
    found = _format(path)
    if found != ORGAN_FORMAT:
        raise InputError(
            f"{path} has the format {found!r}. Allowed: {ORGAN_FORMAT!r}. "
            "Read it with the version of vrcaps that wrote it."
        )
    try:
        return _read(*read_glb(path))
    except _DAMAGED as error:
        reason = " ".join(str(error).split())[:120] or type(error).__name__
        raise InputError(f"{path} is damaged: {reason}. Make or copy the file again.") from error


def _format(path: Path) -> str | None:
    """Format stated by an organ file; None for any other file."""
    try:
        asset = read_document(path)["asset"]
        return str(asset["extras"]["format"]) if asset["generator"] == GENERATOR else None
    except _DAMAGED:
        return None


def _read(document: dict[str, Any], binary: memoryview) -> OrganSurface:
    own = document["asset"]["extras"]
    values: dict[str, Any] = dict(_decoded(document, binary))
    for name, entry in own["arrays"].items():
        if "step" in entry:
            values[name] = _relief(values[name], entry)
        else:
            values[name] = array_of(document, binary, entry)
    values |= _of_vertices(document, binary, values["faces"])
    primitive = document["meshes"][0]["primitives"][0]
    view = document["accessors"][primitive["indices"]]["bufferView"]
    index = np.frombuffer(view_of(document, binary, view), "<u4").reshape(-1, 3)
    values["faces"], values["uv"] = values["faces"][index], values["uv"][index]
    if values["faces"].min() < 0 or values["faces"].max() >= len(values["vertices"]):
        raise ValueError("a triangle has a vertex that is not there")
    return organ_from_arrays(values | own["plain"])


def _of_vertices(
    document: dict[str, Any], binary: memoryview, source: Int[np.ndarray, " k"]
) -> dict[str, np.ndarray]:
    """Arrays stored as vertex attributes: those of a compact file.

    Args:
        document: JSON document of the file.
        binary: Binary chunk of the file.
        source: Index in the organ of each vertex of the file.
    """
    own = document["asset"]["extras"]
    places = document["meshes"][0]["primitives"][0]["attributes"]
    found = {
        name: vertices_of(document, binary, places[attribute])
        for name, attribute in own.get("attributes", {}).items()
    }
    if not found:
        return {}
    numbers, first = np.unique(source, return_index=True)
    if not np.array_equal(numbers, np.arange(len(numbers))):
        raise ValueError("a vertex is missing")
    uv = found.pop("uv").astype(float)
    values = {name: array[first] for name, array in found.items()}
    for name in values.keys() - {"label", "instance"}:
        values[name] = values[name].astype(float)
    T_patient_world = invert(np.array(own["T_world_patient"]))
    values["vertices"] = transform_points(T_patient_world, values["vertices"])
    values["normals"] = rotate_vectors(T_patient_world, values["normals"])
    values["label"] = narrow(values["label"], np.uint8, "labels")
    return {**values, "uv": np.stack([uv[:, 0], 1.0 - uv[:, 1]], axis=1)}


def _relief(image: np.ndarray, entry: dict[str, Any]) -> np.ndarray:
    """Relief [m] from an image of its steps."""
    if entry.get("mimeType") == _WEBP:
        return relief_from_image(image, entry["step"])
    height = image.astype(np.float32)
    height -= 32768
    height *= np.float32(entry["step"])
    return height


def _decoded(document: dict[str, Any], binary: memoryview) -> dict[str, np.ndarray]:
    """Arrays stored as images, decoded in parallel."""
    own = document["asset"]["extras"]
    entries = {name: entry for name, entry in own["arrays"].items() if "step" in entry}
    entries |= {name: document["images"][p["image"]] for name, p in own["images"].items()}
    views = {name: view_of(document, binary, e["bufferView"]) for name, e in entries.items()}
    webps = {name: view for name, view in views.items() if entries[name].get("mimeType") == _WEBP}
    pngs = {name: np.frombuffer(views[name], np.uint8) for name in views.keys() - webps.keys()}
    images = dict(zip(pngs, _core.decode_pngs(list(pngs.values())), strict=True))
    images |= dict(zip(webps, decode_webps(list(webps.values())), strict=True))
    if "appearance.roughness" in webps:  # gray
        images["appearance.roughness"] = images["appearance.roughness"][..., 1].copy()
    return images
