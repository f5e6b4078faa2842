"""Stored wall of each frame: positions of the vertices of `organ.glb`."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from vrcaps.core.files import decode_array
from vrcaps.organ.write_organ import split_at_seams

if TYPE_CHECKING:
    from jaxtyping import Float32

    from vrcaps.organ.surface import OrganSurface
    from vrcaps.world.model import Model, State

_DTYPE = "float32"


def wall_path(frame: int) -> str:
    """Path of a frame's wall in its episode."""
    return f"wall/{frame:06d}.npy"


def wall_to_plain(organ: OrganSurface) -> dict[str, Any]:
    """Storage format of walls, as in `episode.json`."""
    return {
        "meaning": "vertices of organ.glb in the world frame, in the order of the file",
        "path": "wall/{frame:06d}.npy",
        "dtype": _DTYPE,
        "unit": "m",
        "num_vertices": len(file_vertices(organ)),
    }


def file_vertices(organ: OrganSurface) -> np.ndarray:
    """Organ vertex index of each vertex of `organ.glb`, where texture seams are cut."""
    return split_at_seams(organ.faces, organ.uv)[0]


def stored_wall(model: Model, state: State, vertices: np.ndarray) -> Float32[np.ndarray, "k 3"]:
    """Wall of a state in stored form [m].

    Args:
        model: Model with the organ.
        state: State of the world.
        vertices: Result of `file_vertices`.
    """
    here = model.vertices_world if state.vertices_world is None else state.vertices_world
    return np.ascontiguousarray(here[vertices], _DTYPE)


def decode_wall(data: bytes) -> Float32[np.ndarray, "k 3"]:
    """Decode a stored wall from the bytes of its file.

    Raises:
        ValueError: If it is not such a file.
    """
    return decode_array(data)
