"""Facts of organs whose figures are known in closed form."""

import re
from dataclasses import replace

import numpy as np
import pytest
import trimesh

from vrcaps.core.units import MM
from vrcaps.mesh.mesh import Mesh, vertex_normals
from vrcaps.organ.measure import (
    measure_organ,
    segment_spans,
    triangle_quality,
    unit_question,
)
from vrcaps.organ.surface import Centerline, OrganSurface

RADIUS, LENGTH = 0.02, 0.2


def make_organ(judge: trimesh.Trimesh) -> OrganSurface:
    """A wall around the z axis, with the diameter's radius falling linearly along it."""
    vertices, faces = np.array(judge.vertices), np.array(judge.faces)[:, ::-1]
    size = len(vertices)
    line = np.linspace(0.0, LENGTH, 101)
    points = np.stack([0 * line, 0 * line, line - LENGTH / 2], axis=1)
    radius = RADIUS * (1.0 - 0.5 * line / LENGTH)
    return OrganSurface(
        name="tube",
        vertices=vertices,
        faces=faces,
        normals=vertex_normals(vertices, faces),
        uv=np.zeros((len(faces), 3, 2)),
        label=np.where(vertices[:, 2] < 0.0, 1, 2).astype(np.uint8),
        label_names=("background", "first", "second"),
        instance=np.zeros(size, np.uint16),
        arc_length=vertices[:, 2] + LENGTH / 2,
        theta=np.zeros(size),
        radius=np.hypot(vertices[:, 0], vertices[:, 1]),
        centerline=Centerline(points, line, radius, np.tile(np.eye(3), (101, 1, 1))),
    )


def cylinder() -> trimesh.Trimesh:
    return trimesh.creation.cylinder(RADIUS, LENGTH, sections=64).subdivide_to_size(0.01)


@pytest.mark.slow
def test_facts_of_a_cylinder():
    facts = measure_organ(make_organ(cylinder()))
    assert facts.size == pytest.approx((2 * RADIUS, 2 * RADIUS, LENGTH), rel=0.01)
    assert facts.volume == pytest.approx(np.pi * RADIUS**2 * LENGTH, rel=0.01)
    assert facts.area == pytest.approx(2 * np.pi * RADIUS * (RADIUS + LENGTH), rel=0.01)
    assert facts.length == pytest.approx(LENGTH)
    # Where the ends do not narrow it: 2 r(s) for r(0) < s < L − r.
    assert facts.diameter_max == pytest.approx(2 * RADIUS)
    assert facts.diameter_min == pytest.approx(2 * RADIUS * (1 - 0.5 * 0.945), rel=0.01)
    assert facts.diameter_median == pytest.approx(1.5 * RADIUS, rel=0.03)
    first, second = facts.diameter_by_segment["first"], facts.diameter_by_segment["second"]
    assert first == pytest.approx(2 * RADIUS * (1 - 0.5 * 0.30), rel=0.02)
    assert second == pytest.approx(2 * RADIUS * (1 - 0.5 * 0.72), rel=0.02)
    assert facts.num_faces == 2 * facts.num_vertices - 4
    assert 0.0 < facts.quality_p5 < facts.quality_mean < 1.0


def test_quality_is_one_for_an_equilateral_triangle_and_half_root_three_for_half_a_square():
    vertices = np.array([[0, 0, 0], [1, 0, 0], [0.5, np.sqrt(0.75), 0], [0, 1, 0], [0, 2, 0.0]])
    quality = triangle_quality(Mesh(vertices, np.array([[0, 1, 2], [0, 1, 3], [0, 3, 4]])))
    assert quality == pytest.approx([1.0, np.sqrt(3) / 2, 0.0])


def test_clean_sphere_has_no_defects():
    assert measure_organ(make_organ(trimesh.creation.icosphere(radius=RADIUS))).defects == ()


