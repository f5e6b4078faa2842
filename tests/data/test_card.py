"""Data cards: the same bytes, counts of the ledger, a header that a YAML reader takes."""

import json
from pathlib import Path

import pytest
import yaml

from vrcaps.cli import main
from vrcaps.core.errors import InputError, UnknownNameError
from vrcaps.data.card import CARD, card_text, write_card
from vrcaps.data.dataset import (
    by_split,
    count,
    count_by,
    lesion_counts,
    rows_of,
    segment_counts,
    shared_organs,
)
from vrcaps.data.ledger import ABOUT, entries
from vrcaps.data.plan import DatasetSettings
from vrcaps.data.store import LocalStore


def change(made: Path, name: str, **values) -> None:
    """Change what the ledger says of a recording."""
    path = made / "ledger" / f"{name}.json"
    entry = json.loads(path.read_text())
    entry[ABOUT] |= values
    path.write_text(json.dumps(entry))


def test_it_is_there_when_all_is_made_and_has_the_same_bytes_again(made: Path) -> None:
    before = (made / CARD).read_bytes()
    (made / CARD).write_text("mine")
    main(["dataset", "card", str(made)])
    assert (made / CARD).read_bytes() == before


def test_its_header_lists_the_tables_of_each_split(made: Path) -> None:
    _, header, body = (made / CARD).read_text().split("---\n", 2)
    read = yaml.safe_load(header)
    assert read["license"] == "unknown"
    assert read["task_categories"] == ["depth-estimation"]
    assert read["size_categories"] == ["n<1K"]
    assert read["annotations_creators"] == ["machine-generated"]
    assert read["pretty_name"] in body.splitlines()[1]
    assert [line for line in body.splitlines() if line.startswith("## ")] == [
        *("## Dataset Description", "## Uses", "## Dataset Structure", "## Dataset Creation"),
        *("## Bias, Risks, and Limitations", "## Licensing Information"),
    ]
    (config,) = read["configs"]
    files = {one["split"]: one["path"] for one in config["data_files"]}
    found = {
        split: {p.parent.name for path in paths for p in made.glob(path)}
        for split, paths in files.items()
    }
    ledger = entries(LocalStore(made))
    assert found == {
        split: {name for name, entry in ledger.items() if entry["split"] == split}
        for split in ("train", "val", "test")
    }
    assert "4 patients, 8 recordings, 24 frames, 48 images" in body
    assert "| `depth` | 16-bit PNG | z of the surface in the camera frame: stored · 10 µm" in body
    assert "Patients in different splits share an organ" in body
    assert "No license is stated" in body


def test_counts_are_those_of_the_recordings(made: Path) -> None:
    names = list(entries(LocalStore(made)))
    change(made, names[0], lesions=["polyp", "polyp", "ulcer"], capsule="other")
    change(made, names[1], lesions=["polyp"])
    rows = rows_of(LocalStore(made))
    assert lesion_counts(rows) == {"polyp": (2, 1, 2), "ulcer": (1, 1, 1)}
    counts = count_by(rows, lambda row: row.about["capsule"])
    assert [(c.patients, c.recordings, c.frames) for c in counts.values()] == [
        (4, 7, 21),
        (1, 1, 3),
    ]
    assert sum(c.frames for c in by_split(rows).values()) == count(rows).frames == 24
    assert sum(sum(splits.values()) for splits in segment_counts(rows).values()) == 24
    assert shared_organs(rows) == [(0, 1, 2, 3)]
    for number, name in enumerate(names):
        change(made, name, organ_sha256=str(number // 2))
    assert shared_organs(rows_of(LocalStore(made))) == []


def test_recordings_with_other_columns_are_a_configuration_of_their_own(made: Path) -> None:
    names = list(entries(LocalStore(made)))
    change(made, names[0], columns=["frame"])
    text = card_text(LocalStore(made))
    configs = yaml.safe_load(text.split("---\n", 2)[1])["configs"]
    capsule = rows_of(LocalStore(made))[0].about["capsule"]
    assert [config["config_name"] for config in configs] == [capsule, f"{capsule}-2"]
    assert configs[0]["data_files"][0]["path"] == [f"episodes/{names[0]}/frames.parquet"]


def test_it_says_what_is_missing_and_what_effects_there_are(made: Path) -> None:
    names = list(entries(LocalStore(made)))
    (made / "ledger" / f"{names[0]}.json").unlink()
    for name in names[1:]:
        change(made, name, effects=["sensor_noise"], light="direct", contents=["bubbles"])
    write_card(LocalStore(made))
    text = (made / CARD).read_text()
    assert "7 of 8 recordings are complete" in text
    assert "Light is reflected once" in text
    assert "no effects of lens" not in text
    assert "clean lumen" not in text


def test_bad_input_is_one_clear_line(made: Path, tmp_path: Path) -> None:
    with pytest.raises(UnknownNameError, match=r"license named 'CC BY 4\.0'"):
        DatasetSettings("x", license="CC BY 4.0")
    with pytest.raises(InputError, match="contains no data set"):
        card_text(LocalStore(tmp_path / "none"))
    (made / "plan.json").write_text("{}")
    with pytest.raises(InputError, match="not a plan of a data set"):
        card_text(LocalStore(made))
    path = next((made / "ledger").iterdir())
    path.write_text(
        json.dumps({k: v for k, v in json.loads(path.read_text()).items() if k != ABOUT})
    )
    with pytest.raises(InputError, match="of an earlier version"):
        rows_of(LocalStore(made))
