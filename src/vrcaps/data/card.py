"""Data card: the README of a data set, written from its plan and its ledger.

Its header is the YAML block that the Hugging Face Hub and `datasets` read, and its sections have
the titles of the Hub's template (https://huggingface.co/docs/hub/datasets-cards). Each
configuration lists the tables of frames that have the same columns, by split, so that
`datasets.load_dataset(FOLDER, NAME)` reads them.

The same plan and ledger give the same bytes: it holds no date, host or path.
"""

from __future__ import annotations

import json
from collections.abc import Iterable, Iterator, Sequence
from typing import Any

from vrcaps.config.convert import to_plain
from vrcaps.config.plain_files import front_matter, size_category
from vrcaps.data.dataset import (
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
from vrcaps.data.ledger import EPISODES, PLAN, complete_units, failures, read_plain_plan
from vrcaps.data.plan import DatasetSettings, Plan, plan_from_plain
from vrcaps.data.store import Store
from vrcaps.data.units import Units
from vrcaps.recording.frame_sequence import SPLITS
from vrcaps.recording.layout import FRAMES_PARQUET
from vrcaps.render.channels import CHANNELS, file_text, invalid_text, value_text

CARD = "README.md"

_PLAIN_LICENSES = {
    "unknown": "No license is stated. Ask the authors before use.",
    "other": "See the description above.",
}


def write_card(store: Store) -> None:
    """Write the card of a data set in its current state.

    Raises:
        InputError: If the store holds no data set, or its ledger is damaged.
    """
    # Of two concurrent writers, the last to finish has seen all units that were complete by then.
    while True:
        names = complete_units(store)
        store.write(CARD, card_text(store).encode())
        if complete_units(store) == names:
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
    parts = [
        *(_header(plan.settings, rows), f"# Dataset Card for {plan.settings.name}\n"),
        *("## Dataset Description\n", _opening(plan, rows)),
    ]
    if len(rows) < planned:
        parts.append(
            f"**Incomplete**: {len(rows)} of {planned} recordings are complete, {failed} failed.\n"
        )
    if rows:
        parts += [_reading(rows), "## Dataset Structure\n"]
        parts += [_contents(rows), _channels(rows), _cameras(rows)]
    parts += [_making(plan, rows), _limits_text(rows), _license(plan)]
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
    description = plan.settings.description.strip()
    description += "\n\n" if description else ""
    return (
        f"{description}Simulated capsule endoscopy with exact labels: {total.patients} patients, "
        f"{total.recordings} recordings, {total.frames:,} frames, {total.images:,} images, "
        f"{duration_text(total.seconds)}, {size_text(total.num_bytes)}. "
        "No image shows a real patient. Patients are split, never their frames.\n"
    )


def _contents(rows: Sequence[Row]) -> str:
    """Tables of counts."""
    parts = ["### Contents\n", _count_table("split", by_split(rows))]
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
            f"**Patients in different splits share an organ** ({len(shared)} organs): the test "
            "split does not measure generalization to unseen anatomy.\n"
        )
    return "\n".join(parts)


def _channels(rows: Sequence[Row]) -> str:
    channels = {channel for row in rows for channel in row.about["channels"]}
    lines = [
        (f"`{c.name}`", file_text(c), value_text(c), invalid_text(c))
        for c in CHANNELS.values()
        if c.name in channels
    ]
    return (
        "### Image channels\n\n"
        + _table(("channel", "file", "value", "no value"), lines)
        + "\nOne file for each camera, channel and frame: "
        "`episodes/<recording>/<camera>/<channel>/000000.png`. `depth` is z in the camera frame, "
        "not the distance along the ray. Class names of `label` are in `episode.json`, "
        "`organ.label_names`.\n"
    )


def _cameras(rows: Sequence[Row]) -> str:
    cameras = {
        (row.about["capsule"], name, lens, f"{width} x {height}"): None
        for row in rows
        for name, (lens, width, height) in row.about["cameras"].items()
    }
    return "### Cameras\n\n" + _table(("capsule", "camera", "lens", "pixels"), sorted(cameras))


def _reading(rows: Sequence[Row]) -> str:
    names = list(_configurations(rows))
    first = json.dumps(names[0])
    return f"""## Uses

```python
import vrcaps

dataset = vrcaps.data.open("FOLDER")  # the folder or URL of this file
for sequence in dataset.sequences("train"):  # one for each camera of each recording
    frame = sequence[0]
    frame["rgb"], frame["T_world_camera"], sequence.camera.lens
```

Without vrcaps: `episode.json` describes a recording, `frames.parquet` has a row for each frame
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
    lines = [(name, ", ".join(sorted(known))) for name, known in sorted(versions.items())]
    content = {"dataset": to_plain(plan.settings, DatasetSettings), "scenario": plan.scenario}
    plan_text = json.dumps(content, indent=1, ensure_ascii=False, default=str)
    return f"""## Dataset Creation

By vrcaps, from the plan in `{PLAN}`: {plan.settings.patients:,} patients, {len(Units(plan)):,}
recordings. The same plan, versions and kind of machine give the same bytes. Tables such as `choice`
and `uniform` are distributions; `each` makes a recording with every value.

```json
{plan_text}
```

