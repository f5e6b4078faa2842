"""The border of the compiled core: what no caller should give is an exception, never a panic.

Arguments are drawn by the types that `_core.pyi` states: arrays of many shapes, with NaN and
infinities, numbers of either sign, and things of the wrong type.
"""

from __future__ import annotations

import ast
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from tests.support.fem_shapes import straight_tube
from tests.support.walls import floor, world_on
from vrcaps import _core
from vrcaps.tissue.fem.deformation import FemDeformation
from vrcaps.tissue.fem.wall import FemWall
from vrcaps.tissue.tissue import WinklerFoundation

STUBS = ast.parse((Path(_core.__file__).parent / "_core.pyi").read_text())
SHAPES = [(), (0,), (1,), (3,), (7,), (0, 0), (0, 3), (1, 3), (2, 3), (3, 3), (4, 3), (3, 4)]
SHAPES += [(4, 4), (1, 4), (2, 4), (5, 4), (2, 6), (2, 7), (2, 8), (1, 10), (121, 3), (2, 4, 4)]
SHAPES += [(0, 4, 4), (2, 3, 4), (1, 8, 8), (8, 8, 3), (2, 2, 1), (2, 2, 2, 3), (1, 0, 3, 2)]
NUMBERS = [0.0, 1.0, -1.0, 1e-3, 0.3, np.nan, np.inf, -np.inf, 1e300]
CALLS, FEW = 40, {"Radiosity.__init__": 2}
"""Calls of each function from each thread, and of slow functions."""


def _array(kind: str, rng: np.random.Generator) -> np.ndarray:
    shape = SHAPES[rng.integers(len(SHAPES))]
    values = rng.choice([rng.normal(size=shape), np.zeros(shape), np.ones(shape)])
    if values.ndim == 2 and rng.random() < 0.5:
        values = np.eye(*shape)
    dtype = np.dtype(getattr(np, kind, np.float64))
    if dtype.kind == "f" and values.size and rng.random() < 0.3:
        values = values.copy()
        values.flat[rng.integers(values.size)] = rng.choice(NUMBERS[4:])
    with np.errstate(invalid="ignore", over="ignore"):
        values = np.abs(values).astype(dtype) if dtype.kind == "u" else values.astype(dtype)
    return values.T if rng.random() < 0.1 else values


def _drawn(node: ast.expr | None, rng: np.random.Generator, things: dict[str, object]) -> object:
    """An argument for an annotation, now and then of the wrong type."""
    text = "" if node is None else ast.unparse(node)
    if rng.random() < 0.05:
        return [None, "text", 3, [1.0], np.zeros(2), (1.0,) * 3, {}][rng.integers(7)]
    if isinstance(node, ast.BinOp):
        return _drawn([node.left, node.right][rng.integers(2)], rng, things)
    if isinstance(node, ast.Subscript):
        return _of_parts(node, rng, things)
    numbers: dict[str, Callable[[], object]] = {
        "float": lambda: float(rng.choice(NUMBERS)),
        "int": lambda: int(rng.integers(-1, 6)),
        "bool": lambda: bool(rng.integers(2)),
        "str": lambda: "absent.png",
        "None": lambda: None,
        "Vector": lambda: tuple(rng.choice(NUMBERS, 3).tolist()),
        "Pose": lambda: tuple(tuple(rng.normal(size=k).tolist()) for k in (3, 4, 3, 3)),
    }
    return numbers[text]() if text in numbers else things.get(text)


def _of_parts(node: ast.Subscript, rng: np.random.Generator, things: dict[str, object]) -> object:
    name = ast.unparse(node.value)
    parts = node.slice.elts if isinstance(node.slice, ast.Tuple) else [node.slice]
    if name == "NDArray":
        return _array(ast.unparse(node.slice).rpartition(".")[2], rng)
    if name == "tuple" and not any(ast.unparse(p) == "..." for p in parts):
        return tuple(_drawn(p, rng, things) for p in parts)
    many = [_drawn(parts[0], rng, things) for _ in range(rng.integers(8))]
    return tuple(many) if name == "tuple" else {} if name == "dict" else many


