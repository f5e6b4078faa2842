"""Closure of a slack lumen: sections contract about the capsule, in order and without crossings."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.sparse import csr_array, eye_array

from tests.support.tubes import tube_about
from vrcaps.capsule.device_file import read_device
from vrcaps.cli.benchmarks.stage import resized_camera
from vrcaps.core.errors import InputError
from vrcaps.core.geometry import (
    invert,
    rotation_from_vector,
    transform_from,
    transform_points,
)
from vrcaps.core.units import MM
from vrcaps.mesh.self_intersection import self_intersections
from vrcaps.mesh.untangle import HarmonicPatch, relaxed
from vrcaps.motion.dynamics import Dynamics
from vrcaps.motion.rollout import Rollout
from vrcaps.organ.surface import CLOSED_RADIUS, POCKETS
from vrcaps.render.renderer import DEFAULT_CHANNELS as CHANNELS
from vrcaps.render.renderer import Renderer
from vrcaps.world.closed_course import closed_course
from vrcaps.world.lumen_closure import LumenClosure, along_slit, closure_of
from vrcaps.world.model import Model, State, posture_transform
from vrcaps.world.wall_displacement import ShownWall, WallDisplacement

RADIUS, LENGTH, CLOSED = 8 * MM, 200 * MM, 2 * MM


def straight(closed: float = CLOSED) -> Model:
    """Straight tube along world z with a capsule inside."""
    line = np.stack([np.zeros(201), np.zeros(201), np.linspace(0.0, LENGTH, 201)], axis=1)
    organ = tube_about(line, RADIUS, 48)
    organ = replace(organ, metadata={CLOSED_RADIUS: closed})
    return Model(organ, read_device("mirocam"), np.eye(4))


@pytest.fixture(scope="module")
def model() -> Model:
    return straight()


def closed_wall(model: Model, pose: np.ndarray) -> np.ndarray:
    vertices = WallDisplacement(model, model).vertices_world(pose)
    assert vertices is not None
    return vertices


def shown_wall(
    model: Model, state: State, T_world_patient: np.ndarray | None = None, insufflation: float = 1.0
) -> np.ndarray:
    """Vertices that images of a simulated state show."""
    patient = model.T_world_patient if T_world_patient is None else T_world_patient
    vertices = ShownWall(model).vertices_world(state, patient, insufflation)
    assert vertices is not None
    return vertices


def radius_at(model: Model, vertices: np.ndarray, arc_length: float) -> np.ndarray:
    """Radii of a section about its own center [m]."""
    section = vertices[np.abs(model.organ.arc_length - arc_length) < 0.6 * MM]
    center = 0.5 * (section.min(axis=0) + section.max(axis=0))
    return np.linalg.norm((section - center)[:, :2], axis=1)


def test_the_lumen_is_closed_before_and_behind_the_capsule(model):
    vertices = closed_wall(model, model.place(100 * MM).T_world_capsule)
    for arc_length in (70 * MM, 130 * MM):
        # The tone of the place changes the radius by a factor of up to exp(0.9).
        assert 0.35 * CLOSED < radius_at(model, vertices, arc_length).mean() < 2.6 * CLOSED
    for arc_length in (5 * MM, 195 * MM):
        np.testing.assert_allclose(radius_at(model, vertices, arc_length), RADIUS, rtol=0.02)


def assert_outside_shell(model: Model, pose: np.ndarray, vertices: np.ndarray) -> None:
    """Check that no vertex lies inside the capsule."""
    device = model.device
    half = 0.5 * device.length - device.radius
    local = (vertices - pose[:3, 3]) @ pose[:3, :3]
    local[:, 2] -= np.clip(local[:, 2], -half, half)
    assert np.linalg.norm(local, axis=1).min() >= 0.999 * device.radius


@pytest.mark.parametrize("tilt", [0.0, 0.4])
@pytest.mark.parametrize("shift", [0.0, 2 * MM])
def test_the_shell_stays_inside(model, tilt, shift):
    pose = model.place(100 * MM, angle=tilt).T_world_capsule
    pose[0, 3] += shift
    vertices = closed_wall(model, pose)
    assert_outside_shell(model, pose, vertices)
    assert len(self_intersections(vertices, model.organ.faces)) == 0


def tangled(model: Model, vertices: np.ndarray, arc_length: float) -> np.ndarray:
    """Vertices of a wall, one of which is moved past its neighbors [m]."""
    vertices = vertices.copy()
    vertex = int(np.flatnonzero(np.abs(model.organ.arc_length - arc_length) < 0.6 * MM)[7])
    vertices[vertex] += 2.5 * (vertices[vertex + 48] - vertices[vertex])
    assert len(self_intersections(vertices, model.organ.faces)) > 0
    return vertices


def test_triangles_that_intersect_in_the_closed_wall_are_relaxed(model):
    organ = replace(model.organ, vertices=tangled(model, model.vertices_world, 130 * MM))
    closed = closed_wall(replace(model, organ=organ), model.place(100 * MM).T_world_capsule)
    assert len(self_intersections(closed, organ.faces)) == 0


@pytest.mark.parametrize(("arc_length", "is_near"), [(85 * MM, True), (150 * MM, False)])
def test_triangles_that_intersect_next_to_the_capsule_are_relaxed(model, arc_length, is_near):
    pose, faces = model.place(100 * MM, angle=0.2).T_world_capsule, model.organ.faces
    closure = closure_of(model)
    assert closure is not None
    vertices = tangled(model, closed_wall(model, pose), arc_length)
    patches = closure.patches_near(vertices, pose, 0.5 * model.device.length)
    assert len(patches) == is_near
    assert (len(self_intersections(relaxed(vertices, patches), faces)) == 0) == is_near


def test_the_wall_yields_again_where_it_is_relaxed(model, monkeypatch):
    pose = model.place(100 * MM, angle=0.2).T_world_capsule
    within = np.flatnonzero(np.abs(model.organ.arc_length - 100 * MM) < 3 * MM)
    border = within[:1]
    reach = csr_array(np.ones((len(within) - 1, 1)))
    patch = HarmonicPatch(within[1:], border, csr_array(eye_array(len(within) - 1)), reach)
    monkeypatch.setattr(LumenClosure, "patches_near", lambda *_: (patch,))
    assert_outside_shell(model, pose, closed_wall(model, pose))


@pytest.mark.parametrize("factor", [0.7, 0.9, 1.1])
def test_the_order_along_a_ray_is_kept(model, factor):
    """A vertex closer to the centerline stays closer, one farther away stays farther away."""
    pose = model.place(100 * MM).T_world_capsule
    vertex = int(np.flatnonzero(np.abs(model.organ.arc_length - 130 * MM) < 0.6 * MM)[7])
    radii = []
    for scale in (1.0, factor):
        vertices = model.organ.vertices.copy()
        vertices[vertex, :2] *= scale
        closure = LumenClosure(
            replace(model, organ=replace(model.organ, vertices=vertices)), CLOSED
        )
        moved, closed = closure.close(pose, model.device.length / 2.0, model.device.radius)
        radii.append(closed[moved == vertex][0])
    direction = model.organ.vertices[vertex] * np.array([1.0, 1.0, 0.0])
    assert np.sign((radii[1] - radii[0]) @ direction) == np.sign(factor - 1.0)


def test_the_displacement_is_continuous_in_the_pose(model):
    """A capsule that moves by a micrometer moves the wall by a few micrometers."""
    first = model.place(100 * MM).T_world_capsule
    second = first.copy()
    second[:3, 3] += np.array([0.5, 0.0, 1.0]) * 1e-6
    change = np.abs(closed_wall(model, second) - closed_wall(model, first)).max()
    assert 0.0 < change < 2e-5


@pytest.mark.parametrize("shift", [-7 * MM, 1e9])
def test_arc_lengths_may_have_any_origin(model, shift):
    organ = replace(model.organ, arc_length=model.organ.arc_length + shift)
    vertices = closed_wall(replace(model, organ=organ), model.place(100 * MM).T_world_capsule)
    assert np.isfinite(vertices).all()


def test_a_closed_section_is_a_folded_slit():
    """Its perimeter is well above that of a circle of equal area, and below that at rest."""
    model = straight()
    pose = model.place(100 * MM).T_world_capsule
    ratios = []
    for seed in range(8):
        organ = replace(model.organ, metadata={CLOSED_RADIUS: CLOSED, "seed": seed})
        is_near = np.abs(organ.arc_length - 130 * MM) < 0.4 * MM
        section = closed_wall(replace(model, organ=organ), pose)[is_near, :2]
        x, y = section[np.argsort(organ.theta[is_near])].T
        perimeter = np.hypot(x - np.roll(x, 1), y - np.roll(y, 1)).sum()
        area = 0.5 * abs(x @ np.roll(y, -1) - y @ np.roll(x, -1))
        ratios.append(perimeter / np.sqrt(4.0 * np.pi * area))
        assert 0.25 < perimeter / (2.0 * np.pi * RADIUS) < 1.0
    assert min(ratios) > 1.3
    assert np.mean(ratios) > 1.4
    assert len(np.unique(np.round(ratios, 6))) == 8


@pytest.mark.parametrize("closed", [2 * MM, 5 * MM])
@pytest.mark.parametrize("radius", [6 * MM, 12 * MM])
def test_the_closed_lumen_stays_within_the_wall_at_rest(closed, radius):
    """To a tenth, so that adjacent loops of a bowel do not intersect."""
    line = np.stack([np.zeros(201), np.zeros(201), np.linspace(0.0, LENGTH, 201)], axis=1)
    organ = tube_about(line, radius, 48)
    for seed in range(3):
        organ = replace(organ, metadata={CLOSED_RADIUS: closed, "seed": seed})
        model = Model(organ, read_device("mirocam"), np.eye(4))
        vertices = closed_wall(model, model.place(100 * MM).T_world_capsule)
        away = np.abs(organ.arc_length - 100 * MM) > 20 * MM
        assert np.linalg.norm(vertices[away, :2], axis=1).max() < 1.1 * radius


@pytest.mark.parametrize("turn", [0.0, 0.3, 1.2])
def test_the_slit_is_a_segment(turn):
    """The center of a section becomes a segment of the slit's length, not a point."""
    model = straight()
    closure = LumenClosure(model, CLOSED)
    is_near = np.abs(model.organ.arc_length - 130 * MM - turn * 10 * MM) < 0.4 * MM
    order, course, wall = closure._sorted
    along = along_slit(course, wall.outward)[np.argsort(order)][is_near]
    spread = np.linalg.svd(along[:, :2] - along[:, :2].mean(axis=0))[1]
    assert np.ptp(np.linalg.norm(along[:, :2], axis=1)) > 0.8
    assert 0.05 < spread[1] / spread[0] < 0.2
    np.testing.assert_allclose(along[:, 2], 0.0, atol=1e-6)


