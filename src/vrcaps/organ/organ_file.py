"""Organ files: writer and reader of organs as GLB (binary glTF 2.0), exact or compact."""

from __future__ import annotations

import struct
import zlib
from typing import TYPE_CHECKING, Any

import numpy as np

from vrcaps import _core
from vrcaps._core import encode_pngs
from vrcaps.core.errors import InputError, narrow
from vrcaps.core.files import write_bytes
from vrcaps.core.geometry import invert, rotate_vectors, transform_points
from vrcaps.core.rng import MAX_SEED
from vrcaps.mesh.glb import Glb, array_of, read_document, read_glb, vertices_of, view_of
from vrcaps.organ.gltf_material import (
    RELIEF_STEP,
    compact_files,
    decode_webps,
    material_json,
    relief_from_image,
    relief_scale,
    texture_images,
    webp_fits,
)
from vrcaps.organ.surface import (
    HEIGHT_STEP,
    Centerline,
    json_safe,
    organ_from_arrays,
    organ_to_arrays,
)

if TYPE_CHECKING:
    from pathlib import Path

    from jaxtyping import Float, Int

    from vrcaps.organ.surface import Appearance, OrganSurface


ORGAN_FORMAT = "vrcaps-organ/1"
"""Format name of `write_organ`, in the file's ``asset.extras.format``."""

GENERATOR = "vrcaps"

TEXTURES = {
    "appearance.albedo": {"image": 0},
    "appearance.roughness": {"image": 1},
}
"""Arrays stored as images of the file."""

ATTRIBUTES = {
    **{"vertices": "POSITION", "normals": "NORMAL", "uv": "TEXCOORD_0"},
    **{"label": "_LABEL", "instance": "_INSTANCE"},
    **{"arc_length": "_ARC_LENGTH", "theta": "_THETA", "radius": "_RADIUS"},
}
"""Arrays also stored as vertex attributes in single precision; in a compact file, only there."""

_NUM_IMAGES = 3  # of the material; followed by the relief if it is in steps
_ZERO = 32768  # code of height 0


def write_organ(
    path: Path,
    organ: OrganSurface,
    *,
    T_world_patient: Float[np.ndarray, "4 4"] | None = None,
    compact: bool = False,
) -> None:
    """Write `organ_glb` to a file, replacing it atomically."""
    write_bytes(path, organ_glb(organ, T_world_patient=T_world_patient, compact=compact))


def organ_glb(
    organ: OrganSurface,
    *,
    T_world_patient: Float[np.ndarray, "4 4"] | None = None,
    compact: bool = False,
) -> list[bytes]:
    """Encode an organ with texture coordinates, textures, labels, lesions and centerline.

    For viewers, positions are in the world frame [m], in single precision, without a node
    transform. Vertices are duplicated where their texture coordinates differ. The vertex
    attributes ``_LABEL``, ``_INSTANCE``, ``_ARC_LENGTH`` [m], ``_THETA`` [rad] and ``_RADIUS``
    [m] hold those of the organ, the mesh's ``extras`` the label names and lesions.

    For `read_organ`, ``asset.extras`` names a buffer view for each array of the organ that glTF
    would round, in the patient frame and in its own type (docs/reference/episode-format.md).
    Reading it back gives identical values to the last bit. The same organ gives the same bytes,
    returned in pieces.

    A compact file takes a fifth of the space. Its textures are coded with a small loss
    (`gltf_material`), and vertex attributes in single precision are not stored again exactly.
    Vertices, triangles, labels and lesions keep their order.

    Args:
        organ: The organ, in the patient frame.
        T_world_patient: Pose of the patient in the world; None means that the frames coincide.
        compact: Whether to write a small instead of an exact file.
    """
    pose = np.eye(4) if T_world_patient is None else T_world_patient
    glb = Glb()
    source, faces, uv = split_at_seams(organ.faces, organ.uv)
    primitive = {**_add_geometry(glb, organ, pose, (source, faces, uv)), "material": 0}
    images, relief = _add_images(glb, organ, compact=compact)
    extras = {"label_names": list(organ.label_names)}
    for key in ("lesions", "clean_twin_of"):
        if key in organ.metadata:
            extras[key] = json_safe(organ.metadata[key])
    own = {"format": ORGAN_FORMAT, "T_world_patient": pose.tolist()}
    own |= _add_own(glb, organ, source, uv, relief, compact=compact)
    document = {
        "asset": {"version": "2.0", "generator": GENERATOR, "extras": own},
        "scene": 0,
        "scenes": [{"nodes": [0]}],
        "nodes": [{"mesh": 0, "name": organ.name}],
        "meshes": [{"name": organ.name, "primitives": [primitive], "extras": extras}],
        **material_json(organ.appearance, images),
    }
    return glb.pack(document)


