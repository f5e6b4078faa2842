"""Organ file of an episode: the wall at rest, in its folder or shared by a data set."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from vrcaps.core.errors import InputError
from vrcaps.core.transforms import transform_points
from vrcaps.mesh.mesh import Mesh
from vrcaps.mesh.read_mesh import read_mesh
from vrcaps.recording.layout import (
    ORGAN_GLB,
    EpisodeFiles,
    file_here,
    organ_name,
)


def read_stored_organ(files: EpisodeFiles, head: dict[str, Any]) -> Mesh:
    """Read the wall at rest in the world frame [m].

    A shared file is in the patient frame, because episodes differ in posture.

    Raises:
        InputError: If the file is missing or damaged.
        OSError: If the file cannot be read.
    """
    name = organ_name(head)
    if name == ORGAN_GLB:
        with file_here(files, name) as path:
            return read_mesh(path, unit="m")
    try:
        with file_here(files, name) as path:
            path.stat()
            mesh = read_mesh(path, unit="m")
    except FileNotFoundError as error:
        raise InputError(
            f"{files.url} belongs to a data set whose organ {name}, relative to the episode, is "
            "missing. Copy it to the same relative path."
        ) from error
    T_world_patient = np.array(head["T_world_patient"])
    return replace(mesh, vertices=transform_points(T_world_patient, mesh.vertices))
