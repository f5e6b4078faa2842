"""glTF: the same box in every form that the format allows, and what is refused.

The box has sides of 2, 3 and 5 m: 30 m³, its middle at (1, 1.5, 2.5).
"""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.support.small_glb import SmallGlb
from vrcaps.core.errors import InputError
from vrcaps.mesh import gltf
from vrcaps.mesh.mesh import Mesh, signed_volume
from vrcaps.mesh.read_mesh import read_label_names, read_mesh

SIZE = np.array([2.0, 3.0, 5.0])
CORNERS = np.array([[x, y, z] for x in (0, 1) for y in (0, 1) for z in (0, 1)], float)
POINTS = (CORNERS * SIZE).astype("<f4")
QUADS = np.array(
    [[0, 1, 3, 2], [4, 6, 7, 5], [0, 4, 5, 1], [2, 3, 7, 6], [0, 2, 6, 4], [1, 5, 7, 3]], "<u2"
)
FACES = np.concatenate([QUADS[:, [0, 1, 2]], QUADS[:, [0, 2, 3]]])
PRIMITIVE: dict[str, Any] = {"attributes": {"POSITION": 0}, "indices": 1}
Document = dict[str, Any]


def box() -> SmallGlb:
    """Positions as accessor 0, indices as accessor 1."""
    glb = SmallGlb()
    glb.add(POINTS, "VEC3")
    glb.add(FACES.reshape(-1), "SCALAR")
    return glb


def read(path: Path) -> Mesh:
    return read_mesh(path, unit="m")


def check_box(
    mesh: Mesh, volume: float = 30.0, middle: tuple[float, ...] = (1.0, 1.5, 2.5)
) -> None:
    assert signed_volume(mesh) == pytest.approx(volume, rel=1e-4)
    low, high = (
        mesh.vertices[mesh.faces].min(axis=(0, 1)),
        mesh.vertices[mesh.faces].max(axis=(0, 1)),
    )
    assert (low + high) / 2 == pytest.approx(middle, abs=1e-4)


def test_a_plain_box(tmp_path: Path) -> None:
    check_box(read(box().write(tmp_path / "a.glb", [PRIMITIVE])))


@pytest.mark.parametrize("kind", ["<i1", "<u1", "<i2", "<u2"])
def test_normalized_integers_stand_for_fractions(tmp_path: Path, kind: str) -> None:
    """Unsigned integers map to 0 to 1, signed ones to -1 to 1; rows are padded to 4 bytes."""
    glb, largest = SmallGlb(), np.iinfo(np.dtype(kind)).max
    width = 4 // np.dtype(kind).itemsize if np.dtype(kind).itemsize == 1 else 4
    values = np.zeros((8, width), kind)
    values[:, :3] = CORNERS * largest
    stride = width * np.dtype(kind).itemsize
    glb.add(values, "VEC3", stride=stride, normalized=True)
    glb.accessors[0]["count"] = 8
    glb.add(FACES.reshape(-1), "SCALAR")
    required = ["KHR_mesh_quantization"]
    node = {"mesh": 0, "scale": SIZE.tolist()}
    path = glb.write(tmp_path / "a.glb", [PRIMITIVE], nodes=[node], extensionsRequired=required)
    check_box(read(path))


def test_the_least_signed_integer_stands_for_minus_one(tmp_path: Path) -> None:
    glb = SmallGlb()
    values = np.where(CORNERS > 0.0, 32767, -32768).astype("<i2")
    glb.add(np.pad(values, ((0, 0), (0, 1))), "VEC3", stride=8, normalized=True)
    glb.add(FACES.reshape(-1), "SCALAR")
    mesh = read(glb.write(tmp_path / "a.glb", [PRIMITIVE]))
    assert np.array_equal(np.unique(mesh.vertices), [-1.0, 1.0])