def split_at_seams(
    faces: Int[np.ndarray, "m 3"], uv: Float[np.ndarray, "m 3 2"]
) -> tuple[Int[np.ndarray, " k"], Int[np.ndarray, "m 3"], Float[np.ndarray, "k 2"]]:
    """Create one vertex per distinct pair of vertex and texture coordinate.

    Returns:
        The original index of each vertex (ascending), faces over the new vertices, and their uv.
    """
    corners, flat_uv = faces.reshape(-1), uv.reshape(-1, 2)
    u, v = (np.ascontiguousarray(column, float).view(np.uint64) for column in flat_uv.T)
    order = np.lexsort((v, u, corners))
    is_new = np.ones(len(order), bool)
    is_new[1:] = False
    for key in (corners, u, v):
        is_new[1:] |= key[order][1:] != key[order][:-1]
    index = np.empty(len(order), np.int64)
    index[order] = np.cumsum(is_new) - 1
    first = order[is_new]
    return corners[first], index.reshape(-1, 3), flat_uv[first]


def _add_geometry(
    glb: Glb, organ: OrganSurface, pose: Float[np.ndarray, "4 4"], split: tuple[np.ndarray, ...]
) -> dict:
    """Accessors of the vertex attributes and triangles, as stored in a primitive."""
    source, faces, uv = split
    positions = transform_points(pose, organ.vertices).astype(np.float32)[source]
    normals = rotate_vectors(pose, organ.normals).astype(np.float32)[source]
    flipped_uv = np.stack([uv[:, 0], 1.0 - uv[:, 1]], axis=1)  # glTF v points down
    attributes = {
        "POSITION": glb.add_vertices(positions, "VEC3", has_bounds=True),
        "NORMAL": glb.add_vertices(normals, "VEC3"),
        "TEXCOORD_0": glb.add_vertices(flipped_uv, "VEC2"),
        "_LABEL": glb.add_vertices(organ.label[source], "SCALAR"),
        "_INSTANCE": glb.add_vertices(organ.instance[source], "SCALAR"),
        "_ARC_LENGTH": glb.add_vertices(organ.arc_length[source], "SCALAR"),
        "_THETA": glb.add_vertices(organ.theta[source], "SCALAR"),
        "_RADIUS": glb.add_vertices(organ.radius[source], "SCALAR"),
    }
    return {"attributes": attributes, "indices": glb.add_indices(faces)}


def _add_images(
    glb: Glb, organ: OrganSurface, *, compact: bool
) -> tuple[list[dict[str, Any]], dict[str, Any] | None]:
    """Images of the material, and the entry of the relief unless it is stored unchanged."""
    look = organ.appearance
    if look is None:
        return [], None
    scale = relief_scale(organ.vertices, organ.faces, organ.uv)
    if compact and webp_fits(look):
        return _add_webps(glb, look, scale)
    pngs = encode_pngs([*texture_images(look, scale), *_height_steps(look.height)])
    views = [glb.add_bytes(png, {}) for png in pngs]
    images = [{"bufferView": view, "mimeType": "image/png"} for view in views[:_NUM_IMAGES]]
    relief = views[_NUM_IMAGES:]
    return images, {"bufferView": relief[0], "step": HEIGHT_STEP} if relief else None


def _add_webps(
    glb: Glb, look: Appearance, scale: tuple[float, float]
) -> tuple[list[dict[str, Any]], dict[str, Any] | None]:
    """Compact version of `_add_images`."""
    files = compact_files(look, scale)
    views = {name: glb.add_bytes(file, {}) for name, file in files.items()}
    relief = views.pop("relief", None)
    images = [{"bufferView": view, "mimeType": "image/webp"} for view in views.values()]
    entry = {"bufferView": relief, "step": RELIEF_STEP, "mimeType": "image/webp"}
    return images, None if relief is None else entry


