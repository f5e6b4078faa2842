"""`vrcaps weights list`, `pull`, `publish`, `export`: published weights, referenced by name."""

from __future__ import annotations

import os
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from tyro.conf import Positional, UseAppendAction, arg

from vrcaps.cli.arguments import require_file, require_folder
from vrcaps.cli.console import console, progress_bar
from vrcaps.core.errors import InputError, reading


@dataclass(frozen=True)
class List:
    """List published weights: those of the checkout, or of the folder or URL in VRCAPS_WEIGHTS.

    For example:
      vrcaps weights list
    """

    def run(self) -> None:
        """Print one line per entry.

        Raises:
            InputError: If there are none.
        """
        from rich.table import Table

        from vrcaps.learn.hub import read_index, weights_folder

        location = weights_folder()
        table = Table(box=None, padding=(0, 2, 0, 0))
        for title in ("name", "task", "MB", "description"):
            table.add_column(title, overflow="fold", no_wrap=title != "description")
        index = read_index(location)
        for one in index.values():
            table.add_row(one.name, one.task, f"{one.bytes / 1e6:.1f}", one.summary)
        console.print(f"{len(index)} in {location}")
        console.print(table)


@dataclass(frozen=True)
class Pull:
    """Fetch published weights and their model cards, and verify their checksums.

    Commands such as `vrcaps predict` then find them by name. A checkout of vrcaps has them already.

    For example:
      vrcaps weights pull --from https://example.org/vrcaps-weights
      vrcaps weights pull depth segmentation --from /shared/vrcaps/weights
    """

    names: Positional[tuple[str, ...]] = ()
    """Names to fetch, see `vrcaps weights list`; by default all."""

    source: Annotated[str, arg(name="from")] = ""
    """Folder or URL with an index.json and the files; by default that in VRCAPS_WEIGHTS."""

    out: Path | None = None
    """Folder to write; by default the user's data folder, which all commands search."""

    def run(self) -> None:
        """Fetch and report.

        Raises:
            InputError: If there is no source, or a file differs from the index.
        """
        from vrcaps.learn.hub import VARIABLE, download_folder, pull

        source = self.source or os.environ.get(VARIABLE, "")
        if not source:
            raise InputError(
                f"No source is given. Add --from FOLDER or --from URL, such as the folder weights "
                f"of a checkout of vrcaps, or set {VARIABLE}."
            )
        folder = self.out or download_folder()
        with progress_bar("fetching") as show:
            entries = pull(source, self.names, folder=folder, progress=show)
        size = sum(one.bytes for one in entries) / 1e6
        names = ", ".join(one.name for one in entries)
        console.print(f"{len(entries)} files, {size:.1f} MB, in {folder}: {names}.")


@dataclass(frozen=True)
class Publish:
    """Publish the best weights of a training: file, model card and checksum.

    The card lists inputs, outputs, training data and metrics. Your notes are kept when the weights
    are published again.

    For example:
      vrcaps evaluate depth --weights runs/depth/best.safetensors --data runs/cohort --split test
      --out runs/depth-test
      vrcaps weights publish runs/depth --notes depth-notes.md --scores runs/depth-test
      vrcaps weights publish runs/c3vd --name depth-c3vd --notes c3vd.md --license CC-BY-NC-4.0
    """

    training: Positional[Path]
    """Output folder of `vrcaps train`."""

    name: str = ""
    """Name of the task, to be the default of its commands, or the task with a suffix after a
    dash."""

    scores: UseAppendAction[tuple[Path, ...]] = ()
    """Folder that `vrcaps evaluate TASK --out` wrote for these weights; repeat for more."""

    notes: Path | None = None
    """Markdown file with intended use and limits; by default the notes of the previous card."""

    license: str = "Apache-2.0"
    """License of the weights; third-party data may require another."""

    out: Path | None = None
    """Folder of published weights; by default that of the checkout."""

    def run(self) -> None:
        """Publish and report.

        Raises:
            InputError: If the folder is not one of a training, or a file is missing.
        """
        require_folder(self.training, "a training")
        for scored in self.scores:
            require_folder(scored, "an evaluation")
        notes = ""
        if self.notes is not None:
            require_file(self.notes, "a file of Markdown")
            with reading(self.notes):
                notes = self.notes.read_text("utf-8-sig")
        from vrcaps.learn.hub import weights_folder
        from vrcaps.learn.publishing import publish

        location = str(self.out or weights_folder())
        if "://" in location:
            raise InputError(f"{location} is not a local folder. Give --out FOLDER.")
        folder = Path(location)
        entry = publish(
            self.training,
            folder,
            name=self.name,
            evaluations=self.scores,
            notes=notes,
            license_name=self.license,
        )
        console.print(f"{entry.name}: {entry.summary}")
        console.print(f"Written: {folder / entry.file}, model card {entry.name}.md, index.json.")


@dataclass(frozen=True)
class Export:
    """Export trained weights as ONNX, which runs without PyTorch, and compare the two.

    Inputs and output are those of the model card. Batches may have any size; for super-resolution,
    so may images (with attention-unet, side lengths divisible by 2 per level). For sfm, the network
    of distances is exported, not the one of motion.

    For example:
      vrcaps weights export depth --out depth.onnx
      vrcaps weights export runs/segmentation/best.safetensors --out segmentation.onnx
    """

    weights: Positional[str]
    """File of trained weights, or the name of published ones."""

    out: Path
    """ONNX file to write."""

    def run(self) -> None:
        """Write, compare and report.

        Raises:
            InputError: If there are no such weights.
        """
        from vrcaps.core.errors import MissingExtraError, require
        from vrcaps.learn.checkpoint import onnx_difference, read_weights, write_onnx
        from vrcaps.learn.hub import find_weights

        require(self.out.suffix == ".onnx", "--out", self.out, "a name that ends in .onnx")
        trained = read_weights(find_weights(self.weights))
        write_onnx(self.out, trained)
        console.print(f"Written: {self.out}, {self.out.stat().st_size / 1e6:.1f} MB.")
        try:
            difference = onnx_difference(self.out, trained)
            console.print(f"Its outputs differ from those of PyTorch by at most {difference:.1e}.")
        except MissingExtraError:
            console.print("Not compared with PyTorch: onnxruntime is not installed.")
