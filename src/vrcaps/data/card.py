"""Data card: the README of a data set, written from its plan and its ledger.

The same plan and ledger give the same bytes: it holds no date, host or path.
"""

from __future__ import annotations

import json
from collections.abc import Iterable, Sequence
from typing import Any

from vrcaps.config.convert import to_plain
from vrcaps.data import card_limits
from vrcaps.data.card_header import configurations, header
from vrcaps.data.counts import (
    Count,
    Row,
    by_split,
    count,
    count_by,
    lesion_counts,
    rows_of,
    segment_counts,
    shared_organs,
)
from vrcaps.data.ledger import PLAN, failures, read_plain_plan, whole_units
from vrcaps.data.plan import DatasetSettings, Plan, plan_from_plain
from vrcaps.data.store import Store
from vrcaps.data.units import Units
from vrcaps.render.channels import CHANNELS, file_text, invalid_text, value_text

CARD = "README.md"

_PLAIN_LICENSES = {
    "unknown": "No license is stated. Ask whoever made this data set before you use it.",
    "other": "See the description above.",
}


def write_card(store: Store) -> None:
    """Write the card of a data set in its current state.

    Raises:
        InputError: If the store holds no data set, or its ledger is damaged.
    """
    # Of two concurrent writers, the last to finish has seen all units that were complete by then.
    while True:
        names = whole_units(store)
        store.write(CARD, card_text(store).encode())
        if whole_units(store) == names:
            return


def read_plan_of(store: Store) -> Plan:
    """Plan of a data set.

    Raises:
        InputError: If the store holds no data set.
    """
    return plan_from_plain(read_plain_plan(store), at=f"{store.url}/{PLAN}")


def card_text(store: Store) -> str:
    """Text of the card of a data set in its current state.

    Raises:
        InputError: If the store holds no data set, or its ledger is damaged.
    """
    plan, rows = read_plan_of(store), rows_of(store)
    planned, failed = len(Units(plan)), len(failures(store))
    parts = [header(plan.settings, rows), f"# {plan.settings.name}\n", _opening(plan, rows)]
    if len(rows) < planned:
        parts.append(
            f"**Not all is made yet**: {len(rows)} of {planned} recordings are whole, "
            f"{failed} failed.\n"
        )
    if rows:
        parts += [_contents(rows), _channels(rows), _cameras(rows), _reading(rows)]
    parts += [_making(plan, rows), card_limits.limits_text(rows), _license(plan)]
    return "\n".join(parts)


def size_text(num_bytes: float) -> str:
    """Human-readable size: `12.3 GB`."""
    unit, name = (1e9, "GB") if num_bytes >= 1e9 else (1e6, "MB")
    return f"{num_bytes / unit:,.1f} {name}"


def duration_text(seconds: float) -> str:
    """Human-readable duration: `36 s`, `12.5 min`, `3.2 h`."""
    if seconds < 120.0:
        return f"{seconds:.0f} s"
    return f"{seconds / 60:.1f} min" if seconds < 7200.0 else f"{seconds / 3600:,.1f} h"


def _opening(plan: Plan, rows: Sequence[Row]) -> str:
    total = count(rows)
    said = f"{plan.settings.description.strip()}\n\n" if plan.settings.description.strip() else ""
    return (
        f"{said}Simulated capsule endoscopy with exact labels: {total.patients} patients, "
        f"{total.recordings} recordings, {total.frames:,} frames, {total.images:,} images, "
        f"{duration_text(total.seconds)}, {size_text(total.num_bytes)}. "
        "No image shows a real patient. Patients are split, never their frames.\n"
    )


def _contents(rows: Sequence[Row]) -> str:
    """Tables of counts."""
    parts = ["## Contents\n", _count_table("split", by_split(rows))]
    keys = {"organ": "organ", "capsule": "capsule", "posture": "posture", "motion": "motion"}
    for title, key in keys.items():
        parts.append(_count_table(title, count_by(rows, lambda row, key=key: row.about[key])))
    segments = segment_counts(rows)
    lines = [(name, *splits.values()) for name, splits in segments.items()]
    parts.append(_table(("frames with the capsule in", "train", "val", "test"), lines))
    lesions = lesion_counts(rows)
    if lesions:
        lines = [(kind, *numbers) for kind, numbers in lesions.items()]
        parts.append(_table(("lesion", "lesions", "patients", "recordings"), lines))
    else:
        parts.append("No recording shows a lesion.\n")
    shared = shared_organs(rows)
    if shared:
        parts.append(
            f"**Patients in different splits have the same organ** ({len(shared)} organs): the "
            "splits do not tell how a method does in an anatomy that it has not seen.\n"
        )
    return "\n".join(parts)


