"""GLB files say exactly what the organ says, checked with trimesh's reader and PIL."""

import json
import struct
from dataclasses import replace
from io import BytesIO

import numpy as np
import pytest
import trimesh
from PIL import Image

from vrcaps.core.geometry import rotate_vectors, transform_from, transform_points
from vrcaps.mesh.mesh import vertex_normals
from vrcaps.mesh.read_mesh import read_label_names, read_mesh
from vrcaps.mesh.repair import repair
from vrcaps.organ.gltf_material import normal_texture, relief_scale, texture_images
from vrcaps.organ.organ_file import split_at_seams, write_organ
from vrcaps.organ.surface import Appearance, Centerline, OrganSurface

RADIUS, LENGTH = 0.02, 0.1


@pytest.fixture
def organ() -> OrganSurface:
    """A closed cylinder along z with texture coordinates around and along, and a seam."""
    judge = trimesh.creation.cylinder(RADIUS, LENGTH, sections=48).subdivide().subdivide()
    vertices, faces = np.array(judge.vertices), np.array(judge.faces)[:, ::-1]
    theta = np.arctan2(vertices[:, 1], vertices[:, 0])
    u = theta[faces] / (2 * np.pi)
    u = np.where(np.ptp(u, axis=1, keepdims=True) > 0.5, u % 1.0, u)
    arc_length = vertices[:, 2] + LENGTH / 2
    rng = np.random.default_rng(0)
    points = np.linspace([0, 0, -LENGTH / 2], [0, 0, LENGTH / 2], 21)
    line = np.linspace(0, LENGTH, 21)
    rows, columns = np.mgrid[0:32, 0:64] / np.array([32, 64])[:, None, None]
    return OrganSurface(
        name="cylinder",
        vertices=vertices,
        faces=faces,
        normals=vertex_normals(vertices, faces),
        uv=np.stack([u, arc_length[faces] / LENGTH], axis=-1),
        label=rng.integers(1, 3, len(vertices)).astype(np.uint8),
        label_names=("background", "wall", "polyp"),
        instance=rng.integers(0, 1000, len(vertices)).astype(np.uint16),
        arc_length=arc_length,
        theta=theta,
        radius=np.hypot(vertices[:, 0], vertices[:, 1]),
        centerline=Centerline(points, line, np.full(21, RADIUS), np.tile(np.eye(3), (21, 1, 1))),
        appearance=Appearance(
            albedo=rng.integers(0, 256, (32, 64, 3)).astype(np.uint8),
            roughness=rng.integers(0, 256, (32, 64)).astype(np.uint8),
            height=1e-4 * np.sin(2 * np.pi * (rows + columns)),
        ),
    )


def random_pose() -> np.ndarray:
    rotation = trimesh.transformations.random_rotation_matrix(np.array([0.1, 0.7, 0.4]))[:3, :3]
    return transform_from(rotation, np.array([0.3, -0.2, 0.1]))


def read_chunks(path) -> tuple[dict, bytes]:
    data = path.read_bytes()
    magic, version, size, json_size, json_type = struct.unpack("<4sIII4s", data[:20])
    assert (magic, version, size, json_type) == (b"glTF", 2, len(data), b"JSON")
    binary_size, binary_type = struct.unpack("<I4s", data[20 + json_size : 28 + json_size])
    assert binary_type == b"BIN\0"
    assert size == 28 + json_size + binary_size
    return json.loads(data[20 : 20 + json_size]), data[28 + json_size :]


def test_file_holds_world_positions_and_all_attributes(tmp_path, organ):
    pose = random_pose()
    write_organ(tmp_path / "a.glb", organ, T_world_patient=pose)
    scene = trimesh.load_scene(tmp_path / "a.glb", process=False)
    (part,) = scene.geometry.values()
    assert np.array_equal(scene.graph[scene.graph.nodes_geometry[0]][0], np.eye(4))
    faces = organ.faces
    world = transform_points(pose, organ.vertices).astype(np.float32)
    assert np.array_equal(part.vertices.astype(np.float32)[part.faces], world[faces])
    normals = rotate_vectors(pose, organ.normals).astype(np.float32)
    assert np.allclose(part.vertex_normals[part.faces], normals[faces], atol=1e-6)
    assert np.allclose(part.visual.uv[part.faces], organ.uv, atol=2e-7)
    attributes = part.vertex_attributes
    assert np.array_equal(attributes["_LABEL"].reshape(-1)[part.faces], organ.label[faces])
    assert np.array_equal(attributes["_INSTANCE"].reshape(-1)[part.faces], organ.instance[faces])
    arc_length = attributes["_ARC_LENGTH"].reshape(-1)[part.faces]
    assert np.allclose(arc_length, organ.arc_length[faces], rtol=1e-6)


def test_only_seams_are_split(tmp_path, organ):
    source, faces, uv = split_at_seams(organ.faces, organ.uv)
    assert np.all(np.diff(source) >= 0)
    assert np.array_equal(source[faces], organ.faces)
    assert np.array_equal(uv[faces], organ.uv)
    pairs = np.column_stack([organ.faces.reshape(-1), organ.uv.reshape(-1, 2)])
    assert len(source) == len(np.unique(pairs, axis=0))


def test_read_back_and_repaired_it_is_the_same_wall(tmp_path, organ):
    write_organ(tmp_path / "a.glb", organ)
    mesh, report = repair(read_mesh(tmp_path / "a.glb", unit="m"))
    assert {entry.kind for entry in report.repairs} == {"duplicate vertex"}
    assert np.allclose(mesh.vertices, organ.vertices, atol=1e-8)
    assert np.array_equal(mesh.label, organ.label)
    assert read_label_names(tmp_path / "a.glb") == organ.label_names


