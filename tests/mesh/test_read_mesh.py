"""Mesh files are read as they are stored; what cannot be read is one clear line."""

import base64
import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import trimesh

from tests.support.write_ply import write_ply
from vrcaps.core.errors import InputError, UnknownNameError, VrcapsError
from vrcaps.mesh.mesh import Mesh, triangulate_fans
from vrcaps.mesh.read_mesh import read_label_names, read_mesh

QUAD_AND_TRIANGLE = """ply
format ascii 1.0
comment two polygons
element vertex 5
property float x
property float y
property float z
{vertex_uv}element face 2
property list uchar int vertex_indices
{face_uv}end_header
{vertices}
{faces}
"""
POINTS = ["0 0 0", "1 0 0", "1 1 0", "0 1 0", "0.5 0.5 2"]


def ascii_ply(path: Path, *, faces: list[str], vertex_uv: bool = False, face_uv: bool = False):
    points = [f"{p} 0.{i} 0.5" for i, p in enumerate(POINTS)] if vertex_uv else POINTS
    path.write_text(
        QUAD_AND_TRIANGLE.format(
            vertex_uv="property float s\nproperty float t\n" if vertex_uv else "",
            face_uv="property list uchar float texcoord\n" if face_uv else "",
            vertices="\n".join(points),
            faces="\n".join(faces),
        )
    )
    return path


def random_mesh(rng: np.random.Generator, num_vertices: int = 50, num_faces: int = 80) -> Mesh:
    return Mesh(
        rng.normal(size=(num_vertices, 3)),
        rng.integers(0, num_vertices, (num_faces, 3)),
        rng.random((num_faces, 3, 2)),
        rng.integers(0, 9, num_vertices).astype(np.uint8),
    )


@pytest.mark.parametrize("seed", range(5))
def test_ply_round_trip_keeps_every_bit(tmp_path, seed):
    mesh = random_mesh(np.random.default_rng(seed))
    write_ply(tmp_path / "a.ply", mesh)
    back = read_mesh(tmp_path / "a.ply", unit="m")
    for field in ("vertices", "faces", "uv", "label"):
        assert np.array_equal(getattr(back, field), getattr(mesh, field))


def test_bare_ply_round_trip_and_unit(tmp_path):
    mesh = replace(random_mesh(np.random.default_rng(1)), uv=None, label=None)
    write_ply(tmp_path / "a.ply", mesh)
    back = read_mesh(tmp_path / "a.ply", unit="5cm")
    assert np.allclose(back.vertices, 0.05 * mesh.vertices, rtol=1e-15, atol=0)
    assert back.uv is None
    assert back.label is None


def test_ascii_ply_polygons_with_wedges(tmp_path):
    faces = ["4 0 1 2 3 8 0 0 1 0 1 1 0 1", "3 0 1 4 6 .1 .2 .3 .4 .5 .6"]
    mesh = read_mesh(ascii_ply(tmp_path / "a.ply", faces=faces, face_uv=True), unit="mm")
    assert mesh.faces.tolist() == [[0, 1, 2], [0, 2, 3], [0, 1, 4]]
    assert mesh.uv is not None
    assert mesh.uv[1].tolist() == [[0, 0], [1, 1], [0, 1]]
    assert mesh.uv[2].tolist() == [[0.1, 0.2], [0.3, 0.4], [0.5, 0.6]]
    assert mesh.vertices[4].tolist() == [0.0005, 0.0005, 0.002]


def test_ascii_ply_with_texture_coordinates_per_vertex(tmp_path):
    path = ascii_ply(tmp_path / "a.ply", faces=["4 0 1 2 3", "3 0 1 4"], vertex_uv=True)
    mesh = read_mesh(path, unit="m")
    assert mesh.uv is not None
    assert np.allclose(mesh.uv[2], [[0.0, 0.5], [0.1, 0.5], [0.4, 0.5]])


