"""Organ files: what is read is what was written, bit for bit; others read the same file."""

from __future__ import annotations

import json
import struct
from dataclasses import fields, replace
from pathlib import Path

import numpy as np
import pygltflib
import pytest
import trimesh

from tests.support.write_ply import write_ply
from vrcaps.core.errors import InputError
from vrcaps.core.geometry import transform_from, transform_points
from vrcaps.mesh.glb import read_document
from vrcaps.mesh.mesh import Mesh
from vrcaps.organ import gltf_material
from vrcaps.organ.gltf_material import RELIEF_STEP
from vrcaps.organ.organ_file import ATTRIBUTES, is_organ_file, write_organ
from vrcaps.organ.read_organ import read_organ
from vrcaps.organ.surface import (
    HEIGHT_STEP,
    Appearance,
    Centerline,
    OrganSurface,
    organ_to_arrays,
    round_height,
)

NAMES = ("background", "first", "second")
SIZES = {5120: 1, 5121: 1, 5122: 2, 5123: 2, 5125: 4, 5126: 4}
WIDTHS = {"SCALAR": 1, "VEC2": 2, "VEC3": 3}


@pytest.fixture
def organ() -> OrganSurface:
    """Every array random, in double precision: nothing can be guessed from anything else."""
    rng = np.random.default_rng(1)
    judge = trimesh.creation.icosphere(2, 0.03)
    num, faces = len(judge.vertices), np.asarray(judge.faces, np.int32)[:, ::-1].copy()
    of_corner = rng.integers(0, 2, (len(faces), 3, 1))  # two texture places for each vertex
    frames = np.stack([np.linalg.qr(rng.normal(size=(3, 3)))[0] for _ in range(7)])
    return OrganSurface(
        name="a ball",
        vertices=judge.vertices + rng.normal(0.0, 1e-4, (num, 3)),
        faces=faces,
        normals=rng.normal(size=(num, 3)),
        uv=rng.random((num, 2, 2))[faces, of_corner[..., 0]],
        label=rng.integers(1, 3, num).astype(np.uint8),
        label_names=NAMES,
        instance=rng.integers(0, 60_000, num).astype(np.uint16),
        arc_length=rng.random(num),
        theta=rng.uniform(-np.pi, np.pi, num),
        radius=rng.random(num),
        centerline=Centerline(rng.random((7, 3)), np.arange(7) / 3, rng.random(7), frames),
        appearance=Appearance(
            albedo=rng.integers(0, 256, (24, 40, 3), np.uint8),
            roughness=rng.integers(0, 256, (24, 40), np.uint8),
            height=round_height(rng.normal(0.0, 3e-4, (24, 40))),
            ior=1.37,
            clearcoat=0.123456789,
            clearcoat_gloss=1 / 3,
        ),
        metadata={"seed": 3, "lesions": [{"instance": 1, "kind": "polyp", "arc_length_m": 0.1}]},
    )


def assert_same(a: OrganSurface, b: OrganSurface) -> None:
    (arrays, plain), (others, other_plain) = organ_to_arrays(a), organ_to_arrays(b)
    assert plain == other_plain
    assert arrays.keys() == others.keys()
    for name, values in arrays.items():
        assert others[name].dtype == values.dtype, name
        assert others[name].shape == values.shape, name
        assert others[name].flags.c_contiguous
        assert others[name].tobytes() == values.tobytes(), name


@pytest.mark.parametrize("change", ["none", "float32", "int64", "plain", "rough relief", "posed"])
def test_what_is_read_is_what_was_written(organ, tmp_path: Path, change: str) -> None:
    pose = None
    if change == "float32":
        organ = replace(organ, vertices=organ.vertices.astype(np.float32))
    elif change == "int64":
        organ = replace(organ, faces=organ.faces.astype(np.int64))
    elif change == "plain":
        organ = replace(organ, appearance=None, metadata={})
    elif change == "rough relief":
        height = organ.appearance.height * np.float32(np.pi)
        organ = replace(organ, appearance=replace(organ.appearance, height=height))
    elif change == "posed":
        turn = trimesh.transformations.random_rotation_matrix(np.array([0.1, 0.7, 0.4]))
        pose = transform_from(turn[:3, :3], np.array([0.3, -0.2, 0.1]))
    path = tmp_path / "a.glb"
    write_organ(path, organ, T_world_patient=pose)
    back = read_organ(path)
    assert_same(organ, back)
    write_organ(tmp_path / "b.glb", back, T_world_patient=pose)
    assert (tmp_path / "b.glb").read_bytes() == path.read_bytes()


