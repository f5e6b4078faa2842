"""Scans of known organs that the tests of CT share."""

import numpy as np
import pytest
import trimesh

from tests.support.coarse_organs import coarse_looks
from tests.support.phantom import Polyp, Scanner, scan_of, with_polyps
from vrcaps.mesh.mesh import Mesh
from vrcaps.tools.ct.volume import Volume

__all__ = ["coarse_looks"]

RADIUS, LENGTH = 0.017, 0.07


def capsule(radius: float = RADIUS, length: float = LENGTH) -> Mesh:
    """A closed tube, normals into the lumen, away from the origin."""
    judge = trimesh.creation.capsule(length, radius, count=[40, 40])
    place = np.array([0.1, -0.2, -0.3])
    return Mesh(np.array(judge.vertices) + place, np.array(judge.faces)[:, ::-1])


@pytest.fixture(scope="session")
def tube() -> tuple[Mesh, list[Polyp]]:
    """A tube with three polyps."""
    return with_polyps(capsule(), (6e-3, 8e-3, 10e-3), np.random.default_rng(3), apart=0.02)


@pytest.fixture(scope="session")
def dry_scan(tube: tuple[Mesh, list[Polyp]]) -> Volume:
    return scan_of(tube[0], Scanner(), np.random.default_rng(0))


@pytest.fixture(scope="session")
def wet_scan(tube: tuple[Mesh, list[Polyp]]) -> Volume:
    """The same with tagged fluid in it."""
    return scan_of(tube[0], Scanner(fluid_depth=0.012), np.random.default_rng(1))
