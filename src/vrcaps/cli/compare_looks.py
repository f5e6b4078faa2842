"""`vrcaps compare-looks`: distance of rendered images to real ones."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from tyro.conf import Positional, UseAppendAction

from vrcaps.cli.arguments import require_outside, require_sources
from vrcaps.cli.console import console, progress_bar
from vrcaps.core.errors import InputError, require
from vrcaps.core.files import atomic_folder
from vrcaps.core.rng import MAX_SEED

if TYPE_CHECKING:
    from vrcaps.tools.appearance.compare import DescribedSet
    from vrcaps.tools.appearance.views import ImageSet

_MIN_IMAGES = 12
"""Minimum of --max-images, so that halves of the real set can be compared."""
_FEW = 50
"""Number of images of a set below which their distance is uncertain."""
_SECOND_REAL, _HALVES = "second real", "halves of the real set"
_TAKEN = (_SECOND_REAL, _HALVES, "statistic", "meaning", "real, 10 to 90 %")
"""Names of rows and columns of the tables."""


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
    """Real images, the reference. Near-duplicates are excluded."""

    second_real: str = ""
    """Real images of another recorder, whose distance is the unit of R."""

    other: UseAppendAction[tuple[str, ...]] = ()
    """Additional set to compare, NAME=SOURCE; repeat for more."""

    max_images: int = 300
    """Maximum number of images of each set, drawn at random, 12 or more; 22 per patient."""

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
        require(
            self.max_images >= _MIN_IMAGES,
            "--max-images",
            self.max_images,
            f"{_MIN_IMAGES} or more",
        )
        require(0 <= self.seed <= MAX_SEED, "--seed", self.seed, f"0 to {MAX_SEED}")
        sources = self._sources()
        require_sources(sources.values())
        if self.out is None:
            self._compare(sources, None)
            return
        require_outside(self.out, sources.values())
        try:
            self.out.parent.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise InputError(
                f"--out is {self.out}: cannot create its parent ({error.strerror}). Allowed: a new "
                "folder in a writable one."
            ) from error
        with atomic_folder(self.out) as folder:
            self._compare(sources, folder)
        console.print(f"Written: {self.out / 'index.html'}. Blind sheet: {self.out}/blind.png.")

    def _sources(self) -> dict[str, str]:
        """Source of each set by its name."""
        sources = {"ours": self.ours, "real": self.real}
        for text in self.other:
            name, equals, source = (part.strip() for part in text.partition("="))
            if not equals or not name or not source:
                raise InputError(
                    f"--other is {text!r}. Allowed: NAME=SOURCE, such as peer=peer-frames."
                )
            if name in (*sources, *_TAKEN):
                raise InputError(
                    f"--other is {text!r}, and the name {name!r} is taken. Give another name."
                )
            sources[name] = source
        return sources | ({_SECOND_REAL: self.second_real} if self.second_real else {})

    def _compare(self, sources: Mapping[str, str], folder: Path | None) -> None:
        """Print the distances, and write the report to a folder if one is given."""
        from rich.table import Table

        from vrcaps.tools.appearance.compare import (
            compare,
            halves,
            rows_of,
            without_duplicates,
            write_report,
        )

        images = {name: self._read(name, source) for name, source in sources.items()}
        real = without_duplicates(_described(images.pop("real")))
        first, second = halves(real, seed=self.seed)
        sets = {name: _described(one) for name, one in images.items()}
        results = compare(real, list(sets.values()), seed=self.seed)
        floor = compare(first, [second], seed=self.seed)
        unit = next((one.pooled for one in results if one.name == _SECOND_REAL), None)
        rows = rows_of((*results, *floor), unit)
        rows[-1]["set"] = _HALVES
        # A column per set fits into 80 characters.
        head, *lines = zip(rows[0], *(row.values() for row in rows), strict=True)
        table = Table(*head)
        for line in lines:
            table.add_row(*line)
        console.print(table)
        few = [f"{name} {num}" for name, one in sets.items() if (num := len(one.images)) < _FEW]
        if few:
            console.print(
                f"Few images: {', '.join(few)}. The intervals do not include the error of small "
                f"sets; give {_FEW} or more."
            )
        if unit is not None and unit <= 0.0:
            console.print(
                f"No R: the pooled KID of the {_SECOND_REAL} set is {unit:.2f}, not above 0."
            )
        if folder is not None:
            write_report(folder, real, sets["ours"], results, rows)

    def _read(self, name: str, source: str) -> ImageSet:
        from vrcaps.formats import read_source
        from vrcaps.tools.appearance.views import read_image_set

        with progress_bar(f"reading {name}") as show:
            return read_image_set(
                name,
                read_source(source, show),
                max_images=self.max_images,
                seed=self.seed,
                progress=show,
            )


def _described(images: ImageSet) -> DescribedSet:
    from vrcaps.tools.appearance.compare import describe

    with progress_bar(f"describing {images.name}") as show:
        return describe(images, progress=show)
