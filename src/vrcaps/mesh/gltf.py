"""Reader of glTF 2.0 scenes (Khronos 2021) as one mesh: nodes, instances, skins, morph targets."""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING, Any
from urllib.parse import unquote

import numpy as np

from vrcaps.core.errors import narrow
from vrcaps.mesh.glb import (
    DRACO,
    GltfFile,
    compression_text,
    local_transform,
    read_document,
    read_gltf_file,
    translation_rotation_scale,
)
from vrcaps.mesh.mesh import Mesh, drop_unused_vertices, triangulate_fans, triangulate_strips

if TYPE_CHECKING:
    from collections.abc import Iterator

    from jaxtyping import Float, Int


_LISTS = ("accessors", "buffers", "bufferViews", "images", "meshes", "nodes", "scenes", "skins")
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
        raise ValueError("its document is not an object")
    for name in _LISTS:
        entries = document.get(name, [])
        if not (isinstance(entries, list) and all(isinstance(entry, dict) for entry in entries)):
            raise ValueError(f"{name} is not a list of objects")
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
        raise ValueError(f"{name} is {value!r}, allowed: whole numbers from 0 to {most}")


_TRIANGLES, _STRIP, _FAN = 4, 5, 6
_NO_SURFACE = (0, 1, 2, 3)  # modes of points and lines
_INSTANCING = "EXT_mesh_gpu_instancing"
_MAX_VALUES = 50_000_000  # vertices and triangles of a scene, some 100 times a fine wall


def read_gltf(path: Path) -> Mesh:
    """Read all meshes of the default scene as one mesh, in the frame of the scene.

    Raises:
        OSError, ValueError, LookupError, TypeError, struct.error: If the file is damaged, or its
            mesh is compressed.
        InputError: If labels or lesion IDs are out of range.
    """
    require_safe_gltf(path)
    # Overflow is detected in the vertices, see `read_mesh`.
    with np.errstate(over="ignore", invalid="ignore"):
        return _concatenate(_all_parts(read_gltf_file(path)))


def _all_parts(file: GltfFile) -> list[Mesh]:
    """Each primitive of the default scene, once per occurrence."""
    scene_transforms = dict(_world_transforms(file))
    parts, count = [], 0
    for node, transform in scene_transforms.items():
        entry = file.entry("nodes", node)
        if "mesh" not in entry:
            continue
        mesh = file.entry("meshes", entry["mesh"])
        for primitive in mesh["primitives"]:
            for part in _parts(file, entry, mesh, primitive, (transform, scene_transforms)):
                count += len(part.vertices) + len(part.faces)
                if count > _MAX_VALUES:
                    raise ValueError(
                        f"its scene has more than {_MAX_VALUES} vertices and triangles"
                    )
                parts.append(drop_unused_vertices(part))
    return parts


def _world_transforms(file: GltfFile) -> Iterator[tuple[int, np.ndarray]]:
    """Index and transform into the scene of each node of the default scene, parents first."""
    document = file.document
    if document.get("scenes"):
        roots = file.entry("scenes", document.get("scene", 0)).get("nodes", [])
    else:
        nodes = document.get("nodes", [])
        children = {child for node in nodes for child in node.get("children", [])}
        roots = [number for number in range(len(nodes)) if number not in children]
    waiting, seen = [(root, np.eye(4)) for root in reversed(roots)], set()
    while waiting:
        number, parent = waiting.pop()
        node = file.entry("nodes", number)
        if number in seen:
            raise ValueError(f"nodes[{number}] has several parents")
        seen.add(number)
        transform = parent @ local_transform(node)
        yield number, transform
        waiting += [(child, transform) for child in reversed(node.get("children", []))]


def _parts(
    file: GltfFile,
    node: dict[str, Any],
    mesh: dict[str, Any],
    primitive: dict[str, Any],
    scene_transforms: tuple[np.ndarray, dict[int, np.ndarray]],
) -> Iterator[Mesh]:
    """Copies of one primitive in the scene: one, or one per instance of the node.

    Args:
        file: glTF file.
        node: Node with the mesh.
        mesh: Mesh of the node.
        primitive: Primitive of the mesh.
        scene_transforms: Transform of the node into the scene, and those of all nodes by index.
    """
    if primitive.get("mode", _TRIANGLES) in _NO_SURFACE:
        return
    attributes = primitive["attributes"]
    _require_data(file, primitive)
    points = _morphed(file, node, mesh, primitive)
    faces = _faces(file, primitive, len(points))
    if len(faces) and not 0 <= faces.min() <= faces.max() < len(points):
        raise ValueError(f"an index is out of range, allowed: 0 to {len(points) - 1}")
    uv = _attribute(file, attributes, "TEXCOORD_0", len(points))
    if uv is not None:
        uv[:, 1] = 1.0 - uv[:, 1]  # glTF counts texture rows from the top
        uv = uv.astype(float)[faces]
    label = _attribute(file, attributes, "_LABEL", len(points))
    instance = _attribute(file, attributes, "_INSTANCE", len(points))
    if label is not None:
        label = narrow(label.reshape(-1), np.uint8, "labels (_LABEL)")
    if instance is not None:
        instance = narrow(instance.reshape(-1), np.uint16, "lesion IDs (_INSTANCE)")
    for moved, is_mirrored in _moved(file, node, attributes, points, scene_transforms):
        turn = slice(None, None, -1 if is_mirrored else 1)
        yield Mesh(moved, faces[:, turn], None if uv is None else uv[:, turn], label, instance)


def _require_data(file: GltfFile, primitive: dict[str, Any]) -> None:
    """Check that the file holds uncompressed positions."""
    entry = file.entry("accessors", primitive["attributes"]["POSITION"])
    if DRACO in primitive.get("extensions", {}) and "bufferView" not in entry:
        raise ValueError(compression_text(DRACO))


