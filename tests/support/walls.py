"""Walls of simple shape, and capsules on them, for tests of the physics."""

from __future__ import annotations

import numpy as np

from vrcaps import _core
from vrcaps.capsule.device import Body
from vrcaps.core.units import MM
from vrcaps.tissue.tissue import Drag, SpringWall, WinklerFoundation

RADIUS = 5.5 * MM
HALF_AXIS = 7.5 * MM
LYING = (np.sqrt(0.5), np.sqrt(0.5), 0.0, 0.0)
LINEAR = WinklerFoundation(youngs_modulus=3e3, stiffening_strain=np.inf, rate_gain=0.0)


def floor(edge: float, size: float = 80.0 * MM, seed: int = 0) -> _core.Wall:
    """A level floor at z = 0 with normals up, of irregular triangles."""
    rng = np.random.default_rng(seed)
    count = int(size / edge) + 1
    line = np.linspace(-size / 2.0, size / 2.0, count)
    points = np.stack([*np.meshgrid(line, line, indexing="ij"), np.zeros((count, count))], -1)
    inner = points[1:-1, 1:-1, :2]
    inner += rng.uniform(-0.25, 0.25, inner.shape) * edge
    return _core.Wall(points.reshape(-1, 3), _grid_faces(np.arange(count**2).reshape(count, count)))


def tube(radius: float, length: float, edge: float) -> _core.Wall:
    """A straight tube about z, open at both ends, with normals inwards."""
    around, rings = int(np.ceil(2.0 * np.pi * radius / edge)), int(length / edge) + 1
    angle, z = np.meshgrid(2.0 * np.pi * np.arange(around) / around, np.linspace(0, length, rings))
    points = np.stack([radius * np.cos(angle), radius * np.sin(angle), z], -1)
    number = np.arange(rings * around).reshape(rings, around)
    return _core.Wall(points.reshape(-1, 3), _grid_faces(np.column_stack([number, number[:, 0]])))


def creased(radius: float, crest: float, rings: int = 25, around: int = 40) -> _core.Wall:
    """A closed room, round about z, with a sharp fold of height `crest` at every fourth ring."""
    polar = np.pi * np.arange(1, rings) / rings
    reach = radius - np.where(np.arange(1, rings) % 4 == 0, crest, 0.0)
    angle, polar = np.meshgrid(2.0 * np.pi * np.arange(around) / around, polar)
    ring = reach[:, None] * np.sin(polar)
    points = np.stack([ring * np.cos(angle), ring * np.sin(angle), reach[:, None] * np.cos(polar)])
    poles = [[0.0, 0.0, radius], [0.0, 0.0, -radius]]
    vertices = np.concatenate([points.reshape(3, -1).T, poles])
    number = np.arange((rings - 1) * around).reshape(rings - 1, around)
    closed, last = np.column_stack([number, number[:, 0]]), np.full(around, len(vertices) - 1)
    faces = [
        _grid_faces(closed)[:, ::-1],
        np.stack([last - 1, closed[0, 1:], closed[0, :-1]], -1),
        np.stack([last, closed[-1, :-1], closed[-1, 1:]], -1),
    ]
    return _core.Wall(vertices, np.concatenate(faces))


def _grid_faces(number: np.ndarray) -> np.ndarray:
    a, b, c, d = number[:-1, :-1], number[1:, :-1], number[1:, 1:], number[:-1, 1:]
    faces = [np.stack([a, b, c], -1), np.stack([a, c, d], -1)]
    return np.concatenate([face.reshape(-1, 3) for face in faces])


def capsule(half_axis: float = HALF_AXIS, mass: float = 3e-3) -> Body:
    """A capsule of usual size; a sphere for `half_axis` 0."""
    across, along = 1.5e-7 * mass / 3e-3, 4.5e-8 * mass / 3e-3
    return Body(mass, np.diag([across, across, along]), np.zeros(3), half_axis, RADIUS)


def world_on(
    wall: _core.Wall,
    *,
    position: tuple[float, float, float],
    wxyz: tuple[float, ...] = LYING,
    velocity: tuple[float, float, float] = (0.0, 0.0, 0.0),
    spin: tuple[float, float, float] = (0.0, 0.0, 0.0),
    body: Body | None = None,
    foundation: WinklerFoundation = LINEAR,
    drag: Drag | None = None,
    spring_wall: SpringWall | None = None,
    is_quasi_static: bool = False,
) -> _core.World:
    """A capsule on a wall; `position` is in the wall's own frame."""
    place = tuple(np.subtract(position, wall.center))
    drag = drag or Drag(friction=0.0)
    pose = (place, wxyz, velocity, spin)
    return _core.World(
        wall, body or capsule(), foundation, drag, spring_wall, pose, is_quasi_static
    )