@pytest.mark.parametrize("order", ["little", "big"])
def test_binary_ply_with_ragged_faces_in_both_byte_orders(tmp_path, order):
    mark = "<" if order == "little" else ">"
    header = f"ply\nformat binary_{order}_endian 1.0\nelement vertex 4\nproperty double x\n"
    header += "property double y\nproperty float z\nelement face 2\nproperty uchar flag\n"
    header += "property list uchar uint vertex_index\nend_header\n"
    points = np.zeros(4, [("x", mark + "f8"), ("y", mark + "f8"), ("z", mark + "f4")])
    points["x"], points["z"] = [0, 1, 2, 3], 0.5
    body = points.tobytes()
    for corners in ([0, 1, 2, 3], [3, 1, 0]):
        body += bytes([7, len(corners)]) + np.array(corners, mark + "u4").tobytes()
    (tmp_path / "a.ply").write_bytes(header.encode() + body)
    mesh = read_mesh(tmp_path / "a.ply", unit="m")
    assert mesh.faces.tolist() == [[0, 1, 2], [0, 2, 3], [3, 1, 0]]
    assert mesh.vertices[3].tolist() == [3, 0, 0.5]


def test_obj_keeps_vertices_whole_at_texture_seams(tmp_path):
    text = "# a\nv 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\nvt 0 0\nvt 1 0\nvt 1 1\nvt 0.25 1\n"
    text += "g one\nf 1/1/1 2/2/1 3/3/1 4/4/1\ng two\nf -4/4 -3/-3 -2/-2\n"
    (tmp_path / "a.obj").write_text(text)
    mesh = read_mesh(tmp_path / "a.obj", unit="cm")
    assert mesh.vertices.shape == (4, 3)
    assert mesh.faces.tolist() == [[0, 1, 2], [0, 2, 3], [0, 1, 2]]
    assert mesh.uv is not None
    assert mesh.uv[2].tolist() == [[0.25, 1], [1, 0], [1, 1]]
    assert mesh.vertices.max() == 0.01


def test_obj_without_texture_coordinates_on_every_face_has_none(tmp_path):
    (tmp_path / "a.obj").write_text("v 0 0 0\nv 1 0 0\nv 1 1 0\nvt 0 0\nf 1/1 2/1 3/1\nf 1 3 2\n")
    assert read_mesh(tmp_path / "a.obj", unit="m").uv is None


@pytest.mark.parametrize("file_type", ["stl", "stl_ascii"])
def test_stl_is_a_soup_of_the_same_triangles(tmp_path, file_type):
    sphere = trimesh.creation.icosphere(subdivisions=2)
    (path := tmp_path / "a.stl").write_bytes(
        data if isinstance(data := sphere.export(file_type=file_type), bytes) else data.encode()
    )
    mesh = read_mesh(path, unit="mm")
    assert len(mesh.vertices) == 3 * len(mesh.faces) == 3 * len(sphere.faces)
    expected = sphere.vertices[sphere.faces] * 1e-3
    assert np.allclose(mesh.vertices[mesh.faces], expected, atol=1e-9)


def test_glb_applies_node_transforms_and_keeps_windings_outward(tmp_path):
    sphere = trimesh.creation.icosphere(subdivisions=3)
    scene = trimesh.Scene()
    mirror = np.diag([-1.0, 1.0, 1.0, 1.0])
    mirror[:3, 3] = [10, 0, 0]
    scene.add_geometry(sphere, transform=trimesh.transformations.translation_matrix([0, 5, 0]))
    scene.add_geometry(sphere, transform=mirror)
    scene.export(tmp_path / "a.glb")
    mesh = read_mesh(tmp_path / "a.glb", unit="m")
    assert len(mesh.faces) == 2 * len(sphere.faces)
    assert np.allclose(mesh.vertices.min(axis=0), [-1, -1, -1], atol=1e-6)
    assert np.allclose(mesh.vertices.max(axis=0), [11, 6, 1], atol=1e-6)
    volume = trimesh.Trimesh(mesh.vertices, mesh.faces, process=False).volume
    assert volume == pytest.approx(2 * sphere.volume, rel=1e-6)
    assert read_label_names(tmp_path / "a.glb") == ()
    assert read_label_names(tmp_path / "a.ply") == ()


def test_fans_cover_polygons_and_skip_lines():
    corners = triangulate_fans(np.array([3, 2, 5]))
    assert corners.tolist() == [[0, 1, 2], [5, 6, 7], [5, 7, 8], [5, 8, 9]]


