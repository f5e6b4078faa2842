"""The wall of an organ in motion."""

from __future__ import annotations

import hashlib
import os
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.sparse.linalg import spsolve

from tests.support.fem_shapes import full, straight_tube, vertex_areas
from vrcaps import _core
from vrcaps.core.errors import InputError
from vrcaps.organ.surface import OrganSurface
from vrcaps.tissue.fem.assembly import assemble, element_points
from vrcaps.tissue.fem.deformation import FemDeformation
from vrcaps.tissue.fem.wall import FemWall

LINEAR = FemDeformation(edge=0.014, youngs_modulus=5e4, support=2e5)
SOLID = replace(LINEAR, model="neo-hookean", stiffening_strain=0.6)
BOTH = pytest.mark.parametrize("deformation", [LINEAR, SOLID], ids=["linear", "neo-hookean"])


def poke(organ: OrganSurface, force: float) -> np.ndarray:
    """A force outwards on the vertices around the middle of one side [N]."""
    near = np.linalg.norm(organ.vertices - [0.02, 0.0, 0.06], axis=1) < 5e-3
    return np.where(near[:, None], [force / near.sum(), 0.0, 0.0], 0.0)


def nodal(wall: FemWall, force: np.ndarray) -> np.ndarray:
    """Forces at free nodes that do the same work."""
    out = np.zeros((len(wall.layer.nodes), 3))
    np.add.at(out, wall.embedding.nodes, wall.embedding.weights[..., None] * force[:, None])
    return out[: wall.num_free].ravel()


def solid_force(wall: FemWall, number: np.ndarray, u: np.ndarray) -> tuple[float, np.ndarray]:
    """Energy and forces of the hyperelastic layer, in NumPy; `u` of the free nodes."""
    points = element_points(wall.layer, wall.deformation, number)
    every = np.zeros((len(number), 3))
    every[: wall.num_free] = u
    g, w = points.gradients, points.weights
    f = np.eye(3) + np.einsum("eai,eqaj->eqij", every[points.nodes], g)
    inverse = np.linalg.inv(f).swapaxes(-1, -2)
    log = np.log(np.linalg.det(f))
    q = (f**2).sum((-1, -2)) - 3.0 - 2.0 * log
    b, shear, lame = points.stiffening, points.shear, points.lame
    change = np.einsum("pq,pqm->pm", (w * log).reshape(len(points.modes), -1), points.modes)
    log = np.einsum("pm,pqm->pq", change, points.modes).reshape(w.shape)
    energy = (w * shear / (2.0 * b) * (np.exp(b * q) - 1.0)).sum() + lame / 2.0 * (change**2).sum()
    stress = shear * np.exp(b * q)[..., None, None] * (f - inverse)
    stress += lame * log[..., None, None] * inverse
    force = np.zeros_like(every)
    np.add.at(force, points.nodes, np.einsum("eq,eqij,eqaj->eai", w, stress, g))
    return energy, force[: wall.num_free].ravel()


def test_linear_step_is_its_twin(tube: OrganSurface) -> None:
    """(M + dt (dt + c) K) v' = M v + dt (f + M b − K u), solved by SciPy."""
    wall, dt, down = FemWall(tube, LINEAR), 4e-3, (0.0, -9.8, 0.0)
    matrices = assemble(wall.layer, LINEAR, wall.node_index, wall.num_free)
    stiffness, mass = full(matrices)
    u = v = np.zeros(wall.num_dof)
    load = nodal(wall, poke(tube, 0.2)) + np.outer(matrices.node_mass, down).ravel()
    for _ in range(3):
        wall.step(poke(tube, 0.2), dt, acceleration=down)
        right = mass @ v + dt * (load - stiffness @ u)
        v = spsolve((mass + dt * (dt + LINEAR.damping) * stiffness).tocsc(), right)
        u = u + dt * v
    found = wall.snapshot()
    np.testing.assert_allclose(found[:, :3].ravel(), u, rtol=0, atol=1e-9 * np.abs(u).max())
    np.testing.assert_allclose(found[:, 3:].ravel(), v, rtol=0, atol=1e-9 * np.abs(v).max())
    kinetic, stored = wall.energies
    assert kinetic == pytest.approx(0.5 * v @ mass @ v, rel=1e-8)
    assert stored == pytest.approx(0.5 * u @ stiffness @ u, rel=1e-8)


