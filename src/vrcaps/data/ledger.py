"""Ledger of a data set: its complete units, with the checksum of each of their files.

A unit is complete once its entry is written, as the last step; readers never see an incomplete
unit.
"""

from __future__ import annotations

import hashlib
import json
import math
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Any, Literal

from vrcaps.config.convert import from_plain
from vrcaps.config.plain_files import decode_json
from vrcaps.core.build_info import made_here
from vrcaps.core.errors import InputError, require
from vrcaps.core.fields import Range, check_fields
from vrcaps.core.files import file_sha256, files_in
from vrcaps.core.names import require_name
from vrcaps.data.plan import Plan, plan_to_plain
from vrcaps.data.store import Store, StoredOrgan
from vrcaps.data.units import Unit
from vrcaps.recording.episode import Episode, read_episode
from vrcaps.scenario.scenario import MAX_FRAMES

PLAN = "plan.json"
MADE_WITH = "made_with"
EPISODES = "episodes"
LEDGER = "ledger"
FAILED = "failed"

_MAX_LOOKUPS = 128
"""Maximum number of units looked up one by one; a listing returns a thousand at once."""


@dataclass(frozen=True)
class Entry:
    """Entry of a complete unit, as stored in its file in the ledger.

    Attributes:
        number: Index of the unit.
        patient: Index of the patient.
        split: Split of the patient.
        files: Checksum of each file of the recording, by path.
        bytes: Total size of these files.
        about: Summary of the recording; entries of earlier versions have none.
        organ: Organ that is stored separately, if there is one.
    """

    number: Annotated[int, Range(0)]
    patient: Annotated[int, Range(0)]
    split: Literal["train", "val", "test"]
    files: dict
    bytes: Annotated[int, Range(0)]
    about: dict = field(default_factory=dict)
    organ: StoredOrgan | None = None

    def __post_init__(self) -> None:
        check_fields(self)
        for name, checksum in self.files.items():
            require_name("file", name)
            require(isinstance(checksum, str), f"Checksum of {name}", checksum, "a string")
        if self.about:
            require_about(self.about)


@dataclass(frozen=True)
class Failure:
    """Record of a unit that could not be made.

    Attributes:
        number: Index of the unit.
        error: Error message.
        reproduce: Command that makes the unit again.
    """

    number: int
    error: str
    reproduce: str


def entry_of(unit: Unit, folder: Path) -> dict[str, Any]:
    """Build the entry of a unit from its files in a folder."""
    paths = files_in(folder)
    return {
        "number": unit.index,
        "patient": unit.patient,
        "split": unit.split,
        "files": {path.relative_to(folder).as_posix(): file_sha256(path) for path in paths},
        "bytes": sum(path.stat().st_size for path in paths),
        ABOUT: about_recording(folder),
    }


def enter(store: Store, unit: Unit, entry: dict[str, Any]) -> None:
    """Enter a unit as complete; readers ignore its earlier failures."""
    store.write(f"{LEDGER}/{unit.name}.json", _json(entry))


def enter_failure(store: Store, name: str, index: int, message: str, command: str) -> None:
    """Record the reason of a unit's failure, with the command that reproduces it.

    Args:
        store: Store of the data set.
        name: Name of the unit.
        index: Index of the unit.
        message: Error message.
        command: Command that makes the unit again.
    """
    failure = {"number": index, "error": message, "reproduce": command}
    store.write(f"{FAILED}/{name}.json", _json(failure))


def entries(store: Store) -> dict[str, dict[str, Any]]:
    """Return the entries of all complete units by name.

    Raises:
        InputError: If an entry is damaged.
    """
    return {name: read_entry(store, name) for name in complete_units(store)}


def complete_units(store: Store, asked: Sequence[str] | None = None) -> list[str]:
    """Names of the complete units.

    Args:
        store: Store of the data set.
        asked: Names of the units to return; None returns all. A few are looked up one by one, so
            that the slices of a large data set do not each list all of it.
    """
    if asked is not None and len(asked) <= _MAX_LOOKUPS:
        return [name for name in asked if is_complete(store, name)]
    return [name.removesuffix(".json") for name in store.names(LEDGER)]


def is_complete(store: Store, name: str) -> bool:
    """Return whether a unit is complete."""
    return store.has(f"{LEDGER}/{name}.json")


def forget_failure(store: Store, name: str) -> None:
    """Remove the failure record of a unit that has been made since."""
    store.remove(f"{FAILED}/{name}.json")


def failures(store: Store) -> dict[str, dict[str, Any]]:
    """Return the failure records of units that have not been made since."""
    names = [name.removesuffix(".json") for name in store.names(FAILED)]
    complete = set(complete_units(store, names))
    return {
        name: _checked(store, f"{FAILED}/{name}.json", Failure)
        for name in names
        if name not in complete
    }


def read_entry(store: Store, name: str) -> dict[str, Any]:
    """Return the entry of one unit, with the keys of `Entry`.

    Raises:
        InputError: If it is damaged.
    """
    return _checked(store, f"{LEDGER}/{name}.json", Entry)


def _checked(store: Store, where: str, kind: type) -> dict[str, Any]:
    """Read a table from a file in a store and check it against a dataclass.

    Raises:
        InputError: If it does not match.
    """
    location = f"{store.url}/{where}"
    try:
        plain = decode_json(store.read(where), location)
        from_plain(kind, plain, at=f"{location}:")
    except InputError as error:
        raise InputError(
            f"{location} is damaged ({error}) Delete it and repeat `vrcaps dataset make`: only its "
            "unit is recorded again."
        ) from error
    return plain


