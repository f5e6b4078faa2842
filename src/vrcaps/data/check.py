"""Check of a data set: all files, all labels, each patient in one split, no duplicates."""

from __future__ import annotations

import hashlib
import multiprocessing
from collections import defaultdict
from collections.abc import Iterator, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from contextlib import suppress
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

from vrcaps.core.files import files_in, scratch_folder
from vrcaps.core.processes import ProgressReport, end_with_parent, no_report
from vrcaps.data.card import read_plan_of
from vrcaps.data.ledger import ABOUT, EPISODES, entries, failures
from vrcaps.data.store import LocalStore, Store, open_store, read_at_once
from vrcaps.data.units import Units
from vrcaps.recording.check import check_episode

_Entry = Mapping[str, Any]


def check_dataset(
    url: str | Path,
    progress: ProgressReport = no_report,
    *,
    checksums_only: bool = False,
    workers: int = 0,
) -> list[str]:
    """Return the faults of a data set, one line each.

    Args:
        url: Folder or URL of the data set.
        progress: Called with the number of checked recordings and the total.
        checksums_only: Compare checksums only; skip the labels.
        workers: Number of processes; 0 checks in this process.

    Raises:
        InputError: If it is not a data set, or its ledger is damaged.
    """
    store = open_store(url)
    units, recorded = Units(read_plan_of(store)), entries(store)
    faults = [
        *_faults_of_plan(units, recorded),
        *_shared_patients(recorded),
        *_duplicates(recorded),
    ]
    damaged = _damaged_organs(store, recorded)
    faults += damaged.values()
    jobs = []
    for name, entry in recorded.items():
        organ = (entry.get("organ") or {}).get("path")
        # Labels cannot be checked against a damaged organ.
        jobs.append(_Job(str(url), name, entry["files"], organ, checksums_only or organ in damaged))
    for done, faults_of_job in enumerate(_all_checked(jobs, workers), 1):
        faults += faults_of_job
        progress(done, len(jobs))
    return [*faults, *_missing(store, units, len(recorded))]


def _missing(store: Store, units: Units, count: int) -> Iterator[str]:
    """Failed units, and the number of those that are neither failed nor among `count` recorded."""
    failed = failures(store)
    yield from (f"{name} failed: {failure['error']}" for name, failure in failed.items())
    missing = len(units) - count - len(failed)
    if missing > 0:
        yield (
            f"{missing} of {len(units)} recordings are missing; repeat the command that made the "
            "others to resume."
        )


def _damaged_organs(store: Store, recorded: Mapping[str, _Entry]) -> dict[str, str]:
    """Fault of each damaged or missing organ, by its path."""
    organs = {e["organ"]["path"]: e["organ"]["sha256"] for e in recorded.values() if e.get("organ")}
    faults = {path: _fault_of(store, path, checksum) for path, checksum in organs.items()}
    return {path: fault for path, fault in faults.items() if fault is not None}


@dataclass(frozen=True)
class _Job:
    """Recording to check.

    Attributes:
        url: URL of the data set.
        name: Name of the recording.
        files: Checksum of each of its files.
        organ: Name of the organ's file in the data set; None if it is the episode's own.
        checksums_only: Whether to compare checksums only.
    """

    url: str
    name: str
    files: Mapping[str, str]
    organ: str | None
    checksums_only: bool


def _all_checked(jobs: Sequence[_Job], workers: int) -> Iterator[list[str]]:
    """Faults of each recording; in order without processes, otherwise as they complete."""
    if not workers:
        yield from map(_check_unit, jobs)
        return
    context = multiprocessing.get_context("spawn")
    count = min(workers, max(len(jobs), 1))
    with ProcessPoolExecutor(count, mp_context=context, initializer=end_with_parent) as pool:
        results = [pool.submit(_check_unit, job) for job in jobs]
        yield from (result.result() for result in as_completed(results))


def _check_unit(job: _Job) -> list[str]:
    """Faults of one recording; a remote one is downloaded first."""
    store = open_store(job.url)
    if isinstance(store, LocalStore):
        return _faults_of_folder(store.folder / EPISODES / job.name, job)
    with scratch_folder() as scratch:
        names = [f"{EPISODES}/{job.name}/{file}" for file in job.files]
        names += [job.organ] if job.organ and not job.checksums_only else []
        read_at_once(partial(_fetch, store, scratch), names)
        return _faults_of_folder(scratch / EPISODES / job.name, job)


def _fetch(store: Store, folder: Path, name: str) -> None:
    """Copy a file of a store into a folder; skip it if it is missing."""
    path = folder / name
    path.parent.mkdir(parents=True, exist_ok=True)
    with suppress(FileNotFoundError):
        path.write_bytes(store.read(name))


def _faults_of_folder(folder: Path, job: _Job) -> list[str]:
    store = LocalStore(folder)
    changed = [_fault_of(store, name, checksum) for name, checksum in job.files.items()]
    faults = [fault for fault in changed if fault is not None]
    # A changed file needs no second message.
    if not job.checksums_only and not faults:
        faults = [f"{folder / str(problem)}" for problem in check_episode(folder)]
    present = {p.relative_to(folder).as_posix() for p in files_in(folder)}
    extra = sorted(present - {*job.files})
    return faults + [f"{folder / name} belongs to no unit" for name in extra]


def _fault_of(store: Store, name: str, checksum: str) -> str | None:
    """Fault of a file; None if it has none."""
    where = f"{store.url}/{name}"
    try:
        digest = hashlib.sha256(store.read(name)).hexdigest()
    except FileNotFoundError:
        return f"{where} is missing"
    return None if digest == checksum else f"{where} differs from its checksum"


def _faults_of_plan(units: Units, recorded: Mapping[str, _Entry]) -> Iterator[str]:
    """Entries that disagree with the plan."""
    for name, entry in recorded.items():
        index = entry["number"]
        if not 0 <= index < len(units) or units.name(index) != name:
            yield f"{name} is not a recording of the plan"
            continue
        patient = index // units.per_patient
        planned = (patient, units.splits[patient])
        if (entry["patient"], entry["split"]) != planned:
            yield (
                f"{name} is entered as patient {entry['patient']} in {entry['split']}; the plan "
                f"has patient {planned[0]} in {planned[1]}"
            )


def _shared_patients(recorded: Mapping[str, _Entry]) -> Iterator[str]:
    splits: dict[int, set[str]] = defaultdict(set)
    for entry in recorded.values():
        splits[entry["patient"]].add(entry["split"])
    for patient, names in sorted(splits.items()):
        if len(names) > 1:
            yield f"patient {patient} is in {' and '.join(sorted(names))}"


def _duplicates(recorded: Mapping[str, _Entry]) -> Iterator[str]:
    """Recordings with equal images; allowed for a clean twin of a patient without lesions."""
    seen: dict[frozenset[tuple[str, str]], str] = {}
    for name, entry in recorded.items():
        images = frozenset(item for item in entry["files"].items() if item[0].count("/") == 2)
        other = seen.setdefault(images, name)
        if other == name or not images:
            continue
        before = recorded[other]
        if before["patient"] != entry["patient"]:
            yield f"{name} contains the same images as {other}, of another patient"
        elif _is_twin(before) == _is_twin(entry):
            yield f"{name} contains the same images as {other}"


def _is_twin(entry: _Entry) -> bool:
    return bool(entry.get(ABOUT, {}).get("clean_twin"))
