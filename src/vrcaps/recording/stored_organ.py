"""Organ of an episode: a file in its folder, or one of its data set that episodes share."""

from __future__ import annotations

import re
from dataclasses import replace
from typing import Any

import numpy as np

from vrcaps.core.errors import InputError
from vrcaps.core.transforms import transform_points
from vrcaps.mesh.mesh import Mesh
from vrcaps.mesh.read_mesh import read_mesh
from vrcaps.recording.episode_files import EpisodeFiles, file_here
from vrcaps.recording.layout import ORGAN_GLB, SHARED_ORGANS

_SHARED = re.compile(rf"\.\./\.\./{SHARED_ORGANS}/[0-9a-f]{{64}}\.glb")


def organ_name(head: dict[str, Any]) -> str:
    """Path of the organ's file, relative to the episode with this `episode.json`."""
    return head["organ"].get("path", ORGAN_GLB)


def require_organ_name(head: dict[str, Any], where: str) -> None:
    """Check that the organ is the episode's own file or one of its data set.

    Raises:
        InputError: If it is not.
    """
    name = organ_name(head)
    if name != ORGAN_GLB and not (isinstance(name, str) and _SHARED.fullmatch(name)):
        raise InputError(
            f"{where}: organ.path is {name!r}. Allowed: {ORGAN_GLB!r}, or "
            f"'../../{SHARED_ORGANS}/' and the name of an organ there."
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
            f"{files.url} is of a data set, which keeps its organ at {name} relative to the "
            "episode, and that file is missing. Copy it along, to the same relative place."
        ) from error
    T_world_patient = np.array(head["T_world_patient"])
    return replace(mesh, vertices=transform_points(T_world_patient, mesh.vertices))
