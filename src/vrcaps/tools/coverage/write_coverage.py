"""Coverage files: a table over time, and the organ with the coverage of each vertex."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from vrcaps.core.files import write_bytes
from vrcaps.metrics.coverage import COVERAGE_LEVELS
from vrcaps.recording.table import FrameTable, write_table
from vrcaps.tools.coverage.episode_coverage import EpisodeCoverage

if TYPE_CHECKING:
    from jaxtyping import Int

SEEN_COLOR, UNSEEN_COLOR = (64, 176, 80), (200, 48, 48)
"""sRGB colors of seen and unseen wall, as in VR-Caps."""


def write_coverage_table(path: Path, found: EpisodeCoverage) -> None:
    """Write the fraction seen up to each frame, one column per level (Parquet).

    Args:
        path: File to write or replace.
        found: Coverage of an episode.
    """
    columns: dict[str, np.ndarray] = {
        "frame": np.arange(len(found.times)),
        "time_s": np.asarray(found.times),
    }
    columns |= {level: found.over_time(level) for level in COVERAGE_LEVELS}
    write_table(path, FrameTable(columns))


def write_coverage_mesh(path: Path, found: EpisodeCoverage) -> None:
    """Write the organ with vertex colors and the vertex attributes `_COVERAGE` and `_FIRST_SEEN_S`.

    `_COVERAGE` is 0 for an unseen vertex, 1 visible, 2 resolved, 3 readable: the best level of its
    triangles. `_FIRST_SEEN_S` is the time at which it was first visible [s]; −1: never.

    Args:
        path: GLB file to write or replace.
        found: Coverage of an episode.
    """
    import trimesh

    organ, first = found.organ, found.coverage.first_seen["visible"]
    level = vertex_level(found)
    seen = first >= 0
    time = np.full(len(organ.vertices), np.inf)
    times = np.repeat(np.asarray(found.times)[first[seen]], 3)
    np.minimum.at(time, organ.faces[seen].ravel(), times)
    colors = np.where(level[:, None] > 0, SEEN_COLOR, UNSEEN_COLOR).astype(np.uint8)
    mesh = trimesh.Trimesh(organ.vertices, organ.faces, vertex_colors=colors, process=False)
    mesh.vertex_attributes["_COVERAGE"] = level.astype(np.float32)
    mesh.vertex_attributes["_FIRST_SEEN_S"] = np.where(np.isfinite(time), time, -1.0).astype(
        np.float32
    )
    data = mesh.export(file_type="glb")
    assert isinstance(data, bytes)
    write_bytes(path, data)


def vertex_level(found: EpisodeCoverage) -> Int[np.ndarray, " n"]:
    """Best level of each vertex's triangles: 0 unseen, 1 visible, 2 resolved, 3 readable."""
    level = np.zeros(len(found.organ.vertices), np.int32)
    for number, name in enumerate(COVERAGE_LEVELS[1:], start=1):
        level[found.organ.faces[found.coverage.seen(name)].ravel()] = number
    return level