def read_plain_plan(store: Store) -> dict[str, Any]:
    """Plan of a data set, in the form of `plan_to_plain`.

    Raises:
        InputError: If the store holds no data set, or its plan is damaged.
    """
    plan = _stored_plan(store)
    if plan is None:
        raise InputError(
            f"{store.url} contains no data set. Give the --out of `vrcaps dataset make`."
        )
    return plan


def require_same_plan(store: Store, plan: Plan) -> None:
    """Initialize a store with a plan, or check that it has the same plan.

    Raises:
        InputError: If it holds the data set of another plan or of other versions, or something
            else.
    """
    if not require_target(store, plan) and not store.create(PLAN, _plan_file(plan)):
        require_target(store, plan)  # another process may have been first


def require_target(store: Store, plan: Plan) -> bool:
    """Check that a store is empty or holds the data set of a plan; return whether it holds it.

    Raises:
        InputError: If it holds the data set of another plan or of other versions, or something
            else.
    """
    before = _stored_plan(store)
    if before is None:
        if store.is_empty():
            return False
        before = _stored_plan(store)  # another process may have been first
        if before is None:
            raise InputError(
                f"{store.url} is not empty and contains no data set. Give a new or empty --out, or "
                "that of an unfinished data set."
            )
    wanted = json.loads(_plan_file(plan))
    differs = _difference(before, wanted)
    if differs is not None and differs.startswith(MADE_WITH):
        name = differs.removeprefix(f"{MADE_WITH}.")
        then = before.get(MADE_WITH, {}).get(name) or "unknown"
        raise InputError(
            f"{store.url} was started with {name} {then}; this installation has "
            f"{wanted[MADE_WITH].get(name) or 'none'}, so bytes may differ. Install that version, "
            "or give another --out."
        )
    if differs is not None:
        raise InputError(
            f"{store.url} contains a data set of another plan (its {differs} differs). Give "
            "another --out, or the plan it was made with."
        )
    return True


def _plan_file(plan: Plan) -> bytes:
    """Contents of the plan's file: the plan and the versions of the software."""
    return _json({**plan_to_plain(plan), MADE_WITH: made_here()})


def _stored_plan(store: Store) -> Any:
    """Plan in a store in JSON form; None if there is none.

    Raises:
        InputError: If it is damaged.
    """
    try:
        text = store.read(PLAN)
    except (FileNotFoundError, NotADirectoryError):
        return None
    location = f"{store.url}/{PLAN}"
    try:
        plain = decode_json(text, location)
        require(isinstance(plain, dict), location, type(plain).__name__, "a table")
    except InputError as error:
        raise InputError(
            f"{location} is damaged ({error}) Give another --out, or delete that file to resume "
            "with the original plan."
        ) from error
    return plain


def _difference(a: Any, b: Any, path: str = "") -> str | None:
    """Path of the first value in which two plain trees differ; None if they are equal."""
    if isinstance(a, dict) and isinstance(b, dict):
        for key in dict.fromkeys([*a, *b]):
            where = f"{path}.{key}" if path else key
            if key not in a or key not in b:
                return where
            if (difference := _difference(a[key], b[key], where)) is not None:
                return difference
        return None
    return None if a == b else path or "content"


def _json(value: Any) -> bytes:
    return (json.dumps(value, indent=1, ensure_ascii=False, default=str) + "\n").encode()


ABOUT = "about"
"""Key in an entry of the ledger."""


_CONTENTS = ("bubbles", "chyme", "liquid")


def about_recording(folder: Path) -> dict[str, Any]:
    """Summarize the episode in a folder, in JSON form.

    Raises:
        InputError: If the folder does not hold a complete episode.
    """
    episode = read_episode(folder)
    head, scenario = episode.head, episode.head["scenario"]
    segments = Counter(str(name) for name in episode.table.columns["segment"])
    return {
        "frames": len(episode),
        "seconds": len(episode) / head["fps"],
        "organ": head["organ"]["name"],
        "organ_sha256": _organ_sha256(episode),
        "capsule": head["capsule"]["name"],
        "cameras": {c.name: [c.lens.kind, c.width, c.height] for c in episode.cameras},
        "posture": scenario["posture"],
        "motion": scenario["motion"]["kind"],
        "steered": scenario["motion"].get("magnet") is not None,
        "light": scenario["render"]["light"],
        "contents": [k for k in _CONTENTS if scenario["contents"][k] != 0],
        "effects": sorted(k for k, v in scenario["effects"].items() if v not in (None, 0)),
        "lesions": [lesion["kind"] for lesion in head["organ"]["lesions"]],
        "clean_twin": scenario["clean_twin"],
        "segments": dict(sorted(segments.items())),
        "channels": list(episode.channels),
        "columns": list(episode.table.columns),
        "versions": {"vrcaps": head["vrcaps_version"], **head["made_with"]},
    }


def _organ_sha256(episode: Episode) -> str:
    """Checksum of how the organ was made: equal for the same anatomy in any posture."""
    plain = json.dumps(episode.head["scenario"]["organ"], sort_keys=True)
    return hashlib.sha256(plain.encode()).hexdigest()


def require_about(about: dict[str, Any]) -> None:
    """Check the values of an entry's summary from which counts are computed.

    Raises:
        InputError: If a number is out of range, or a table is missing.
    """
    frames, seconds = about.get("frames"), about.get("seconds")
    is_count = type(frames) is int and 0 < frames <= MAX_FRAMES
    require(is_count, "about.frames", repr(frames), f"1 to {MAX_FRAMES}")
    is_number = isinstance(seconds, int | float) and not isinstance(seconds, bool)
    is_time = is_number and 0.0 < float(seconds or 0.0) < math.inf
    require(is_time, "about.seconds", repr(seconds), "a finite number above 0")
    for key in ("cameras", "segments", "versions"):
        if not isinstance(about.get(key, {}), dict):
            raise InputError(f"about.{key} is {about[key]!r}. Allowed: a table.")