@pytest.mark.parametrize(("pockets", "count"), [(0.0, 2), (0.3, 6), (0.9, 6)])
def test_pockets_stay_open(pockets, count):
    """Beyond the capsule, pockets keep the wall at rest over their fraction of the length."""
    model = straight()
    fractions = []
    for seed in range(count):
        organ = replace(
            model.organ, metadata={CLOSED_RADIUS: CLOSED, POCKETS: pockets, "seed": seed}
        )
        vertices = closed_wall(replace(model, organ=organ), model.place(100 * MM).T_world_capsule)
        assert len(self_intersections(vertices, organ.faces)) == 0
        places = np.arange(68 * MM, 74 * MM, 1 * MM)
        narrow = [radius_at(model, vertices, at).mean() < 0.75 * RADIUS for at in places]
        fractions.append(1.0 - np.mean(narrow))
    assert np.mean(fractions) == pytest.approx(pockets, abs=0.25)
    assert (np.mean(fractions) == 0.0) == (pockets == 0.0)


@pytest.mark.parametrize("value", [-0.1, 1.0, float("nan"), "half", None])
def test_invalid_pockets_are_one_line(value):
    organ = replace(straight().organ, metadata={CLOSED_RADIUS: CLOSED, POCKETS: value})
    with pytest.raises(InputError, match=r"pockets in .* is .*Allowed: 0 to below 1"):
        closure_of(replace(straight(), organ=organ))