def test_solid_step_satisfies_its_twin(tube: OrganSurface) -> None:
    """M (v' − v) = dt (f − c K v' − S u' − ∂Ψ/∂u'), to the tolerance of the minimization."""
    wall, dt = FemWall(tube, SOLID), 4e-3
    number = wall.node_index
    matrices = assemble(wall.layer, SOLID, number, wall.num_free)
    bare = assemble(wall.layer, replace(SOLID, support=0.0), number, wall.num_free)
    stiffness, mass = full(matrices)
    support = stiffness - full(bare)[0]
    for _ in range(4):
        before = wall.snapshot()
        wall.step(poke(tube, 1.0), dt)
    after = wall.snapshot()
    u, v = after[:, :3].ravel(), after[:, 3:].ravel()
    energy, force = solid_force(wall, number, after[:, :3])
    right = nodal(wall, poke(tube, 1.0)) - SOLID.damping * stiffness @ v - support @ u - force
    residual = mass @ (v - before[:, 3:].ravel()) / dt - right
    assert np.abs(u).max() > 1e-3
    assert np.abs(residual).max() < 1e-4 * np.abs(force).max()
    assert wall.energies[1] == pytest.approx(energy + 0.5 * u @ support @ u, rel=1e-10)


def test_solid_is_linear_where_strain_is_small(tube: OrganSurface) -> None:
    walls = FemWall(tube, LINEAR), FemWall(tube, SOLID)
    first, second = (wall.step(poke(tube, 1e-4), 0.01)[0] for wall in walls)
    np.testing.assert_allclose(second, first, atol=2e-3 * np.abs(first).max())


@pytest.mark.slow
def test_solid_yields_less_to_more_force(tube: OrganSurface) -> None:
    """It stiffens: a hundred times the force gives less than a hundred times the displacement."""
    wall = FemWall(tube, SOLID)
    for _ in range(5):
        little, _ = wall.step(poke(tube, 0.02), 0.5)
    for _ in range(5):
        much, _ = wall.step(poke(tube, 2.0), 0.5)
    assert 10.0 < np.abs(much).max() / np.abs(little).max() < 80.0


def test_pressed_tube_widens_as_it_should() -> None:
    """Lamé's tube of a length that does not change, on a support that presses back by k u.

    u(r) = (1 + ν)/E ((1 − 2ν) A r + B/r), A = (p a² − q b²)/(b² − a²), B = (p − q) a² b²/(b² − a²)
    with the pressures p at a and q = k u(b) at b (Timoshenko, Goodier, 1970, 28).
    """
    tube = straight_tube(radius=0.02, length=0.16, edge=0.0025)
    wall = FemWall(tube, LINEAR)
    for _ in range(4):
        u, _ = wall.step(1e3 * vertex_areas(tube), 1.0)
    middle = np.abs(tube.arc_length - 0.08) < 0.02
    found = (u * tube.vertices * [1.0, 1.0, 0.0] / 0.02).sum(axis=1)[middle]
    a, b, nu, p = 0.02, 0.022, LINEAR.poisson_ratio, 1e3

    def widening(r: float, q: float) -> float:
        first = (1.0 - 2.0 * nu) * (p * a**2 - q * b**2) * r
        return (1.0 + nu) / 5e4 * (first + (p - q) * a**2 * b**2 / r) / (b**2 - a**2)

    # q = k u(b, q) is linear in q.
    slope = widening(b, 1.0) - widening(b, 0.0)
    q = 2e5 * widening(b, 0.0) / (1.0 - 2e5 * slope)
    assert found.mean() == pytest.approx(widening(a, q), rel=0.02)
    assert found.std() < 0.02 * found.mean()


@BOTH
def test_energy_never_grows_without_load(tube: OrganSurface, deformation: FemDeformation) -> None:
    """From any motion, damped or not, at steps short and long."""
    wall = FemWall(tube, replace(deformation, damping=0.0))
    rng = np.random.default_rng(2)
    for dt in (2e-4, 2e-2):
        start = np.zeros((wall.num_free, 6))
        start[:, 3:] = rng.normal(size=(wall.num_free, 3)) * 0.1
        wall.restore(start)
        energy = sum(wall.energies)
        assert energy > 0.0
        # The nonlinear wall is solved to a tolerance.
        rounding = 1e-9 * energy
        for _ in range(15):
            wall.step(np.zeros_like(tube.vertices), dt)
            after = sum(wall.energies)
            assert after <= energy + rounding
            energy = after


