"""Poses of a magnet for a wanted wrench, against the field's own wrench."""

from __future__ import annotations

import magpylib
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from tests.support.pose_solver_twin import PoseSolverTwin, dipole_field
from vrcaps.actuation.magnet_pose_solver import MagnetPoseSolver, Workspace, WrenchTarget
from vrcaps.core.errors import InputError
from vrcaps.magnet.field import SourceSet, wrench
from vrcaps.magnet.presets import read_magnet
from vrcaps.magnet.sources import Dipole, InternalMagnet, UniformField, magnet_pose

MAGNETS = (InternalMagnet((0, 0, -4e-3), (0, 0, 1.12)),)
EARTH = 5e-5 * np.array([0.0, 0.6, -0.8])


@pytest.mark.parametrize("source", [Dipole(970.0), read_magnet("cylinder-101.6")])
def test_any_force_and_heading_can_be_had(source):
    """Five wishes, five freedoms: force, and no torque for the heading."""
    rng = np.random.default_rng(0)
    solver = MagnetPoseSolver(SourceSet([source]), MAGNETS, Workspace(min_distance=0.05))
    missed = []
    for _ in range(60):
        capsule = magnet_pose(rng.uniform(-0.1, 0.1, 3), rng.normal(size=3))
        away, force = rng.normal(size=3), rng.normal(size=3)
        force *= 0.3 / np.linalg.norm(force)
        start = solver.initial_guess(capsule, away, 0.3)
        solution = solver.solve(
            WrenchTarget(force.tolist(), motion_weight=0.0), capsule, start, max_iterations=200
        )
        got = wrench([type(source)(**vars(source) | {"T_world_magnet": solution.T_world_magnet})],
                     MAGNETS, capsule)  # fmt: skip
        np.testing.assert_allclose(np.array(got), [solution.force, solution.torque], atol=1e-12)
        missed.append(np.linalg.norm(solution.force - force))
        place = solution.T_world_magnet[:3, :3]
        np.testing.assert_allclose(place @ place.T, np.eye(3), atol=1e-9)
    assert np.mean(np.array(missed) < 1e-4) > 0.9


def test_room_is_kept():
    """A target that only a nearer magnet could fulfil ends at the bound, and says what it gives."""
    workspace = Workspace(low=(-0.05, -0.05, 0.2), high=(0.05, 0.05, 0.5))
    solver = MagnetPoseSolver(SourceSet([Dipole(100.0), UniformField(50e-6)]), MAGNETS, workspace)
    capsule = magnet_pose((0, 0, 0), (1, 0, 0))
    start = solver.initial_guess(capsule, np.array([0, 0, 1]), 1.0)
    solution = solver.solve(WrenchTarget((0, 0, 1.0)), capsule, start, max_iterations=100)
    place = solution.T_world_magnet[:3, 3]
    assert np.all(place >= workspace.low) and np.all(place <= workspace.high)
    assert place[2] == 0.2
    assert 0.0 < solution.force[2] < 0.2


def test_guess_points_the_field_along_the_moment():
    rng = np.random.default_rng(1)
    sources = SourceSet([Dipole(500.0)])
    solver = MagnetPoseSolver(sources, (InternalMagnet((0, 0, 0), (0, 0, 0.2)),), Workspace())
    for _ in range(20):
        capsule = magnet_pose(rng.normal(size=3), rng.normal(size=3))
        sources.move(0, solver.initial_guess(capsule, rng.normal(size=3), 0.1))
        flux = sources.field(capsule[None, :3, 3])[0][0]
        np.testing.assert_allclose(flux / np.linalg.norm(flux), capsule[:3, 2], atol=1e-9)


def test_farthest_is_where_the_coaxial_pull_is_the_force():
    """Maximum distance of point dipoles; forces below a millinewton are not requested."""
    dipole = Dipole(500.0)
    magnets = (InternalMagnet((0, 0, 0), (0, 0, 1.12)),)
    solver = MagnetPoseSolver(SourceSet([dipole]), magnets, Workspace())
    for force in (2e-3, 0.3, 5.0):
        place = magnet_pose((0, 0, solver.max_distance(force)), (0, 0, 1))
        pull = wrench([Dipole(500.0, place)], magnets, np.eye(4))[0]
        np.testing.assert_allclose(pull, [0, 0, force], rtol=1e-9, atol=1e-12)
    assert solver.max_distance(0.0) == solver.max_distance(1e-3)