def test_an_open_organ_is_not_closed():
    model = straight(0.0)
    assert closure_of(model) is None
    assert WallDisplacement(model, model).vertices_world(model.place().T_world_capsule) is None


@pytest.mark.parametrize("value", [-1.0, 1.0, float("nan"), "2 mm", None, [1.0]])
def test_invalid_metadata_are_one_line(value):
    model = straight()
    organ = replace(model.organ, metadata={CLOSED_RADIUS: value})
    with pytest.raises(InputError, match=r"closed_radius_m .* is .*Allowed: 0 \(open\) to 0.005 m"):
        closure_of(replace(model, organ=organ))


def test_frames_are_those_of_a_wall_that_moves_as_a_whole(model):
    """Image, depth, labels and motion have the same bytes if all of the wall is refitted."""
    channels = (*CHANNELS, "flow_forward", "flow_backward", "occlusion", "position", "face")
    poses = [model.place(at).T_world_capsule for at in np.linspace(90 * MM, 120 * MM, 5)]
    states = [
        State(0.1 * k, pose, vertices_world=closed_wall(model, pose))
        for k, pose in enumerate(poses)
    ]
    far = replace(states[0], vertices_world=model.vertices_world + 1 * MM)  # no vertex stays
    camera = resized_camera(model.device.cameras[0], 96)
    digests = []
    for before in (None, far):
        renderer, frames = Renderer(model), []
        for previous, state, following in zip(states, states[1:], states[2:], strict=False):
            if before is not None:
                renderer.arrays((before, before, before), camera, channels)
            arrays = renderer.arrays((previous, state, following), camera, channels)
            frames.append({name: array.tobytes() for name, array in arrays.items()})
        digests.append(frames)
    assert digests[0] == digests[1]
    assert all(len({frame["depth"] for frame in frames}) == 3 for frames in digests)