def test_unit_is_checked_first(tmp_path):
    with pytest.raises(InputError, match=r"Unknown length unit 'furlong'\. Allowed: m, dm, cm, mm"):
        read_mesh(tmp_path / "none.ply", unit="furlong")


def test_missing_file(tmp_path):
    with pytest.raises(InputError, match=r"No mesh file at .*none\.ply"):
        read_mesh(tmp_path / "none.ply", unit="mm")


def test_unknown_extension(tmp_path):
    with pytest.raises(
        UnknownNameError, match=r"No mesh file type named 'step'\. Known: glb, gltf,"
    ):
        read_mesh(tmp_path / "a.step", unit="mm")


@pytest.mark.parametrize("extension", ["ply", "obj", "stl", "glb", "gltf"])
@pytest.mark.parametrize("content", [b"", b"not a mesh", bytes(range(256)) * 20])
def test_corrupt_files_are_one_line(tmp_path, extension, content):
    path = tmp_path / f"a.{extension}"
    path.write_bytes(content)
    with pytest.raises(InputError, match=r"^(Cannot read|.* is empty)") as error:
        read_mesh(path, unit="mm")
    assert "\n" not in str(error.value)


@pytest.mark.parametrize("extension", ["ply", "stl", "glb"])
@pytest.mark.parametrize("share", [0.01, 0.05, 0.5, 0.99])
def test_cut_files_never_read_as_whole(tmp_path, extension, share):
    sphere = trimesh.creation.icosphere(subdivisions=2)
    whole = tmp_path / f"whole.{extension}"
    sphere.export(whole)
    path = tmp_path / f"cut.{extension}"
    path.write_bytes(whole.read_bytes()[: int(share * whole.stat().st_size)])
    with pytest.raises(VrcapsError, match=r"^(Cannot read|.* is empty|.* has)"):
        read_mesh(path, unit="mm")


def _write_gltf(path, change):
    """A sphere as .gltf with its buffer in the document, its JSON changed."""
    files = trimesh.exchange.gltf.export_gltf(
        trimesh.Scene(trimesh.creation.icosphere(subdivisions=1)), merge_buffers=True
    )
    document = json.loads(files["model.gltf"])
    (buffer,) = document["buffers"]
    data = base64.b64encode(files[buffer["uri"]]).decode()
    buffer["uri"] = f"data:application/octet-stream;base64,{data}"
    change(document)
    path.write_text(json.dumps(document))


def test_a_gltf_with_its_data_inside_is_read(tmp_path):
    _write_gltf(tmp_path / "a.gltf", lambda _: None)
    assert len(read_mesh(tmp_path / "a.gltf", unit="m").faces) == 80


@pytest.mark.parametrize(
    ("change", "match"),
    [
        (
            lambda d: d["buffers"][0].update(uri="../secret.bin"),
            r"names '\.\./secret\.bin', which lies outside its folder",
        ),
        (lambda d: d["buffers"][0].update(uri="/etc/hosts"), "outside its folder"),
        (lambda d: d["buffers"][0].update(uri="%2e%2e/secret.bin"), "outside its folder"),
        (lambda d: d["buffers"][0].update(uri="file:///etc/hosts"), "outside its folder"),
        (lambda d: d.update(images=[{"uri": "../a.png"}]), "outside its folder"),
        (
            lambda d: d["accessors"][0].update(count=10**15),
            r"accessors\[0\]\.count is 1000000000000000, allowed: whole numbers from 0 to",
        ),
        (lambda d: d["accessors"][0].update(count=-3), r"accessors\[0\]\.count is -3"),
        (lambda d: d["buffers"][0].update(byteLength=10**12), r"buffers\[0\]\.byteLength is"),
        (lambda d: d["bufferViews"][0].update(byteLength=None), r"byteLength is None"),
        (lambda d: d.update(nodes=[7]), "nodes is not a list of objects"),
    ],
)
def test_a_gltf_that_reaches_out_is_refused(tmp_path, change, match):
    folder = tmp_path / "mine"
    folder.mkdir()
    (tmp_path / "secret.bin").write_bytes(bytes(10_000))
    _write_gltf(folder / "a.gltf", change)
    with pytest.raises(InputError, match=match):
        read_mesh(folder / "a.gltf", unit="m")


