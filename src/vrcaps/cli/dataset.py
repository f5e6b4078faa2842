"""`vrcaps dataset`: make a data set from a plan, verify it, describe its contents."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from tyro.conf import Positional

from vrcaps.cli.arguments import require_file, require_folder, require_sources
from vrcaps.cli.console import console, progress_bar
from vrcaps.core.errors import InputError, require, require_extra
from vrcaps.core.processes import MAX_WORKERS

if TYPE_CHECKING:
    from vrcaps.data.dataset import Row
    from vrcaps.data.plan import Plan
    from vrcaps.data.runners.local import Runner
    from vrcaps.data.units import Units

_DATASET = "a data set: the --out of `vrcaps dataset make`"


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
    """Range of units to make on this machine, such as 0:100 for the first hundred."""

    workers: int | None = None
    """Number of parallel recordings; by default one per processor. 0 records in this process."""

    ray: str | None = None
    """Ray cluster to record on: local starts one here, auto joins this machine's, or HOST:PORT."""

    dry_run: bool = False
    """Print the number of recordings and frames to make, then exit."""

    estimate: bool = False
    """Also measure and print expected duration and disk space (a few minutes), then exit."""

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
        indices = _slice(self.units, len(units))
        if self.dry_run or self.estimate:
            missing = _list(plan, units, indices or range(len(units)), self.out)
            if self.estimate and missing:
                _estimate(units, missing, self.out)
            return
        with progress_bar("recording") as progress:
            made = make_dataset(
                plan,
                self.out,
                numbers=indices,
                runner=runner,
                progress=progress,
                source=str(self.plan),
            )
        console.print(f"Made {made.made} recordings in {self.out}; {made.present} existed.")
        for name, message in made.failed.items():
            console.print(f"{name} failed: {message}")
        if made.failed:
            raise InputError(
                f"{len(made.failed)} recordings failed; {self.out}/failed states the cause and the "
                "command to repeat each. The others are complete."
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
        require_folder(self.dataset, _DATASET)
        from vrcaps.data.check import check_dataset
        from vrcaps.data.dataset import by_split, count, rows_of, shared_organs
        from vrcaps.data.store import open_store

        workers = _workers(self.workers)
        with progress_bar("checking") as progress:
            faults = check_dataset(
                self.dataset, progress, checksums_only=self.checksums_only, workers=workers
            )
        for fault in faults:
            console.print(fault)
        if faults:
            raise InputError(f"{self.dataset} has {len(faults)} fault{'s' * (len(faults) > 1)}.")
        rows = rows_of(open_store(self.dataset))
        splits = ", ".join(f"{part.patients} {name}" for name, part in by_split(rows).items())
        total = count(rows)
        console.print(
            f"{total.recordings} recordings of {total.patients} patients ({splits}) are complete."
        )
        if shared := len(shared_organs(rows)):
            console.print(f"Note: patients in different splits share an organ ({shared} organs).")


def _workers(given: int | None, least: int = 0) -> int:
    """Number of processes; by default one per processor."""
    from vrcaps.data.runners.local import num_processors

    if given is not None:
        require(least <= given <= MAX_WORKERS, "--workers", given, f"{least} to {MAX_WORKERS}")
    return num_processors() if given is None else given


def _runner(workers: int | None, ray: str | None) -> Runner:
    """Runner of the units.

    Raises:
        InputError: If there is no such runner.
    """
    from vrcaps.data.runners.local import InProcess, Pool
    from vrcaps.data.runners.ray_cluster import RayCluster

    if ray is None:
        return Pool(count) if (count := _workers(workers)) else InProcess()
    _workers(workers, least=1)
    return RayCluster(ray, workers)


def _slice(text: str | None, count: int) -> range | None:
    """Indices of a slice such as ``0:100``; None for all."""
    if text is None:
        return None
    first, colon, last = text.partition(":")
    try:
        indices = range(int(first or 0), min(int(last or count), count))
    except ValueError:
        indices = range(0)
    if not colon or not indices or indices[0] < 0:
        raise InputError(f"--units is {text!r}. Allowed: FIRST:END from 0:1 to 0:{count}.")
    return indices


def _list(plan: Plan, units: Units, indices: Sequence[int], out: str) -> list[int]:
    """Print the recordings to make; return their indices.

    Raises:
        InputError: If the plan is invalid, or the target holds another data set.
    """
    from vrcaps.data.estimate import num_frames
    from vrcaps.data.ledger import complete_units, require_target
    from vrcaps.data.store import open_store
    from vrcaps.data.units import check_plan
    from vrcaps.recording.frame_sequence import SPLITS

    check_plan(units)
    store = open_store(out)
    require_target(store, plan)
    complete = set(complete_units(store, [units.name(index) for index in indices]))
    missing = [index for index in indices if units.name(index) not in complete]
    splits = ", ".join(f"{units.splits.count(s)} {s}" for s in SPLITS)
    console.print(
        f"{plan.settings.name}: {len(units.splits)} patients ({splits}), {len(units)} recordings."
    )
    if len(indices) < len(units):
        console.print(f"Selected: recordings {indices[0]} to {indices[-1]}.")
    if complete:
        console.print(f"{len(complete)} of them exist.")
    if not missing:
        console.print("Nothing to do: all are complete.")
        return missing
    console.print(f"To record: {len(missing)} recordings, {num_frames(units, missing):,} frames.")
    return missing


def _estimate(units: Units, missing: Sequence[int], out: str) -> None:
    """Print the estimated duration and size of the missing recordings.

    Raises:
        InputError: If the target lacks space, or a recording cannot be made.
    """
    from vrcaps.data.estimate import describe, estimate, require_space
    from vrcaps.data.store import open_store

    with progress_bar("measuring") as progress:
        cost = estimate(units, missing, progress)
    free = open_store(out).free_bytes()
    console.print(describe(cost, out, free))
    require_space(cost, out, free)


@dataclass(frozen=True)
class Composite:
    """Composite rendered lesions into real images without lesions, with exact masks.

    A lesion's change of the rendered wall relative to the clean twin is applied to random images,
    which keep their light. Others show films of blood or no lesion; half of all show other fluids.
    Requires a plan with channels radiance and instance, and clean_twin = { each = [false, true] }.

    For example:
      vrcaps dataset composite runs/pairs --into photos/normal --out runs/composites
      vrcaps train segmentation --data runs/composites --out runs/masks
    """

    dataset: Positional[str]
    """Folder or URL of the data set with the lesions."""

    into: tuple[str, ...]
    """Folders of real images without lesions, for training only."""

    out: Path
    """Folder to create: images and masks by kind of lesion, and normal images."""

    count: int = 1000
    """Number of images."""

    normal: float = 0.4
    """Fraction of images without a lesion."""

    fluid: float = 0.4
    """Fraction of the images with a lesion that show films of blood or hemorrhagic mucosa."""

    seed: int = 0
    """Random seed."""

    def run(self) -> None:
        """Write and report."""
        require_sources((self.dataset, *self.into))
        from vrcaps.core.files import require_new_folder
        from vrcaps.formats.io import read_sources
        from vrcaps.learn.compositing import CompositeSettings, lesion_pairs, write_composites

        require_new_folder(self.out)
        settings = CompositeSettings(self.count, self.normal, self.fluid, seed=self.seed)
        with progress_bar("reading") as show:
            pairs = lesion_pairs(read_sources((self.dataset,), show))
            images = read_sources(self.into, show)
        with progress_bar("compositing") as show:
            counts = write_composites(pairs, images, self.out, settings, progress=show)
        console.print(f"Wrote {self.out}: {', '.join(f'{n:,} {k}' for k, n in counts.items())}.")


@dataclass(frozen=True)
class Card:
    """Rewrite the data card of a data set: its README.md, as at the end of `dataset make`.

    The card describes contents and limits of the data set, how it was made, and how to read it; its
    header is in the format of the Hugging Face Hub. An existing file is replaced. License and
    description are taken from the plan.

    For example:
      vrcaps dataset card runs/cohort
    """

    dataset: Positional[str]
    """Folder or URL of the data set."""

    def run(self) -> None:
        """Write and report.

        Raises:
            InputError: If there is no data set.
        """
        require_folder(self.dataset, _DATASET)
        from vrcaps.data.card import CARD, write_card
        from vrcaps.data.store import open_store

        write_card(open_store(self.dataset))
        console.print(f"Wrote {self.dataset.rstrip('/')}/{CARD}.")


@dataclass(frozen=True)
class Show:
    """Show the contents of a data set: as an HTML page, and as a short table in the terminal.

    The page is one self-contained file: counts by split, organ, capsule, segment and lesion;
    histograms of depth, brightness and speed; frames with their channels; a mosaic. It samples 240
    images that are spread evenly over all recordings.

    For example:
      vrcaps dataset show runs/cohort
      vrcaps dataset show s3://bucket/cohort --out cohort.html
    """

    dataset: Positional[str]
    """Folder or URL of the data set."""

    out: Path | None = None
    """Page to write; by default NAME.html next to a local data set, here for a remote one."""

    def run(self) -> None:
        """Write the page and print the table.

        Raises:
            InputError: If there is no data set, or it is empty.
        """
        require_folder(self.dataset, _DATASET)
        require_extra("reports", "matplotlib")
        from vrcaps.data import open as open_dataset
        from vrcaps.data.card import read_plan_of
        from vrcaps.data.dataset import rows_of
        from vrcaps.data.store import open_store
        from vrcaps.data.units import Units
        from vrcaps.tools.reports.dataset_page import write_page
        from vrcaps.tools.reports.dataset_sample import sample

        store = open_store(self.dataset)
        plan, rows = read_plan_of(store), rows_of(store)
        if not rows:
            raise InputError(
                f"{self.dataset} contains no complete recording. Make one with "
                "`vrcaps dataset make`."
            )
        _print_counts(rows)
        out = self.out or _page_beside(self.dataset)
        with console.status("sampling frames"):
            sampled = sample(open_dataset(self.dataset))
            out.parent.mkdir(parents=True, exist_ok=True)
            write_page(out, plan.settings, rows, sampled, len(Units(plan)))
        console.print(f"Wrote {out}.")


def _page_beside(dataset: str) -> Path:
    """Default path of the page: next to a local data set, here for a remote one."""
    if "://" in dataset and not dataset.startswith("file://"):
        return Path(dataset.rstrip("/").rpartition("/")[2] + ".html")
    folder = Path(dataset.removeprefix("file://")).resolve()
    return folder.with_name(f"{folder.name}.html")


def _print_counts(rows: Sequence[Row]) -> None:
    from rich.table import Table

    from vrcaps.data.card import duration_text, size_text
    from vrcaps.data.dataset import by_split, count, count_by, lesion_counts

    table = Table(box=None, padding=(0, 2, 0, 0))
    for name in ("", "patients", "recordings", "frames", "recorded", "size"):
        table.add_column(name, justify="right" if name else "left")
    groups = [by_split(rows)]
    groups += [count_by(rows, lambda row, key=key: row.about[key]) for key in ("organ", "capsule")]
    groups.append({"all": count(rows)})
    for group in groups:
        for name, c in group.items():
            counts = (f"{n:,}" for n in (c.patients, c.recordings, c.frames))
            table.add_row(name, *counts, duration_text(c.seconds), size_text(c.num_bytes))
        table.add_row()
    console.print(table)
    lesions = (f"{n:,} {kind}" for kind, (n, _, _) in lesion_counts(rows).items())
    console.print(f"Lesions: {', '.join(lesions) or 'none'}.")