def twin_wrench(source, capsule: np.ndarray):
    """Wrench of a magnet on `MAGNETS` and of the earth, by formula or by magpylib."""
    inside = MAGNETS[0]
    arm, moment = capsule[:3, :3] @ inside.position_capsule, capsule[:3, :3] @ inside.moment_capsule
    at = capsule[:3, 3] + arm
    h = 1e-3 * np.array([-2, -1, 1, 2])[:, None, None]
    weights = np.array([1, -8, 8, -1]) / 12e-3

    def field(pose: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        if isinstance(source, Dipole):
            return dipole_field(source.moment * pose[:3, 2], at - pose[:3, 3])
        magnet = magpylib.magnet.Cylinder(
            polarization=(0, 0, source.remanence),
            dimension=(source.diameter, source.length),
            position=pose[:3, 3],
            orientation=Rotation.from_matrix(pose[:3, :3]),
        )
        around = magnet.getB((at + h * np.eye(3)).reshape(-1, 3)).reshape(4, 3, 3)
        return magnet.getB(at), np.einsum("k,kji->ij", weights, around)

    def wrench_of(pose: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        flux, gradient = field(pose)
        force = gradient.T @ moment
        return force, np.cross(moment, flux + EARTH) + np.cross(arm, force)

    return wrench_of


@pytest.mark.slow
@pytest.mark.parametrize("source", [Dipole(400.0), read_magnet("cylinder-76.2")])
@pytest.mark.parametrize(
    "workspace", [Workspace(min_distance=0.08), Workspace((-0.1, -0.1, 0.15), (0.1, 0.1, 0.3))]
)
def test_pose_is_the_twins(source, workspace):
    """The same search in NumPy, for random targets; the box is often in its way."""
    rng = np.random.default_rng(2)
    earth = UniformField(5e-5, T_world_magnet=magnet_pose((0, 0, 0), EARTH))
    solver = MagnetPoseSolver(SourceSet([source, earth]), MAGNETS, workspace)
    for rounds in [3, 8, 20] * 2:
        capsule = magnet_pose(rng.uniform(-0.02, 0.02, 3), rng.normal(size=3))
        start = solver.initial_guess(capsule, np.array([0, 0, 1]) + 0.5 * rng.normal(size=3), 0.3)
        target = WrenchTarget(
            rng.normal(scale=0.2, size=3).tolist(),
            rng.normal(scale=2e-3, size=3).tolist(),
            (40.0 * np.eye(3) + 100.0 * np.diag(rng.uniform(size=3))).tolist(),
            motion_weight=float(rng.choice([1e-3, 1e-1])),
        )
        solution = solver.solve(target, capsule, start, max_iterations=rounds)
        twin = PoseSolverTwin(
            twin_wrench(source, capsule), target, workspace, capsule[:3, 3], start
        )
        miss = 1e-12 if isinstance(source, Dipole) else 1e-7  # of differences of magpylib's field
        theirs = twin.wrench(solution.T_world_magnet)
        np.testing.assert_allclose([solution.force, solution.torque], theirs, atol=miss)
        place = 1e-8 if isinstance(source, Dipole) else 2e-7
        np.testing.assert_allclose(solution.T_world_magnet, twin.solve(rounds), atol=place)


def test_what_cannot_be():
    with pytest.raises(InputError, match="contains no magnet"):
        MagnetPoseSolver(SourceSet([Dipole(1.0)]), (), Workspace())
    with pytest.raises(InputError, match=r"index is 1\. Allowed: 0 to 0"):
        MagnetPoseSolver(SourceSet([Dipole(1.0)]), MAGNETS, Workspace(), index=1)
    with pytest.raises(InputError, match="low up to high"):
        Workspace(low=(1, 0, 0), high=(0, 0, 0))
    with pytest.raises(InputError, match="Workspace's min_distance is 0"):
        Workspace(min_distance=0.0)