{_table(("software", "version"), lines) if lines else ""}"""


def _license(plan: Plan) -> str:
    name = plan.settings.license
    return f"## Licensing Information\n\n{_PLAIN_LICENSES.get(name, f'`{name}`.')}\n"


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


_TASKS = (
    ("depth-estimation", {"depth", "ray_distance"}),
    ("image-segmentation", {"label", "instance"}),
    ("object-detection", {"instance"}),
)
"""Tasks, each with its alternative channels, one of which suffices."""


def _header(settings: DatasetSettings, rows: Sequence[Row]) -> str:
    """YAML block with its delimiters.

    Args:
        settings: Settings of the data set.
        rows: Recordings of the data set.
    """
    channels = {channel for row in rows for channel in row.about["channels"]}
    tasks = [name for name, needs in _TASKS if needs & channels]
    if any(row.about["steered"] for row in rows):
        tasks.append("robotics")
    return front_matter(
        {
            "pretty_name": settings.name,
            "license": settings.license,
            "task_categories": tasks,
            "size_categories": [size_category(sum(row.frames for row in rows))],
            "annotations_creators": ["machine-generated"],
            "source_datasets": ["original"],
            "tags": ("synthetic", "medical", "endoscopy", "capsule-endoscopy", "vrcaps"),
            "configs": list(_configs(rows)),
        }
    )


def _configurations(rows: Sequence[Row]) -> dict[str, list[Row]]:
    """Recordings grouped by equal table columns, under the name of their capsule."""
    groups: dict[tuple[str, ...], list[Row]] = {}
    for row in rows:
        groups.setdefault(tuple(row.about["columns"]), []).append(row)
    named: dict[str, list[Row]] = {}
    for group in groups.values():
        capsules = dict.fromkeys(row.about["capsule"] for row in group)
        name = stem = "-".join(capsules) if len(capsules) < 4 else "frames"
        suffix = 2
        while name in named:
            name, suffix = f"{stem}-{suffix}", suffix + 1
        named[name] = group
    return named


def _configs(rows: Sequence[Row]) -> Iterator[dict[str, Any]]:
    """Configurations with the paths of their tables by split; the first is the default."""
    sizes: dict[int, int] = {}
    for row in rows:
        sizes[row.patient] = sizes.get(row.patient, 0) + 1
    for index, (name, group) in enumerate(_configurations(rows).items()):
        paths = {
            split: _paths([row for row in group if row.split == split], sizes) for split in SPLITS
        }
        files = [{"split": split, "path": own} for split, own in paths.items() if own]
        default = {} if index else {"default": True}
        yield {"config_name": name, **default, "data_files": files}


def _paths(rows: Sequence[Row], sizes: dict[int, int]) -> list[str]:
    """Paths of tables; one pattern if all recordings of a patient are included."""
    by_patient: dict[int, list[str]] = {}
    for row in rows:
        by_patient.setdefault(row.patient, []).append(row.name)
    paths = []
    for patient, names in by_patient.items():
        is_all = len(names) == sizes[patient] and len(names) > 1
        patterns = [f"{names[0].rpartition('-')[0]}-*"] if is_all else names
        paths += [f"{EPISODES}/{pattern}/{FRAMES_PARQUET}" for pattern in patterns]
    return paths


_ALWAYS = (
    "Appearance is a model: colors, vessels, mucus and relief of the mucosa are fitted to frames "
    "of a few real colons and drawn from noise. Images resemble those of real capsules, no more. "
    "Evaluate a method on real images before you trust its results.",
    "Generated anatomy follows published lengths and diameters of adults. Diseased, operated, "
    "pediatric or unusual anatomy is absent, unless custom organs were given.",
    "Colors of lesions are fitted by eye, lesions stand apart from each other, and a kind has the "
    "variation that its parameters have. Prevalence is that of the plan, not of any hospital.",
    "Labels are exact for the geometry that was rendered: at centers of pixels, without blur or "
    "mixed pixels at edges. Manual annotations of real images are less exact.",
    "This is not a medical device. Nothing in it was evaluated for diagnosis.",
)
_MOTIONS = {
    "fly-through": "The capsule flies along a smooth path in the middle of the lumen: there is no "
    "contact, sliding or tumbling, and the wall yields where it is narrow.",
    "random-views": "Frames are independent random views, most of them of lesions: they form no "
    "video, and their frequencies are not those along a passage.",
    "replay": "The capsule follows given poses; they are as realistic as their source.",
    "dynamics": "Contact, drag and motility follow published laws with parameters from the "
    "literature. They differ between people and were fitted to no patient.",
}
_LIGHTS = {
    "direct": "Light is reflected once: images have no indirect illumination, so deep lumen and "
    "folds are darker than in real ones.",
    "radiosity": "Indirect light is diffuse and interpolated between points of the wall.",
    "path": "Light is path traced: images carry the noise of their samples.",
}

_TIMES = {"auto_exposure", "adaptive_frame_rate"}
"""Effects that set when and how long a camera exposes, and do not degrade the image."""


def _limits_text(rows: Sequence[Row]) -> str:
    """Section of a card on known limits.

    Args:
        rows: Recordings of the data set.
    """
    limits = [*_ALWAYS]
    limits += [_MOTIONS[m] for m in _MOTIONS if any(row.about["motion"] == m for row in rows)]
    limits += [_LIGHTS[k] for k in _LIGHTS if any(row.about["light"] == k for row in rows)]
    clean = sum(not set(row.about["effects"]) - _TIMES for row in rows)
    if clean:
        limits.append(
            f"{clean:,} of {len(rows):,} recordings have no effects of lens and sensor: no noise, "
            "blur, bubbles or compression, which real images have."
        )
    without = sum(not row.about["contents"] for row in rows)
    if without:
        limits.append(f"{without:,} of {len(rows):,} recordings show an empty, clean lumen.")
    return "## Bias, Risks, and Limitations\n\n" + "".join(f"- {line}\n" for line in limits)
