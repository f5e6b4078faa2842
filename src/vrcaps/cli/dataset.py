"""`vrcaps dataset`: make a data set from a plan, verify it."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from tyro.conf import Positional

from vrcaps.cli.arguments import require_file, require_folder
from vrcaps.cli.console import console, progress_bar
from vrcaps.core.errors import InputError

if TYPE_CHECKING:
    from collections.abc import Sequence

    from vrcaps.data.plan import Plan
    from vrcaps.data.runners.runner import Runner
    from vrcaps.data.units import Units

_MB, _GB, _MINUTE, _HOUR = 1e6, 1e9, 60.0, 3600.0


@dataclass(frozen=True)
class Make:
    """Make a data set from a plan: many recordings, split by patient.

    A plan is a scenario file with a table [dataset]. Any other value may be replaced by a
    distribution: { choice = [...] }, { uniform = [low, high] }, { log-uniform = [low, high] },
    { normal = [mean, deviation] }, { integer = [low, high] }; { each = [...] } makes one recording
    per value. lesions = { prevalence = 1.0 } samples lesions as in a screening population.

    To resume an interrupted run, repeat the command; the data set then has the same bytes. A
    recording that fails is reported and does not stop the others.

    For example:
      vrcaps dataset make cohort.toml --out runs/cohort --dry-run
      vrcaps dataset make cohort.toml --out runs/cohort --workers 2
      vrcaps dataset make cohort.toml --out runs/cohort --ray local
      vrcaps dataset make cohort.toml --out s3://bucket/cohort --units 0:100
    """

    plan: Positional[Path]
    """Plan file (TOML or JSON)."""

    out: str
    """Folder or URL of the data set: new, or an unfinished one of the same plan."""

    units: str | None = None
    """Range of units to make, FIRST:END without END, such as 0:100 for the first hundred: a slice
    for each machine."""

    workers: int | None = None
    """Number of parallel recordings; by default one per processor. 0 records in this process."""

    ray: str | None = None
    """Ray cluster to record on: local starts one here, auto joins this machine's, or HOST:PORT."""

    dry_run: bool = False
    """Print the recordings to make and estimates of duration and disk space, then exit."""

    def run(self) -> None:
        """Make and report.

        Raises:
            InputError: If the plan or the target is invalid, or recordings failed.
        """
        require_file(self.plan, "a plan (TOML or JSON), such as examples/cohort.toml")
        from vrcaps.data.make import make_dataset
        from vrcaps.data.plan import read_plan
        from vrcaps.data.units import Units

        runner = _runner(self.workers, self.ray)
        plan = read_plan(self.plan)
        units = Units(plan)
        numbers = _slice(self.units, len(units))
        if self.dry_run:
            _estimate(plan, units, numbers or range(len(units)), self.out)
            return
        with progress_bar("recording") as progress:
            made = make_dataset(
                plan,
                self.out,
                numbers=numbers,
                runner=runner,
                progress=progress,
                source=str(self.plan),
            )
        console.print(f"Made {made.made} recordings into {self.out}; {made.present} were there.")
        for name, message in made.failed.items():
            console.print(f"{name} failed: {message}")
        if made.failed:
            raise InputError(
                f"{len(made.failed)} recordings failed; {self.out}/failed says why and how to "
                "repeat each. The others are whole."
            )


@dataclass(frozen=True)
class Check:
    """Verify a data set: all files and labels, no patient in two splits, no duplicates.

    Compares every file with its checksum, checks every label image as `vrcaps check` does for an
    episode, and reports recordings with identical images. Prints one line per fault.

    For example:
      vrcaps dataset check runs/cohort
      vrcaps dataset check s3://bucket/cohort --checksums-only
    """

    dataset: Positional[str]
    """Folder or URL of the data set."""

    checksums_only: bool = False
    """Compare checksums only."""

    workers: int | None = None
    """Number of processes; by default one per processor. 0 checks in this process."""

    def run(self) -> None:
        """Check and report.

        Raises:
            InputError: If there are faults.
        """
        require_folder(self.dataset, "a data set: the --out of `vrcaps dataset make`")
        from vrcaps.data.check_dataset import check_dataset
        from vrcaps.data.counts import by_split, count, rows_of, shared_organs
        from vrcaps.data.store import open_store

        workers = _workers(self.workers)
        with progress_bar("checking") as progress:
            faults = check_dataset(
                self.dataset, progress, checksums_only=self.checksums_only, workers=workers
            )
        for fault in faults:
            console.print(fault)
        if faults:
            noun = "fault" if len(faults) == 1 else "faults"
            raise InputError(f"{self.dataset} has {len(faults)} {noun}.")
        rows = rows_of(open_store(self.dataset))
        splits = ", ".join(f"{found.patients} {name}" for name, found in by_split(rows).items())
        total = count(rows)
        console.print(
            f"{total.recordings} recordings of {total.patients} patients ({splits}) are whole."
        )
        shared = len(shared_organs(rows))
        if shared:
            console.print(f"Note: patients in different splits share an organ ({shared} organs).")


