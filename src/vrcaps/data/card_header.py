"""Header of a data card: the YAML block that the Hugging Face Hub and `datasets` read.

Its keys: https://huggingface.co/docs/hub/datasets-cards. Each configuration lists the tables of
frames that have the same columns, by split, so that `datasets.load_dataset(FOLDER, NAME)` reads
them.
"""

from __future__ import annotations

import json
from collections.abc import Iterator, Sequence

from vrcaps.data.counts import Row
from vrcaps.data.ledger import EPISODES
from vrcaps.data.plan import DatasetSettings
from vrcaps.recording.frame_sequence import SPLITS
from vrcaps.recording.layout import FRAMES_PARQUET

_SIZES = (
    *((10**3, "n<1K"), (10**4, "1K<n<10K"), (10**5, "10K<n<100K"), (10**6, "100K<n<1M")),
    *((10**7, "1M<n<10M"), (10**8, "10M<n<100M"), (10**9, "100M<n<1B"), (10**10, "1B<n<10B")),
)
_LARGEST = "10B<n<100B"
_TASKS = (
    ("depth-estimation", {"depth", "ray_distance"}),
    ("image-segmentation", {"label", "instance"}),
    ("object-detection", {"instance"}),
)
"""Tasks, each with the channels of which one suffices."""


def header(settings: DatasetSettings, rows: Sequence[Row]) -> str:
    """YAML block with its delimiters.

    Args:
        settings: Settings of the data set.
        rows: Recordings of the data set.
    """
    channels = {channel for row in rows for channel in row.about["channels"]}
    tasks = [name for name, needs in _TASKS if needs & channels]
    if any(row.about["steered"] for row in rows):
        tasks.append("robotics")
    lines = ["---", f"pretty_name: {json.dumps(settings.name)}", f"license: {settings.license}"]
    lines += ["task_categories:", *(f"- {name}" for name in tasks)] if tasks else []
    lines += ["size_categories:", f"- {size_category(sum(row.frames for row in rows))}"]
    lines += ["tags:", "- synthetic", "- medical", "- endoscopy", "- capsule-endoscopy", "- vrcaps"]
    if rows:
        lines += ["configs:", *_config_lines(rows)]
    return "\n".join([*lines, "---", ""])


def size_category(frames: int) -> str:
    """Size category of the Hub for a number of rows."""
    return next((name for limit, name in _SIZES if frames < limit), _LARGEST)


def configurations(rows: Sequence[Row]) -> dict[str, list[Row]]:
    """Recordings grouped by equal table columns, under the name of their capsule."""
    groups: dict[tuple[str, ...], list[Row]] = {}
    for row in rows:
        groups.setdefault(tuple(row.about["columns"]), []).append(row)
    named: dict[str, list[Row]] = {}
    for group in groups.values():
        capsules = dict.fromkeys(row.about["capsule"] for row in group)
        name = stem = "-".join(capsules) if len(capsules) < 4 else "frames"
        number = 2
        while name in named:
            name, number = f"{stem}-{number}", number + 1
        named[name] = group
    return named


def _config_lines(rows: Sequence[Row]) -> Iterator[str]:
    sizes: dict[int, int] = {}
    for row in rows:
        sizes[row.patient] = sizes.get(row.patient, 0) + 1
    for number, (name, group) in enumerate(configurations(rows).items()):
        yield f"- config_name: {json.dumps(name)}"
        if number == 0:
            yield "  default: true"
        yield "  data_files:"
        for split in SPLITS:
            paths = _paths([row for row in group if row.split == split], sizes)
            if paths:
                yield f"  - split: {split}"
                yield "    path:"
                yield from (f"    - {json.dumps(path)}" for path in paths)


def _paths(rows: Sequence[Row], sizes: dict[int, int]) -> list[str]:
    """Paths of tables; one pattern if all recordings of a patient are included."""
    by_patient: dict[int, list[str]] = {}
    for row in rows:
        by_patient.setdefault(row.patient, []).append(row.name)
    found = []
    for patient, names in by_patient.items():
        is_whole = len(names) == sizes[patient] and len(names) > 1
        patterns = [f"{names[0].rpartition('-')[0]}-*"] if is_whole else names
        found += [f"{EPISODES}/{pattern}/{FRAMES_PARQUET}" for pattern in patterns]
    return found
