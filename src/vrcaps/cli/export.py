"""`vrcaps export FORMAT`: write episodes and data sets in other layouts."""

from __future__ import annotations

from dataclasses import dataclass
from math import radians
from pathlib import Path
from typing import Any, ClassVar

from tyro.conf import Positional

from vrcaps.cli.arguments import require_folder
from vrcaps.cli.console import console, progress_bar
from vrcaps.cli.parts import command_of, part_of
from vrcaps.core.errors import UnknownNameError
from vrcaps.formats.format import FORMATS, Format
from vrcaps.recording.frame_sequence import SPLITS


@dataclass(frozen=True, kw_only=True)
class Export:
    """Options shared by the exports to all formats."""

    source: Positional[str]
    """Folder or URL of an episode or of a data set."""

    out: Path
    """Folder to create; it appears when the export is complete."""

    camera: str | None = None
    """Camera to export; by default all of the capsule."""

    split: str | None = None
    """Split of a data set to export: train, val or test."""

    rectify: float | None = None
    """Resample to a pinhole with this horizontal field of view [degrees], below 180; depth, flow
    and masks follow. The resolution at the center is kept."""

    part: ClassVar[type[Format]]

    def run(self) -> None:
        """Export and report.

        Raises:
            InputError: If the format does not support the recording.
        """
        require_folder(self.source, "an episode or a data set")
        from vrcaps.data.dataset import sequences_of
        from vrcaps.formats.io import export
        from vrcaps.formats.rectify import rectified

        if self.split is not None and self.split not in SPLITS:
            raise UnknownNameError("split", self.split, SPLITS)
        form = part_of(self)
        with progress_bar("reading") as show:
            sequences = sequences_of(
                self.source, camera=self.camera, split=self.split, progress=show
            )
        if self.rectify is not None:
            sequences = tuple(rectified(one, radians(self.rectify)) for one in sequences)
        with progress_bar("exporting") as progress:
            export(form, sequences, self.out, progress=progress)
        frames = sum(map(len, sequences))
        noun = "sequence" if len(sequences) == 1 else "sequences"
        console.print(f"Wrote {len(sequences)} {noun}, {frames} frames, into {self.out}.")


def __getattr__(kind: str) -> Any:
    """Export command of a format: shared options and those of the format."""
    if kind not in FORMATS:
        raise AttributeError(kind)
    examples = f"  vrcaps export {kind} runs/colon --out runs/colon-{kind}"
    return command_of(Export, FORMATS[kind], examples)
