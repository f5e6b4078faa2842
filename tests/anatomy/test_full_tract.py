"""The whole tract as one wall, the stitching of walls, and one patient across organs."""

from __future__ import annotations

import dataclasses
import hashlib
import os
import subprocess
import sys

import numpy as np
import pytest

from vrcaps import _core
from vrcaps.anatomy import full_tract as generate_module
from vrcaps.anatomy.full_tract import generate_full_tract, soften, stitch, without_vertices
from vrcaps.anatomy.full_tract.patient import (
    COLON_DISTENSIONS,
    PatientAnatomy,
    colon_at,
    draw_patient_anatomy,
    neighboring_organs,
    stomach_axis,
)
from vrcaps.anatomy.full_tract.textures import with_appearance
from vrcaps.anatomy.small_bowel import lay_small_bowel, small_bowel_rng
from vrcaps.anatomy.tube_mesh.swept_surface import within_bend, wrap
from vrcaps.anatomy.tube_mesh.tube import ObstacleSpheres, smooth_course
from vrcaps.core.errors import InputError
from vrcaps.core.geometry import smoothstep
from vrcaps.core.rng import truncated_normal
from vrcaps.core.units import CM, MM
from vrcaps.organ.measure import measure_organ
from vrcaps.organ.surface import OrganSurface, interpolate
from vrcaps.organ.waves import draw_waves, sum_waves

pytestmark = pytest.mark.slow

SEED = 4


def coarse_patient(seed: int) -> PatientAnatomy:
    """A patient with a short small bowel, large triangles and low folds: quick to make."""
    patient = draw_patient_anatomy(seed)
    changes = {"length": 2.0, "edge": 4 * MM, "jejunum_fold_height": 1.5 * MM}
    return dataclasses.replace(
        patient,
        stomach=dataclasses.replace(patient.stomach, edge=4 * MM, rugae_height=2 * MM),
        small_bowel=dataclasses.replace(patient.small_bowel, **changes),
        colon=dataclasses.replace(patient.colon, triangles=20_000),
    )


def coarse_tract(seed: int) -> OrganSurface:
    """The whole tract of a coarse patient."""
    patient = coarse_patient(seed)
    return generate_full_tract(patient.stomach, patient.small_bowel, patient.colon, seed=seed)


def digest(organ: OrganSurface) -> str:
    """Digest of all arrays of a surface."""
    names = ("vertices", "faces", "normals", "uv", "label", "arc_length", "theta", "radius")
    line = ("points", "arc_length", "radius", "frames")
    arrays = [getattr(organ, n) for n in names] + [getattr(organ.centerline, n) for n in line]
    return hashlib.sha256(b"".join(a.tobytes() for a in arrays)).hexdigest()


@pytest.fixture(scope="module")
def tract() -> OrganSurface:
    return coarse_tract(SEED)


def test_the_joined_wall_is_closed_and_cuts_nowhere(tract: OrganSurface):
    assert measure_organ(tract).defects == ()  # self-intersections are defects
    edges = np.sort(tract.faces[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2), axis=1)
    edges, counts = np.unique(edges, axis=0, return_counts=True)
    assert np.all(counts == 2)
    assert len(tract.vertices) - len(edges) + len(tract.faces) == 2
    a, b, c = (tract.vertices[tract.faces[:, k]] for k in range(3))
    assert np.einsum("ij,ij->", a, np.cross(b, c)) < 0.0


def test_organs_follow_each_other_from_mouth_to_anus(tract: OrganSurface):
    names = ("fundus", "body", "antrum", "duodenal_bulb", "duodenum", "jejunum", "ileum")
    names += ("ascending", "transverse", "descending", "sigmoid", "rectum")
    place = [np.median(tract.arc_length[tract.label == tract.label_names.index(n)]) for n in names]
    assert np.all(np.diff(place) > 0.0)
    assert set(np.unique(tract.label)) == set(range(1, len(tract.label_names)))
    patient = coarse_patient(SEED)
    asked = patient.stomach.length + patient.small_bowel.length + patient.colon.length
    assert tract.centerline.length == pytest.approx(asked, rel=0.05)


def test_gut_coordinates_are_continuous_and_give_back_the_vertices(tract: OrganSurface):
    at, _, _ = interpolate(tract.centerline, tract.arc_length)
    assert np.allclose(np.linalg.norm(tract.vertices - at, axis=1), tract.radius)
    step = np.ptp(tract.arc_length[tract.faces], axis=1)
    assert np.percentile(step, 99.9) < 15 * MM
    assert step.max() < 60 * MM
    narrowest = coarse_patient(SEED).small_bowel.min_radius
    assert tract.centerline.radius.min() > 0.85 * narrowest


