"""Folder of a training: what it was begun with, so that it goes on to the same result."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from vrcaps import __version__
from vrcaps.errors import InputError
from vrcaps.files import is_new_folder, write_json
from vrcaps.made_with import core_sha256, versions
from vrcaps.plain_files import decode_json

SETTINGS = "settings.json"


def begin_training(
    out: Path, plain: dict[str, Any], packages: tuple[str, ...], *, is_forced: bool = False
) -> None:
    """Make the folder of a training, or check that it is of the same one.

    Args:
        out: Folder: new, empty, or of the same training.
        plain: Settings as plain values.
        packages: Packages that the result's bytes depend on.
        is_forced: Go on even if vrcaps or a package has changed since the training began.

    Raises:
        InputError: If the folder holds something else, or a training of other settings or versions.
    """
    path = out / SETTINGS
    made_with = {"vrcaps": __version__, "core": core_sha256(), **versions(packages)}
    if not path.is_file():
        if not is_new_folder(out):
            raise InputError(f"{out} holds no training. Give a new or empty folder.")
        out.mkdir(parents=True, exist_ok=True)
        write_json(path, {"made_with": made_with, "settings": plain})
        return
    try:
        found = decode_json(path.read_bytes(), path)
        before, versions_before = found["settings"], found["made_with"]
    except (InputError, LookupError, TypeError) as error:
        raise InputError(f"{path} is damaged. Give a new folder.") from error
    changed = _differences(before, plain)
    if changed:
        raise InputError(
            f"{out} holds a training with other settings: {', '.join(changed[:5])}. Give a new "
            "folder, or the settings that it was begun with."
        )
    newer = _differences(versions_before, made_with)
    if newer and not is_forced:
        raise InputError(
            f"{out} was begun with other versions: {', '.join(newer)}. Its result would not be the "
            "same. Give a new folder, or --force to go on."
        )


def _differences(before: Any, now: Any, at: str = "") -> list[str]:
    """Places at which two plain trees differ, with both values."""
    if isinstance(before, dict) and isinstance(now, dict):
        keys = sorted({*before, *now})
        return [
            line
            for key in keys
            for line in _differences(before.get(key), now.get(key), f"{at}.{key}".strip("."))
        ]
    if before is None and now == []:  # a list that an older version did not know
        return []
    return [] if before == now else [f"{at} was {_short(before)}, now {_short(now)}"]


def _short(value: Any) -> str:
    text = str(value)
    return text if len(text) <= 24 else f"{text[:12]}…"
