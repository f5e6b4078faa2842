"""A narrow wall makes way for the capsule's shell."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from tests.support.tubes import bent_tube, tube_about
from vrcaps.capsule.device_file import read_device
from vrcaps.core.geometry import invert, transform_points
from vrcaps.core.units import MM
from vrcaps.mesh.self_intersection import self_intersections
from vrcaps.motion.fly_through import FlyThrough, fly_through
from vrcaps.motion.trajectory import Trajectory
from vrcaps.organ.surface import CLOSED_RADIUS
from vrcaps.world.model import Model
from vrcaps.world.wall_displacement import WallDisplacement


@pytest.fixture(scope="module")
def narrow() -> Model:
    """A tube of 8 mm around a capsule of 10.8 mm."""
    return Model(bent_tube(radius=4.0 * MM, around=30, along=400), read_device("mirocam"))


def _flight(model: Model, start: float, end: float, *, rigid_wall: bool = False) -> Trajectory:
    settings = FlyThrough(start=start, end=end, whole=True, rigid_wall=rigid_wall)
    return fly_through(model, settings, frames=12, fps=3.0, rng=np.random.default_rng(3))


def _from_axis(model: Model, pose: np.ndarray, points: np.ndarray | None) -> np.ndarray:
    """Vectors to points from the nearest point of the body's axis, in the capsule frame."""
    assert points is not None
    local = transform_points(invert(pose), points)
    half = model.device.length / 2.0 - model.device.radius
    local[:, 2] -= np.clip(local[:, 2], -half, half)
    return local


def test_the_shell_has_room(narrow):
    """No vertex stays within the shell, the wall touches it, and nothing moves far away."""
    path = _flight(narrow, 0.1, 0.9)
    radius = narrow.device.radius
    for index in range(len(path)):
        state = path.state(index)
        assert state.vertices_world is not None
        before = _from_axis(narrow, state.T_world_capsule, narrow.vertices_world)
        after = _from_axis(narrow, state.T_world_capsule, state.vertices_world)
        near, away = np.linalg.norm(before, axis=1), np.linalg.norm(after, axis=1)
        assert radius * (1.0 - 1e-9) < away.min() < 1.05 * radius
        far = near >= 2.0 * radius
        np.testing.assert_array_equal(state.vertices_world[far], narrow.vertices_world[far])