@pytest.mark.parametrize("index_kind", ["<u1", "<u2", "<u4"])
@pytest.mark.parametrize("has_base", [True, False])
def test_sparse_accessors_replace_rows(tmp_path: Path, index_kind: str, has_base: bool) -> None:
    glb = SmallGlb()
    wrong = POINTS.copy()
    wrong[4:] += 7.0
    which = np.arange(4 if has_base else 0, 8).astype(index_kind)
    glb.add(wrong, "VEC3")
    glb.add(FACES.reshape(-1), "SCALAR")
    indices, values = glb.add(which, "SCALAR"), glb.add(POINTS[which], "VEC3")
    glb.accessors[0]["sparse"] = {
        "count": len(which),
        "indices": {
            "bufferView": indices,
            "componentType": glb.accessors[indices]["componentType"],
        },
        "values": {"bufferView": values},
    }
    if not has_base:  # then of zeros
        del glb.accessors[0]["bufferView"]
    check_box(read(glb.write(tmp_path / "a.glb", [PRIMITIVE])))


def test_strips_and_fans_keep_their_sides(tmp_path: Path) -> None:
    """Three sides as fans, three as strips; points and lines are no surface."""
    glb, primitives = SmallGlb(), []
    glb.add(POINTS, "VEC3")
    for number, quad in enumerate(QUADS):
        order = quad if number < 3 else quad[[0, 1, 3, 2]]
        index = glb.add(order, "SCALAR")
        mode = 6 if number < 3 else 5
        primitives.append({"attributes": {"POSITION": 0}, "indices": index, "mode": mode})
    primitives += [PRIMITIVE | {"mode": mode} for mode in (0, 1, 2, 3)]
    mesh = read(glb.write(tmp_path / "a.glb", primitives))
    assert len(mesh.faces) == 12
    check_box(mesh)


def test_positions_without_indices_are_triangles_in_order(tmp_path: Path) -> None:
    glb = SmallGlb()
    glb.add(POINTS[FACES.reshape(-1)], "VEC3")
    mesh = read(glb.write(tmp_path / "a.glb", [{"attributes": {"POSITION": 0}}]))
    assert len(mesh.vertices) == 36
    check_box(mesh)


def test_nodes_multiply_and_mirrors_keep_the_outside_out(tmp_path: Path) -> None:
    """A mirrored child of a moved and turned parent: by hand, x to y, y to -x."""
    turn = [0.0, 0.0, np.sqrt(0.5), np.sqrt(0.5)]
    nodes = [
        {"children": [1], "translation": [10, 0, 0], "rotation": turn},
        {"mesh": 0, "matrix": [-1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1]},
    ]
    mesh = read(box().write(tmp_path / "a.glb", [PRIMITIVE], nodes=nodes))
    check_box(mesh, middle=(8.5, -1.0, 2.5))


def test_only_the_default_scene_counts(tmp_path: Path) -> None:
    nodes = [{"mesh": 0, "translation": [9, 9, 9]}, {"mesh": 0}]
    scenes = [{"nodes": [0]}, {"nodes": [1]}]
    check_box(
        read(box().write(tmp_path / "a.glb", [PRIMITIVE], nodes=nodes, scenes=scenes, scene=1))
    )


def test_without_scenes_all_roots_count(tmp_path: Path) -> None:
    nodes = [{"children": [1], "scale": [1, 1, 2]}, {"mesh": 0, "scale": [1, 1, 0.5]}]
    check_box(read(box().write(tmp_path / "a.glb", [PRIMITIVE], nodes=nodes, scenes=[])))


def test_instances_are_copies_in_the_frame_of_their_node(tmp_path: Path) -> None:
    glb = box()
    moves = glb.add(np.array([[0, 0, 0], [10, 0, 0]], "<f4"), "VEC3")
    scales = glb.add(np.array([[1, 1, 1], [-1, 1, 1]], "<f4"), "VEC3")
    turns = glb.add(np.array([[0, 0, 0, 127], [0, 0, 0, 127]], "<i1"), "VEC4", normalized=True)
    names = {"TRANSLATION": moves, "SCALE": scales, "ROTATION": turns}
    extension = {"EXT_mesh_gpu_instancing": {"attributes": names}}
    nodes = [{"mesh": 0, "scale": [1, 1, 2], "extensions": extension}]
    mesh = read(glb.write(tmp_path / "a.glb", [PRIMITIVE], nodes=nodes))
    assert len(mesh.faces) == 24
    check_box(mesh, volume=120.0, middle=(5.0, 1.5, 5.0))