def test_document_follows_the_specification(tmp_path, organ):
    write_organ(tmp_path / "a.glb", organ)
    document, binary = read_chunks(tmp_path / "a.glb")
    assert document["buffers"] == [{"byteLength": len(binary)}]
    assert document["nodes"] == [{"mesh": 0, "name": "cylinder"}]
    assert all(view["byteOffset"] % 4 == 0 for view in document["bufferViews"])
    position = document["accessors"][0]
    assert position["min"] == organ.vertices.astype(np.float32).min(axis=0).tolist()
    assert position["max"] == organ.vertices.astype(np.float32).max(axis=0).tolist()
    assert document["extensionsUsed"] == ["KHR_materials_clearcoat", "KHR_materials_ior"]
    (material,) = document["materials"]
    coat = material["extensions"]["KHR_materials_clearcoat"]
    assert coat["clearcoatFactor"] == 0.25
    # Burley 2012: α from 0.1 to 0.001 by gloss 0.9; glTF states √α.
    assert coat["clearcoatRoughnessFactor"] == pytest.approx(np.sqrt(0.0109))
    assert material["extensions"]["KHR_materials_ior"] == {"ior": 1.4}


def test_textures_are_exact(tmp_path, organ):
    write_organ(tmp_path / "a.glb", organ)
    document, binary = read_chunks(tmp_path / "a.glb")
    images = []
    for image in document["images"]:
        view = document["bufferViews"][image["bufferView"]]
        data = binary[view["byteOffset"] : view["byteOffset"] + view["byteLength"]]
        images.append(np.array(Image.open(BytesIO(data))))
    albedo, roughness, normal = images
    assert np.array_equal(albedo, organ.appearance.albedo)
    assert np.array_equal(roughness, organ.appearance.roughness)
    assert document["materials"][0]["pbrMetallicRoughness"]["metallicFactor"] == 0.0
    assert normal.shape == albedo.shape


def test_normals_are_the_slope_of_the_relief():
    """h = A sin(2π(u + 2v)) over a wall of size Lu × Lv: n ∝ (−∂h/∂x, −∂h/∂y, 1)."""
    size, amplitude, scale = 256, 1e-4, (0.1, 0.2)
    v, u = 1.0 - (np.mgrid[0:size, 0:size] + 0.5) / size
    u = 1.0 - u
    height = amplitude * np.sin(2 * np.pi * (u + 2 * v))
    slope = 2 * np.pi * amplitude * np.cos(2 * np.pi * (u + 2 * v))
    expected = np.stack([-slope / scale[0], -2 * slope / scale[1], np.ones_like(u)], axis=-1)
    expected /= np.linalg.norm(expected, axis=-1, keepdims=True)
    found = normal_texture(height, scale) / 127.5 - 1.0
    assert np.abs(found - expected).max() < 1.01 / 255


def test_a_fine_relief_is_averaged_for_viewers(organ, monkeypatch):
    """On a plane, the mean of four texels is the height at their center: the slope is unchanged."""
    from vrcaps.organ import gltf_material

    look = replace(organ.appearance, height=np.add.outer(np.arange(32.0), 2 * np.arange(64.0)))
    full = texture_images(look, (64.0, 32.0))[2]
    monkeypatch.setattr(gltf_material, "_MAX_NORMALS", 32 * 64 - 1)
    albedo, roughness, half = texture_images(look, (64.0, 32.0))
    assert albedo.shape == (32, 64, 3) and roughness.shape == (32, 64)
    assert half.shape == (16, 32, 3)
    assert np.array_equal(half[1:-1, 1:-1], full[2:-2:2, 2:-2:2])
    odd = replace(look, height=look.height[:31])
    assert texture_images(odd, (64.0, 32.0))[2].shape == (31, 64, 3)


def test_relief_scale_of_a_cylinder(organ):
    side = np.abs(vertex_normals(organ.vertices, organ.faces)[:, 2]) < 0.1
    faces = np.all(side[organ.faces], axis=1)
    along_u, along_v = relief_scale(organ.vertices, organ.faces[faces], organ.uv[faces])
    assert along_u == pytest.approx(2 * np.pi * RADIUS, rel=0.01)
    assert along_v == pytest.approx(LENGTH, rel=0.01)
    flat = np.zeros_like(organ.uv)
    assert relief_scale(organ.vertices, organ.faces, flat) == (1.0, 1.0)


def test_plain_organ_has_a_plain_material(tmp_path, organ):
    write_organ(tmp_path / "a.glb", replace(organ, appearance=None))
    document, _ = read_chunks(tmp_path / "a.glb")
    assert "images" not in document
    assert "baseColorFactor" in document["materials"][0]["pbrMetallicRoughness"]
    trimesh.load_scene(tmp_path / "a.glb")


def test_same_bytes_and_no_temporary_file_left(tmp_path, organ):
    for name in ("a.glb", "b.glb", "b.glb"):
        write_organ(tmp_path / name, organ)
    assert (tmp_path / "a.glb").read_bytes() == (tmp_path / "b.glb").read_bytes()
    assert sorted(path.name for path in tmp_path.iterdir()) == ["a.glb", "b.glb"]


def test_failed_write_leaves_the_old_file(tmp_path, organ, monkeypatch):
    path = tmp_path / "a.glb"
    write_organ(path, organ)
    before = path.read_bytes()

    def fail(source, target):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("vrcaps.core.files.os.replace", fail)
    with pytest.raises(OSError, match="No space left"):
        write_organ(path, organ)
    assert path.read_bytes() == before
    assert [entry.name for entry in tmp_path.iterdir()] == ["a.glb"]
