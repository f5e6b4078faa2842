"""Input that a world refuses: the message names the field, and the state is unchanged."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from tests.support.shapes import DIRECT
from vrcaps import _core
from vrcaps.capsule.device import Body
from vrcaps.core.errors import InputError, UnknownNameError
from vrcaps.core.units import MM
from vrcaps.render.renderer import Renderer
from vrcaps.tissue.motility.motility import Motility
from vrcaps.tissue.tissue import Drag, SpringWall, Tissue, WinklerFoundation
from vrcaps.world.control import Control
from vrcaps.world.model import Model, State, posture_transform
from vrcaps.world.snapshot import Snapshot, read_snapshot
from vrcaps.world.world import World

NAN, INF = np.nan, np.inf


def start_of(model: Model, sample: int = 150, aside: float = 0.0) -> State:
    line = model.organ.centerline
    pose = np.eye(4)
    pose[:3, :3] = line.frames[sample]
    pose[:3, 3] = line.points[sample] + aside * line.frames[sample][:, 0]
    return State(0.0, model.T_world_patient @ pose)


@pytest.fixture
def world(model: Model) -> World:
    """A capsule that has moved and pressed the wall."""
    world = World(model, Tissue(), start_of(model))
    world.step(Control(force_world=(0.0, 0.0, -0.3)), 0.05)
    return world


def assert_same(before: Snapshot, after: Snapshot) -> None:
    for name, value in vars(before).items():
        assert np.asarray(value).tobytes() == np.asarray(getattr(after, name)).tobytes(), name


@pytest.mark.parametrize(
    ("field", "value", "match"),
    [
        ("force_world", (0.0, NAN, 0.0), "force_world is .*nan.* Allowed: finite"),
        ("torque_world", (INF, 0.0, 0.0), "torque_world is .*inf.* Allowed: finite"),
        ("insufflation", NAN, "insufflation is nan"),
        ("T_world_patient", np.full((4, 4), NAN), "T_world_patient is .* Allowed: finite"),
        ("force_world", (0.0, 1.0), r"force_world has the shape \(2,\). Allowed: \(3,\)"),
        ("torque_world", 1.0, r"torque_world has the shape \(\). Allowed: \(3,\)"),
        ("T_world_patient", np.eye(3), r"T_world_patient has the shape \(3, 3\)"),
        ("T_world_patient", np.diag([2.0, 1, 1, 1]), "T_world_patient stretches"),
        ("T_world_patient", np.diag([-1.0, 1, 1, 1]), "T_world_patient stretches or mirrors"),
        ("insufflation", 0.1, "insufflation is 0.1. Allowed: 0.2 to 2"),
    ],
)
def test_control(field: str, value: object, match: str) -> None:
    with pytest.raises(InputError, match=match):
        Control(**{field: value})


@pytest.mark.parametrize(
    ("control", "dt", "match"),
    [
        (Control(), 0.0, "dt is 0.0. Allowed: above 0 to 1 s"),
        (Control(), -1.0, "dt is -1.0"),
        (Control(), 2.0, "dt is 2.0"),
        (Control(), NAN, "dt is nan"),
        (Control(force_world=(0.0, 0.0, 101.0)), 0.01, "force_world is 101 strong. .* up to 100"),
        (Control(torque_world=(0.0, 11.0, 0.0)), 0.01, "torque_world is 11 strong. .* up to 10"),
    ],
)
def test_step(world: World, control: Control, dt: float, match: str) -> None:
    before, state = world.snapshot(), world.state
    with pytest.raises(InputError, match=match):
        world.step(control, dt)
    assert_same(before, world.snapshot())
    assert world.state.contact.energy == state.contact.energy
    assert world.state.vertices_world.tobytes() == state.vertices_world.tobytes()


def test_motion_that_runs_away(model: Model) -> None:
    """A step that ends in no number is taken back, also the wall that was pressed on the way."""
    start = replace(start_of(model), linear_velocity_world=np.array([1e300, 0.0, 0.0]))
    world = World(model, Tissue(), start)
    before = world.snapshot()
    with pytest.raises(InputError, match="step is too large: the capsule's motion runs away"):
        world.step(Control(), 0.01)
    assert_same(before, world.snapshot())


@pytest.mark.parametrize(
    ("changed", "match"),
    [
        ({"aside": 25.0 * MM}, "T_world_capsule puts the capsule's axis outside the lumen"),
        ({"sample": 1}, "T_world_capsule puts the capsule's axis outside the lumen"),
    ],
)
def test_start_outside(model: Model, changed: dict[str, float], match: str) -> None:
    with pytest.raises(InputError, match=match):
        World(model, Tissue(), start_of(model, **changed))


def test_capsule_that_does_not_fit(model: Model) -> None:
    fat = Body(0.1, 1e-5 * np.eye(3), np.zeros(3), 2.0 * MM, 200.0 * MM)
    with pytest.raises(InputError, match=r"400.0 mm thick, does not fit: the lumen is .* mm wide"):
        World(model, Tissue(), start_of(model), body=fat)


@pytest.mark.parametrize(
    "field", ["T_world_capsule", "linear_velocity_world", "angular_velocity_world"]
)
def test_start_that_is_not_finite(model: Model, field: str) -> None:
    start = start_of(model)
    broken = np.array(getattr(start, field))
    broken[0] = NAN
    with pytest.raises(InputError, match=f"start's {field} is not finite"):
        World(model, Tissue(), replace(start, **{field: broken}))


@pytest.mark.parametrize("substep", [0.0, -1e-5, 2e-3, NAN])
def test_substep(model: Model, substep: float) -> None:
    with pytest.raises(InputError, match=r"substep is .* Allowed: above 0 to 0.001 s"):
        World(model, Tissue(), start_of(model), substep=substep)


def test_substep_too_long_for_the_deformation(model: Model) -> None:
    stiff = Tissue(deformation=SpringWall(mass=1e-4, stiffness=1e4))
    with pytest.raises(InputError, match=r"substep is 0.0005. Allowed: above 0 to 0.0001 s"):
        World(model, stiff, start_of(model), substep=5e-4)


@pytest.mark.parametrize(
    ("law", "field", "value"),
    [
        (WinklerFoundation, "thickness", -1e-3),
        (WinklerFoundation, "youngs_modulus", -5.0),
        (WinklerFoundation, "youngs_modulus", NAN),
        (WinklerFoundation, "poisson_ratio", 0.5),
        (WinklerFoundation, "stiffening_strain", 0.0),
        (WinklerFoundation, "rate_gain", 1.0),
        (WinklerFoundation, "strain_rate", 0.0),
        (Drag, "friction", -0.1),
        (Drag, "viscosity", NAN),
        (Drag, "a", -1.0),
        (Drag, "b", INF),
        (Drag, "constant", -1.0),
        (Drag, "threshold", -1.0),
        (Drag, "c", 0.5),
        (SpringWall, "length", 0.0),
        (SpringWall, "reach", INF),
        (SpringWall, "mass", -1.0),
        (SpringWall, "stiffness", -150.0),
        (SpringWall, "damping", NAN),
        (SpringWall, "foundation_gain", 0.0),
    ],
)
def test_tissue(law: Callable[..., object], field: str, value: float) -> None:
    with pytest.raises(InputError, match=f"^{field} is {value}. Allowed: "):
        law(**{field: value})


def test_names_that_nobody_knows(model: Model) -> None:
    with pytest.raises(UnknownNameError, match=r"No drag law named 'stokes'. Known: continuous"):
        Drag(law="stokes")  # pyright: ignore[reportArgumentType]
    with pytest.raises(UnknownNameError, match=r"No posture named 'upside-down'. Known: left"):
        posture_transform("upside-down")
    with pytest.raises(UnknownNameError, match=r"No segment with muscle named .* Known: "):
        World(model, Tissue(motility=Motility()), start_of(model))


@pytest.mark.parametrize("seed", [-1, -7, 2**64])
def test_seed(model: Model, seed: int) -> None:
    with pytest.raises(InputError, match=f"seed is {seed}. Allowed: 0 to {2**64 - 1}"):
        World(model, Tissue(), start_of(model), seed=seed)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("changed", "match"),
    [
        ({"seed": 5}, "seed is 5. Allowed: this world's, 0"),
        ({"active_wall": np.zeros((4, 3))}, "a wall of 4 vertices, the model has"),
        ({"wall_displacement": np.zeros((4, 6))}, r"wall_displacement has the shape \(4, 6\)"),
        ({"capsule": np.zeros(12)}, r"capsule has the shape \(12,\). Allowed: \(13,\)"),
        ({"lumen_scale": np.ones(3)}, r"lumen_scale has the shape \(3,\)"),
        ({"time": NAN}, "time is not finite"),
        ({"capsule": np.full(13, NAN)}, "capsule is not finite"),
        ({"T_world_patient": np.full((4, 4), INF)}, "T_world_patient is not finite"),
    ],
)
def test_snapshot(world: World, changed: dict[str, object], match: str) -> None:
    before = world.snapshot()
    world.step(Control(), 0.01)
    now = world.snapshot()
    with pytest.raises(InputError, match=match):
        world.restore(replace(before, **changed))
    assert_same(now, world.snapshot())


def test_file_that_is_no_snapshot(tmp_path: Path) -> None:
    np.savez(tmp_path / "other.npz", seed=1)
    (tmp_path / "text.npz").write_text("no archive")
    np.save(tmp_path / "array.npy", np.zeros(3))
    whole = (tmp_path / "other.npz").read_bytes()
    (tmp_path / "cut.npz").write_bytes(whole[: len(whole) // 2])
    for name in ("other.npz", "text.npz", "array.npy", "cut.npz", "absent.npz"):
        with pytest.raises(InputError, match=rf"{name} is not a snapshot of a world"):
            read_snapshot(tmp_path / name)


@pytest.mark.slow
def test_never_tunnels_or_explodes(model: Model, rng: np.random.Generator) -> None:
    """Forces up to 5 N in any direction, changing, at the default step."""
    world = World(model, Tissue(), start_of(model))
    length = model.organ.centerline.length
    limit = np.sqrt(2.0 * 5.0 * length / world.body.mass)  # 5 N all along the lumen
    for _ in range(12):
        push = rng.normal(size=3)
        force = push * (rng.uniform(0.0, 5.0) / np.linalg.norm(push))
        for _ in range(4):
            world.step(Control(force_world=force), 5e-3)
            speed = np.linalg.norm(world.state.linear_velocity_world)
            assert np.isfinite(world.snapshot().wall_displacement).all()
            assert speed < limit
        assert world.is_inside()


def test_a_wall_under_a_world(world: World) -> None:
    """It keeps no vertex normals: they are made when asked for, and it is not drawn by mistake."""
    model = world.model
    wall = world.wall
    camera, renderer = model.device.cameras[0], Renderer(model, DIRECT)
    arrays = {"depth": np.empty((camera.height, camera.width), np.float32)}
    with pytest.raises(ValueError, match="wall has moved under a world: refit it to draw it"):
        renderer._render_into(wall, camera, world.state, arrays, None)
    vertices = world._core.vertices(np.eye(4))
    fresh = _core.Wall(vertices, model.organ.faces.astype(np.int64))
    normals = wall.vertex_normals()
    np.testing.assert_allclose(normals, fresh.vertex_normals(), atol=1e-5)
    assert np.abs(normals - model.wall.vertex_normals()).max() > 1e-3
    renderer._render_into(wall, camera, world.state, arrays, None)