def test_a_skinned_mesh_follows_its_joints_not_its_node(tmp_path: Path) -> None:
    """Its corners at the far x follow a joint that is 4 m off its bind pose: 3 times as long."""
    glb, far = box(), CORNERS[:, 0] > 0.0
    joints, weights = np.zeros((8, 4), "<u1"), np.zeros((8, 4), "<u1")
    joints[far, 0], weights[:, 0] = 1, 255
    inverse = np.tile(np.eye(4, dtype="<f4"), (2, 1, 1))
    inverse[1, 3, :3] = [-1.0, 0.0, 0.0]  # column by column: bound at x = 1
    names = {
        "JOINTS_0": glb.add(joints, "VEC4"),
        "WEIGHTS_0": glb.add(weights, "VEC4", normalized=True),
    }
    skin = {"joints": [1, 2], "inverseBindMatrices": glb.add(inverse.reshape(2, 16), "MAT4")}
    nodes = [
        {"mesh": 0, "skin": 0, "scale": [100] * 3},
        {"children": [2]},
        {"translation": [5, 0, 0]},
    ]
    path = glb.write(
        tmp_path / "a.glb",
        [{"attributes": {"POSITION": 0, **names}, "indices": 1}],
        nodes=nodes,
        scenes=[{"nodes": [0, 1]}],
        skins=[skin],
    )
    check_box(read(path), volume=90.0, middle=(3.0, 1.5, 2.5))


@pytest.mark.parametrize("place", ["node", "mesh", "none"])
def test_morph_targets_move_by_their_default_weights(tmp_path: Path, place: str) -> None:
    """Half of a target that doubles z."""
    glb = box()
    target = glb.add((POINTS * [0, 0, 1]).astype("<f4"), "VEC3")
    primitive = PRIMITIVE | {"targets": [{"POSITION": target}]}
    mesh = {"primitives": [primitive]} | ({"weights": [0.5]} if place == "mesh" else {})
    node = {"mesh": 0} | ({"weights": [0.5]} if place == "node" else {})
    found = read(glb.write(tmp_path / "a.glb", [], nodes=[node], meshes=[mesh]))
    half = place != "none"
    check_box(found, volume=45.0 if half else 30.0, middle=(1.0, 1.5, 3.75 if half else 2.5))


def test_labels_numbers_and_texture_coordinates(tmp_path: Path) -> None:
    glb = box()
    label, lesion = np.arange(8).astype("<u1"), np.arange(8, dtype="<u2") * 9000
    uv = np.column_stack([np.arange(8), np.arange(8)]) * 8192
    names = {
        "_LABEL": glb.add(np.pad(label[:, None], ((0, 0), (0, 3))), "SCALAR", stride=4),
        "_INSTANCE": glb.add(np.pad(lesion[:, None], ((0, 0), (0, 1))), "SCALAR", stride=4),
        "TEXCOORD_0": glb.add(uv.astype("<u2"), "VEC2", normalized=True),
    }
    primitive = {"attributes": {"POSITION": 0, **names}, "indices": 1}
    mesh = {"primitives": [primitive], "extras": {"label_names": ["background", "wall"]}}
    path = glb.write(tmp_path / "a.glb", [], meshes=[mesh])
    found = read(path)
    assert found.label is not None and found.instance is not None and found.uv is not None
    assert np.array_equal(found.label, label)
    assert np.array_equal(found.instance, lesion)
    expected = np.column_stack([np.arange(8) * 8192 / 65535, 1.0 - np.arange(8) * 8192 / 65535])
    assert np.allclose(found.uv, expected[found.faces], atol=1e-6)
    assert read_label_names(path) == ("background", "wall")


@pytest.mark.parametrize("extras", [[], {"label_names": "wall"}, {"label_names": [1]}, None])
def test_label_names_are_texts_or_none(tmp_path: Path, extras: object) -> None:
    mesh = {"primitives": [PRIMITIVE], "extras": extras}
    assert read_label_names(box().write(tmp_path / "a.glb", [], meshes=[mesh])) == ()


