"""Check of a data set: every file against its checksum, every patient in one split, no doubles."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable
from pathlib import Path

from vrcaps.data.ledger import EPISODES, entries, failures
from vrcaps.data.store import LocalStore
from vrcaps.files import file_sha256, files_in


def check_dataset(
    path: str | Path, progress: Callable[[int, int], None] | None = None
) -> list[str]:
    """Faults of a data set, one line each.

    Args:
        path: Its folder.
        progress: Called with the number of units checked and of all.

    Raises:
        InputError: If its ledger is damaged.
    """
    folder, store = Path(path), LocalStore(Path(path))
    found, faults = entries(store), []
    splits: dict[int, set[str]] = defaultdict(set)
    organs: dict[str, str] = {}
    seen: dict[frozenset[str], tuple[str, int]] = {}
    for done, (name, entry) in enumerate(found.items(), 1):
        splits[entry["patient"]].add(entry["split"])
        faults += _faults_of_files(folder / EPISODES / name, entry["files"])
        if entry.get("organ"):  # many show the same one
            organs[entry["organ"]["path"]] = entry["organ"]["sha256"]
        images = frozenset(sha for file, sha in entry["files"].items() if file.endswith(".png"))
        other, patient = seen.setdefault(images, (name, entry["patient"]))
        if patient != entry["patient"]:
            faults.append(f"{name} holds the same images as {other}, of another patient")
        if progress is not None:
            progress(done, len(found))
    for name, checksum in organs.items():
        faults += _faults_of_file(folder / name, checksum)
    for patient, names in sorted(splits.items()):
        if len(names) > 1:
            faults.append(f"patient {patient} is in {' and '.join(sorted(names))}")
    faults += [f"{name} could not be made: {f['error']}" for name, f in failures(store).items()]
    return faults


def _faults_of_files(folder: Path, files: dict[str, str]) -> list[str]:
    faults = [f for name, sha in files.items() for f in _faults_of_file(folder / name, sha)]
    present = {p.relative_to(folder).as_posix() for p in files_in(folder)}
    return faults + [f"{folder / name} belongs to no unit" for name in sorted(present - {*files})]


def _faults_of_file(path: Path, checksum: str) -> list[str]:
    if not path.is_file():
        return [f"{path} is missing"]
    return [] if file_sha256(path) == checksum else [f"{path} has changed since it was made"]