def test_every_field_of_an_organ_is_in_the_file(organ, tmp_path: Path) -> None:
    write_organ(tmp_path / "a.glb", organ)
    own = read_document(tmp_path / "a.glb")["asset"]["extras"]
    stored = own["plain"].keys() | own["arrays"].keys() | own["images"].keys()
    wanted = {f.name for f in fields(OrganSurface)} - {"centerline", "appearance"}
    wanted |= {f"centerline.{f.name}" for f in fields(Centerline)}
    assert stored == wanted | {f"appearance.{f.name}" for f in fields(Appearance)}


def test_relief_in_steps_takes_two_bytes_a_texel(organ, tmp_path: Path) -> None:
    write_organ(tmp_path / "a.glb", organ)
    arrays = read_document(tmp_path / "a.glb")["asset"]["extras"]["arrays"]
    assert arrays["appearance.height"]["step"] == HEIGHT_STEP
    for limit in (-32768, 32767):
        height = np.full((24, 40), limit * HEIGHT_STEP, np.float32)
        one = replace(organ, appearance=replace(organ.appearance, height=height))
        write_organ(tmp_path / "b.glb", one)
        assert_same(one, read_organ(tmp_path / "b.glb"))
    rounded = round_height(np.array([[1e-4 + 0.4 * HEIGHT_STEP]]))
    assert abs(rounded[0, 0] - 1e-4) <= HEIGHT_STEP
    assert rounded.dtype == np.float32
    assert not np.signbit(round_height(np.array([[-1e-12]]))).any()


@pytest.mark.parametrize("compact", [False, True])
def test_other_readers_find_the_same(organ, tmp_path: Path, compact: bool) -> None:
    """pygltflib and trimesh: every accessor lies in the buffer and says what the organ says."""
    path = tmp_path / "a.glb"
    write_organ(path, organ, compact=compact)
    file = pygltflib.GLTF2().load(path)
    blob = file.binary_blob()
    assert file.asset.version == "2.0"
    assert file.buffers[0].byteLength == len(blob)
    for view in file.bufferViews:
        assert view.byteOffset % 4 == 0
        assert view.byteOffset + view.byteLength <= len(blob)
    counts = set()
    for accessor in file.accessors:
        view = file.bufferViews[accessor.bufferView]
        size = SIZES[accessor.componentType] * WIDTHS[accessor.type]
        stride = view.byteStride or size
        assert stride % 4 == 0 or view.target == pygltflib.ELEMENT_ARRAY_BUFFER
        assert (accessor.count - 1) * stride + size <= view.byteLength
        if view.target == pygltflib.ARRAY_BUFFER:
            assert accessor.componentType != 5125  # no 32-bit integers in vertex attributes
            counts.add(accessor.count)
    assert len(counts) == 1
    (primitive,) = file.meshes[0].primitives
    own = {n for n in vars(primitive.attributes) if n.startswith("_")}
    assert own == {"_LABEL", "_INSTANCE", "_ARC_LENGTH", "_THETA", "_RADIUS"}
    part = trimesh.load_mesh(path, process=False)
    for name in ("label", "instance", "arc_length", "theta", "radius"):
        found = part.vertex_attributes[f"_{name.upper()}"].reshape(-1)[part.faces]
        assert np.allclose(found, getattr(organ, name)[organ.faces], rtol=1e-6)
    texture = np.asarray(part.visual.material.baseColorTexture.convert("RGB")).astype(int)
    assert np.abs(texture - organ.appearance.albedo).max() <= (2 if compact else 0)


def test_an_episodes_organ_comes_back_in_the_patient_frame(organ, tmp_path: Path) -> None:
    pose = transform_from(np.array([[1.0, 0, 0], [0, 0, 1], [0, -1, 0]]), np.zeros(3))
    write_organ(tmp_path / "a.glb", organ, T_world_patient=pose)
    assert np.array_equal(read_organ(tmp_path / "a.glb").vertices, organ.vertices)
    world = trimesh.load_mesh(tmp_path / "a.glb", process=False)
    expected = transform_points(pose, organ.vertices)[organ.faces]
    assert np.allclose(world.vertices[world.faces], expected, atol=1e-8)


