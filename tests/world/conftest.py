"""A bent tube whose centreline and radius are known in closed form."""

import sys
from pathlib import Path

import numpy as np
import pytest

from vrcaps.capsule.catalog import load_device
from vrcaps.organ.centerline.curve import transport_frames
from vrcaps.organ.surface import Centerline, OrganSurface, vertex_normals
from vrcaps.world.model import Model

sys.path.insert(0, str(Path(__file__).parent))  # the support modules beside the tests
sys.path.insert(0, str(Path(__file__).parents[1] / "tissue"))  # straight guts

TUBE_RADIUS = 0.018
BEND_RADIUS = 0.045


def _course(num: int) -> np.ndarray:
    """Straight 0.1 m, half a turn of `BEND_RADIUS`, straight back, lifted like a helix."""
    arc = np.pi * BEND_RADIUS
    s = np.linspace(0.0, 0.2 + arc, num)
    turn = np.clip((s - 0.1) / BEND_RADIUS, 0.0, np.pi)
    x = np.minimum(s, 0.1) + BEND_RADIUS * np.sin(turn) - np.maximum(s - 0.1 - arc, 0.0)
    y = BEND_RADIUS * (1.0 - np.cos(turn))
    return np.stack([x, y, 0.02 * np.sin(s / 0.05)], axis=1)


def make_tube(radius: float = TUBE_RADIUS, around: int = 40, along: int = 300) -> OrganSurface:
    """A closed tube around `_course`; faces are counter-clockwise seen from inside."""
    points = _course(along)
    tangents = np.gradient(points, axis=0)
    tangents /= np.linalg.norm(tangents, axis=1, keepdims=True)
    arc_length = np.append(0.0, np.cumsum(np.linalg.norm(np.diff(points, axis=0), axis=1)))
    clear = np.minimum(radius, np.minimum(arc_length, arc_length[-1] - arc_length))
    line = Centerline(points, arc_length, clear, transport_frames(points, tangents))
    angle = np.linspace(0.0, 2.0 * np.pi, around, endpoint=False)
    ring = np.cos(angle)[:, None] * line.frames[:, None, :, 0]
    ring = ring + np.sin(angle)[:, None] * line.frames[:, None, :, 1]
    vertices = (line.points[:, None] + radius * ring).reshape(-1, 3)
    i, j = np.meshgrid(np.arange(len(line.points) - 1), np.arange(around), indexing="ij")
    k = (j + 1) % around
    a, b, c, d = (r * around + q for r, q in ((i, j), (i, k), (i + 1, k), (i + 1, j)))
    faces = np.concatenate([np.stack([a, c, b], -1), np.stack([a, d, c], -1)]).reshape(-1, 3)
    last = len(vertices)
    vertices = np.concatenate([vertices, line.points[[0, -1]]])
    j, k = np.arange(around), (np.arange(around) + 1) % around
    end = last - around
    faces = np.concatenate(
        [
            faces,
            np.stack([np.full(around, last), j, k], -1),
            np.stack([np.full(around, last + 1), end + k, end + j], -1),
        ]
    )
    arc_length = np.concatenate([np.repeat(line.arc_length, around), line.arc_length[[0, -1]]])
    return OrganSurface(
        name="tube",
        vertices=vertices,
        faces=faces,
        normals=vertex_normals(vertices, faces),
        uv=np.zeros((len(faces), 3, 2)),
        label=np.where(arc_length < 0.15, 1, 2).astype(np.uint8),
        label_names=("background", "first", "second"),
        instance=np.zeros(len(vertices), np.uint16),
        arc_length=arc_length,
        theta=np.zeros(len(vertices)),
        radius=np.full(len(vertices), radius),
        centerline=line,
    )


@pytest.fixture(scope="session")
def tube() -> OrganSurface:
    return make_tube()


@pytest.fixture(scope="session")
def model(tube: OrganSurface) -> Model:
    return Model(tube, load_device("mirocam"))


@pytest.fixture
def rng() -> np.random.Generator:
    return np.random.default_rng(7)