def _add_own(
    glb: Glb,
    organ: OrganSurface,
    source: Int[np.ndarray, " k"],
    uv: Float[np.ndarray, "k 2"],
    relief: dict[str, Any] | None,
    *,
    compact: bool,
) -> dict[str, Any]:
    """Entries read by `read_organ`: plain values, arrays, and the images and attributes of arrays.

    ``faces`` and ``uv`` are stored for each vertex of the file, in the organ's order:
    ``faces[m, c] = source[index]`` and ``uv[m, c] = uv[index]`` with the file's own indices.
    """
    arrays, plain = organ_to_arrays(organ)
    arrays |= {"faces": source.astype(organ.faces.dtype), "uv": uv}
    images = {name: texture for name, texture in TEXTURES.items() if name in arrays}
    # Vertices without triangles are not in the file.
    is_all_there = len(np.unique(source)) == len(organ.vertices)
    attributes = dict(ATTRIBUTES) if compact and is_all_there else {}
    elsewhere = {*images, *attributes, *(["appearance.height"] if relief else [])}
    own = {
        name: glb.add_array(array, deflated=compact)
        for name, array in sorted(arrays.items())
        if name not in elsewhere
    }
    own |= {"appearance.height": relief} if relief else {}
    plain_record = {"plain": json_safe(plain), "arrays": own, "images": images}
    return plain_record | ({"attributes": attributes} if attributes else {})


def _height_steps(height: Float[np.ndarray, "h w"]) -> list[np.ndarray]:
    """Relief as a 16-bit image of its steps (`HEIGHT_STEP`); empty if that would not be exact."""
    if height.dtype != np.float32:
        return []
    steps = height * np.float32(1.0 / HEIGHT_STEP)
    steps += np.float32(_ZERO)
    image = np.clip(steps, 0, 2 * _ZERO - 1).astype(np.uint16)
    return [image] if np.array_equal(image, steps) else []


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
    file_format = _format(path)
    if file_format != ORGAN_FORMAT:
        raise InputError(
            f"{path} has the format {file_format!r}. Allowed: {ORGAN_FORMAT!r}. "
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
        raise ValueError("a triangle refers to a missing vertex")
    if not np.isfinite(values["arc_length"]).all():
        raise ValueError("an arc length is not a number")
    if not isinstance(own["plain"]["metadata"], dict):
        raise ValueError("its metadata are not a table")
    seed = own["plain"]["metadata"].get("seed", 0)
    if isinstance(seed, int) and not 0 <= seed <= MAX_SEED:
        raise ValueError(f"seed in its metadata is {seed}. Allowed: 0 to {MAX_SEED}")
    organ = organ_from_arrays(values | own["plain"])
    if not (np.diff(organ.centerline.arc_length) > 0.0).all():
        raise ValueError("the arc lengths of its centerline do not ascend")
    _require_centerline(organ.centerline)
    return organ


def _require_centerline(line: Centerline) -> None:
    """Check points and radii of a centerline.

    Raises:
        ValueError: If they are damaged.
    """
    if not (np.linalg.norm(np.diff(line.points, axis=0), axis=1) > 0.0).all():  # NaN neither
        raise ValueError("the points of its centerline are repeated or not finite")
    if not ((line.radius >= 0.0) & np.isfinite(line.radius)).all() or not line.radius.any():
        raise ValueError("the radii of its centerline are negative, all zero or not finite")


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
    attributes_of_file = document["meshes"][0]["primitives"][0]["attributes"]
    result = {
        name: vertices_of(document, binary, attributes_of_file[attribute])
        for name, attribute in own.get("attributes", {}).items()
    }
    if not result:
        return {}
    numbers, first = np.unique(source, return_index=True)
    if not np.array_equal(numbers, np.arange(len(numbers))):
        raise ValueError("a vertex is missing")
    uv = result.pop("uv").astype(float)
    values = {name: array[first] for name, array in result.items()}
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