def test_texture_parts_do_not_overlap_and_each_gets_its_mucosa(tract: OrganSurface):
    parts = tract.metadata["texture_parts"]
    which = np.searchsorted(parts[1:-1], tract.uv[..., 0].mean(axis=1))
    assert np.all(tract.uv >= 0.0)
    assert np.all(tract.uv <= 1.0)
    stomach = tract.label_names.index("pylorus")
    of_face = tract.label[tract.faces].max(axis=1)
    assert set(which[of_face <= stomach]) == {0}
    # The band at the valve, between the last of the ileum and the colon, belongs to the ileum.
    least = tract.label[tract.faces].min(axis=1)
    assert set(which[least > tract.label_names.index("ileum")]) == {2}
    organ = with_appearance(tract, seed=SEED, max_texels=100_000)
    assert organ.appearance is not None
    assert organ.appearance.albedo.shape[:2] == organ.appearance.height.shape
    assert organ.uv.min() >= 0.0
    assert organ.uv.max() <= 1.0


def test_a_seed_is_the_same_tract_in_another_process(tract: OrganSurface):
    """Other hashes, another number of threads."""
    code = f"import runpy; m = runpy.run_path({__file__!r}); "
    code += f"print(m['digest'](m['coarse_tract']({SEED})))"
    changed = {"PYTHONHASHSEED": "7", "OMP_NUM_THREADS": "3", "OPENBLAS_NUM_THREADS": "3"}
    run = subprocess.run(
        [sys.executable, "-c", code],
        env=os.environ | changed,
        capture_output=True,
        text=True,
        check=True,
    )
    assert run.stdout.strip() == digest(tract)


