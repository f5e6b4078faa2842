"""Writer of organs as GLB files (binary glTF 2.0, Khronos 2021), exact or compact."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from vrcaps._core import encode_pngs
from vrcaps.core.files import write_bytes
from vrcaps.core.transforms import rotate_vectors, transform_points
from vrcaps.mesh.glb import Glb
from vrcaps.organ.arrays import json_safe, organ_to_arrays
from vrcaps.organ.compact_textures import RELIEF_STEP, compact_files, webp_fits
from vrcaps.organ.gltf_material import material_json, relief_scale, texture_images
from vrcaps.organ.surface import HEIGHT_STEP

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
    (`compact_textures`), and vertex attributes in single precision are not stored again exactly.
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
    number = np.empty(len(order), np.int64)
    number[order] = np.cumsum(is_new) - 1
    first = order[is_new]
    return corners[first], number.reshape(-1, 3), flat_uv[first]


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
    images = {name: place for name, place in TEXTURES.items() if name in arrays}
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
    found = {"plain": json_safe(plain), "arrays": own, "images": images}
    return found | ({"attributes": attributes} if attributes else {})


def _height_steps(height: Float[np.ndarray, "h w"]) -> list[np.ndarray]:
    """Relief as a 16-bit image of its steps (`HEIGHT_STEP`); empty if that would not be exact."""
    if height.dtype != np.float32:
        return []
    steps = height * np.float32(1.0 / HEIGHT_STEP)
    steps += np.float32(_ZERO)
    image = np.clip(steps, 0, 2 * _ZERO - 1).astype(np.uint16)
    return [image] if np.array_equal(image, steps) else []