def test_a_fold_across_the_axis_gives_way(narrow):
    """The wall yields along the whole body, also where a fold reaches beyond its axis."""
    pose = _flight(narrow, 0.3, 0.7).state(6).T_world_capsule
    half = narrow.device.length / 2.0 - narrow.device.radius
    local = transform_points(invert(pose), narrow.vertices_world)
    is_beside = local[:, 0] > 0.0
    square = local[:, 1] ** 2 + (local[:, 2] - 0.5 * half) ** 2
    height = np.where(is_beside, 4.6 * MM * np.exp(-0.5 * square / MM**2), 0.0)
    folded = local - height[:, None] * np.array([1.0, 0.0, 0.0])
    patient = transform_points(invert(narrow.T_world_patient) @ pose, folded)
    model = Model(replace(narrow.organ, vertices=patient), narrow.device)
    free = model.axis_clearance(pose[None])[0]
    assert min(free[0], free[-1], free[len(free) // 2]) > 0.0 > free.min()
    after = _from_axis(model, pose, WallDisplacement(model, model).vertices_world(pose))
    assert np.linalg.norm(after, axis=1).min() > narrow.device.radius * (1.0 - 1e-9)


def test_points_go_outwards_in_order(narrow):
    """Points move straight away from the axis, and farther ones stay farther."""
    path = _flight(narrow, 0.4, 0.6)
    state = path.state(4)
    before = _from_axis(narrow, state.T_world_capsule, narrow.vertices_world)
    after = _from_axis(narrow, state.T_world_capsule, state.vertices_world)
    near, away = np.linalg.norm(before, axis=1), np.linalg.norm(after, axis=1)
    assert np.linalg.norm(np.cross(before, after), axis=1).max() < 1e-12
    assert (away >= near * (1.0 - 1e-9)).all()
    order = np.argsort(near)
    assert (np.diff(away[order]) > -1e-12).all()


def test_nothing_moves_where_there_is_room(model):
    path = _flight(model, 0.2, 0.8)
    assert all(path.state(index).vertices_world is None for index in range(len(path)))


def test_a_rigid_wall_stays(narrow):
    path = _flight(narrow, 0.1, 0.9, rigid_wall=True)
    assert all(path.state(index).vertices_world is None for index in range(len(path)))


def test_it_begins_without_a_jump(narrow):
    """At the width of the capsule the wall does not move, near it only little."""
    radius = narrow.device.radius
    pose = np.eye(4)
    line = narrow.organ.centerline
    pose[:3, :3] = narrow.T_world_patient[:3, :3] @ line.frames[60]
    pose[:3, 3] = transform_points(narrow.T_world_patient, line.points[60])
    shifts = []
    for less in (0.3, 0.1, 0.0):
        tube = bent_tube(radius=radius - less * MM, around=60, along=400)
        model = Model(tube, narrow.device)
        moved = WallDisplacement(model, model).vertices_world(pose)
        rest = model.vertices_world
        shift = 0.0 if moved is None else np.linalg.norm(moved - rest, axis=1).max()
        shifts.append(shift / MM)
    # The tube curves and is of flat faces, so that even the last is met by 0.16 mm.
    assert shifts[2] < 0.2
    np.testing.assert_allclose(np.subtract(shifts, shifts[2]), [0.3, 0.1, 0.0], atol=0.02)


def test_the_twin_moves_alike(narrow):
    """The wall of a clean twin is moved by the same law, vertex by vertex."""
    organ = narrow.organ
    lump = np.zeros((len(organ.vertices), 3))
    lump[6000] = 1.0 * MM * organ.normals[6000]
    shown = Model(replace(organ, vertices=organ.vertices + lump), narrow.device)
    pose = _flight(narrow, 0.3, 0.7).state(6).T_world_capsule
    own = WallDisplacement(narrow, narrow).vertices_world(pose)
    twin = WallDisplacement(narrow, shown).vertices_world(pose)
    assert own is not None and twin is not None
    same = np.ones(len(own), bool)
    same[6000] = False
    np.testing.assert_array_equal(own[same], twin[same])


def test_another_loop_gives_way_where_a_closed_lumen_reaches_beyond_the_wall_at_rest():
    """Two legs of a hairpin, 0.4 mm apart; the capsule lies against the wall between them."""
    leg, turn = 150 * MM, 8.2 * MM
    along, angle = np.linspace(0.0, leg, 151), np.linspace(0.0, np.pi, 27)[1:-1]
    bend = np.stack([turn * (1.0 - np.cos(angle)), leg + turn * np.sin(angle)], axis=1)
    there = np.stack([0.0 * along, along], axis=1)
    line = np.concatenate([there, bend, there[::-1] + np.array([2.0 * turn, 0.0])])
    line = np.insert(line, 1, 0.0, axis=1)
    organ = replace(tube_about(line, 8 * MM, 48), metadata={CLOSED_RADIUS: 2 * MM})
    model = Model(organ, read_device("mirocam"), np.eye(4))
    pose = model.place(60 * MM).T_world_capsule
    pose[:3, 3] = [4.5 * MM, 0.0, 60 * MM]
    displacement = WallDisplacement(model, model)
    half, radius = 0.5 * model.device.length, model.device.radius
    assert displacement.closure is not None
    moved, closed = displacement.closure.close(pose, half, radius)
    only_closed = model.vertices_world.copy()
    only_closed[moved] = closed
    assert len(self_intersections(only_closed, organ.faces)) > 0
    vertices = displacement.vertices_world(pose)
    assert vertices is not None
    assert len(self_intersections(vertices, organ.faces)) == 0
