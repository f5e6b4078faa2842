"""A capsule on a wall of finite elements, in a `World`."""

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

from tests.support.fem_shapes import full
from tests.support.tubes import straight_gut
from vrcaps import _core
from vrcaps.capsule.device_file import read_device
from vrcaps.core.errors import InputError
from vrcaps.core.geometry import transform_points
from vrcaps.core.units import MM
from vrcaps.tissue.fem.assembly import assemble, surface_mass
from vrcaps.tissue.fem.deformation import FemDeformation
from vrcaps.tissue.tissue import Drag, Tissue
from vrcaps.world.control import GRAVITY, Control
from vrcaps.world.model import Model, State
from vrcaps.world.snapshot import read_snapshot, write_snapshot
from vrcaps.world.world import World

RADIUS = 18.0 * MM
GUT = straight_gut({"ileum": 0.08}, radius=RADIUS, edge=3.0 * MM)
LAYER = FemDeformation(edge=14.0 * MM, fix_ends=False)
SOLID = replace(LAYER, model="neo-hookean", stiffening_strain=0.6)
STILL = Control()


def world(
    deformation: FemDeformation,
    *,
    gap: float = -0.1 * MM,
    substep: float = 1e-4,
    gut=GUT,
    velocity: tuple[float, float, float] = (0.0, 0.0, 0.0),
    **tissue,
) -> World:
    """A capsule along the gut, a gap above its floor; the patient's frame is the world's."""
    device = read_device("mirocam")
    middle = len(gut.centerline.points) // 2
    start = np.eye(4)
    start[:3, :3], start[:3, 3] = gut.centerline.frames[middle], gut.centerline.points[middle]
    start[2, 3] -= gut.radius[0] - device.radius - gap
    tissue = Tissue(deformation=deformation, **tissue)
    state = State(0.0, start, linear_velocity_world=np.array(velocity))
    return World(Model(gut, device, np.eye(4)), tissue, state, substep=substep)


def nodal_force(world: World) -> np.ndarray:
    return world.snapshot().layer[:, 6:9]


def energy(world: World) -> float:
    """Energy of motion, weight, foundation and layer [J]."""
    state = world.state
    assert world.layer is not None
    assert state.contact is not None
    height = state.T_world_capsule[2, 3]
    spin, velocity = state.angular_velocity_world, state.linear_velocity_world
    frame = state.T_world_capsule[:3, :3]
    inertia = frame @ world.body.inertia @ frame.T
    motion = 0.5 * (world.body.mass * velocity @ velocity + spin @ inertia @ spin)
    weight = world.body.mass * GRAVITY * height
    return motion + weight + state.contact.energy + sum(world.layer.energies)


@pytest.mark.slow
def test_a_resting_capsule_is_carried_by_the_layer() -> None:
    """The wall's force is the weight, and the layer stands as its own static solution has it."""
    at_rest = world(LAYER)
    for _ in range(12):
        at_rest.step(STILL, 0.05)
    weight = at_rest.body.mass * GRAVITY
    force = at_rest.state.contact.force_world
    assert force[2] == pytest.approx(weight, rel=1e-3)
    assert np.abs(force[:2]).max() < 1e-3 * weight
    load = nodal_force(at_rest)
    assert load.sum(axis=0) == pytest.approx(-force, abs=1e-3 * weight)
    wall = at_rest.layer
    stiffness = full(assemble(wall.layer, LAYER, wall.node_index, wall.num_free))[0]
    static = spsolve(stiffness.tocsc(), load.ravel()).reshape(-1, 3)
    found = at_rest.snapshot().layer[:, :3]
    np.testing.assert_allclose(found, static, rtol=0, atol=1e-3 * np.abs(static).max())


@pytest.mark.slow
def test_a_stiff_tube_sinks_into_its_support_as_a_whole() -> None:
    """A rigid wall on springs k by area A goes down by m g/(k A)."""
    stiff = replace(LAYER, youngs_modulus=1e9, support=1e4, step=0.02)
    at_rest = world(stiff)
    for _ in range(10):
        at_rest.step(STILL, 0.1)
    layer = at_rest.layer.layer
    area = surface_mass(layer.nodes, layer.outer_triangles).sum()
    sunk = -at_rest.snapshot().layer[:, 2].mean()
    assert sunk == pytest.approx(at_rest.body.mass * GRAVITY / (1e4 * area), rel=0.01)


@pytest.mark.slow
@pytest.mark.parametrize("deformation", [LAYER, SOLID], ids=["linear", "neo-hookean"])
def test_depth_at_rest_does_not_depend_on_the_step(deformation: FemDeformation) -> None:
    """Against a step of a tenth, whose error is a tenth."""
    heights = []
    for step in (5e-3, 5e-4):
        pressed = world(replace(deformation, step=step))
        for _ in range(5):
            pressed.step(Control(force_world=(0.0, 0.0, -0.2)), 0.04)
        heights.append(pressed.state.T_world_capsule[2, 3])
    first = world(deformation).state.T_world_capsule[2, 3]
    assert heights[0] - first == pytest.approx(heights[1] - first, rel=0.05)


