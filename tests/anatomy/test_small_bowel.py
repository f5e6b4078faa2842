"""A generated small bowel: anatomy, mesh, fillings, and the population it is drawn from."""

from __future__ import annotations

import dataclasses
import itertools

import numpy as np
import pytest

from vrcaps.anatomy import small_bowel as generate_module
from vrcaps.anatomy.full_tract.patient import draw_patient_anatomy, neighboring_organs
from vrcaps.anatomy.small_bowel import SmallBowelParameters, generate_small_bowel
from vrcaps.anatomy.small_bowel import course as course_module
from vrcaps.anatomy.small_bowel.course import NeighboringOrgans
from vrcaps.anatomy.small_bowel.distance_routing import make_routing_grid, route_around
from vrcaps.anatomy.small_bowel.parameters import DISTENSIONS, SEGMENTS
from vrcaps.anatomy.tube_mesh import surface_to_organ
from vrcaps.anatomy.tube_mesh.tube import ObstacleSpheres
from vrcaps.core.errors import InputError
from vrcaps.core.units import CM, MM
from vrcaps.mesh.mesh import Mesh
from vrcaps.organ.measure import measure_organ, triangle_quality
from vrcaps.organ.surface import OrganSurface

pytestmark = pytest.mark.slow

SEED = 0
EDGE = 2.5 * MM
"""Edge length of the bowels whose walls are looked at; those of the catalog are finer."""


def drawn(distension: str, **values: float) -> SmallBowelParameters:
    """A patient's bowel, shorter than a patient's: what is tested is the same along it."""
    patient = draw_patient_anatomy(SEED, distension).small_bowel
    return dataclasses.replace(patient, **{"length": 2.0, **values})


@pytest.fixture(scope="module")
def around() -> NeighboringOrgans:
    return neighboring_organs(draw_patient_anatomy(SEED, "normal"))


@pytest.fixture(scope="module")
def bowel(around: NeighboringOrgans) -> OrganSurface:
    return generate_small_bowel(drawn("normal", edge=EDGE), around, seed=SEED)


def test_wall_is_closed_clean_and_cuts_nowhere(bowel: OrganSurface):
    assert measure_organ(bowel).defects == ()  # self-intersections are defects
    edges = np.sort(bowel.faces[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2), axis=1)
    edges, counts = np.unique(edges, axis=0, return_counts=True)
    assert np.all(counts == 2)
    assert len(bowel.vertices) - len(edges) + len(bowel.faces) == 2
    a, b, c = (bowel.vertices[bowel.faces[:, k]] for k in range(3))
    assert np.einsum("ij,ij->", a, np.cross(b, c)) < 0.0


@pytest.mark.validation
def test_the_wall_of_a_whole_patient_is_closed_and_cuts_nowhere(around: NeighboringOrgans):
    whole = draw_patient_anatomy(SEED, "normal").small_bowel
    assert whole.length > 3.0
    test_wall_is_closed_clean_and_cuts_nowhere(generate_small_bowel(whole, around, seed=SEED))


def test_triangles_are_small_and_well_shaped(bowel: OrganSurface):
    quality = triangle_quality(Mesh(bowel.vertices, bowel.faces))
    assert quality.mean() > 0.88
    assert np.percentile(quality, 5) > 0.65
    edges = np.linalg.norm(np.diff(bowel.vertices[bowel.faces[:, :2]], axis=1), axis=2)
    assert edges.mean() < 1.03 * EDGE


@pytest.fixture(scope="module")
def slack(around: NeighboringOrgans) -> OrganSurface:
    return generate_small_bowel(drawn("collapsed", length=1.5, edge=EDGE), around, seed=SEED)


def test_a_slack_wall_has_plump_folds_and_no_defects(slack: OrganSurface):
    assert [one for one in measure_organ(slack).defects if "thin triangles" not in one] == []
    assert (triangle_quality(Mesh(slack.vertices, slack.faces)) < 0.1).mean() < 1e-4
    assert slack.metadata["closed_radius_m"] > 0.0
    # Folds 2 to 3 mm high along the whole gut, stretches with higher and with lower ones.
    sections = np.array_split(slack.radius[np.argsort(slack.arc_length)], 60)
    relief = np.array([np.percentile(one, 95) - np.percentile(one, 5) for one in sections[5:-5]])
    assert 1.5 * MM < np.median(relief) < 4.5 * MM
    assert np.percentile(relief, 90) > 1.4 * np.percentile(relief, 10)