@pytest.mark.slow
@BOTH
def test_restored_walls_go_on_to_the_same_bytes(
    tube: OrganSurface, deformation: FemDeformation
) -> None:
    wall = FemWall(tube, deformation)
    wall.step(poke(tube, 0.5), 0.005)
    half = wall.snapshot()
    first = [wall.step(poke(tube, 0.5), 0.005)[0].tobytes() for _ in range(3)]
    wall.step(poke(tube, 0.5), 0.002)
    wall.restore(half)
    assert [wall.step(poke(tube, 0.5), 0.005)[0].tobytes() for _ in range(3)] == first
    other = FemWall(tube, deformation)
    other.restore(half)
    assert [other.step(poke(tube, 0.5), 0.005)[0].tobytes() for _ in range(3)] == first


_RUN = """
import sys; sys.path.insert(0, {here!r})
from test_wall import *
print(digest())
"""


def digest() -> str:
    """Checksum of some steps of a fine wall."""
    organ = straight_tube(radius=0.02, length=0.12, edge=0.0012)
    wall = FemWall(organ, SOLID)
    steps = [wall.step(poke(organ, 0.5), 0.005) for _ in range(3)]
    return hashlib.sha256(b"".join(a.tobytes() for step in steps for a in step)).hexdigest()


@pytest.mark.slow
def test_the_same_bytes_on_any_number_of_threads() -> None:
    """Those of this process, and those of another with another number of threads."""
    code = _RUN.format(here=str(Path(__file__).parent))
    threads = "3" if _core.num_threads() == 1 else "1"
    env = os.environ | {"RAYON_NUM_THREADS": threads, "OPENBLAS_NUM_THREADS": threads}
    run = subprocess.run(
        [sys.executable, "-c", code], env=env, capture_output=True, text=True, check=True
    )
    one = digest()
    assert len(one) == len(hashlib.sha256().hexdigest())
    assert run.stdout.strip() == one


def test_stretches_and_ends_are_held(tube: OrganSurface) -> None:
    held = FemWall(tube, replace(LINEAR, fix_ends=True, fixed=((0.0, 0.05),)))
    u, v = held.step(poke(tube, 1.0), 0.01)
    assert np.abs(u[tube.arc_length < 0.03]).max() < 1e-12
    assert np.abs(u[tube.arc_length > 0.12 - 1e-9]).max() < 1e-6
    assert np.abs(v[np.abs(tube.arc_length - 0.07) < 0.01]).max() > 0.0


def test_what_nothing_holds_is_refused(tube: OrganSurface) -> None:
    with pytest.raises(InputError, match="Nothing holds the wall: support is 0"):
        FemWall(tube, replace(LINEAR, support=0.0, fix_ends=False))
    with pytest.raises(InputError, match="fixed covers the whole wall"):
        FemWall(tube, replace(LINEAR, fixed=((-1.0, 1.0),)))
    FemWall(tube, replace(LINEAR, support=0.0)).step(poke(tube, 0.1), 0.01)


def test_bad_steps_leave_the_wall_as_it_was(tube: OrganSurface) -> None:
    wall = FemWall(tube, SOLID)
    wall.step(poke(tube, 0.1), 0.01)
    before = wall.snapshot()
    broken = poke(tube, 0.1)
    broken[7, 1] = np.nan
    for force, dt, match in (
        (broken, 0.01, "force_on_vertices is not finite"),
        (poke(tube, 0.1), 0.0, "dt is 0.0. Allowed: above 0 to 1 s"),
        (poke(tube, 0.1), float("nan"), "dt is nan"),
        (poke(tube, 0.1)[:5], 0.01, r"force_on_vertices has the shape \(5, 3\)"),
        (poke(tube, 1e12), 0.01, "did not converge.*shorter dt"),
    ):
        with pytest.raises(InputError, match=match):
            wall.step(force, dt)
        np.testing.assert_array_equal(wall.snapshot(), before)
    with pytest.raises(InputError, match="acceleration is not finite"):
        wall.step(poke(tube, 0.1), 0.01, acceleration=(np.inf, 0.0, 0.0))
    with pytest.raises(InputError, match=r"The snapshot has the shape \(3, 6\)"):
        wall.restore(np.zeros((3, 6)))
    with pytest.raises(InputError, match="The snapshot is not finite"):
        wall.restore(before * np.nan)