def _morphed(
    file: GltfFile, node: dict[str, Any], mesh: dict[str, Any], primitive: dict[str, Any]
) -> Float[np.ndarray, "n 3"]:
    """Positions in the frame of the node, displaced by the morph targets at default weights."""
    points = file.array(primitive["attributes"]["POSITION"]).astype(float)
    targets = primitive.get("targets", [])
    weights = node.get("weights", mesh.get("weights", [0.0] * len(targets)))
    for weight, target in zip(weights, targets, strict=True):
        if "POSITION" in target and weight != 0.0:
            points = points + weight * file.array(target["POSITION"])
    return points


def _faces(file: GltfFile, primitive: dict[str, Any], count: int) -> Int[np.ndarray, "m 3"]:
    """Triangles of a primitive."""
    corners = np.arange(count)
    if "indices" in primitive:
        corners = file.array(primitive["indices"])
        if corners.ndim != 1 or corners.dtype.kind != "u":
            raise ValueError("indices are not whole numbers")
        corners = corners.astype(np.int64)
    mode = primitive.get("mode", _TRIANGLES)
    if mode == _TRIANGLES:
        return corners.reshape(-1, 3)
    if mode == _STRIP:
        return corners[triangulate_strips(np.array([len(corners)]))]
    if mode == _FAN:
        return corners[triangulate_fans(np.array([len(corners)]))]
    raise ValueError(f"the mode of a primitive is {mode!r}, allowed: 0 to 6")


def _attribute(
    file: GltfFile, attributes: dict[str, Any], key: str, count: int
) -> np.ndarray[Any, Any] | None:
    """Value per vertex, if the primitive has the attribute."""
    if key not in attributes:
        return None
    values = file.array(attributes[key])
    if len(values) != count:
        raise ValueError(f"{key} has {len(values)} values for {count} vertices")
    return values


def _moved(
    file: GltfFile,
    node: dict[str, Any],
    attributes: dict[str, Any],
    points: Float[np.ndarray, "n 3"],
    scene_transforms: tuple[np.ndarray, dict[int, np.ndarray]],
) -> Iterator[tuple[Float[np.ndarray, "n 3"], bool]]:
    """Positions in the scene, and whether they are mirrored; one item per instance."""
    if "skin" in node:  # its node's transform is ignored
        yield _skinned(
            file, file.entry("skins", node["skin"]), attributes, points, scene_transforms[1]
        )
        return
    for transform in scene_transforms[0] @ _instances(file, node):
        matrix = transform[:3, :3]
        yield points @ matrix.T + transform[:3, 3], bool(np.linalg.det(matrix) < 0.0)


def _instances(file: GltfFile, node: dict[str, Any]) -> Float[np.ndarray, "n 4 4"]:
    """Transforms of the copies of a node's mesh in the frame of the node."""
    extension = node.get("extensions", {}).get(_INSTANCING)
    if extension is None:
        return np.eye(4)[None]
    components = {key: file.array(number) for key, number in extension["attributes"].items()}
    lengths = {len(values) for values in components.values()}
    if len(lengths) != 1:
        raise ValueError(f"the attributes of {_INSTANCING} differ in length")
    (count,) = lengths
    return translation_rotation_scale(
        components.get("TRANSLATION", np.zeros((count, 3))),
        components.get("ROTATION", np.tile([0.0, 0.0, 0.0, 1.0], (count, 1))),
        components.get("SCALE", np.ones((count, 3))),
    )


def _skinned(
    file: GltfFile,
    skin: dict[str, Any],
    attributes: dict[str, Any],
    points: Float[np.ndarray, "n 3"],
    scene_transforms: dict[int, np.ndarray],
) -> tuple[Float[np.ndarray, "n 3"], bool]:
    """Positions in the scene by linear blend skinning, and whether they are mirrored."""
    joints = skin["joints"]
    outside = [number for number in joints if number not in scene_transforms]
    if outside:
        raise ValueError(f"nodes[{outside[0]}] is a joint outside the scene")
    transforms = np.array([scene_transforms[number] for number in joints])
    if "inverseBindMatrices" in skin:
        inverse = file.array(skin["inverseBindMatrices"]).reshape(-1, 4, 4).transpose(0, 2, 1)
        transforms = transforms @ inverse[: len(joints)]
    blended = np.zeros((len(points), 3, 4))
    for number in range(sum(key.startswith("JOINTS_") for key in attributes)):
        chosen = narrow(file.array(attributes[f"JOINTS_{number}"]), np.int64, "joints")
        weights = file.array(attributes[f"WEIGHTS_{number}"])
        for joint, weight in zip(chosen.T, weights.T, strict=True):
            blended += weight[:, None, None] * transforms[joint, :3]
    moved = np.einsum("nij,nj->ni", blended[..., :3], points) + blended[..., 3]
    return moved, bool(np.median(np.linalg.det(blended[..., :3])) < 0.0)


def _concatenate(parts: list[Mesh]) -> Mesh:
    if not parts:
        return Mesh(np.zeros((0, 3)), np.zeros((0, 3), np.int64))
    offsets = np.cumsum([0] + [len(part.vertices) for part in parts[:-1]])
    uvs = [part.uv for part in parts if part.uv is not None]
    labels = [part.label for part in parts if part.label is not None]
    instances = [part.instance for part in parts if part.instance is not None]
    return Mesh(
        np.concatenate([part.vertices for part in parts]),
        np.concatenate([part.faces + offset for part, offset in zip(parts, offsets, strict=True)]),
        np.concatenate(uvs) if len(uvs) == len(parts) else None,
        np.concatenate(labels) if len(labels) == len(parts) else None,
        np.concatenate(instances) if len(instances) == len(parts) else None,
    )