def even_stretch(bowel: OrganSurface, name: str) -> np.ndarray:
    """Distance of the wall from the centerline where a segment has one diameter.

    The ileum narrows over its first half, in some patients by a fifth, and is another at its end.
    """
    chosen = bowel.label == bowel.label_names.index(name)
    if name == "ileum":
        first, last = bowel.arc_length[chosen].min(), bowel.arc_length[chosen].max()
        chosen &= (bowel.arc_length > 0.5 * (first + last)) & (bowel.arc_length < last - 25 * CM)
    return bowel.radius[chosen]


def test_it_is_as_long_and_as_wide_as_asked(bowel: OrganSurface, around: NeighboringOrgans):
    parameters = drawn("normal")
    assert bowel.centerline.length == pytest.approx(parameters.length, rel=0.02)
    assert np.allclose(bowel.centerline.points[0], around.pylorus)
    assert np.allclose(bowel.centerline.points[-1], around.valve)
    for name, diameter in (
        ("jejunum", parameters.jejunum_diameter),
        ("ileum", parameters.distal_ileum_diameter),
    ):
        # The wall between folds and contractions is the wider part of all wall.
        assert 2.0 * np.percentile(even_stretch(bowel, name), 80) == pytest.approx(
            diameter, rel=0.08
        )


def test_segments_follow_each_other(bowel: OrganSurface):
    assert bowel.label_names == ("background", *SEGMENTS)
    place = [bowel.arc_length[bowel.label == k] for k in range(1, 5)]
    assert all(one.max() <= other.min() + 1e-9 for one, other in itertools.pairwise(place))
    parameters = drawn("normal")
    assert place[1].max() == pytest.approx(parameters.duodenum_length, abs=3 * MM)


def test_the_duodenum_is_a_c_open_to_the_left(bowel: OrganSurface):
    points = bowel.centerline.points[bowel.centerline.arc_length < 25 * CM]
    rightmost = points[:, 0].argmin()
    assert 0 < rightmost < len(points) - 1
    assert points[0, 0] > points[rightmost, 0] + 1 * CM
    assert points[-1, 0] > points[rightmost, 0] + 5 * CM


def test_folds_thin_out_distally(bowel: OrganSurface):
    def relief(name: str) -> float:
        radius = even_stretch(bowel, name)
        return float(np.percentile(radius, 90) - np.percentile(radius, 10))

    assert relief("jejunum") > 1.25 * relief("ileum")


def test_it_keeps_clear_of_the_other_organs(bowel: OrganSurface, around: NeighboringOrgans):
    inner = (bowel.arc_length > 5 * CM) & (bowel.arc_length < bowel.centerline.length - 5 * CM)
    distance, nearest = around.obstacles.tree.query(bowel.vertices[inner], 4)
    assert (distance - around.obstacles.radius[nearest]).min() > -2 * MM


def test_the_population_is_the_published_one():
    drawn = [SmallBowelParameters.draw(np.random.default_rng([k, 3])) for k in range(400)]
    for name, mean, deviation in (
        ("length", 3.5, 0.25),
        ("jejunum_diameter", 24.5 * MM, 4.2 * MM),
        ("proximal_ileum_diameter", 19.5 * MM, 3.6 * MM),
    ):
        values = np.array([getattr(p, name) for p in drawn])
        # Within three standard errors of the mean and of the deviation.
        assert abs(values.mean() - mean) < 3.0 * deviation / len(values) ** 0.5
        assert values.std() == pytest.approx(deviation, rel=3.0 / (2.0 * len(values)) ** 0.5)


def test_narrow_bowels_collapse_no_further():
    narrow = dataclasses.replace(SmallBowelParameters(), distal_ileum_diameter=9 * MM)
    assert narrow.at("collapsed").distal_ileum_diameter == 9 * MM
    assert narrow.at("collapsed").jejunum_diameter < 20 * MM


