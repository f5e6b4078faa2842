"""The surface of a clump in plain NumPy, double precision: see `rust/src/lumen/clump.rs`."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

REACH, BUMP = 1.5, 0.28
WAVES = np.array([[0.94, 0.47, -0.46], [-0.44, 1.08, 0.41], [0.39, -0.41, 1.29]])


def _mix(h: np.ndarray) -> np.ndarray:
    h = h ^ (h >> np.uint32(16))
    h = h * np.uint32(0x7FEB352D)
    h = h ^ (h >> np.uint32(15))
    h = h * np.uint32(0x846CA68B)
    return h ^ (h >> np.uint32(16))


def _uniform(seed: int, a: np.ndarray, b: np.ndarray) -> np.ndarray:
    inner = _mix(a ^ _mix(b + np.uint32(0x9E3779B9)))
    return (_mix(np.uint32(seed) ^ inner) >> np.uint32(8)) / 2.0**24


def _wave(x: np.ndarray) -> np.ndarray:
    u = x - np.round(x)
    return 8.0 * u * (1.0 - 2.0 * np.abs(u))


@dataclass(frozen=True)
class ClumpTwin:
    """Particles of one clump, numbered 0, 1, 2, …: centers [n 3] and radii [n] in meters."""

    centers: np.ndarray
    radius: np.ndarray

    def value(self, points: np.ndarray) -> np.ndarray:
        """The field less 1 at points [k 3]: above 0 inside, 0 on the surface."""
        number = np.arange(len(self.radius), dtype=np.uint32)[:, None]
        phases = _uniform(0x570011, number, np.arange(3, dtype=np.uint32))
        offset = (points[:, None] - self.centers) / (REACH * self.radius)[:, None]
        inside = np.maximum(1.0 - (offset**2).sum(-1), 0.0)
        bumps = _wave(offset @ WAVES.T + phases).mean(-1)
        fields = inside / (1.0 - REACH**-2) * (1.0 + BUMP * bumps)
        return np.sqrt((fields**2).sum(-1)) - 1.0

    def normal(self, points: np.ndarray, step: float = 1e-8) -> np.ndarray:
        """Unit normals at points of the surface [k 3], by central differences."""
        ways = step * np.eye(3)
        rise = [self.value(points + way) - self.value(points - way) for way in ways]
        return -np.stack(rise, -1) / np.linalg.norm(rise, axis=0)[:, None]

    def first_hit(self, rays: np.ndarray, until: float, steps: int = 400) -> np.ndarray:
        """Distances [k] at which unit rays from the origin enter; infinity where they do not."""
        near = np.linalg.norm(np.cross(rays[:, None], self.centers), axis=-1) < REACH * self.radius
        found = np.full(len(rays), np.inf)
        start = np.linalg.norm(self.centers, axis=-1).min() - REACH * self.radius.max()
        ways = np.linspace(start, until, steps)
        some = np.flatnonzero(near.any(axis=1))
        inside = np.stack([self.value(ways[:, None] * ray) >= 0.0 for ray in rays[some]])
        some, first = some[inside.any(axis=1)], inside.argmax(axis=1)[inside.any(axis=1)]
        low, high = ways[first - 1], ways[first]
        for _ in range(30):
            middle = 0.5 * (low + high)
            is_in = self.value(middle[:, None] * rays[some]) >= 0.0
            low, high = np.where(is_in, low, middle), np.where(is_in, middle, high)
        found[some] = high
        return found