@pytest.mark.parametrize(
    ("key", "value"), [("_LABEL", 300.0), ("_LABEL", 1.5), ("_INSTANCE", -1.0)]
)
def test_labels_and_numbers_never_wrap(tmp_path: Path, key: str, value: float) -> None:
    glb = box()
    values = np.ones(8, "<f4")
    values[2] = value
    attributes = {"POSITION": 0, key: glb.add(values, "SCALAR")}
    path = glb.write(tmp_path / "a.glb", [{"attributes": attributes, "indices": 1}])
    with pytest.raises(InputError, match=rf"(IDs|labels) .*{key}.* the first is {value}\. Allowed"):
        read(path)


def _compressed(extension: str) -> Callable[[SmallGlb], Document]:
    def change(glb: SmallGlb) -> Document:
        if "draco" in extension:
            del glb.accessors[0]["bufferView"]
            part = {"bufferView": 0, "attributes": {"POSITION": 0}}
            return {"meshes": [{"primitives": [PRIMITIVE | {"extensions": {extension: part}}]}]}
        for view in glb.views:
            view |= {"buffer": 1, "extensions": {extension: {"buffer": 0}}}
        return {"buffers": [{"byteLength": len(glb.data)}] * 2}

    return change


@pytest.mark.parametrize(
    "extension",
    ["KHR_draco_mesh_compression", "EXT_meshopt_compression", "KHR_meshopt_compression"],
)
@pytest.mark.parametrize("is_required", [True, False])
def test_compression_is_named_with_the_way_out(
    tmp_path: Path, extension: str, is_required: bool
) -> None:
    glb = box()
    document = _compressed(extension)(glb)
    names = {"extensionsUsed": [extension]}
    if is_required:
        names["extensionsRequired"] = [extension]
    path = glb.write(tmp_path / "a.glb", [PRIMITIVE], **(document | names))
    with pytest.raises(
        InputError,
        match=rf"compressed \({extension}\), .* export it without compression, or as PLY\.$",
    ):
        read(path)


def test_a_compressed_mesh_with_its_plain_form_is_read(tmp_path: Path) -> None:
    extensions = {"KHR_draco_mesh_compression": {"bufferView": 0, "attributes": {"POSITION": 0}}}
    primitive = PRIMITIVE | {"extensions": extensions}
    used = ["KHR_draco_mesh_compression", "KHR_materials_unlit"]
    check_box(read(box().write(tmp_path / "a.glb", [primitive], extensionsUsed=used)))


@pytest.mark.parametrize(
    ("name", "is_read"),
    [("KHR_materials_unlit", True), ("EXT_texture_webp", True), ("ACME_voxels", False)],
)
def test_required_extensions(tmp_path: Path, name: str, is_read: bool) -> None:
    path = box().write(tmp_path / "a.glb", [PRIMITIVE], extensionsRequired=[name])
    if is_read:
        check_box(read(path))
        return
    with pytest.raises(InputError, match="requires the extension ACME_voxels, which is not supp"):
        read(path)


