"""Summary of a recording, kept in its entry in the ledger.

A data card, a count or a table of all recordings therefore needs only the ledger.
"""

from __future__ import annotations

import hashlib
import json
import math
from collections import Counter
from pathlib import Path
from typing import Any

from vrcaps.core.errors import InputError, require
from vrcaps.recording.episode import Episode, read_episode
from vrcaps.scenario.scenario import MAX_FRAMES

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
    """Check the values in an entry's summary that are counted.

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
