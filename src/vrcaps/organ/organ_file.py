"""Reader of organ files: a GLB that `write_organ` made comes back without loss."""

from __future__ import annotations

import struct
from typing import TYPE_CHECKING, Any

import numpy as np

from vrcaps import _core
from vrcaps.errors import InputError
from vrcaps.mesh.glb import array_of, read_document, read_glb, view_of
from vrcaps.organ.arrays import organ_from_arrays
from vrcaps.organ.write_organ import GENERATOR, ORGAN_FORMAT

if TYPE_CHECKING:
    from pathlib import Path

    from vrcaps.organ.surface import OrganSurface

_DAMAGED = (
    ValueError,
    LookupError,
    TypeError,
    AttributeError,
    OSError,
    RecursionError,
    struct.error,
)
"""What parsing a file that was cut short or changed raises."""


def is_organ_file(path: Path) -> bool:
    """Whether a file is an organ of `write_organ`, in meters, that nothing else has rewritten."""
    return path.suffix.lower() == ".glb" and _format(path) is not None


def read_organ_file(path: Path) -> OrganSurface:
    """The organ that `write_organ` wrote, equal to the last bit, in the patient frame.

    The file's positions are in the world frame; their pose is not applied. An episode's organ
    comes back as it was before the patient took the posture of the recording.

    Raises:
        InputError: If the file is of another format version, or is damaged.
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
    """The format that an organ file states; None for any other file."""
    try:
        asset = read_document(path)["asset"]
        return str(asset["extras"]["format"]) if asset["generator"] == GENERATOR else None
    except _DAMAGED:
        return None


def _read(document: dict[str, Any], binary: memoryview) -> OrganSurface:
    own = document["asset"]["extras"]
    values = _decoded(document, binary)
    for name, entry in own["arrays"].items():
        if "step" in entry:
            height = values[name].astype(np.float32)
            height -= 32768
            height *= np.float32(entry["step"])
            values[name] = height
        else:
            values[name] = array_of(document, binary, entry)
    primitive = document["meshes"][0]["primitives"][0]
    view = document["accessors"][primitive["indices"]]["bufferView"]
    index = np.frombuffer(view_of(document, binary, view), "<u4").reshape(-1, 3)
    values["faces"], values["uv"] = values["faces"][index], values["uv"][index]
    if values["faces"].min() < 0 or values["faces"].max() >= len(values["vertices"]):
        raise ValueError("a triangle has a vertex that is not there")
    return organ_from_arrays(values | own["plain"])


def _decoded(document: dict[str, Any], binary: memoryview) -> dict[str, np.ndarray]:
    """The arrays that are images, decoded side by side."""
    own = document["asset"]["extras"]
    steps = {k: entry["bufferView"] for k, entry in own["arrays"].items() if "step" in entry}
    places = own["images"].items()
    views = steps | {k: document["images"][place["image"]]["bufferView"] for k, place in places}
    files = [np.frombuffer(view_of(document, binary, view), np.uint8) for view in views.values()]
    images = dict(zip(views, _core.decode_pngs(files), strict=True))
    for name, place in places:
        if "channel" in place:
            images[name] = images[name][..., place["channel"]].copy()
    return images
