"""Organs of a data set: each is stored once, regardless of the number of its recordings.

The file name is derived from all properties of the organ, so equal organs share one file,
whichever worker was first. It is in the patient frame: recordings in other postures share it.
"""

from __future__ import annotations

import hashlib
import json
import re
from dataclasses import dataclass
from pathlib import Path, PurePosixPath
from typing import Annotated, Any

from vrcaps.config.convert import from_plain
from vrcaps.config.fields import Range, check_fields
from vrcaps.config.plain_files import decode_json
from vrcaps.core.errors import InputError, require
from vrcaps.data.store import Store
from vrcaps.organ.organ_file import organ_glb
from vrcaps.organ.surface import OrganSurface, organ_sha256
from vrcaps.recording.layout import SHARED_ORGANS, LocalFiles, read_head

_ORGAN_FILE = re.compile(rf"{SHARED_ORGANS}/[0-9a-f]{{64}}\.glb")


@dataclass(frozen=True)
class StoredOrgan:
    """Entry of an organ that recordings of a data set share.

    Attributes:
        path: Name of its file in the data set.
        sha256: Checksum of the file.
        bytes: Size of the file.
    """

    path: str
    sha256: str
    bytes: Annotated[int, Range(0)]

    def __post_init__(self) -> None:
        check_fields(self)
        is_organ = bool(_ORGAN_FILE.fullmatch(self.path))
        require(is_organ, "path", repr(self.path), f"{SHARED_ORGANS}/ and the name of an organ")


def store_organ(store: Store, organ: OrganSurface) -> str:
    """Store an organ if it does not exist yet.

    Returns:
        The path of its file, relative to an episode of the data set.
    """
    name = f"{SHARED_ORGANS}/{organ_sha256(organ)}.glb"
    if _read_entry(store, name) is None:
        data = b"".join(organ_glb(organ, compact=True))
        entry = {"path": name, "sha256": hashlib.sha256(data).hexdigest(), "bytes": len(data)}
        store.write(name, data)
        # Written last: if it exists, the organ is complete.
        store.write(_entry_name(name), (json.dumps(entry) + "\n").encode())
    return f"../../{name}"


def organ_entry(store: Store, episode: Path) -> dict[str, Any] | None:
    """Path in the data set, checksum and size of the organ that an episode names."""
    file = PurePosixPath(read_head(LocalFiles(episode))["organ"]["path"]).name
    return _read_entry(store, f"{SHARED_ORGANS}/{file}")


def _entry_name(name: str) -> str:
    return name.removesuffix(".glb") + ".json"


def _read_entry(store: Store, name: str) -> dict[str, Any] | None:
    """Entry of a stored organ; None if it is missing or damaged."""
    where = _entry_name(name)
    try:
        plain = decode_json(store.read(where), where)
        from_plain(StoredOrgan, plain, at=where)
    except (FileNotFoundError, InputError):
        return None
    return plain
