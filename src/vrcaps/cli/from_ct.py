"""`vrcaps organ from-ct`: organs from a CT scan or a label map."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Literal

import numpy as np
from tyro.conf import Positional

from vrcaps.cli.arguments import require_existing, require_out
from vrcaps.cli.console import console, progress_bar
from vrcaps.cli.organ import report_organ
from vrcaps.core.errors import InputError
from vrcaps.core.units import CM, MM

if TYPE_CHECKING:
    from collections.abc import Callable

    from vrcaps.organ.surface import OrganSurface
    from vrcaps.tools.ct.from_ct import WallOptions
    from vrcaps.tools.ct.lumen import GasPiece
    from vrcaps.tools.ct.volume import Volume


@dataclass(frozen=True)
class FromCt:
    """Make organs from a CT scan: from the gas in the gut, or from a label map or mask.

    Gas: the largest piece of gas inside the body, or the one at --seed-mm, or all of them. Labels:
    those of --labels on the scan's grid, or of SCAN itself if it is a label map; by ID, or by
    TotalSegmentator's names (version 2: stomach, duodenum, small_bowel, colon). Every organ is
    written as GLB in the patient frame (LPS, meters), with an overview figure.

    For example:
      vrcaps organ from-ct dicom/ --out colon.glb
      vrcaps organ from-ct dicom/ --series 2 --seed-mm 43 -120 -310 --tagged-fluid supine
      vrcaps organ from-ct ct.nii.gz --labels labels.nii.gz --label colon stomach
      vrcaps organ from-ct colon-mask.nii.gz --label 1 --anatomy colon --bridge-mm 40
    """

    scan: Positional[Path]
    """Folder of DICOM slices, or a NIfTI, NRRD or MetaImage file."""

    out: Path = Path("organ.glb")
    """File to write; with several organs, their names or indices are appended to the name."""

    series: str | None = None
    """DICOM series of a folder with several: its index in the list, or its UID."""

    labels: Path | None = None
    """Label map or mask on the scan's grid."""

    label: tuple[str, ...] = ()
    """Labels to make organs from, by ID or name; that of a mask is 1."""

    seed_mm: tuple[float, float, float] | None = None
    """Point in the gas of the lumen: x, y, z in the patient frame (LPS) [mm]."""

    all_pieces: bool = False
    """Make an organ of every piece of gas instead of only the largest."""

    threshold: int = -800
    """Hounsfield units below which a voxel is entirely gas; lower it if loops leak together."""

    tagged_fluid: Literal["supine", "prone", "left-lateral", "right-lateral"] | None = None
    """Posture of the patient; counts tagged fluid as lumen (electronic cleansing)."""

    bridge_mm: float = 0.0
    """Maximum gap between pieces to open to a channel; wider gaps are only reported."""

    edge_mm: float = 1.6
    """Mean edge length of the triangles."""

    blur: float | None = None
    """Blur of the scan beforehand [voxels]; by default 0.5 for gas, 0.7 for labels."""

    pass_band: float = 0.1
    """Pass band of the wall's smoothing: lower is smoother, 2 is none."""

    open_ends: Literal["cap", "keep"] = "cap"
    """Close the lumen (cap) or leave it open (keep) where the scan cuts it."""

    anatomy: Literal["any", "colon"] = "any"
    """Anatomy: a whole colon is divided into segments, and its lower end is the anal one."""

    reverse: bool = False
    """Use the other end of the lumen as the oral one."""

    def run(self) -> None:
        """Read, make, write and report."""
        require_out(self.out, ".glb")
        if self.labels is not None and not self.label:
            raise InputError(
                "--labels is given without --label. Give the labels to use, e.g. --label colon."
            )
        if self.label and (self.seed_mm or self.all_pieces or self.tagged_fluid):
            raise InputError(
                "--seed-mm, --all-pieces and --tagged-fluid apply to gas, not to labels. Omit "
                "them, or --label."
            )
        self._check_settings()
        require_existing((self.scan, *filter(None, [self.labels])), "a scan, or a folder of DICOM")
        is_label_map = bool(self.label) and self.labels is None
        scan = _read(self.scan, self.series, is_label_map=is_label_map)
        organs = self._from_labels(scan) if self.label else self._from_gas(scan)
        for path, organ in organs:
            _write(path, organ)

    def _check_settings(self) -> None:
        """Check the settings before reading a scan, which takes up to a minute."""
        for path in (self.scan, self.labels):
            if path is not None and not path.exists():
                raise InputError(f"No scan at {path}. Give a DICOM folder or a NIfTI file.")
        from vrcaps.tools.ct.from_ct import label_number, require_threshold

        self._wall()
        require_threshold(self.threshold)
        for label in self.label:
            label_number(label)

    def _wall(self) -> WallOptions:
        from vrcaps.tools.ct.from_ct import WallOptions

        return WallOptions(
            edge=self.edge_mm * MM,
            blur=self.blur,
            pass_band=self.pass_band,
            bridge=self.bridge_mm * MM,
            open_ends=self.open_ends,
            reverse=self.reverse,
            anatomy=self.anatomy,
        )

    def _from_gas(self, scan: Volume) -> Iterator[tuple[Path, OrganSurface]]:
        from vrcaps.tools.ct.from_ct import find_lumens, organ_from_gas
        from vrcaps.tools.ct.lumen import choose_gas

        wall = self._wall()
        with _steps("segmenting gas"):
            gas = find_lumens(scan, threshold=self.threshold)
        seed = None if self.seed_mm is None else np.array(self.seed_mm) * MM
        pieces = choose_gas(gas, scan, seed=seed)
        _list_pieces(gas.pieces)
        pieces = pieces if self.all_pieces else pieces[:1]
        for number, piece in enumerate(pieces, start=1):
            path = self._path(f"{number}", len(pieces))
            with _steps(path.stem) as report:
                organ = organ_from_gas(
                    scan,
                    gas,
                    piece,
                    wall=wall,
                    name=path.stem,
                    tagged_fluid=self.tagged_fluid,
                    report=report,
                )
            yield path, organ

    def _from_labels(self, scan: Volume) -> Iterator[tuple[Path, OrganSurface]]:
        from vrcaps.tools.ct.from_ct import check_label, misplaced, organ_from_label
        from vrcaps.tools.ct.scan_files import read_volume
        from vrcaps.tools.ct.volume import common_part

        wall, labels = self._wall(), scan
        if self.labels is not None:
            scan, labels = common_part(scan, read_volume(self.labels, is_label_map=True))
        values = [check_label(labels, label) for label in self.label]
        for label, value in zip(self.label, values, strict=True):
            path = self._path(label, len(values))
            name = label if not label.isdigit() else "wall"
            with _steps(path.stem) as report:
                organ = organ_from_label(
                    labels, value, wall=wall, name=path.stem, label_name=name, report=report
                )
            if self.labels is not None and (warning := misplaced(scan, labels, value)):
                organ.metadata["notes"].append(warning)
            yield path, organ

    def _path(self, which: str, num: int) -> Path:
        """File of one of several organs."""
        return self.out if num == 1 else self.out.with_name(f"{self.out.stem}-{which}.glb")