def test_an_organ_file_needs_no_unit_and_is_read_without_changes(organ, tmp_path: Path) -> None:
    path = tmp_path / "a.glb"
    write_organ(path, organ)
    assert is_organ_file(path)
    for unit in (None, "m"):
        assert_same(organ, read_organ(path, unit=unit))
    for wrong in ({"unit": "mm"}, {"reverse": True}, {"open_ends": "keep"}, {"name": "b"}):
        with pytest.raises(
            InputError, match="is an organ file: in meters, and read without changes"
        ):
            read_organ(path, **wrong)


def test_what_another_program_rewrote_is_a_mesh(organ, tmp_path: Path) -> None:
    write_organ(tmp_path / "a.glb", organ)
    rewrite(tmp_path / "a.glb", lambda d: d["asset"].update(generator="Blender"))
    assert not is_organ_file(tmp_path / "a.glb")
    with pytest.raises(InputError, match=r"a\.glb does not state its unit\. Allowed: m, dm, cm"):
        read_organ(tmp_path / "a.glb")


def rewrite(path: Path, change) -> None:
    """Change the JSON of a GLB file."""
    data = path.read_bytes()
    size = struct.unpack_from("<I", data, 12)[0]
    document = json.loads(data[20 : 20 + size])
    change(document)
    text = json.dumps(document).encode()
    text += b" " * (-len(text) % 4)
    rest = data[20 + size :]
    head = struct.pack("<4sIII4s", b"glTF", 2, 20 + len(text) + len(rest), len(text), b"JSON")
    path.write_bytes(head + text + rest)


def test_mistakes_are_told_apart(organ, tmp_path: Path) -> None:
    path = tmp_path / "a.glb"
    with pytest.raises(InputError, match=r"No organ or mesh file at .*a\.glb"):
        read_organ(path)
    write_ply(tmp_path / "a.ply", Mesh(organ.vertices, organ.faces))
    with pytest.raises(InputError, match=r"a\.ply does not state its unit\. Allowed: m, dm, cm"):
        read_organ(tmp_path / "a.ply")
    write_organ(path, organ)
    rewrite(path, lambda d: d["asset"]["extras"].update(format="vrcaps-organ/9"))
    with pytest.raises(InputError, match=r"'vrcaps-organ/9'.*Allowed: 'vrcaps-organ/1'"):
        read_organ(path)


def _drop_array(document: dict) -> None:
    del document["asset"]["extras"]["arrays"]["theta"]


def _wrong_shape(document: dict) -> None:
    document["asset"]["extras"]["arrays"]["theta"]["shape"] = [5]


def _wrong_view(document: dict) -> None:
    document["images"][0]["bufferView"] = 0


def _too_few_vertices(document: dict) -> None:
    arrays = document["asset"]["extras"]["arrays"]
    arrays["vertices"] = arrays["centerline.points"]


def _no_metadata(document: dict) -> None:
    document["asset"]["extras"]["plain"]["metadata"] = [1]


def _negative_seed(document: dict) -> None:
    document["asset"]["extras"]["plain"]["metadata"]["seed"] = -3


@pytest.mark.parametrize(
    "fault",
    [_drop_array, _wrong_shape, _wrong_view, _too_few_vertices, _no_metadata, _negative_seed],
)
def test_a_damaged_file_is_one_line(organ, tmp_path: Path, fault) -> None:
    path = tmp_path / "a.glb"
    write_organ(path, organ)
    rewrite(path, fault)
    with pytest.raises(InputError, match=r"a\.glb is damaged: .*Make or copy the file again"):
        read_organ(path)


def test_an_arc_length_without_value_is_one_line(organ, tmp_path: Path) -> None:
    path = tmp_path / "a.glb"
    write_organ(path, replace(organ, arc_length=np.full(len(organ.vertices), np.nan)))
    with pytest.raises(InputError, match=r"a\.glb is damaged: an arc length is not a number"):
        read_organ(path)


@pytest.mark.parametrize("second", [0.0, np.nan])
def test_a_centerline_with_repeated_points_is_one_line(organ, tmp_path: Path, second) -> None:
    path, arc_length = tmp_path / "a.glb", organ.centerline.arc_length.copy()
    arc_length[1] = second
    write_organ(path, replace(organ, centerline=replace(organ.centerline, arc_length=arc_length)))
    with pytest.raises(InputError, match=r"a\.glb is damaged: the arc lengths of its centerline"):
        read_organ(path)