def test_a_tract_that_cuts_itself_is_refused(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(generate_module, "_NUM_TRIES", 0)
    with pytest.raises(InputError, match="Found no tract of seed 4 without self-intersection"):
        coarse_tract(SEED)


def test_a_patient_is_the_same_whatever_the_filling():
    usual, inflated, collapsed = (
        draw_patient_anatomy(3, c) for c in (None, "inflated", "collapsed")
    )
    assert usual.colon == inflated.colon
    assert usual.stomach == draw_patient_anatomy(3, "normal").stomach
    assert collapsed.colon.length == usual.colon.length
    assert collapsed.colon.transverse.diameter < 0.7 * usual.colon.transverse.diameter
    assert collapsed.small_bowel.length == usual.small_bowel.length
    assert colon_at(usual.colon, "inflated") is usual.colon
    assert min(COLON_DISTENSIONS.values()) > 0.5
    with pytest.raises(InputError, match=r"Distension is 'full'\. Allowed: inflated, normal"):
        draw_patient_anatomy(3, "full")


def ring(num: int, height: float) -> np.ndarray:
    """Points around a circle of radius 1."""
    angle = 2.0 * np.pi * np.arange(num) / num
    return np.stack([np.cos(angle), np.sin(angle), np.full(num, height)], axis=1)


@pytest.mark.parametrize(("num_one", "num_other"), [(12, 12), (9, 31), (40, 7)])
def test_stitched_rims_make_a_band_without_gaps(num_one: int, num_other: int):
    vertices = np.concatenate([ring(num_one, 0.0), ring(num_other, 0.3)])
    one = np.arange(num_one)
    other = num_one + np.arange(num_other)[::-1]
    band = stitch(vertices, one, np.roll(other, 5))
    assert len(band) == num_one + num_other
    halves = {tuple(e) for f in band for e in ((f[0], f[1]), (f[1], f[2]), (f[2], f[0]))}
    assert len(halves) == 3 * len(band)
    open_halves = {e for e in halves if e[::-1] not in halves}
    # Each rim edge is used against its own face's direction.
    rims = {(b, a) for rim in (one, other) for a, b in zip(rim, np.roll(rim, -1), strict=True)}
    assert open_halves == {(int(a), int(b)) for a, b in rims}


def test_removed_vertices_leave_an_ordered_rim():
    num = 9
    ids = np.arange(num * num).reshape(num, num)
    a, b, c, d = ids[:-1, :-1], ids[1:, :-1], ids[1:, 1:], ids[:-1, 1:]
    faces = np.concatenate([np.stack(f, -1).reshape(-1, 3) for f in ((a, b, c), (a, c, d))])
    is_removed = np.zeros(num * num, bool)
    is_removed[ids[3:6, 3:6]] = True
    kept, rim = without_vertices(faces, is_removed)
    assert not is_removed[faces[kept]].any()
    assert len(rim) in (16, 32)  # around the hole, or around the sheet, which is longer
    vertices = np.concatenate([ring(8, 0.0), [[0.0, 0.0, 5.0]]])
    fan = np.stack([np.full(8, 8), np.arange(8), np.roll(np.arange(8), -1)], axis=1)
    softened = soften(vertices, fan, np.array([8]))
    assert softened[8, 2] < vertices[8, 2]


def test_organs_alone_are_those_of_the_tract(tract: OrganSurface):
    patient = coarse_patient(SEED)
    around = neighboring_organs(patient)
    _, tube = lay_small_bowel(patient.small_bowel, around, small_bowel_rng(SEED))
    middle = tube.curve(np.array([0.2, 1.0, 1.8]))
    distance = np.linalg.norm(tract.centerline.points[:, None] - middle, axis=2).min(axis=0)
    assert distance.max() < 5 * MM
    axis = stomach_axis(patient)
    body = axis.points[np.abs(axis.arc_length - 0.5 * patient.stomach.length) < 1 * MM]
    distance = np.linalg.norm(tract.centerline.points - body[0], axis=1).min()
    assert distance < 10 * MM


def test_deviations_are_bounded_with_mean_0_and_variance_1():
    rng = np.random.default_rng(0)
    for bound, most in ((1.0, 1.9), (2.0, 2.28), (3.0, 3.05)):
        drawn = np.array([truncated_normal(rng, bound) for _ in range(20_000)])
        assert abs(drawn.mean()) < 0.03
        assert drawn.std() == pytest.approx(1.0, rel=0.02)
        assert bound < np.abs(drawn).max() < most


def test_summed_waves_are_their_sines():
    rng = np.random.default_rng(1)
    waves = draw_waves(rng, 30, (1 * CM, 4 * CM), 1.0, np.arange(-5, 6))
    s, theta = rng.uniform(0.0, 1.0, 50_000), rng.uniform(-np.pi, np.pi, 50_000)
    sines = [a * np.sin(k * s + lobes * theta + phase) for a, k, lobes, phase in waves]
    one_by_one = np.sum(sines, axis=0)
    assert np.allclose(sum_waves(waves, s, theta), one_by_one, atol=0.01)
    few = slice(0, 40)
    assert np.allclose(sum_waves(waves, s[few], theta[few]), one_by_one[few])
    assert sum_waves(waves, s[:0], theta[:0]).shape == (0,)


def test_tables_of_waves_are_not_read_beyond_their_ends():
    def total(end: float, num_angles: int = 2) -> np.ndarray:
        s = np.array([1.0, end])
        return _core.sum_wave_tables(np.ones((3, 2, 2)), 0.5, s, np.zeros(num_angles))

    assert np.allclose(total(1.99), 2.0)  # the imaginary parts of both tables
    for end in (2.0, np.inf):
        with pytest.raises(ValueError, match="beyond the tables"):
            total(end)
    with pytest.raises(ValueError, match="as many angles"):
        total(1.5, num_angles=3)


def test_waves_have_the_asked_deviation_and_close_around_the_tube():
    rng = np.random.default_rng(0)
    waves = draw_waves(rng, 40, (1 * CM, 4 * CM), 0.3, np.arange(-5, 6))
    s, theta = rng.uniform(0.0, 10.0, 20_000), rng.uniform(-np.pi, np.pi, 20_000)
    assert sum_waves(waves, s, theta).std() == pytest.approx(0.3, rel=0.1)
    assert np.allclose(sum_waves(waves, s, theta), sum_waves(waves, s, theta + 2 * np.pi))
    assert np.allclose(np.sin(wrap(theta * 9)), np.sin(theta * 9))
    assert np.allclose(smoothstep(np.array([-1.0, 0.5, 2.0])), [0.0, 0.5, 1.0])
    assert np.all(within_bend(np.full(9, 0.02), np.linspace(0.0, 200.0, 9)) <= 0.02)
    assert within_bend(np.array([0.05]), np.array([100.0]))[0] < 0.0073


def test_a_smooth_course_keeps_its_ends_and_balls_add_up():
    angle = np.linspace(0.0, np.pi, 60)
    nodes = 0.1 * np.stack([np.cos(angle), np.sin(angle), 0 * angle], axis=1)
    course = smooth_course(nodes)
    assert np.allclose(course.points[[0, -1]], nodes[[0, -1]])
    assert course.arc_length[-1] == pytest.approx(0.1 * np.pi, rel=0.01)
    ball = ObstacleSpheres(np.zeros((1, 3)), np.ones(1))
    assert len((ball + ball).radius) == 2
