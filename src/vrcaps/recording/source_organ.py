"""An organ in memory becomes a file of its episode, so that the recording can be repeated."""

from __future__ import annotations

import os
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory

from vrcaps.errors import InputError
from vrcaps.files import file_sha256
from vrcaps.organ.surface import OrganSurface
from vrcaps.organ.write_organ import write_organ
from vrcaps.scenario.scenario import SOURCE_ORGAN, OrganFile, Scenario


def with_stored_organ(scenario: Scenario, out: Path) -> Scenario:
    """The scenario with an organ in memory replaced by the organ file in an episode's folder.

    Args:
        scenario: What to record.
        out: Folder of the episode: new, empty, or an episode of the same organ.

    Raises:
        InputError: If the folder holds anything else.
    """
    if not isinstance(scenario.organ, OrganSurface):
        return scenario
    path = out / SOURCE_ORGAN
    if not path.exists() and out.exists() and (not out.is_dir() or any(out.iterdir())):
        raise InputError(f"{out} holds something else. Give a new or empty folder.")
    out.parent.mkdir(parents=True, exist_ok=True)
    with TemporaryDirectory(dir=out.parent, prefix=f".{out.name}.") as folder:
        written = Path(folder) / SOURCE_ORGAN
        write_organ(written, scenario.organ)
        if not path.exists():
            out.mkdir(exist_ok=True)
            os.replace(written, path)
        elif file_sha256(written) != file_sha256(path):
            raise InputError(f"{out} holds an episode of another organ. Give an empty folder.")
    return replace(scenario, organ=OrganFile(str(path)))