@pytest.mark.parametrize(
    ("name", "value", "match"),
    [
        ("radius", -1.0, "the radii of its centerline are negative"),
        ("radius", np.nan, "the radii of its centerline are negative"),
        ("radius", 0.0, "the radii of its centerline are negative, all zero"),
        ("points", np.nan, "the points of its centerline are repeated or not finite"),
        ("points", 0.0, "the points of its centerline are repeated"),
    ],
)
def test_a_damaged_centerline_is_one_line(organ, tmp_path: Path, name, value, match) -> None:
    path, line = tmp_path / "a.glb", organ.centerline
    damaged = replace(line, **{name: np.full_like(getattr(line, name), value)})
    write_organ(path, replace(organ, centerline=damaged))
    with pytest.raises(InputError, match=rf"a\.glb is damaged: {match}"):
        read_organ(path)


def test_a_file_cut_short_is_one_line(organ, tmp_path: Path) -> None:
    path = tmp_path / "a.glb"
    write_organ(path, organ)
    data = path.read_bytes()
    path.write_bytes(data[: len(data) // 2])
    with pytest.raises(InputError, match="is damaged: it has"):
        read_organ(path)
    path.write_bytes(data[:30])
    assert not is_organ_file(path)


def test_a_compact_file_is_the_same_wall_in_coarser_steps(organ, tmp_path: Path) -> None:
    """Order, labels to the bit, places and coordinates to single precision, textures in steps."""
    height = round_height(np.random.default_rng(1).normal(0.0, 2e-4, organ.appearance.height.shape))
    organ = replace(organ, appearance=replace(organ.appearance, height=height))
    pose = transform_from(np.array([[1.0, 0, 0], [0, 0, 1], [0, -1, 0]]), np.full(3, 0.3))
    write_organ(tmp_path / "a.glb", organ, T_world_patient=pose, compact=True)
    found = read_organ(tmp_path / "a.glb")
    for name in ("faces", "label", "instance"):
        assert getattr(found, name).tobytes() == getattr(organ, name).tobytes()
    for name in ("vertices", "normals", "uv", "arc_length", "theta", "radius"):
        assert getattr(found, name).dtype == float
        assert np.allclose(getattr(found, name), getattr(organ, name), atol=3e-7)
    assert (found.metadata, found.name) == (organ.metadata, organ.name)
    assert np.array_equal(found.centerline.points, organ.centerline.points)
    look, exact = found.appearance, organ.appearance
    assert np.abs(look.albedo.astype(int) - exact.albedo).max() <= 2
    assert np.abs(look.height - exact.height).max() <= 0.501 * RELIEF_STEP
    assert look.height.dtype == np.float32
    assert look.roughness.shape == exact.roughness.shape


def test_what_a_compact_file_cannot_round_is_stored_exactly(organ, tmp_path: Path, monkeypatch):
    """A relief of meters, a vertex of no triangle, a texture that is too long for WebP."""
    high = np.full_like(organ.appearance.height, 3.0)
    odd = replace(
        organ,
        appearance=replace(organ.appearance, height=high),
        **{
            name: np.concatenate([getattr(organ, name), getattr(organ, name)[:1]])
            for name in ATTRIBUTES
            if name != "uv"
        },
    )
    write_organ(tmp_path / "a.glb", odd, compact=True)
    found = read_organ(tmp_path / "a.glb")
    assert np.array_equal(found.vertices, odd.vertices)
    assert np.array_equal(found.appearance.height, high)
    monkeypatch.setattr(gltf_material, "_MAX_SIDE", 8)
    write_organ(tmp_path / "b.glb", organ, compact=True)
    assert np.array_equal(read_organ(tmp_path / "b.glb").appearance.albedo, organ.appearance.albedo)


def test_the_coded_textures_of_a_large_organ_are_kept(organ, tmp_path: Path, monkeypatch) -> None:
    monkeypatch.setenv("VRCAPS_CACHE", str(tmp_path / "cache"))
    monkeypatch.setattr(gltf_material, "_KEPT_TEXELS", 1)
    write_organ(tmp_path / "a.glb", organ, compact=True)
    monkeypatch.setattr(gltf_material, "albedo_webp", lambda _: pytest.fail("it is there"))
    write_organ(tmp_path / "b.glb", organ, compact=True)
    assert (tmp_path / "a.glb").read_bytes() == (tmp_path / "b.glb").read_bytes()
    other = replace(
        organ, appearance=replace(organ.appearance, albedo=255 - organ.appearance.albedo)
    )
    monkeypatch.setattr(gltf_material, "albedo_webp", lambda _: b"new")
    write_organ(tmp_path / "c.glb", other, compact=True)
    assert len(list((tmp_path / "cache" / "organs").glob("webp-*.npz"))) == 2