def _workers(given: int | None) -> int:
    """Number of processes."""
    from vrcaps.data.runners.runner import num_processors

    if given is not None and given < 0:
        raise InputError(f"--workers is {given}. Allowed: 0 or more.")
    return num_processors() if given is None else given


def _runner(workers: int | None, ray: str | None) -> Runner:
    """Runner of the units.

    Raises:
        InputError: If there is no such runner.
    """
    from vrcaps.data.runners.in_process import InProcess
    from vrcaps.data.runners.pool import Pool
    from vrcaps.data.runners.ray_cluster import RayCluster

    if ray is None:
        return Pool(count) if (count := _workers(workers)) else InProcess()
    if workers is not None and workers < 1:
        raise InputError(f"--workers is {workers}. Allowed with --ray: 1 or more.")
    return RayCluster(ray, workers)


def _slice(text: str | None, count: int) -> range | None:
    """Indices of a slice such as ``0:100``; None for all."""
    if text is None:
        return None
    first, colon, last = text.partition(":")
    try:
        numbers = range(int(first or 0), min(int(last or count), count))
    except ValueError:
        numbers = range(0)
    if not colon or not numbers or numbers[0] < 0:
        raise InputError(f"--units is {text!r}. Allowed: FIRST:END from 0:1 to 0:{count}.")
    return numbers


def _estimate(plan: Plan, units: Units, numbers: Sequence[int], out: str) -> None:
    """Print an estimate of a run.

    Args:
        plan: Plan of the data set.
        units: Its units.
        numbers: Indices of the units to make.
        out: Folder or URL of the data set.

    Raises:
        InputError: If the target holds another data set, or lacks space.
    """
    from vrcaps.data.check_plan import check_plan
    from vrcaps.data.estimate import estimate
    from vrcaps.data.ledger import require_target, whole_units
    from vrcaps.data.store import open_store
    from vrcaps.recording.frame_sequence import SPLITS

    check_plan(units)
    store = open_store(out)
    require_target(store, plan)
    whole = set(whole_units(store, [units.name(number) for number in numbers]))
    missing = [number for number in numbers if units.name(number) not in whole]
    splits = ", ".join(f"{units.splits.count(s)} {s}" for s in SPLITS)
    console.print(
        f"{plan.settings.name}: {len(units.splits)} patients ({splits}), {len(units)} recordings."
    )
    if len(numbers) < len(units):
        console.print(f"Asked for: recordings {numbers[0]} to {numbers[-1]}.")
    if whole:
        console.print(f"{len(whole)} of them are there already.")
    if not missing:
        console.print("Nothing is left to be made.")
        return
    with console.status("recording a few frames to measure"):
        found = estimate(units, missing)
    free = store.free_bytes()
    room = "" if free is None else f"; {size_text(free)} are free at {out}"
    console.print(
        f"To be made: {len(missing)} recordings, {found.frames:,} frames. About "
        f"{time_text(found.seconds)} on this machine (one after the other) and "
        f"{size_text(found.num_bytes)}{room}."
    )
    console.print(f"Measured with {', '.join(found.measured)}.")
    if free is not None and free < found.num_bytes:
        raise InputError(
            f"{out} has room for {size_text(free)}, and {size_text(found.num_bytes)} are needed. "
            "Give a place with more, or fewer frames, channels or patients."
        )


def time_text(seconds: float) -> str:
    """Format a duration in a suitable unit."""
    if seconds < 2.0 * _MINUTE:
        return f"{seconds:.0f} seconds"
    if seconds < 2.0 * _HOUR:
        return f"{seconds / _MINUTE:.0f} minutes"
    return f"{seconds / _HOUR:.1f} hours"


def size_text(num_bytes: float) -> str:
    """Format a size in a suitable unit."""
    return f"{num_bytes / _MB:,.1f} MB" if num_bytes < _GB else f"{num_bytes / _GB:,.1f} GB"