def test_defects_are_named_and_counted():
    organ = make_organ(trimesh.creation.icosphere(radius=RADIUS))
    faces = organ.faces[1:]
    assert measure_organ(replace(organ, faces=faces)).defects == ("1 open ends or holes",)
    faces = np.vstack([organ.faces[:1, ::-1], organ.faces[1:]])
    (wrong,) = measure_organ(replace(organ, faces=faces)).defects
    assert wrong.startswith("3 edges whose triangles are wound against each other")
    fin = np.vstack([organ.faces, [[*organ.faces[0, :2], 200]]])
    assert "1 edges of more than two triangles" in measure_organ(replace(organ, faces=fin)).defects


def test_handles_are_counted():
    facts = measure_organ(make_organ(trimesh.creation.torus(RADIUS, 0.3 * RADIUS)))
    assert facts.defects == ("1 handles (the wall joins itself around a gap)",)


def test_thin_triangles_are_counted():
    organ = make_organ(trimesh.creation.cylinder(RADIUS, LENGTH, sections=400))
    assert any("thin triangles" in defect for defect in measure_organ(organ).defects)


@pytest.mark.slow
def test_self_intersections_are_counted_and_located():
    organ = make_organ(cylinder())
    outer = np.argmax(organ.vertices[:, 0] - np.abs(organ.vertices[:, 2]))
    vertices = organ.vertices.copy()
    vertices[outer, 0] -= 3 * RADIUS
    defects = measure_organ(replace(organ, vertices=vertices)).defects
    (cut,) = (defect for defect in defects if "self-intersections" in defect)
    found = re.fullmatch(r"1 self-intersections of the wall \((\d+) pairs .*, at \((.*)\) mm", cut)
    assert found
    assert 4 < int(found[1]) < 100
    x, y, z = map(float, found[2].split(", "))
    assert (x, y, z) == pytest.approx((-RADIUS / MM, 0.0, 0.0), abs=1.5)


@pytest.mark.slow
def test_open_ends_count_as_closed_for_the_volume():
    judge = cylinder()
    wall = judge.submesh([np.nonzero(np.abs(judge.face_normals[:, 2]) < 0.5)[0]], append=True)
    facts = measure_organ(make_organ(wall))
    assert facts.volume == pytest.approx(np.pi * RADIUS**2 * LENGTH, rel=0.01)
    assert facts.defects[0] == "2 open ends or holes"


@pytest.mark.slow
def test_short_centerline_without_inner_samples_counts_whole():
    organ = make_organ(cylinder())
    wide = replace(organ.centerline, radius=np.full(101, LENGTH))
    assert measure_organ(replace(organ, centerline=wide)).diameter_min == 2 * LENGTH


def test_segments_follow_each_other_along_the_way():
    organ = make_organ(cylinder())
    spans = segment_spans(organ)
    assert [label for label, _, _ in spans] == [1, 2]
    assert spans[0][1] == 0.0
    assert spans[0][2] == spans[1][1] == pytest.approx(LENGTH / 2, abs=0.006)
    assert spans[1][2] == pytest.approx(LENGTH)
    one = replace(organ, label=np.ones_like(organ.label))
    assert segment_spans(one) == [(1, 0.0, pytest.approx(LENGTH))]


@pytest.mark.parametrize(
    ("unit", "diameter", "question"),
    [
        ("mm", 3.0 * MM, " Is the unit cm, not mm?"),
        ("m", 30.0, " Is the unit mm, not m?"),
        ("cm", 0.3, " Is the unit mm, not cm?"),
        ("mm", 30e-6, " Is the unit m, not mm?"),
        ("5cm", 1.5, " Is the unit mm, not 5cm?"),
        ("mm", 10.0 * MM, ""),
        ("mm", 100.0 * MM, ""),
        ("mm", 1e3, ""),
    ],
)
def test_the_unit_that_was_meant(unit, diameter, question):
    """A lumen is some 30 mm wide: 3 in the file are cm, 30 are mm."""
    assert unit_question(unit, diameter) == question