@pytest.mark.slow
@pytest.mark.parametrize("law", ["physical", "continuous"])
def test_what_acts_on_the_capsule_acts_back_on_the_layer(law: str) -> None:
    """Force and torque about one point, every substep, while the capsule is pulled and turned.

    The layer is stiff, as nodes count where they are at rest.
    """
    stiff = replace(LAYER, youngs_modulus=1e10, support=1e10)
    drag = Drag(law=law, friction=0.2, viscosity=0.1)
    pulled = world(stiff, substep=2e-5, drag=drag)  # a fast capsule takes no shorter ones
    wall = pulled.layer
    nodes = np.empty((wall.num_free, 3))
    nodes[wall.node_index] = wall.layer.nodes
    control = Control(force_world=(0.4, 0.1, -0.5), torque_world=(1e-3, -5e-4, 1e-3))
    for _ in range(200):
        center = pulled.state.T_world_capsule[:3, 3]
        pulled.step(control, 2e-5)
        contact, load = pulled.state.contact, nodal_force(pulled)
        size = np.linalg.norm(contact.force_world)
        np.testing.assert_allclose(load.sum(axis=0), -contact.force_world, atol=1e-9 * size)
        torque = np.cross(nodes - center, load).sum(axis=0)
        np.testing.assert_allclose(torque, -contact.torque_world, atol=1e-6 * size * RADIUS)
    assert size > 0.4


@pytest.mark.slow
@pytest.mark.parametrize("deformation", [LAYER, SOLID], ids=["linear", "neo-hookean"])
@pytest.mark.parametrize("step", [2e-3, 2e-2])
def test_energy_does_not_grow(deformation: FemDeformation, step: float) -> None:
    """A capsule dropped on the wall: it bounces, and all it loses stays lost."""
    dropped = world(replace(deformation, step=step, damping=0.0), gap=3.0 * MM)
    energies = []
    for _ in range(12):
        dropped.step(STILL, 0.02)
        energies.append(energy(dropped))
    fall = dropped.body.mass * GRAVITY * 3.0 * MM
    assert np.diff(energies).max() < 1e-3 * fall
    assert energies[0] - energies[-1] > 0.3 * fall


def test_the_wall_that_is_seen_is_the_wall_that_is_felt() -> None:
    """Vertices go with the layer; muscle and gas move them besides."""
    pressed = world(LAYER)
    for _ in range(3):
        pressed.step(Control(force_world=(0.0, 0.0, -0.3), insufflation=1.02), 0.01)
    u, v = np.hsplit(pressed.layer.wall_displacement, 2)
    driven = GUT.vertices + 0.02 * (GUT.vertices * [0.0, 1.0, 1.0])
    side = np.abs(GUT.vertices[:, 0] - 0.04) < 0.03  # the caps' middles stay on the axis
    seen = pressed.state.vertices_world
    np.testing.assert_allclose(seen[side], (driven + u)[side], rtol=0, atol=1e-9)
    assert np.abs(u).max() > 0.5 * MM
    assert np.abs(v).max() > 0.0
    axis = np.outer(np.linspace(-1.0, 1.0, 99) * pressed.body.half_axis, [0.0, 0.0, 1.0])
    axis = transform_points(pressed.state.T_world_capsule, axis)
    wall = _core.Wall(seen, GUT.faces.astype(np.int64))
    depth = pressed.body.radius - np.abs(wall.signed_distance(axis)).min()
    assert depth == pytest.approx(pressed.state.contact.depth, abs=0.05 * MM)


@pytest.mark.slow
def test_a_narrow_lumen_on_a_layer_grips_within_what_is_measured() -> None:
    """1.9 ± 1.0 N per cm of a capsule in a gut 8.4 mm wide (see `WinklerFoundation`)."""
    narrow = straight_gut({"ileum": 0.08}, radius=4.2 * MM, edge=1.2 * MM)
    gripped = world(replace(LAYER, edge=5.0 * MM), gut=narrow, gap=-1.2 * MM)
    for _ in range(3):
        gripped.step(STILL, 0.02)
    length = 2.0 * (gripped.body.half_axis + gripped.body.radius)
    assert 0.9 < 0.01 * gripped.state.contact.normal_force_total / length < 2.9


def push(world: World, dt: float = 0.008) -> bytes:
    """Bytes of some steps in which the capsule slides into other triangles and nodes."""
    digest = hashlib.sha256()
    for k in range(4):
        world.step(Control(force_world=(0.3, 0.02 * k, -0.1)), dt)
        digest.update(world.state.T_world_capsule.tobytes())
        digest.update(world.state.vertices_world.tobytes())
    return digest.digest()


