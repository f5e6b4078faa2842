"""A generated stomach: anatomy, mesh, fillings, and the population it is drawn from."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from vrcaps.anatomy.stomach import StomachParameters, generate_stomach
from vrcaps.anatomy.stomach.parameters import DISTENSIONS, SEGMENTS
from vrcaps.anatomy.stomach.shape import curvatures, draw_stomach_wall, stomach_course
from vrcaps.anatomy.tube_mesh import surface_to_organ
from vrcaps.anatomy.tube_mesh.tube import make_tube
from vrcaps.core.errors import InputError
from vrcaps.core.units import CM, MM
from vrcaps.mesh.mesh import Mesh
from vrcaps.mesh.self_intersection import self_intersections
from vrcaps.organ.measure import measure_organ, triangle_quality
from vrcaps.organ.surface import OrganSurface

LITER = 1e-3


@pytest.fixture(scope="module", params=list(DISTENSIONS))
def stomach(request: pytest.FixtureRequest) -> OrganSurface:
    return generate_stomach(StomachParameters().at(request.param), seed=0)


@pytest.mark.slow
def test_wall_is_closed_clean_and_faces_the_lumen(stomach: OrganSurface):
    facts = measure_organ(stomach)
    assert facts.defects == ()
    edges = np.sort(stomach.faces[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2), axis=1)
    edges, counts = np.unique(edges, axis=0, return_counts=True)
    assert np.all(counts == 2)
    assert len(stomach.vertices) - len(edges) + len(stomach.faces) == 2
    a, b, c = (stomach.vertices[stomach.faces[:, k]] for k in range(3))
    assert np.einsum("ij,ij->", a, np.cross(b, c)) < 0.0


@pytest.mark.slow
def test_triangles_are_small_and_well_shaped(stomach: OrganSurface):
    quality = triangle_quality(Mesh(stomach.vertices, stomach.faces))
    assert quality.mean() > 0.88
    assert np.percentile(quality, 5) > 0.7
    edges = np.linalg.norm(np.diff(stomach.vertices[stomach.faces[:, :2]], axis=1), axis=2)
    assert edges.mean() < 2 * MM


@pytest.mark.slow
def test_every_segment_is_there_in_order(stomach: OrganSurface):
    assert stomach.label_names == ("background", *SEGMENTS)
    assert set(np.unique(stomach.label)) == set(range(1, 7))
    place = [np.median(stomach.arc_length[stomach.label == k]) for k in (1, 3, 5, 6)]
    assert np.all(np.diff(place) > 0.0)
    height = [np.median(stomach.vertices[stomach.label == k, 2]) for k in (1, 3, 5)]
    assert height == sorted(height, reverse=True)
    # The J ends right of where it begins (patient x points left).
    x = stomach.vertices[:, 0]
    assert x[stomach.label == 1].mean() - x[stomach.label == 6].mean() > 5 * CM


@pytest.mark.slow
def test_gut_coordinates_give_back_the_vertices(stomach: OrganSurface):
    from vrcaps.organ.surface import interpolate

    points, _, _ = interpolate(stomach.centerline, stomach.arc_length)
    distance = np.linalg.norm(stomach.vertices - points, axis=1)
    assert np.allclose(distance, stomach.radius, atol=1e-9)
    jump = np.abs(np.diff(stomach.arc_length[stomach.faces], axis=1)).max()
    assert jump < 15 * MM
    assert stomach.centerline.radius.min() > 4 * MM


@pytest.mark.slow
def test_folds_flatten_as_the_stomach_fills():
    volume, slack = [], []
    for distension in ("inflated", "normal", "collapsed"):
        parameters = dataclasses.replace(StomachParameters().at(distension), edge=2.5 * MM)
        facts = measure_organ(generate_stomach(parameters, seed=0))
        volume.append(facts.volume)
        # Area over that of the ball of the same volume: grows with folds.
        slack.append(facts.area / (36.0 * np.pi * facts.volume**2) ** (1.0 / 3.0))
    assert 1.0 * LITER < volume[0] < 1.5 * LITER
    assert 0.35 * LITER < volume[1] < 0.8 * LITER
    assert 0.1 * LITER < volume[2] < 0.35 * LITER
    assert slack == sorted(slack)


@pytest.mark.slow
def test_a_seed_is_a_patient():
    parameters = dataclasses.replace(StomachParameters.draw(np.random.default_rng(5)), edge=3 * MM)
    one, again = (generate_stomach(parameters, seed=5) for _ in range(2))
    for field in ("vertices", "faces", "uv", "label", "arc_length", "theta"):
        assert getattr(one, field).tobytes() == getattr(again, field).tobytes()
    other = generate_stomach(parameters, seed=6)
    assert not np.array_equal(one.vertices[:100], other.vertices[:100])


@pytest.mark.validation
def test_no_drawn_stomach_cuts_itself():
    for seed in range(4):
        parameters = StomachParameters.draw(np.random.default_rng(seed)).at("normal")
        organ = generate_stomach(dataclasses.replace(parameters, edge=2.5 * MM), seed=seed)
        assert not len(self_intersections(organ.vertices, organ.faces))


def test_curvatures_are_those_of_a_j():
    lengths = []
    for distension in ("collapsed", "inflated"):
        parameters = StomachParameters().at(distension)
        rng = np.random.default_rng(0)
        wall = draw_stomach_wall(parameters, make_tube(stomach_course(parameters, rng)), rng)
        lengths.append(curvatures(wall))
    assert 25 * CM < lengths[0][0] < 31 * CM
    assert 34 * CM < lengths[1][0] < 43 * CM
    assert all(2.5 < greater / lesser < 4.5 for greater, lesser in lengths)


@pytest.mark.slow
def test_impossible_stomachs_are_refused(monkeypatch: pytest.MonkeyPatch):
    with pytest.raises(InputError, match=r"length is 1\.0\. Allowed: 0\.1 to 0\.35 m"):
        StomachParameters(length=1.0)
    with pytest.raises(InputError, match=r"antrum_diameter is 0\.065\. Allowed: up to the body"):
        StomachParameters(body_diameter=0.05)
    with pytest.raises(InputError, match=r"Distension is 'full'\. Allowed: inflated, normal"):
        StomachParameters().at("full")
    monkeypatch.setattr(surface_to_organ, "self_intersections", lambda *_: np.zeros((1, 2)))
    with pytest.raises(InputError, match="without self-intersection"):
        generate_stomach(StomachParameters(edge=4.5 * MM), seed=0)