def _channels(rows: Sequence[Row]) -> str:
    found = {channel for row in rows for channel in row.about["channels"]}
    lines = [
        (f"`{c.name}`", file_text(c), value_text(c), invalid_text(c))
        for c in CHANNELS.values()
        if c.name in found
    ]
    return (
        "## Image channels\n\n"
        + _table(("channel", "file", "value", "no value"), lines)
        + "\nOne file for each camera, channel and frame: "
        "`episodes/<recording>/<camera>/<channel>/000000.png`. `depth` is z in the camera frame, "
        "not the distance along the ray. Class names of `label` are in `episode.json`, "
        "`organ.label_names`.\n"
    )


def _cameras(rows: Sequence[Row]) -> str:
    found = {
        (row.about["capsule"], name, lens, f"{width} x {height}"): None
        for row in rows
        for name, (lens, width, height) in row.about["cameras"].items()
    }
    return "## Cameras\n\n" + _table(("capsule", "camera", "lens", "pixels"), sorted(found))


def _reading(rows: Sequence[Row]) -> str:
    names = list(configurations(rows))
    first = json.dumps(names[0])
    return f"""## Reading

```python
import vrcaps

dataset = vrcaps.data.open("FOLDER")  # the folder or URL of this file
for sequence in dataset.sequences("train"):  # one for each camera of each recording
    frame = sequence[0]
    frame["rgb"], frame["T_world_camera"], sequence.camera.lens
```

Without vrcaps: `episode.json` says what a recording is, `frames.parquet` has a row for each frame
with time, poses and velocities, units in the names of the columns; images are ordinary files. The
tables alone, whose configurations have equal columns ({", ".join(names)}):
`datasets.load_dataset("FOLDER", {first})`.

Meters, seconds, radians. `T_a_b` maps points from b to a; poses are camera to world, quaternions
w x y z. Cameras have x right, y down, z forward; pixel (0, 0) is the center of the top-left pixel.
`vrcaps export` writes other layouts; `ledger/` holds the SHA-256 checksum of every file.
"""


def _making(plan: Plan, rows: Sequence[Row]) -> str:
    versions: dict[str, dict[str, None]] = {}
    for row in rows:
        for name, version in row.about["versions"].items():
            versions.setdefault(name, {})[version] = None
    lines = [(name, ", ".join(sorted(found))) for name, found in sorted(versions.items())]
    whole = {"dataset": to_plain(plan.settings, DatasetSettings), "scenario": plan.scenario}
    said = json.dumps(whole, indent=1, ensure_ascii=False, default=str)
    return f"""## How it was made

By vrcaps, from the plan in `{PLAN}`: {plan.settings.patients:,} patients, {len(Units(plan)):,}
recordings. The same plan, versions and kind of machine give the same bytes. Tables such as `choice`
and `uniform` are distributions; `each` makes a recording with every value.

```json
{said}
```

{_table(("made with", "version"), lines) if lines else ""}"""


def _license(plan: Plan) -> str:
    name = plan.settings.license
    return f"## License\n\n{_PLAIN_LICENSES.get(name, f'`{name}`.')}\n"


def _count_table(title: str, counts: dict[Any, Count]) -> str:
    lines = [
        (name, c.patients, c.recordings, c.frames, duration_text(c.seconds), size_text(c.num_bytes))
        for name, c in counts.items()
    ]
    return _table((title, "patients", "recordings", "frames", "time", "size"), lines)


def _table(head: tuple[str, ...], lines: Iterable[tuple[Any, ...]]) -> str:
    """Markdown table; counts have thousands separators."""
    rows = [head, tuple("---" for _ in head)]
    rows += [tuple(f"{x:,}" if isinstance(x, int) else str(x) for x in line) for line in lines]
    return "".join(f"| {' | '.join(row)} |\n" for row in rows)