@pytest.mark.parametrize(
    ("change", "match"),
    [
        (lambda d: d["nodes"][0].update(children=[0]), r"nodes\[0\] has several parents"),
        (lambda d: d["scenes"][0].update(nodes=[5]), r"it has no nodes\[5\]"),
        (lambda d: d["nodes"][0].update(mesh=-1), r"it has no meshes\[-1\]"),
        (lambda d: d["accessors"][0].update(bufferView=True), r"it has no bufferViews\[True\]"),
        (lambda d: d["accessors"][0].update(count=80), r"bufferViews\[0\] is too short for 80"),
        (lambda d: d["accessors"][0].update(byteOffset=-4), "is too short for 8 rows"),
        (lambda d: d["bufferViews"][0].update(byteStride=4), "is too short for 8 rows"),
        (lambda d: d["bufferViews"][0].update(byteOffset=-1), "bytes of"),
        (lambda d: d["bufferViews"][0].update(byteLength=9999), "byteLength is 9999"),
        (lambda d: d["buffers"].append({"byteLength": 96}) or d["bufferViews"][0].update(buffer=1),
         r"buffers\[1\] has no data"),
        (lambda d: d["accessors"][0].pop("bufferView"), r"accessors\[0\] has no data"),
        (lambda d: d["accessors"][0].pop("componentType"), "it has no 'componentType'"),
        (lambda d: d["accessors"][1].update(count=35), "cannot reshape"),
        (lambda d: d["meshes"][0]["primitives"][0].update(mode=9), "the mode of a primitive is 9"),
        (lambda d: d["meshes"][0]["primitives"][0]["attributes"].update(_LABEL=1),
         "_LABEL has 36 values for 8 vertices"),
        (lambda d: d["meshes"][0]["primitives"][0].update(indices=0), "indices are not whole"),
        (lambda d: d["accessors"][0].update(count=7),
         "an index is out of range, allowed: 0 to 6"),
        (lambda d: d["nodes"][0].update(skin=0) or d.update(skins=[{"joints": [7]}]),
         r"nodes\[7\] is a joint outside the scene"),
        (lambda d: d["nodes"][0].update(extensions={"EXT_mesh_gpu_instancing": {"attributes": {
            "TRANSLATION": 0, "SCALE": 1}}}), "EXT_mesh_gpu_instancing differ in length"),
        (lambda d: d["accessors"][0].update(sparse={"count": 9, "indices": {}}),
         "sparse.count is 9"),
        (lambda d: d["accessors"][0].update(sparse={"count": 8, "indices": {
            "bufferView": 0, "componentType": 5126}, "values": {"bufferView": 0}}),
         "an index of a sparse accessor is out of range"),
        (lambda d: d["buffers"][0].update(uri="data:,abc"), "a data URI is not in base64"),
    ],
)  # fmt: skip
def test_damage_is_one_clear_line(
    tmp_path: Path, change: Callable[[Document], object], match: str
) -> None:
    path = box().write(tmp_path / "a.glb", [PRIMITIVE])
    data = path.read_bytes()
    size = int.from_bytes(data[12:16], "little")
    document = json.loads(data[20 : 20 + size])
    change(document)
    glb = SmallGlb()
    glb.data = data[28 + size :]
    glb.write(path, [], **document)
    with pytest.raises(InputError, match=match) as error:
        read(path)
    assert str(error.value).startswith(f"Cannot read {path} as GLB: ")
    assert "\n" not in str(error.value)


def test_a_scene_of_too_many_triangles_is_refused(tmp_path: Path, monkeypatch) -> None:
    monkeypatch.setattr(gltf, "_MAX_VALUES", 30)
    nodes = [{"mesh": 0}] * 2
    path = box().write(tmp_path / "a.glb", [PRIMITIVE], nodes=nodes, scenes=[{"nodes": [0, 1]}])
    with pytest.raises(InputError, match="its scene has more than 30 vertices and triangles"):
        read(path)


def test_a_document_with_a_byte_order_mark_and_a_buffer_beside_it(tmp_path: Path) -> None:
    path = box().write(tmp_path / "a.glb", [PRIMITIVE])
    data = path.read_bytes()
    size = int.from_bytes(data[12:16], "little")
    document = json.loads(data[20 : 20 + size])
    document["buffers"][0]["uri"] = "a%20b.bin"
    (tmp_path / "a b.bin").write_bytes(data[28 + size :])
    (tmp_path / "a.gltf").write_text(json.dumps(document), encoding="utf-8-sig")
    check_box(read(tmp_path / "a.gltf"))


@pytest.mark.parametrize("value", [np.nan, np.inf, 1e38])
def test_values_that_overflow_are_counted_without_a_warning(tmp_path: Path, value: float) -> None:
    glb, points = SmallGlb(), POINTS.copy()
    points[3] = value
    glb.add(points, "VEC3")
    glb.add(FACES.reshape(-1), "SCALAR")
    nodes = [{"mesh": 0, "scale": [1e300] * 3}]
    path = glb.write(tmp_path / "a.glb", [PRIMITIVE], nodes=nodes)
    with pytest.raises(InputError, match="1 vertices that are not finite"):
        read(path)


def test_a_glb_may_have_bytes_after_its_end(tmp_path: Path) -> None:
    path = box().write(tmp_path / "a.glb", [PRIMITIVE])
    path.write_bytes(path.read_bytes() + b"\n\n")
    check_box(read(path))
