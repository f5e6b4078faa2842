"""A generated colon: anatomy, mesh, texture coordinates, and the population it is drawn from."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from scipy.ndimage import map_coordinates

from vrcaps.anatomy import colon as generate_module
from vrcaps.anatomy.colon import ColonParameters, generate_colon
from vrcaps.anatomy.colon import course as course_module
from vrcaps.anatomy.colon.course import colon_rng, count_flexures, generate_course
from vrcaps.anatomy.colon.parameters import SEGMENTS
from vrcaps.anatomy.colon.shape import draw_colon_wall, wall_radius
from vrcaps.anatomy.full_tract.patient import colon_at
from vrcaps.anatomy.tube_mesh import surface_to_organ
from vrcaps.anatomy.tube_mesh.tube import Course, make_tube
from vrcaps.core.errors import InputError
from vrcaps.core.units import MM
from vrcaps.mesh.mesh import Mesh
from vrcaps.mesh.self_intersection import self_intersections
from vrcaps.mucosa.bake import bake_appearance
from vrcaps.organ.gltf_material import relief_scale
from vrcaps.organ.measure import triangle_quality
from vrcaps.organ.surface import OrganSurface
from vrcaps.organ.uv import texture_stretch

pytestmark = pytest.mark.slow

SMALL, COARSE = 20_000, 60_000
"""Triangles of the colons that are made only to be compared, and of those that are looked at."""


@pytest.fixture(scope="module")
def mean_colon() -> OrganSurface:
    return generate_colon(dataclasses.replace(ColonParameters(), triangles=COARSE), seed=0)


@pytest.fixture(scope="module")
def small_colon() -> OrganSurface:
    return generate_colon(dataclasses.replace(ColonParameters(), triangles=SMALL), seed=1)


@pytest.fixture(scope="module", params=["mean", "drawn"])
def colon(request: pytest.FixtureRequest, mean_colon: OrganSurface) -> OrganSurface:
    if request.param == "mean":
        return mean_colon
    drawn = ColonParameters.draw(np.random.default_rng(3))
    return generate_colon(dataclasses.replace(drawn, triangles=COARSE), seed=3)


def edge_faces(faces: np.ndarray) -> np.ndarray:
    """Number of faces that use each undirected edge."""
    halves = np.sort(faces[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2), axis=1)
    return np.unique(halves, axis=0, return_counts=True)[1]


def signed_volume(organ: OrganSurface) -> float:
    """Volume by the divergence theorem, positive where normals point out [m³]."""
    a, b, c = (organ.vertices[organ.faces[:, k]] for k in range(3))
    return float(np.einsum("ij,ij->", a, np.cross(b, c)) / 6.0)


def test_surface_is_a_closed_sphere_facing_the_lumen(colon: OrganSurface):
    counts = edge_faces(colon.faces)
    assert np.all(counts == 2)
    assert len(colon.vertices) - len(counts) + len(colon.faces) == 2
    # A distended adult colon holds two to four liters.
    assert -4.5e-3 < signed_volume(colon) < -1.5e-3
    center = np.stack(
        [
            np.interp(colon.arc_length, colon.centerline.arc_length, colon.centerline.points[:, k])
            for k in range(3)
        ],
        axis=1,
    )
    inward = np.einsum("ij,ij->i", colon.normals, center - colon.vertices)
    assert np.mean(inward > 0.0) > 0.97
    assert np.allclose(np.linalg.norm(colon.normals, axis=1), 1.0)


def test_triangles_are_many_and_well_shaped(colon: OrganSurface):
    asked = colon.metadata["parameters"]["triangles"]
    assert asked <= len(colon.faces) <= 1.1 * asked
    quality = triangle_quality(Mesh(colon.vertices, colon.faces))
    assert quality.mean() > 0.9
    assert np.percentile(quality, 5) > 0.7
    assert quality.min() > 0.02
    near_ends = np.isin(colon.faces, np.flatnonzero(colon.radius < 4e-3)).any(axis=1)
    assert near_ends.sum() > 20
    assert np.median(quality[near_ends]) > 0.6


def test_surface_does_not_cut_itself(colon: OrganSurface):
    assert len(self_intersections(colon.vertices, colon.faces)) == 0


def test_self_intersections_finds_what_is_put_there(small_colon: OrganSurface):
    """A vertex pushed through the wall, two triangles that cross; not two that touch."""
    apart = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1], [1, 0, 1], [0, 1, 1.0]])
    faces = np.array([[0, 1, 2], [3, 4, 5]])
    assert len(self_intersections(apart, faces)) == 0
    crossing = apart.copy()
    crossing[3] = [0.2, 0.2, -1.0]
    assert self_intersections(crossing, faces).tolist() == [[0, 1]]
    neighbors = np.array([[0, 1, 2], [0, 2, 3]])
    assert len(self_intersections(apart, neighbors)) == 0
    moved = small_colon.vertices.copy()
    bump = np.argmax(small_colon.normals[:, 0])
    moved[bump] += 0.08 * small_colon.normals[bump]
    assert len(self_intersections(moved, small_colon.faces)) > 0


def test_gut_coordinates_reproduce_the_vertices(colon: OrganSurface):
    tube = make_tube(Course(colon.centerline.points, colon.centerline.arc_length))
    again = tube.points(colon.arc_length, colon.theta, colon.radius)
    assert np.allclose(again, colon.vertices, atol=1e-9)
    assert np.all(np.abs(colon.theta) <= np.pi)
    assert colon.arc_length.min() == 0.0
    assert colon.arc_length.max() == pytest.approx(colon.centerline.length)


def test_centerline_is_smooth_framed_and_inside(colon: OrganSurface):
    line = colon.centerline
    steps = np.linalg.norm(np.diff(line.points, axis=0), axis=1)
    assert np.allclose(steps, np.diff(line.arc_length), rtol=0.01)
    gram = np.swapaxes(line.frames, 1, 2) @ line.frames
    assert np.allclose(gram, np.eye(3), atol=1e-9)
    assert np.allclose(np.linalg.det(line.frames), 1.0)
    ahead = np.gradient(line.points, axis=0)
    ahead /= np.linalg.norm(ahead, axis=1, keepdims=True)
    assert np.all(np.einsum("ij,ij->i", ahead, line.frames[:, :, 2]) > 0.999)
    # Parallel transport: the transverse axes turn with the tangent only.
    turn = np.einsum("ij,ij->i", line.frames[1:, :, 0], line.frames[:-1, :, 1])
    assert np.abs(turn).max() < 1e-3
    is_open = (line.arc_length > 0.02) & (line.arc_length < line.length - 0.02)
    assert line.radius[is_open].min() > 5e-3


def test_length_and_flexures_come_out_as_asked(colon: OrganSurface):
    parameters = colon.metadata["parameters"]
    asked = sum(parameters[name]["length"] for name in SEGMENTS)
    polyline = np.linalg.norm(np.diff(colon.centerline.points, axis=0), axis=1).sum()
    assert polyline == pytest.approx(asked, rel=0.002)
    course = Course(colon.centerline.points, colon.centerline.arc_length)
    assert count_flexures(course) == parameters["flexures"]


def test_anatomy_lies_where_it_belongs(colon: OrganSurface):
    """LPS: x to the left, y posterior, z superior."""
    assert colon.label_names == ("background", *SEGMENTS)
    assert set(np.unique(colon.label)) == set(range(1, len(SEGMENTS) + 1))
    middle = {
        name: np.median(colon.vertices[colon.label == number], axis=0)
        for number, name in enumerate(colon.label_names)
        if number
    }
    assert middle["ascending"][0] < -0.06 < 0.06 < middle["descending"][0]
    assert middle["caecum"][0] < -0.05
    assert middle["caecum"][2] < middle["ascending"][2] < middle["hepatic_flexure"][2]
    assert middle["splenic_flexure"][2] > middle["descending"][2] > middle["sigmoid"][2]
    assert middle["transverse"][1] < min(middle["ascending"][1], middle["descending"][1])
    assert abs(middle["rectum"][0]) < 0.03
    assert middle["rectum"][1] > middle["transverse"][1]
    lowest = np.argmin(colon.vertices[:, 2])
    assert colon.arc_length[lowest] > colon.centerline.length - 0.03


@pytest.mark.parametrize("name", ["caecum", "ascending", "transverse", "descending", "sigmoid"])
def test_diameter_is_as_asked_with_folds_into_the_lumen(mean_colon: OrganSurface, name: str):
    segment = getattr(ColonParameters(), name)
    is_in = mean_colon.label == mean_colon.label_names.index(name)
    if name == "caecum":
        is_in &= mean_colon.arc_length > 0.035
    radius = mean_colon.radius[is_in]
    assert 2.0 * np.median(radius) == pytest.approx(segment.diameter, rel=0.15)
    assert np.percentile(radius, 2) < 0.5 * segment.diameter - 0.6 * segment.fold_height


def test_rectum_has_three_valves_and_no_haustra(mean_colon: OrganSurface):
    from_anus = mean_colon.centerline.length - mean_colon.arc_length
    bins = np.arange(0.055, 0.14, 0.005)
    narrowest = np.array(
        [
            mean_colon.radius[(from_anus >= start) & (from_anus < start + 0.005)].min()
            for start in bins
        ]
    )
    is_valve = narrowest < 0.75 * np.median(
        mean_colon.radius[(from_anus > 0.06) & (from_anus < 0.14)]
    )
    assert np.sum(np.diff(is_valve.astype(int)) == 1) + is_valve[0] == 3


def test_texture_coordinates_lie_in_the_unit_square_without_mirrored_faces(colon: OrganSurface):
    uv = colon.uv
    assert uv.shape == (len(colon.faces), 3, 2)
    assert uv.min() > 0.0
    assert uv.max() < 1.0
    one, two = uv[:, 1] - uv[:, 0], uv[:, 2] - uv[:, 0]
    area = 0.5 * (one[:, 0] * two[:, 1] - one[:, 1] * two[:, 0])
    assert np.all(area > 0.0)
    assert 0.6 < np.sum(area) < 1.0


def test_texels_are_even_on_the_wall(colon: OrganSurface):
    """Texels are nearly square and equal over the whole wall, steep folds and ends included."""
    width, height = relief_scale(colon.vertices, colon.faces, colon.uv)
    stretch = texture_stretch(colon.vertices[colon.faces], colon.uv * [width, height])
    assert np.all(stretch > 0.0)
    least, most = np.percentile(stretch, [5, 95], axis=0)
    assert least[0] > 0.88
    assert most[1] < 1.5
    assert np.percentile(stretch[:, 1] / stretch[:, 0], 95) < 1.5


def test_baked_mucosa_runs_on_across_cuts_and_seam(small_colon: OrganSurface):
    """Along every edge where strips part, both sides have the same color and relief."""
    organ, look = small_colon, bake_appearance(small_colon, seed=0, texels_per_mm=2.0)
    halves = organ.faces[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2)
    ends = organ.uv[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2, 2)
    key = np.sort(halves, axis=1) @ [len(organ.vertices), 1]
    one, other = np.argsort(key, kind="stable").reshape(-1, 2).T
    near, far = ends[one], ends[other][:, ::-1]
    is_parted = np.abs(near - far).max(axis=(1, 2)) > 1e-6
    is_open = np.all(organ.radius[halves[one]] > 8 * MM, axis=1)
    near, far = near[is_parted & is_open], far[is_parted & is_open]
    assert len(near) > 300
    for texture in (look.albedo[..., 1].astype(float), look.height):
        sides = [sample(texture, uv.mean(axis=1)) for uv in (near, far)]
        assert np.sqrt(np.mean((sides[0] - sides[1]) ** 2)) < 0.25 * texture.std()


def sample(texture: np.ndarray, uv: np.ndarray) -> np.ndarray:
    """Bilinear lookup inside a texture whose row 0 is v = 1."""
    height, width = texture.shape
    place = [(1.0 - uv[:, 1]) * height - 0.5, uv[:, 0] * width - 0.5]
    return map_coordinates(texture, place, order=1)


def test_same_seed_same_bytes_other_seed_other_course(
    small_colon: OrganSurface, mean_colon: OrganSurface
):
    parameters = dataclasses.replace(ColonParameters(), triangles=SMALL)
    one, again = small_colon, generate_colon(parameters, seed=1)
    for name in ("vertices", "faces", "normals", "uv", "label", "arc_length", "theta", "radius"):
        assert getattr(one, name).tobytes() == getattr(again, name).tobytes()
    assert np.abs(one.centerline.points - mean_colon.centerline.points).max() > 0.01


def test_courses_of_drawn_patients_have_their_length_and_flexures():
    """So courses have the moments of the drawn parameters, which the next test looks at."""
    for seed in range(2):
        rng = np.random.default_rng([seed, 1])
        parameters = ColonParameters.draw(rng)
        course = generate_course(parameters, rng)
        length = np.linalg.norm(np.diff(course.points, axis=0), axis=1).sum()
        assert length == pytest.approx(parameters.length, rel=0.002)
        assert count_flexures(course) == parameters.flexures


def test_drawn_population_has_the_published_moments():
    """1.895 ± 0.263 m and 10.9 ± 2.4 flexures (Khashab et al. 2009)."""
    rng = np.random.default_rng(0)
    drawn = [ColonParameters.draw(rng) for _ in range(2000)]
    lengths, flexures = [p.length for p in drawn], [p.flexures for p in drawn]
    assert np.mean(lengths) == pytest.approx(1.895, abs=0.015)
    assert np.std(lengths) == pytest.approx(0.263, rel=0.08)
    assert np.mean(flexures) == pytest.approx(10.9, abs=0.15)
    assert np.std(flexures) == pytest.approx(2.4, rel=0.08)


def test_count_flexures_of_plain_curves():
    """A straight line has none, a semicircle of 5 cm radius one, an S of two such two."""
    s = np.linspace(0.0, 1.0, 1001)
    straight = np.stack([s, 0 * s, 0 * s], axis=1)
    assert count_flexures(Course(straight, s)) == 0

    def winding(turns: int) -> Course:
        """Bends of 150° and 4 cm radius, alternating, with straights of 12 cm between."""
        angle = np.radians(150.0)
        bend, gap = np.full(round(0.04 * angle * 1000), 1.0 / 0.04), np.zeros(120)
        curvature = np.concatenate(
            [gap] + [c for k in range(turns) for c in ((-1) ** k * bend, gap)]
        )
        heading = np.cumsum(curvature) * 1e-3
        points = 1e-3 * np.cumsum(
            np.stack([np.cos(heading), np.sin(heading), 0 * heading], 1), axis=0
        )
        return Course(points, 1e-3 * np.arange(len(points)))

    for turns in (1, 2, 5):
        assert count_flexures(winding(turns)) == turns


def replace_segment(name: str, **values: float) -> ColonParameters:
    mean = ColonParameters()
    return dataclasses.replace(mean, **{name: dataclasses.replace(getattr(mean, name), **values)})


def test_impossible_parameters_are_refused():
    with pytest.raises(InputError, match=r"length is 9\.0\. Allowed: 0\.03 to 1\.5 m"):
        replace_segment("sigmoid", length=9.0)
    with pytest.raises(InputError, match=r"fold_height is 0\.05\. Allowed: 0 to 0\.012 m"):
        replace_segment("rectum", fold_height=0.05)
    with pytest.raises(InputError, match=r"colon length is 3\.2"):
        ColonParameters(
            **{
                name: dataclasses.replace(getattr(ColonParameters(), name), length=0.4)
                for name in SEGMENTS
            }
        )
    with pytest.raises(InputError, match=r"flexures is 50\. Allowed: 4 to 20"):
        dataclasses.replace(ColonParameters(), flexures=50)
    with pytest.raises(InputError, match="roughness is nan"):
        ColonParameters(roughness=float("nan"))
    with pytest.raises(InputError, match=r"triangles is 10\. Allowed: 20000 to 5000000"):
        dataclasses.replace(ColonParameters(), triangles=10)


def test_a_colon_that_does_not_fit_is_refused(monkeypatch: pytest.MonkeyPatch):
    crowded = dataclasses.replace(
        ColonParameters(),
        flexures=20,
        **{
            name: dataclasses.replace(getattr(ColonParameters(), name), length=0.115, diameter=0.06)
            for name in SEGMENTS
        },
    )
    monkeypatch.setattr(course_module, "_NUM_TRIES", 2)
    with pytest.raises(InputError, match=r"Found no course 0\.92 m long with 20 flexures"):
        generate_course(crowded, np.random.default_rng(0))
    monkeypatch.undo()
    monkeypatch.setattr(surface_to_organ, "self_intersections", lambda *_: np.zeros((1, 2)))
    monkeypatch.setattr(generate_module, "_NUM_TRIES", 1)
    with pytest.raises(InputError, match="without self-intersection"):
        generate_colon(dataclasses.replace(ColonParameters(), triangles=SMALL), seed=0)


def test_a_collapsed_colon_closes_to_pleats_between_pockets_of_gas():
    """Over half of its length the pleats' crests are within 1.5 mm of the middle, and the wall is
    thrown into folds: its girth is still half of that under gas."""
    least, girths = [], []
    for distension in ("inflated", "collapsed"):
        parameters, rng = colon_at(ColonParameters(), distension), colon_rng(0)
        wall = draw_colon_wall(parameters, make_tube(generate_course(parameters, rng)), rng)
        s, theta = np.meshgrid(
            np.linspace(0.05, parameters.length - 0.05, 300),
            np.linspace(-np.pi, np.pi, 120, endpoint=False),
            indexing="ij",
        )
        radius = wall_radius(wall, s.ravel(), theta.ravel()).reshape(s.shape)
        around = radius * np.exp(1j * theta)
        least.append(radius.min(axis=1))
        girths.append(np.abs(np.diff(around, axis=1)).sum(axis=1))
    assert least[0].min() > 5.0 * MM
    assert 0.4 < np.mean(least[1] < 1.5 * MM) < 0.8
    assert least[1].max() > 8.0 * MM
    assert np.median(girths[1] / girths[0]) > 0.5