@pytest.mark.slow
@pytest.mark.parametrize("deformation", [LAYER, SOLID], ids=["linear", "neo-hookean"])
def test_a_restored_world_goes_on_to_the_same_bytes(
    deformation: FemDeformation, tmp_path: Path
) -> None:
    first = world(deformation)
    push(first)
    half = first.snapshot()
    expected = push(first)
    write_snapshot(tmp_path / "half.npz", half)
    other = world(deformation)
    other.step(STILL, 0.005)
    other.restore(read_snapshot(tmp_path / "half.npz"))
    assert push(other) == expected


THROWN = (4.0, 0.0, -0.5)
"""Velocity of a capsule that takes parts of substeps, and comes near to others within them [m/s]"""


def test_a_thrown_capsule_is_held_and_restored_to_the_same_bytes() -> None:
    first = world(LAYER, velocity=THROWN, substep=1e-3)
    before = energy(first)
    push(first, 0.001)
    half = first.snapshot()
    expected = push(first, 0.001)
    traveled = first.state.T_world_capsule[0, 3] - 0.04
    assert 0.02 < traveled < 0.04
    assert energy(first) < before + 0.5 * traveled  # at most the work of the force
    assert first.is_inside()
    other = world(LAYER, substep=1e-3)
    other.restore(half)
    assert push(other, 0.001) == expected


_RUN = """
import sys; sys.path[:0] = [{here!r}, {above!r}]
from test_exchange import *
print(digests())
"""


def digests() -> str:
    """Checksums of a capsule that is pushed and of one that is thrown."""
    return f"{push(world(LAYER)).hex()} {push(world(LAYER, velocity=THROWN), 0.002).hex()}"


@pytest.mark.slow
def test_the_same_bytes_on_any_number_of_threads() -> None:
    """Those of this process, and those of another with another number of threads."""
    here = Path(__file__).parent
    code = _RUN.format(here=str(here), above=str(here.parents[1]))
    threads = "3" if _core.num_threads() == 1 else "1"
    env = os.environ | {"RAYON_NUM_THREADS": threads, "OPENBLAS_NUM_THREADS": threads}
    run = subprocess.run(
        [sys.executable, "-c", code], env=env, capture_output=True, text=True, check=True
    )
    checksums = digests()
    assert len(checksums) > 60
    assert run.stdout.strip() == checksums


@pytest.mark.parametrize(
    ("change", "match"),
    [
        ({"thickness": 40.0 * MM}, "The layer folds over itself.*thickness is 40 mm"),
        ({"support": 0.0}, "Nothing holds the wall: support is 0"),
        ({"edge": 60.0 * MM}, "edge is 60 mm: too long for this organ"),
        ({"step": 5e-5}, "substep is 0.0001. Allowed: above 0 to 5e-05 s"),
    ],
)
def test_a_layer_that_cannot_be_is_refused(change: dict[str, float], match: str) -> None:
    with pytest.raises(InputError, match=match):
        world(replace(LAYER, **change))


@pytest.mark.parametrize("name", ["youngs_modulus", "support", "step"])
def test_negative_values_are_refused(name: str) -> None:
    with pytest.raises(InputError, match=f"^{name} is -1"):
        replace(LAYER, **{name: -1.0})


@pytest.mark.slow
def test_errors_leave_the_world_as_it_was() -> None:
    pressed = world(replace(LAYER, youngs_modulus=1e4, support=1e5))
    pressed.step(STILL, 0.02)
    before = pressed.snapshot()
    seen = pressed.state.vertices_world
    for control, dt, match in (
        (Control(force_world=(0.0, 0.0, -50.0)), 0.05, "breaks through the elastic wall.*force"),
        (STILL, 2.0, "dt is 2.0. Allowed: above 0 to 1 s"),
        (Control(force_world=(0.0, 0.0, -500.0)), 0.01, "force_world is 500 strong"),
    ):
        with pytest.raises(InputError, match=match):
            pressed.step(control, dt)
        after = pressed.snapshot()
        for name in ("capsule", "active_wall", "wall_displacement", "layer", "contact_faces"):
            np.testing.assert_array_equal(getattr(after, name), getattr(before, name))
        np.testing.assert_array_equal(pressed.state.vertices_world, seen)
    finer = world(replace(LAYER, edge=10.0 * MM))
    with pytest.raises(InputError, match=r"The snapshot has a layer of .* nodes, the world's has"):
        finer.restore(before)
    broken = replace(before, layer=np.full_like(before.layer, np.nan))
    with pytest.raises(InputError, match="The snapshot is not finite"):
        pressed.restore(broken)
    np.testing.assert_array_equal(pressed.snapshot().layer, before.layer)