def _read(path: Path, series: str | None, *, is_label_map: bool) -> Volume:
    from vrcaps.tools.ct.scan_files import read_volume

    with progress_bar("reading slices") as progress:
        return read_volume(path, series=series, is_label_map=is_label_map, progress=progress)


@contextmanager
def _steps(title: str) -> Iterator[Callable[[str], None]]:
    """Status line on the terminal that shows the current step."""
    with console.status(title) as status:
        yield lambda step: status.update(f"{title}: {step}")


def _list_pieces(pieces: tuple[GasPiece, ...]) -> None:
    """Print the pieces of gas, largest first."""
    from rich.table import Table

    table = Table("gas", "volume", "inside it (LPS, mm)", "HU", box=None, padding=(0, 2, 0, 0))
    for piece in pieces:
        position = " ".join(f"{x / MM:.1f}" for x in piece.center)
        table.add_row(
            piece.kind, f"{piece.volume / CM**3:.1f} ml", position, f"{piece.hounsfield:.0f}"
        )
    console.print(table)


def _write(path: Path, organ: OrganSurface) -> None:
    from vrcaps.organ.organ_file import write_organ

    write_organ(path, organ)
    console.print(f"Wrote {path} (unit: m).")
    report_organ(organ, path.with_name(f"{path.stem}-overview.png"))
    for note in organ.metadata["notes"]:
        console.print(f"Note: {note}.")
    console.print(f"Record it: vrcaps record --organ {path} --out DIR")
