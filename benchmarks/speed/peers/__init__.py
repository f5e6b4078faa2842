"""Other renderers, run from their own packages on the same wall, views and lights.

Each module has ``subjects(stage) -> list[Subject]`` and raises `PeerMissingError` if its
package is not installed or does not work on this machine.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from importlib import import_module
from importlib.metadata import PackageNotFoundError, version
from typing import TYPE_CHECKING, Any

import numpy as np

from vrcaps.cli.benchmarks.report import Subject
from vrcaps.cli.benchmarks.stage import Stage
from vrcaps.core.geometry import transform_points
from vrcaps.mesh.mesh import vertex_normals

if TYPE_CHECKING:
    from jaxtyping import Float, Int

PACKAGES = {"embree": "embreex", "mitsuba": "mitsuba", "mujoco": "mujoco"}
"""Package on the index of each peer's module here."""


class PeerMissingError(Exception):
    """A peer that cannot be measured here; its text states the reason and the remedy."""


@dataclass(frozen=True)
class WeldedMesh:
    """A wall with one texture coordinate a vertex: vertices on seams are doubled.

    Attributes:
        vertices: Positions in the world [m].
        normals: Unit normals, into the lumen.
        uv: Texture coordinates.
        faces: Vertex numbers of each triangle.
    """

    vertices: Float[np.ndarray, "n 3"]
    normals: Float[np.ndarray, "n 3"]
    uv: Float[np.ndarray, "n 2"]
    faces: Int[np.ndarray, "m 3"]


def welded_mesh(stage: Stage) -> WeldedMesh:
    """Wall for renderers without texture coordinates of face corners."""
    organ, places = stage.model.organ, stage.model.vertices_world
    corners = np.column_stack([organ.faces.reshape(-1), organ.uv.reshape(-1, 2)])
    unique, number = np.unique(corners, axis=0, return_inverse=True)
    vertex = unique[:, 0].astype(int)
    normals = vertex_normals(places, organ.faces)
    return WeldedMesh(places[vertex], normals[vertex], unique[:, 1:], number.reshape(-1, 3))


def led_positions(stage: Stage) -> Float[np.ndarray, "views leds 3"]:
    """Positions of the first camera's LEDs in the world in each view [m]."""
    places = np.array([led.position_camera for led in stage.camera.leds])
    return np.stack([transform_points(T, places) for T in stage.Ts_world_camera()])


def load_package(name: str) -> Any:
    """Import a peer's package.

    Raises:
        PeerMissingError: If it is not installed or cannot be loaded.
    """
    try:
        return import_module(name)
    except ImportError as error:
        raise PeerMissingError(
            f"{name} cannot be imported ({error}); pip install 'vrcaps[dev]'"
        ) from error


def find_peers(
    stage: Stage, names: Sequence[str] = tuple(PACKAGES)
) -> tuple[list[Subject], dict[str, str]]:
    """Subjects of the peers that work here, and the reasons why others are left out."""
    found: list[Subject] = []
    skipped: dict[str, str] = {}
    for name in names:
        module = import_module(f"{__name__}.{name}")
        try:
            found += module.subjects(stage)
        except PeerMissingError as error:
            skipped[name] = str(error)
    return found, skipped


def package_versions() -> dict[str, str]:
    """Versions of the peers' packages that are installed."""
    versions = {}
    for package in PACKAGES.values():
        try:
            versions[package] = version(package)
        except PackageNotFoundError:
            continue
    return versions
