"""Organ files of an episode: the wall at rest, and a source organ that was given in memory.

The wall is a file in the episode's folder, or one of its data set that episodes share.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from vrcaps.core.errors import InputError
from vrcaps.core.files import file_sha256, scratch_folder
from vrcaps.core.transforms import transform_points
from vrcaps.mesh.mesh import Mesh
from vrcaps.mesh.read_mesh import read_mesh
from vrcaps.organ.organ_file import write_organ
from vrcaps.organ.surface import OrganSurface
from vrcaps.recording.layout import (
    EPISODE_JSON,
    ORGAN_GLB,
    EpisodeFiles,
    file_here,
    organ_name,
)
from vrcaps.scenario.scenario import SOURCE_ORGAN, OrganFile, Scenario


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


def with_stored_organ(scenario: Scenario, out: Path) -> Scenario:
    """Replace an in-memory organ of a scenario by the organ file in an episode's folder.

    Args:
        scenario: Scenario to record.
        out: Folder of the episode: empty, or an episode of the same organ.

    Raises:
        InputError: If the folder holds an episode of another organ.
    """
    if not isinstance(scenario.organ, OrganSurface):
        return scenario
    path = out / SOURCE_ORGAN
    if not (out / EPISODE_JSON).exists():
        write_organ(path, scenario.organ)
        return replace(scenario, organ=OrganFile(str(path)))
    with scratch_folder() as folder:
        written = folder / SOURCE_ORGAN
        write_organ(written, scenario.organ)
        if not path.exists() or file_sha256(written) != file_sha256(path):
            raise InputError(f"{out} contains an episode of another organ. Give an empty folder.")
    return replace(scenario, organ=OrganFile(str(path)))
