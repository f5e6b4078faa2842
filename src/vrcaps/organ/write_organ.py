"""An organ as a GLB file (binary glTF 2.0, Khronos 2021), exact or compact: any viewer opens it."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from vrcaps._core import encode_pngs
from vrcaps.files import write_bytes
from vrcaps.mesh.glb import Glb
from vrcaps.organ.arrays import json_safe, organ_to_arrays
from vrcaps.organ.compact_textures import RELIEF_STEP, compact_files, webp_fits
from vrcaps.organ.gltf_material import material_json, relief_scale, texture_images
from vrcaps.organ.surface import HEIGHT_STEP
from vrcaps.transforms import rotate_vectors, transform_points

if TYPE_CHECKING:
    from pathlib import Path

    from jaxtyping import Float, Int

    from vrcaps.organ.surface import Appearance, OrganSurface

ORGAN_FORMAT = "vrcaps-organ/1"
"""Names the layout of `write_organ`, in the file's ``asset.extras.format``."""

GENERATOR = "vrcaps"

TEXTURES = {
    "appearance.albedo": {"image": 0},
    "appearance.roughness": {"image": 1},
}
"""Arrays that the file's images hold."""

ATTRIBUTES = {
    **{"vertices": "POSITION", "normals": "NORMAL", "uv": "TEXCOORD_0"},
    **{"label": "_LABEL", "instance": "_INSTANCE"},
    **{"arc_length": "_ARC_LENGTH", "theta": "_THETA", "radius": "_RADIUS"},
}
"""Arrays that the vertices of the file hold too, in single precision; of a compact file only they
do."""

_NUM_IMAGES = 3  # of the material; the relief follows where it is in steps
_ZERO = 32768  # stored for a height of 0


def write_organ(
    path: Path,
    organ: OrganSurface,
    *,
    T_world_patient: Float[np.ndarray, "4 4"] | None = None,
    compact: bool = False,
) -> None:
    """Write `organ_glb` to a file, which is replaced; it appears whole or not at all."""
    write_bytes(path, organ_glb(organ, T_world_patient=T_world_patient, compact=compact))


def organ_glb(
    organ: OrganSurface,
    *,
    T_world_patient: Float[np.ndarray, "4 4"] | None = None,
    compact: bool = False,
) -> list[bytes]:
    """An organ file with texture coordinates, textures, labels, lesions and centerline, in pieces.

    For viewers, positions are in the world frame [m], in single precision, without a node
    transform. Vertices are copied where their texture coordinates differ. The vertex
    attributes ``_LABEL``, ``_INSTANCE``, ``_ARC_LENGTH`` [m], ``_THETA`` [rad] and ``_RADIUS``
    [m] carry the organ's own, the mesh's ``extras`` the label names and lesions.

    For `read_organ`, ``asset.extras`` names a buffer view for each array of the organ that glTF
    would round, in the patient frame and in its own type (docs/episode-format.md): what is read
    back equals what was written, to the last bit. The same organ gives the same bytes.

    A compact file takes a fifth. Its textures are coded with a small loss (`compact_textures`), and
    what its vertices hold in single precision is not there a second time. Vertices, triangles,
    labels and lesions keep their order.

    Args:
        organ: The organ, in the patient frame.
        T_world_patient: Pose of the patient in the world; None: they coincide.
        compact: Whether the file shall be small rather than exact.
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
    """One vertex for each pair of vertex and texture coordinate that occurs.

    Returns:
        The old number of each vertex (ascending), faces over the new vertices, and their uv.
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
    """Accessors of the vertex attributes and of the triangles, as a primitive holds them."""
    source, faces, uv = split
    positions = transform_points(pose, organ.vertices).astype(np.float32)[source]
    normals = rotate_vectors(pose, organ.normals).astype(np.float32)[source]
    flipped_uv = np.stack([uv[:, 0], 1.0 - uv[:, 1]], axis=1)  # glTF counts v from the top down
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
    """The material's images, and where the relief is, unless it is to be stored as it is."""
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
    """What `_add_images` does, in little space."""
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
    """What `read_organ` reads: plain values, arrays, and which images and attributes hold arrays.

    ``faces`` and ``uv`` are stored for each vertex of the file, in their place in the organ:
    ``faces[m, c] = source[index]`` and ``uv[m, c] = uv[index]`` with the file's own indices.
    """
    arrays, plain = organ_to_arrays(organ)
    arrays |= {"faces": source.astype(organ.faces.dtype), "uv": uv}
    images = {name: place for name, place in TEXTURES.items() if name in arrays}
    # A vertex of no triangle is not in the file.
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
    """Relief as a 16-bit image of its steps (`HEIGHT_STEP`); none where that would not be exact."""
    if height.dtype != np.float32:
        return []
    steps = height * np.float32(1.0 / HEIGHT_STEP)
    steps += np.float32(_ZERO)
    image = np.clip(steps, 0, 2 * _ZERO - 1).astype(np.uint16)
    return [image] if np.array_equal(image, steps) else []
