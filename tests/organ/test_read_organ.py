"""A mesh file becomes an organ with every field in step."""

import hashlib
import re
from dataclasses import replace

import numpy as np
import pytest
import trimesh

from tests.support.tubes import straight_tube
from tests.support.write_ply import write_ply
from vrcaps.core.errors import InputError
from vrcaps.mesh.mesh import Mesh
from vrcaps.organ.measure import measure_organ
from vrcaps.organ.organ_file import write_organ
from vrcaps.organ.read_organ import read_organ
from vrcaps.organ.surface import OrganSurface

RADIUS, LENGTH = 0.02, 0.2


def check_organ(organ: OrganSurface) -> None:
    num_vertices, num_faces = len(organ.vertices), len(organ.faces)
    judge = trimesh.Trimesh(organ.vertices, organ.faces, process=False)
    assert judge.is_watertight
    assert judge.volume < 0.0
    assert np.allclose(np.linalg.norm(organ.normals, axis=1), 1.0)
    for values in (organ.label, organ.instance, organ.arc_length, organ.theta, organ.radius):
        assert values.shape == (num_vertices,)
        assert np.isfinite(values).all()
    assert organ.uv.shape == (num_faces, 3, 2)
    assert np.isfinite(organ.uv).all()
    assert organ.label.max() < len(organ.label_names)
    assert organ.arc_length.min() >= 0.0
    assert organ.arc_length.max() <= organ.centerline.length * (1 + 1e-9)


@pytest.fixture(scope="module")
def tube_path(tmp_path_factory):
    """A closed tube in millimeters, normals outward, with labels and flat wedges."""
    judge = trimesh.creation.capsule(LENGTH, RADIUS, count=[24, 24])
    vertices, faces = np.array(judge.vertices) * 1e3, np.array(judge.faces)
    uv = vertices[faces][..., :2] / 100
    label = np.where(vertices[:, 2] > 100, 3, 1).astype(np.uint8)
    path = tmp_path_factory.mktemp("organ") / "tube.ply"
    write_ply(path, Mesh(vertices, faces, uv, label))
    return path


@pytest.fixture(scope="module")
def tube(tube_path) -> OrganSurface:
    return read_organ(tube_path, unit="mm")


@pytest.mark.slow
def test_tube(tube, tube_path):
    organ = tube
    check_organ(organ)
    assert organ.name == "tube"
    assert organ.label_names == ("background", "label 1", "label 2", "label 3")
    assert organ.metadata["source"] == str(tube_path)
    assert organ.metadata["sha256"] == hashlib.sha256(tube_path.read_bytes()).hexdigest()
    assert organ.metadata["unit"] == "mm"
    assert organ.metadata["repairs"] == ["1 × outward surface: turned to face into the lumen"]
    assert LENGTH < organ.centerline.length < LENGTH + 2 * RADIUS
    facts = measure_organ(organ)
    assert facts.diameter_median == pytest.approx(2 * RADIUS, rel=0.05)
    assert facts.volume == pytest.approx(np.pi * RADIUS**2 * (LENGTH + 4 / 3 * RADIUS), rel=0.03)


@pytest.mark.slow
def test_own_texture_coordinates_stay_on_request(tube, tube_path):
    organ = read_organ(tube_path, unit="mm", name="mine", keep_uv=True)
    assert organ.name == "mine"
    expected = organ.vertices[organ.faces][..., :2] * 1e3 / 100
    assert np.allclose(organ.uv, expected, atol=1e-9)
    assert not np.allclose(tube.uv, expected)


def test_there_must_be_texture_coordinates_to_keep(tmp_path):
    ball = trimesh.creation.icosphere(radius=RADIUS)
    ball.export(tmp_path / "a.stl")
    with pytest.raises(InputError, match="has no finite texture coordinates to keep"):
        read_organ(tmp_path / "a.stl", unit="m", keep_uv=True)


@pytest.mark.slow
def test_written_organ_comes_back(tube, tmp_path):
    organ = replace(
        tube,
        label=np.minimum(tube.label, 2).astype(np.uint8),
        label_names=("background", "wall", "fundus"),
    )
    write_organ(tmp_path / "a.glb", organ)
    back = read_organ(tmp_path / "a.glb", unit="m")
    assert back.label_names == organ.label_names
    assert np.array_equal(back.label, organ.label)
    assert np.allclose(back.vertices, organ.vertices, atol=1e-7)


@pytest.mark.parametrize(
    ("name", "length_mm"),
    [
        pytest.param("colon_GI1_mm", (800, 2500), marks=pytest.mark.validation),
        ("stomach_C_mm", (50, 200)),
    ],
)
def test_real_organs(real_organ, name, length_mm):
    organ = real_organ(name)
    check_organ(organ)
    assert organ.label_names == ("background", "wall")
    assert np.all(organ.label == 1)
    assert length_mm[0] < organ.centerline.length * 1e3 < length_mm[1]
    facts = measure_organ(organ)
    assert 5.0 < facts.diameter_min * 1e3 < facts.diameter_median * 1e3 < facts.diameter_max * 1e3
    assert list(facts.diameter_by_segment) == ["wall"]


@pytest.mark.slow
def test_an_unlikely_width_asks_for_the_unit(tube_path, caplog):
    read_organ(tube_path, unit="cm")
    assert re.search(r"the lumen is 396 mm wide. Is the unit mm, not cm\?", caplog.text)
    with pytest.raises(
        InputError,
        match=r"3\.96e\+03 mm wide\. Allowed: at most 1000 mm\. Is the unit mm, not dm\?",
    ):
        read_organ(tube_path, unit="dm")


@pytest.mark.slow
@pytest.mark.parametrize("open_ends", ["cap", "keep"])
def test_a_third_opening_is_named_with_its_place(tmp_path, caplog, open_ends):
    """A hole of 30 mm in the side of an open tube of 40 mm."""
    open_tube = straight_tube(LENGTH, RADIUS, around=24, rings=26)
    middle = open_tube.vertices[open_tube.faces].mean(axis=1)
    is_hole = np.linalg.norm(middle - [RADIUS, 0, LENGTH / 2], axis=1) < 0.015
    write_ply(tmp_path / "a.ply", Mesh(open_tube.vertices, open_tube.faces[~is_hole]))
    read_organ(tmp_path / "a.ply", unit="m", open_ends=open_ends)
    assert "has 3 openings as wide as a lumen, at (" in caplog.text
    assert "a gut has two" in caplog.text


def test_a_wall_with_a_thickness_in_one_piece_is_refused(tmp_path):
    judge = trimesh.creation.annulus(RADIUS, RADIUS + 3e-3, LENGTH)
    write_ply(tmp_path / "a.ply", Mesh(np.array(judge.vertices), np.array(judge.faces)))
    with pytest.raises(InputError, match=r"a wall about 2\.9 mm thick"):
        read_organ(tmp_path / "a.ply", unit="m")
