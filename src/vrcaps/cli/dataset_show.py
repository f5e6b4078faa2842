"""`vrcaps dataset card`, `vrcaps dataset show`: describe the contents of a data set."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from tyro.conf import Positional

from vrcaps.cli.arguments import require_folder
from vrcaps.cli.console import console
from vrcaps.core.errors import InputError

if TYPE_CHECKING:
    from vrcaps.data.counts import Row

_WHAT = "a data set: the --out of `vrcaps dataset make`"


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
        require_folder(self.dataset, _WHAT)
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
        require_folder(self.dataset, _WHAT)
        from vrcaps.data import open as open_dataset
        from vrcaps.data.card import read_plan_of
        from vrcaps.data.counts import rows_of
        from vrcaps.data.store import open_store
        from vrcaps.data.units import Units
        from vrcaps.tools.reports.dataset_page import write_page
        from vrcaps.tools.reports.dataset_sample import sample

        store = open_store(self.dataset)
        plan, rows = read_plan_of(store), rows_of(store)
        if not rows:
            raise InputError(
                f"{self.dataset} holds no whole recording yet. Make one with `vrcaps dataset make`."
            )
        _print_counts(rows)
        out = self.out or _page_beside(self.dataset)
        with console.status("looking at frames"):
            found = sample(open_dataset(self.dataset))
            out.parent.mkdir(parents=True, exist_ok=True)
            write_page(out, plan.settings, rows, found, len(Units(plan)))
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
    from vrcaps.data.counts import by_split, count, count_by, lesion_counts

    table = Table(box=None, padding=(0, 2, 0, 0))
    for name in ("", "patients", "recordings", "frames", "recorded", "size"):
        table.add_column(name, justify="right" if name else "left")
    groups = [by_split(rows)]
    groups += [count_by(rows, lambda row, key=key: row.about[key]) for key in ("organ", "capsule")]
    groups.append({"all": count(rows)})
    for group in groups:
        for name, c in group.items():
            numbers = (f"{n:,}" for n in (c.patients, c.recordings, c.frames))
            table.add_row(name, *numbers, duration_text(c.seconds), size_text(c.num_bytes))
        table.add_row()
    console.print(table)
    lesions = (f"{number:,} {kind}" for kind, (number, _, _) in lesion_counts(rows).items())
    console.print(f"Lesions: {', '.join(lesions) or 'none'}.")