def test_the_wall_of_a_simulation_closes_as_that_of_a_fly_through(model):
    pose = model.place(100 * MM).T_world_capsule
    state = State(0.0, pose, vertices_world=model.vertices_world)
    shown = shown_wall(model, state)
    np.testing.assert_allclose(shown, closed_wall(model, pose), atol=1e-6)
    at_rest = replace(state, vertices_world=None)
    assert ShownWall(model).vertices_world(at_rest, model.T_world_patient, 1.0) is None


def test_the_closure_turns_with_the_patient(model):
    pose = model.place(100 * MM, angle=0.2).T_world_capsule
    turned = transform_from(rotation_from_vector(np.array([0.3, -1.1, 0.4])), np.array([1, 2, 3]))
    state = State(0.0, pose, vertices_world=model.vertices_world)
    moved = State(0.0, turned @ pose, vertices_world=transform_points(turned, model.vertices_world))
    expected = transform_points(turned, shown_wall(model, state))
    actual = shown_wall(model, moved, turned @ model.T_world_patient)
    np.testing.assert_allclose(actual, expected, atol=1e-9)


def test_a_contracted_wall_does_not_open_by_closing(model):
    """A section that the muscle has made narrower than the closed lumen stays as narrow."""
    pose = model.place(100 * MM).T_world_capsule
    contracted = model.vertices_world.copy()
    near = np.abs(model.organ.arc_length - 125 * MM) < 5 * MM
    contracted[near, :2] *= 0.1
    state = State(0.0, pose, vertices_world=contracted)
    shown = shown_wall(model, state)
    assert radius_at(model, shown, 125 * MM).max() < 0.35 * RADIUS
    assert radius_at(model, shown, 110 * MM).mean() > 1.5 * MM


@pytest.mark.parametrize(("insufflation", "is_open"), [(0.9, False), (1.0, False), (1.1, True)])
def test_gas_opens_a_slack_lumen(model, insufflation, is_open):
    state = State(0.0, model.place(100 * MM).T_world_capsule, vertices_world=model.vertices_world)
    shown = shown_wall(model, state, insufflation=insufflation)
    assert (np.abs(shown - model.vertices_world).max() < 1e-9) == is_open


def test_a_simulation_shows_the_closed_lumen():
    """In a run of the world the lumen is closed ahead and keeps the shell inside."""
    model = replace(straight(), T_world_patient=posture_transform("supine"))
    settings = Dynamics(start=0.5, settle=0.1, substep=1e-3)
    state = next(Rollout(model, settings, frames=1, fps=5.0, seed=0).steps()).state
    assert state.vertices_world is not None
    vertices = transform_points(invert(model.T_world_patient), state.vertices_world)
    at = invert(model.T_world_patient) @ state.T_world_capsule
    assert radius_at(model, vertices, at[2, 3] + 30 * MM).mean() < 0.5 * RADIUS
    half = 0.5 * model.device.length - model.device.radius
    local = transform_points(invert(at), vertices)
    local[:, 2] -= np.clip(local[:, 2], -half, half)
    assert np.linalg.norm(local, axis=1).min() >= 0.999 * model.device.radius


@pytest.mark.parametrize("seed", range(4))
def test_creases_end_and_the_height_of_folds_varies(seed):
    """Zeros of a field of waves do not end, but the depth of its creases falls to zero."""
    organ = replace(straight().organ, metadata={"seed": seed})
    count = len(organ.vertices)
    plane, width = np.tile(np.eye(3)[:, :2], (count, 1, 1)), np.full(count, 4.0 * RADIUS)
    sections = np.zeros((count, 3)), plane, width
    course = closed_course(organ, sections, CLOSED, 0.0)
    whole = course.folds.max() - course.folds.min()
    assert whole == pytest.approx(1.0, abs=0.02)
    around = [course.folds[course.s == s] for s in np.unique(course.s)]
    depths = np.array([course.folds.max() - row.min() for row in around])
    assert depths.min() < 0.5 * whole
    assert np.mean(depths > 0.9 * whole) > 0.2
    assert abs(course.folds.mean()) < 1e-9
    assert course.top.max() > 2.0 * course.top.min()
