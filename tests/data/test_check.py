"""Check of a data set: labels, splits, doubles, what is missing."""

import json
import shutil
from pathlib import Path

import numpy as np
import pytest

from vrcaps.cli import main
from vrcaps.core.files import file_sha256
from vrcaps.data.check import check_dataset
from vrcaps.data.ledger import entries
from vrcaps.data.store import LocalStore, open_store
from vrcaps.recording.frame_files import write_images


def enter(made: Path, name: str, **values) -> dict:
    """Change an entry of the ledger."""
    path = made / "ledger" / f"{name}.json"
    entry = json.loads(path.read_text()) | values
    path.write_text(json.dumps(entry))
    return entry


def test_a_label_against_its_schema_is_found_though_its_checksum_fits(made: Path) -> None:
    name = next(iter(entries(LocalStore(made))))
    image = made / "episodes" / name / "front" / "depth" / "000001.png"
    write_images([(image, np.zeros((3, 3), np.uint16))])
    files = entries(LocalStore(made))[name]["files"]
    enter(made, name, files=files | {"front/depth/000001.png": file_sha256(image)})
    (fault,) = check_dataset(made)
    assert "front/depth/000001.png" in fault
    assert "(3, 3)" in fault
    assert check_dataset(made, checksums_only=True) == []


def test_a_patient_in_two_splits_is_found(made: Path) -> None:
    name, entry = next(iter(entries(LocalStore(made)).items()))
    other = "test" if entry["split"] != "test" else "train"
    enter(made, name, split=other)
    faults = check_dataset(made, checksums_only=True)
    assert any(f"patient {entry['patient']} is in " in fault for fault in faults)
    assert any(f"the plan has patient {entry['patient']} in {entry['split']}" in f for f in faults)


def test_the_same_images_under_two_names_are_found(made: Path) -> None:
    names = list(entries(LocalStore(made)))
    for source, target in ((0, 1), (2, 4)):
        folder = made / "episodes" / names[target]
        shutil.rmtree(folder)
        shutil.copytree(made / "episodes" / names[source], folder)
        enter(made, names[target], files=entries(LocalStore(made))[names[source]]["files"])
    faults = check_dataset(made, checksums_only=True)
    assert f"{names[1]} contains the same images as {names[0]}" in faults
    assert f"{names[4]} contains the same images as {names[2]}, of another patient" in faults
    about = entries(LocalStore(made))[names[1]]["about"]
    enter(made, names[1], about=about | {"clean_twin": True})
    assert not any(fault.startswith(names[1]) for fault in check_dataset(made, checksums_only=True))


def test_what_is_not_made_yet_or_not_planned_is_said(made: Path, capsys) -> None:
    names = list(entries(LocalStore(made)))
    (made / "ledger" / f"{names[0]}.json").rename(made / "ledger" / "p00009-000009.json")
    assert (
        check_dataset(made, checksums_only=True)[0]
        == "p00009-000009 is not a recording of the plan"
    )
    (made / "ledger" / "p00009-000009.json").unlink()
    assert check_dataset(made, checksums_only=True) == [
        "1 of 8 recordings are missing; repeat the command that made the others to resume."
    ]
    with pytest.raises(SystemExit):
        main(["dataset", "check", str(made), "--checksums-only", "--workers", "0"])
    assert "has 1 fault." in capsys.readouterr().err
    with pytest.raises(SystemExit):
        main(["dataset", "check", str(made), "--workers", "-1"])
    assert "--workers is -1" in capsys.readouterr().err


@pytest.mark.slow
def test_a_process_of_its_own_checks_labels_too(made: Path, capsys) -> None:
    main(["dataset", "check", str(made), "--workers", "1"])
    said = capsys.readouterr().out
    assert "8 recordings of 4 patients (2 train, 1 val, 1 test) are complete" in said
    assert "patients in different splits share an organ (1 organs)" in said


def test_a_remote_one_is_checked_as_a_local_one(made: Path) -> None:
    pytest.importorskip("fsspec")
    url = "memory://checked"
    store = open_store(url)
    for path in made.rglob("*"):
        if path.is_file():
            store.write(path.relative_to(made).as_posix(), path.read_bytes())
    name = next(iter(entries(store)))
    store.write(f"episodes/{name}/frames.parquet", b"other")
    (fault,) = check_dataset(url, checksums_only=True)
    assert "frames.parquet differs" in fault