def test_text_of_a_glb_that_is_not_utf8_is_one_line(tmp_path):
    trimesh.creation.icosphere(subdivisions=1).export(tmp_path / "a.glb")
    data = (tmp_path / "a.glb").read_bytes()
    (tmp_path / "a.glb").write_bytes(data.replace(b'"generator"', b'"gener\xff\xfeor"'))
    with pytest.raises(InputError, match=r"Cannot read .* as GLB: 'utf-8' codec can't decode"):
        read_mesh(tmp_path / "a.glb", unit="m")


def test_empty_mesh(tmp_path):
    (tmp_path / "a.obj").write_text("v 0 0 0\nv 1 0 0\n")
    with pytest.raises(InputError, match="is empty: 2 vertices, 0 triangles"):
        read_mesh(tmp_path / "a.obj", unit="mm")


def test_vertices_that_are_not_finite(tmp_path):
    (tmp_path / "a.obj").write_text("v 0 0 0\nv nan 0 0\nv 0 1 0\nf 1 2 3\n")
    with pytest.raises(InputError, match="1 vertices that are not finite, first at index 1"):
        read_mesh(tmp_path / "a.obj", unit="mm")


@pytest.mark.parametrize("index", ["9", "-7"])
def test_face_indices_out_of_range(tmp_path, index):
    (tmp_path / "a.obj").write_text(f"v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\nf 1 2 {index}\n")
    with pytest.raises(
        InputError, match=r"1 faces with vertex indices out of range.*face 1: \[0, 1,"
    ):
        read_mesh(tmp_path / "a.obj", unit="mm")


def test_obj_counts_from_one(tmp_path):
    (tmp_path / "a.obj").write_text("v 0 0 0\nv 1 0 0\nv 0 1 0\nf 0 1 2\n")
    with pytest.raises(InputError, match="OBJ indices start at 1"):
        read_mesh(tmp_path / "a.obj", unit="mm")


def test_wedges_must_match_corners(tmp_path):
    faces = ["4 0 1 2 3 8 0 0 1 0 1 1 0 1", "3 0 1 4 4 .1 .2 .3 .4"]
    path = ascii_ply(tmp_path / "a.ply", faces=faces, face_uv=True)
    with pytest.raises(InputError, match="two numbers for each corner"):
        read_mesh(path, unit="mm")


def test_real_colon_is_the_same_in_both_units(shared_data):
    millimeters = read_mesh(shared_data / "organs" / "colon_GI1_mm.ply", unit="mm")
    raw = read_mesh(shared_data / "organs" / "colon_GI1_raw.ply", unit="5cm")
    assert millimeters.vertices.shape == raw.vertices.shape == (10609, 3)
    assert np.array_equal(millimeters.faces, raw.faces)
    assert millimeters.uv is not None
    assert millimeters.uv.shape == (21209, 3, 2)
    offset = raw.vertices - millimeters.vertices
    assert np.ptp(offset, axis=0).max() < 1e-7


@pytest.mark.parametrize("name", ["stomach_A_mm", "stomach_C_mm", "stomach_new5_raw"])
def test_real_stomachs_agree_with_trimesh(shared_data, name):
    path = shared_data / "organs" / f"{name}.ply"
    mesh, expected = read_mesh(path, unit="mm"), trimesh.load_mesh(path, process=False)
    assert np.allclose(mesh.vertices, expected.vertices * 1e-3, rtol=1e-12)
    assert np.array_equal(mesh.faces, expected.faces)


def test_a_mesh_of_impossible_size_is_refused(tmp_path):
    mesh = random_mesh(np.random.default_rng(0))
    lines = [*(f"v {x} {y} {z}" for x, y, z in 1e300 * mesh.vertices), "f 1 2 3", "f 2 3 4"]
    (tmp_path / "huge.obj").write_text("\n".join(lines))
    with pytest.raises(InputError, match=r"largest coordinate of .*huge\.obj is .* up to 1e\+09 m"):
        read_mesh(tmp_path / "huge.obj", unit="mm")
