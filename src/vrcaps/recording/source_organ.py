"""Storage of an in-memory organ in its episode, so that the recording can be repeated."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

from vrcaps.core.errors import InputError
from vrcaps.core.files import file_sha256
from vrcaps.core.temporary_files import scratch_folder
from vrcaps.organ.surface import OrganSurface
from vrcaps.organ.write_organ import write_organ
from vrcaps.recording.layout import EPISODE_JSON
from vrcaps.scenario.scenario import SOURCE_ORGAN, OrganFile, Scenario


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
            raise InputError(f"{out} holds an episode of another organ. Give an empty folder.")
    return replace(scenario, organ=OrganFile(str(path)))
