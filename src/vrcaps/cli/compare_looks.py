"""`vrcaps compare-looks`: distance of rendered images to real ones."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from tyro.conf import Positional, UseAppendAction

from vrcaps.cli.arguments import require_sources
from vrcaps.cli.console import console, progress_bar
from vrcaps.core.errors import InputError

if TYPE_CHECKING:
    from vrcaps.tools.appearance.compare import DescribedSet

_MIN_REAL = 12
"""Minimum number of real images, so that halves of them can be compared."""


@dataclass(frozen=True)
class CompareLooks:
    """Measure how far images are from real endoscopic images.

    Views of equal size are cut from both sets and described by the features of EfficientNet-Lite0
    at three depths and by statistics of exposure, color and texture. The kernel inception distance
    (KID) of both sets is reported next to that of two halves of the real set, and of a second real
    set if one is given: R is the ratio to the latter. Sets may be folders of images, episodes, data
    sets, or KIND:FOLDER. Needs the extra `learn`.

    For example:
      vrcaps compare-looks runs/cohort real-frames --out runs/looks
      vrcaps compare-looks runs/cohort real-frames --second-real other-recorder --out runs/looks
      vrcaps compare-looks runs/new real-frames --other before=runs/old --other peer=peer-frames
    """

    ours: Positional[str]
    """Images to compare."""

    real: Positional[str]
    """Real images, the reference. Near-duplicates are left out."""

    second_real: str = ""
    """Real images of another recorder, whose distance is the unit of R."""

    other: UseAppendAction[tuple[str, ...]] = ()
    """Further set to compare, NAME=SOURCE; repeat for more."""

    max_images: int = 300
    """Maximum number of images of each set, drawn at random; at most 22 of a patient."""

    out: Path | None = None
    """Output folder: index.html with nearest images, looks.csv, statistics.csv, and blind.png with
    its answers."""

    seed: int = 0
    """Seed of the drawn images and of the bootstrap."""

    def run(self) -> None:
        """Compare and report.

        Raises:
            InputError: If a set has too few images or cannot be read.
            MissingExtraError: If PyTorch is not installed.
        """
        others = [_named(text) for text in self.other]
        sources = {"ours": self.ours, "real": self.real, **dict(others)}
        if self.second_real:
            sources["second real"] = self.second_real
        require_sources(tuple(sources.values()))
        from rich.table import Table

        from vrcaps.core.files import require_new_folder
        from vrcaps.tools.appearance.compare import compare, halves, without_duplicates
        from vrcaps.tools.appearance.report import rows_of, write_report

        if self.out is not None:
            require_new_folder(self.out)
        sets = {name: self._described(name, source) for name, source in sources.items()}
        real = without_duplicates(sets.pop("real"))
        if len(real.images) < _MIN_REAL:
            raise InputError(
                f"The real set has {len(real.images)} images without near-duplicates. Allowed: "
                f"{_MIN_REAL} or more."
            )
        first, second = halves(real, seed=self.seed)
        results = compare(real, list(sets.values()), seed=self.seed)
        floor = compare(first, [second], seed=self.seed)
        unit = next((one.pooled for one in results if one.name == "second real"), None)
        rows = rows_of((*results, *floor), unit)
        rows[-1]["set"] = "halves of the real set"
        table = Table(*rows[0])
        for row in rows:
            table.add_row(*row.values())
        console.print(table)
        if self.out is not None:
            self.out.mkdir(parents=True, exist_ok=True)
            write_report(self.out, real, sets["ours"], results, unit)
            console.print(f"Written: {self.out / 'index.html'}. Blind sheet: {self.out}/blind.png.")

    def _described(self, name: str, source: str) -> DescribedSet:
        from vrcaps.formats import read_source
        from vrcaps.tools.appearance.compare import describe
        from vrcaps.tools.appearance.image_set import read_image_set

        with progress_bar(f"reading {name}") as show:
            images = read_image_set(
                name,
                read_source(source),
                max_images=self.max_images,
                seed=self.seed,
                progress=show,
            )
        with progress_bar(f"describing {name}") as show:
            return describe(images, progress=show)


def _named(text: str) -> tuple[str, str]:
    name, equals, source = text.partition("=")
    if not equals or not name or not source or name in ("ours", "real", "second real"):
        raise InputError(f"--other is {text!r}. Allowed: NAME=SOURCE, such as peer=peer-frames.")
    return name, source
