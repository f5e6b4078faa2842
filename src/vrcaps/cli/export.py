"""`vrcaps export FORMAT`: write episodes and data sets in the layouts of others."""

from __future__ import annotations

import inspect
from dataclasses import dataclass, fields
from math import radians
from pathlib import Path
from typing import Any, ClassVar

from tyro.conf import Positional

from vrcaps.cli.console import console, progress_bar
from vrcaps.data.plan import SPLITS
from vrcaps.errors import UnknownNameError
from vrcaps.formats.format import Format
from vrcaps.formats.registry import FORMATS


@dataclass(frozen=True, kw_only=True)
class Export:
    """What the exports to all formats have in common."""

    source: Positional[Path]
    """Folder of an episode or of a data set."""

    out: Path
    """Folder to make; it appears when all is written."""

    camera: str | None = None
    """Only this camera; by default all of the capsule."""

    split: str | None = None
    """Only this split of a data set: train, val or test."""

    rectify: float | None = None
    """Resample to a pinhole with this angle from left to right [degrees], below 180; depth, flow
    and masks follow. The middle keeps its resolution."""

    form: ClassVar[type[Format]]

    def run(self) -> None:
        """Export and report.

        Raises:
            InputError: If the format cannot hold what was recorded.
        """
        from vrcaps.data.sequences import sequences_of
        from vrcaps.formats.export import export
        from vrcaps.formats.rectify import rectified

        if self.split is not None and self.split not in SPLITS:
            raise UnknownNameError("split", self.split, SPLITS)
        options = [f.name for f in fields(self.form)]  # type: ignore[arg-type]
        form = self.form(**{name: getattr(self, name) for name in options})
        sequences = sequences_of(self.source, camera=self.camera, split=self.split)
        if self.rectify is not None:
            sequences = tuple(rectified(one, radians(self.rectify)) for one in sequences)
        with progress_bar("exporting") as progress:
            export(form, sequences, self.out, progress=progress)
        frames = sum(map(len, sequences))
        console.print(f"Wrote {len(sequences)} sequences, {frames} frames, into {self.out}.")


def __getattr__(kind: str) -> Any:
    """The command that exports to a format: what all have in common, and the format's options."""
    if kind not in FORMATS:
        raise AttributeError(kind)
    form = FORMATS[kind]
    meaning, attributes, options = inspect.cleandoc(form.__doc__ or "").partition("Attributes:")
    example = f"For example:\n  vrcaps export {kind} runs/colon --out runs/colon-{kind}\n\n"
    doc = f"{meaning.rstrip()}\n\n{example}{attributes}{options}"
    own: dict[str, Any] = {"form": form, "__doc__": doc, "__module__": __name__}
    return dataclass(frozen=True, kw_only=True)(type(form.__name__, (Export, form), own))