def test_ways_lead_around_obstacles():
    wall = np.stack(np.meshgrid(np.arange(-4, 5), np.arange(-4, 5)), axis=-1).reshape(-1, 2)
    centers = np.concatenate([wall, np.zeros((len(wall), 1))], axis=1)[:, [0, 2, 1]] * CM
    obstacles = ObstacleSpheres(centers, np.full(len(centers), 1 * CM))
    low, high = np.full(3, -10 * CM), np.full(3, 10 * CM)
    grid = make_routing_grid(low, high, obstacles, 1 * CM)
    ends = np.array([[0.0, -8.0, 0.0], [0.0, 0.0, 0.0], [0.0, 8.0, 0.0]]) * CM
    way = route_around(ends, grid)
    fine = np.concatenate([np.linspace(a, b, 20) for a, b in itertools.pairwise(way)])
    assert np.array_equal(way[[0, -1]], ends[[0, -1]])
    assert (obstacles.tree.query(fine)[0] - 1 * CM).min() > 0.0
    straight = np.array([[-8.0, -8.0, 0.0], [8.0, -8.0, 0.0]]) * CM
    assert np.allclose(route_around(straight, grid)[:, 1], -8 * CM)
    inside = 1.0 - grid.free_volume / 0.2**3
    assert 0.0 < inside < 0.1


def test_after_the_widest_abdomen_the_tries_begin_anew(
    monkeypatch: pytest.MonkeyPatch, around: NeighboringOrgans
):
    widths, survey_abdomen = [], course_module._abdomen

    def record(length: float, radius: np.ndarray, around: NeighboringOrgans, width: int):
        widths.append(width)
        return survey_abdomen(length, radius, around, width)

    monkeypatch.setattr(course_module, "_abdomen", record)
    monkeypatch.setattr(course_module, "min_clearance", lambda *_: -1.0)
    monkeypatch.setattr(course_module, "_NUM_STEPS", 2)
    monkeypatch.setattr(course_module, "_NUM_WIDTHS", 2)
    monkeypatch.setattr(course_module, "_NUM_TRIES", 3)
    with pytest.raises(InputError, match="Found no course"):
        generate_small_bowel(SmallBowelParameters(length=2.0), around, seed=0)
    assert widths == [0, 1, 0]


def test_distensions_differ_in_diameter_and_slack():
    plain = SmallBowelParameters()
    inflated, collapsed = plain.at("inflated"), plain.at("collapsed")
    assert set(DISTENSIONS) == {"inflated", "normal", "collapsed"}
    assert 25 * MM < inflated.jejunum_diameter < 30 * MM
    assert collapsed.jejunum_diameter < 0.85 * plain.jejunum_diameter
    assert collapsed.slack_fold_height > 2 * MM
    assert collapsed.closed_radius > 0.0 == plain.closed_radius == inflated.closed_radius
    assert inflated.longitudinal_fold_depth == 0.0


def test_impossible_bowels_are_refused(monkeypatch: pytest.MonkeyPatch, around: NeighboringOrgans):
    with pytest.raises(InputError, match=r"length is 9\.0\. Allowed: 1\.5 to 5 m"):
        SmallBowelParameters(length=9.0)
    with pytest.raises(InputError, match=r"Distension is 'full'\. Allowed: inflated, normal"):
        SmallBowelParameters().at("full")
    monkeypatch.setattr(course_module, "_NUM_TRIES", 1)
    monkeypatch.setattr(course_module, "_NUM_STEPS", 20)
    full = dataclasses.replace(around, obstacles=ObstacleSpheres(np.zeros((1, 3)), np.array([0.3])))
    with pytest.raises(InputError, match=r"Found no course for 2\.00 m of small bowel"):
        generate_small_bowel(SmallBowelParameters(length=2.0), full, seed=0)
    monkeypatch.undo()
    monkeypatch.setattr(generate_module, "_NUM_TRIES", 1)
    monkeypatch.setattr(surface_to_organ, "self_intersections", lambda *_: np.zeros((1, 2)))
    parameters = SmallBowelParameters(length=1.8, edge=5 * MM)
    with pytest.raises(InputError, match="without self-intersection"):
        generate_small_bowel(parameters, around, seed=0)
