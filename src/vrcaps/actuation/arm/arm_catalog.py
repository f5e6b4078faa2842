"""Catalog of robot arms, one TOML file each in `arms/`, and a user's own files."""

from __future__ import annotations

from pathlib import Path

from vrcaps.actuation.arm.arm import Arm
from vrcaps.catalog_folder import CatalogFolder
from vrcaps.errors import InputError
from vrcaps.plain_files import read_plain
from vrcaps.serialization import from_plain

_ARMS = CatalogFolder(Path(__file__).parent / "arms", "arm")


def arm_names() -> tuple[str, ...]:
    """Names of the catalog's arms, sorted."""
    return _ARMS.names()


def read_arm(name_or_path: str | Path) -> Arm:
    """An arm of the catalog by its name, or a user's own by the path of its TOML file.

    The file has the fields of `Arm` in the units of their keys (see `arms/panda.toml`); the arm is
    named as the file.

    Raises:
        UnknownNameError: If the catalog has no arm of that name.
        InputError: If there is no such file, it is no TOML, lacks a key, has an unknown key or a
            wrong value, or describes no possible arm.
    """
    path = _ARMS.find(name_or_path)
    plain = read_plain(path, "arm")
    if "name" in plain:
        raise InputError(f"Unknown key {path.name}: name. The arm is named as its file.")
    return from_plain(Arm, {"name": path.stem, **plain}, at=f"{path.name}:", units=True)
