"""Ledger of a data set: which units are whole, with the checksum of every file of theirs.

A unit counts as there when its entry is written, which happens last. So readers never see a part.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from vrcaps.data.about import ABOUT, about_recording
from vrcaps.data.store import Store
from vrcaps.data.units import Unit
from vrcaps.errors import InputError
from vrcaps.files import file_sha256, files_in

PLAN = "plan.json"
EPISODES = "episodes"
LEDGER = "ledger"
FAILED = "failed"


def entry_of(unit: Unit, folder: Path) -> dict[str, Any]:
    """Entry of a unit whose files lie in a folder."""
    paths = files_in(folder)
    return {
        "number": unit.number,
        "patient": unit.patient,
        "split": unit.split,
        "files": {path.relative_to(folder).as_posix(): file_sha256(path) for path in paths},
        "bytes": sum(path.stat().st_size for path in paths),
        ABOUT: about_recording(folder),
    }


def enter(store: Store, unit: Unit, entry: dict[str, Any]) -> None:
    """Make a unit count; an earlier failure of it is forgotten by readers."""
    store.write(f"{LEDGER}/{unit.name}.json", _json(entry))


def enter_failure(store: Store, name: str, number: int, message: str, command: str) -> None:
    """Note why a unit could not be made, with the command that shows it again.

    Args:
        store: Of the data set.
        name: Of the unit.
        number: Of the unit.
        message: What went wrong.
        command: What makes the unit again.
    """
    failure = {"number": number, "error": message, "reproduce": command}
    store.write(f"{FAILED}/{name}.json", _json(failure))


def entries(store: Store) -> dict[str, dict[str, Any]]:
    """All whole units by name.

    Raises:
        InputError: If an entry is damaged.
    """
    return {name: read_entry(store, name) for name in whole_units(store)}


def whole_units(store: Store) -> list[str]:
    """Names of the units that are whole."""
    return [name.removesuffix(".json") for name in store.names(LEDGER)]


def failures(store: Store) -> dict[str, dict[str, Any]]:
    """Units that could not be made and were not made since."""
    whole = set(whole_units(store))
    names = [name.removesuffix(".json") for name in store.names(FAILED)]
    return {
        name: json.loads(store.read(f"{FAILED}/{name}.json")) for name in names if name not in whole
    }


def read_entry(store: Store, name: str) -> dict[str, Any]:
    """Entry of one unit.

    Raises:
        InputError: If it is damaged.
    """
    where = f"{LEDGER}/{name}.json"
    try:
        return json.loads(store.read(where))
    except ValueError as error:
        raise InputError(
            f"{store.url}/{where} is damaged ({error}). Delete it and make the data "
            "set again: the unit is made anew."
        ) from error


def read_plain_plan(store: Store) -> dict[str, Any]:
    """The plan of a data set, as `plan_to_plain` made it.

    Raises:
        InputError: If the store holds no data set.
    """
    try:
        return json.loads(store.read(PLAN))
    except (OSError, ValueError) as error:
        raise InputError(
            f"{store.url} holds no data set ({error}). Give the --out of `vrcaps dataset make`."
        ) from error


def require_same_plan(store: Store, plan: dict[str, Any]) -> None:
    """Make a store the data set of a plan, or check that it is.

    Raises:
        InputError: If it holds the data set of another plan.
    """
    try:
        before = json.loads(store.read(PLAN))
    except FileNotFoundError:
        store.write(PLAN, _json(plan))
        return
    if before != json.loads(_json(plan)):
        differs = next((key for key in plan if before.get(key) != plan[key]), "a key")
        raise InputError(
            f"{store.url} holds a data set of another plan (its {differs} differs). Give another "
            "--out, or the plan it was made with."
        )


def _json(value: Any) -> bytes:
    return (json.dumps(value, indent=1, ensure_ascii=False, default=str) + "\n").encode()