def _instances() -> dict[str, object]:
    """One of each class, made as the tests of each make it."""
    wall, eye = floor(8e-3), np.eye(4)
    sources = _core.FieldSources()
    sources.add_dipole(eye, 1.0)
    joints = np.array([[0.0, 0.3, 0.5, 0.1, -2.0, 2.0]] * 3)
    arm = _core.ArmChain(joints, eye, np.array([[1, 0, 0, 0, 0, 0, 0.1, 0.05]]), [])
    count, corners = len(wall.vertex_normals()), 2 * 10 * 10
    scene = _core.Scene(
        np.zeros((corners, 3, 2), np.float32),
        np.ones(corners, np.float32),
        np.zeros(corners, np.uint8),
        np.zeros(corners, np.uint16),
        np.zeros(count, np.float32),
        texture=None,
        albedo=(0.5, 0.3, 0.2),
        roughness=0.5,
        reflectance=(0.04,) * 3,
    )
    rays = _core.RayTable(np.ones((2, 2, 3), np.float32) / np.float32(np.sqrt(3.0)))
    world = world_on(floor(8e-3), position=(0.0, 0.0, 5e-3), foundation=WinklerFoundation())
    loaded = _core.ArmWithPayload(arm, arm, eye, eye, (0.07, 0.07), None)
    limits = np.tile([0.0, 1.0, 1.0, 10.0], (3, 1))
    box, along = ((-1.0,) * 3, (1.0,) * 3), (0.0, 0.0, 1.0)
    lit, cosine = np.ones((2, 2), bool), np.ones((2, 2), np.float32)
    spheres = SimpleNamespace(
        centers=np.full((2, 3), 5e-3),
        radius=np.full(2, 1e-3),
        kind=np.ones(2, np.uint8),
        instance=np.ones(2, np.uint16),
        color=np.ones((2, 3)),
        arc_length=np.zeros(2),
    )
    rates = dict.fromkeys(("burst_rate", "landing_rate", "release_rate", "drift"), 0.0)
    liquid = dict.fromkeys(("liquid_density", "viscosity", "chyme_density", "reach"), 1.0)
    laws = SimpleNamespace(**rates, **liquid, seed=0)
    tangents = np.tile([1.0, 0.0, 0.0], (3, 1))
    layer = FemWall(straight_tube(20e-3, 80e-3, 10e-3), FemDeformation(edge=20e-3, fix_ends=True))
    return {
        "Wall": wall,
        "World": world,
        "FieldSources": sources,
        "ArmChain": arm,
        "ArmWithPayload": loaded,
        "RobotActuator": _core.RobotActuator(loaded, limits, box, along, (0.1, 1.0)),
        "Scene": scene,
        "RayTable": rays,
        "Radiosity": _core.Radiosity(wall, scene),
        "CameraPipeline": _core.CameraPipeline(rays, lit, cosine, {}),
        "Particles": _core.Particles(wall, spheres, laws, tangents, 0.1),
        "FemLayer": layer._core,
        "WallPoints": _core.WallPoints(
            np.zeros((2, 3), "u4"), np.zeros((2, 2), "f4"), np.ones((2, 2)), np.zeros(2, "u4")
        ),
        "DirectionTable": _core.DirectionTable(np.ones((4, 4), np.float32)),
    }


def _functions(things: dict[str, object]) -> Iterator[tuple[str, Callable, ast.FunctionDef]]:
    for node in STUBS.body:
        if isinstance(node, ast.FunctionDef):
            yield node.name, getattr(_core, node.name), node
        if isinstance(node, ast.ClassDef) and not node.name.startswith("_"):
            for child in node.body:
                if not isinstance(child, ast.FunctionDef) or child.decorator_list:
                    continue
                is_new = child.name == "__init__"
                owner = getattr(_core, node.name) if is_new else things.get(node.name)
                if owner is not None:
                    called = owner if is_new else getattr(owner, child.name)
                    yield f"{node.name}.{child.name}", called, child


def _arguments(
    node: ast.FunctionDef, rng: np.random.Generator, things: dict[str, object]
) -> tuple[list[object], dict[str, object]]:
    given = [*node.args.posonlyargs, *node.args.args]
    plain = [_drawn(a.annotation, rng, things) for a in given if a.arg != "self"]
    return plain, {a.arg: _drawn(a.annotation, rng, things) for a in node.args.kwonlyargs}


def _call(called: Callable, plain: list[object], named: dict[str, object]) -> str | None:
    """Message with which a call panics; None if it does not."""
    try:
        called(*plain, **named)
    except Exception:
        return None
    except BaseException as error:
        return str(error)
    return None


@pytest.fixture(scope="module")
def things() -> dict[str, object]:
    return _instances()


def _panics(things: dict[str, object], seed: int) -> dict[str, str]:
    """Functions that panic, with the message of the first panic."""
    found: dict[str, str] = {}
    for name, called, node in _functions(things):
        rng = np.random.default_rng([seed, *name.encode()])
        for _ in range(FEW.get(name, CALLS)):
            plain, named = _arguments(node, rng, things)
            if (error := _call(called, plain, named)) is not None:
                found.setdefault(name, error)
    return found


@pytest.mark.slow
def test_no_call_panics(things: dict[str, object]) -> None:
    """From two threads that share all objects."""
    with ThreadPoolExecutor(2) as pool:
        for found in pool.map(lambda seed: _panics(things, seed), (0, 1)):
            assert not found, "\n".join(f"{name}: {error}" for name, error in found.items())


def test_a_wall_shared_by_threads_is_an_error() -> None:
    """While one thread steps a world, its wall cannot be read or moved by another."""
    wall = floor(4e-3)
    worlds = [
        world_on(wall, position=(0.0, 0.0, 5e-3), foundation=WinklerFoundation()) for _ in range(2)
    ]

    def step(world: _core.World) -> str | None:
        try:
            for _ in range(20):
                world.step(5e-5, 100, (0.0,) * 6, (0.0, 0.0, -9.81))
        except RuntimeError as error:
            return str(error)
        return None

    with ThreadPoolExecutor(2) as pool:
        told = [error for error in pool.map(step, worlds) if error is not None]
    assert len(told) == 1
    assert "Each world needs a wall" in told[0]


def test_a_tree_deeper_than_the_stack_is_refused() -> None:
    """Triangles within each other, each a little smaller than the one before."""
    size = 1.03 ** -np.arange(2000.0)
    corners = size[:, None, None] * np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.1], [0.0, 1.0, -0.1]])
    with pytest.raises(ValueError, match=r"levels deep\. Allowed: 32"):
        _core.Wall(corners.reshape(-1, 3), np.arange(6000).reshape(-1, 3))
