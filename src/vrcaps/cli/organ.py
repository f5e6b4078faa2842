"""`vrcaps organ`: generate an organ, look at an organ file."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

from tyro.conf import Positional, UseAppendAction

from vrcaps.cli.console import console
from vrcaps.cli.lesions import chosen_lesions, lesion_lines
from vrcaps.errors import InputError
from vrcaps.units import CM, MM

if TYPE_CHECKING:
    from vrcaps.organ.facts import OrganFacts
    from vrcaps.organ.surface import OrganSurface


@dataclass(frozen=True)
class Inspect:
    """Print size, volume, area, length, calibre and defects of a mesh file; draw a picture.

    The mesh is repaired first, as a recording would, and every repair is listed.

    For example:
      vrcaps organ inspect colon.ply --unit mm
      vrcaps organ inspect scan.stl --unit 5cm --picture scan.png
    """

    file: Positional[Path]
    """Mesh file: PLY, OBJ, STL, GLB."""

    unit: str
    """Length unit of the file: m, dm, cm, mm, um, or e.g. 5cm. Never guessed."""

    open_ends: Literal["cap", "keep"] = "cap"
    """Whether the lumen's open ends are capped or kept."""

    reverse: bool = False
    """Whether the narrower end of the lumen is the oral one."""

    picture: Path | None = None
    """Picture to write; by default <name>-overview.png in the working directory."""

    def run(self) -> None:
        """Inspect and report."""
        from vrcaps.organ.from_file import organ_from_file

        with console.status("reading, repairing and measuring"):
            organ = organ_from_file(
                self.file, unit=self.unit, open_ends=self.open_ends, reverse=self.reverse
            )
        report_organ(organ, self.picture or Path(f"{organ.name}-overview.png"))


@dataclass(frozen=True)
class Make:
    """Generate an organ and write it as a GLB file, textures included; draw a picture.

    For example:
      vrcaps organ make colon --seed 3 --out colon-3.glb
      vrcaps organ make colon --lesion polyp-Ip:size=12mm,segment=sigmoid --lesion colitis-2
      vrcaps organ make stomach --seed 3 --condition inflated
    """

    name: Positional[str]
    """Which organ: colon, stomach, small-bowel, or gi, all three as one wall."""

    seed: int = 0
    """A different patient for each."""

    condition: Literal["inflated", "normal", "collapsed"] | None = None
    """How full it is; by default the colon is inflated, all else normal."""

    mucosa: str | None = None
    """Look of the wall: colon, stomach or small_intestine, or the folder of a texture that
    vrcaps organ texture wrote; by default the organ's own."""

    out: Path | None = None
    """File to write; by default <name>-<seed>.glb in the working directory. In metres."""

    lesion: Annotated[tuple[str, ...], UseAppendAction] = ()
    """Put this into the organ; give it again for more. As in vrcaps record."""

    lesions: str | None = None
    """A file of lesions (TOML or JSON), or prevalence. As in vrcaps record."""

    clean_twin: bool = False
    """Write the clean twin too, as <out>-clean.glb."""

    def run(self) -> None:
        """Generate and report."""
        import numpy as np

        from vrcaps.organ.catalog import load_organ
        from vrcaps.organ.lesion import add_lesions
        from vrcaps.organ.write import write_glb

        out = self.out or Path(f"{self.name}-{self.seed}.glb")
        if out.suffix != ".glb":
            raise InputError(f"--out is {out}. Allowed: a name that ends in .glb.")
        with console.status("generating"):
            organ = load_organ(
                self.name, seed=self.seed, condition=self.condition, mucosa=self.mucosa
            )
            lesions = chosen_lesions(self.lesion, self.lesions, self.seed)
            patient = add_lesions(organ, lesions, np.random.default_rng([self.seed, 3]))
            organ = patient.organ if lesions else organ
            write_glb(out, organ)
            if self.clean_twin:
                write_glb(out.with_name(f"{out.stem}-clean.glb"), patient.clean)
        console.print(f"Wrote {out} (unit: m).")
        for line in lesion_lines(organ.metadata.get("lesions", []), organ.centerline.length):
            console.print(f"Lesion {line}.")
        report_organ(organ, out.with_name(f"{out.stem}-overview.png"))


def report_organ(organ: OrganSurface, picture: Path) -> None:
    """Print the facts as a table, and the repairs of a mesh file, and write the picture."""
    from rich.table import Table

    from vrcaps.organ.facts import organ_facts
    from vrcaps.render.overview import write_overview

    facts = organ_facts(organ)
    table = Table(show_header=False, box=None, padding=(0, 2, 0, 0))
    for name, value in _rows(facts):
        table.add_row(name, value)
    lists = {"defects": facts.defects}
    if "repairs" in organ.metadata:
        lists["repairs"] = organ.metadata["repairs"]
    for title, lines in lists.items():
        for number, line in enumerate(lines or ("none",)):
            table.add_row("" if number else title, line)
    console.print(table)
    write_overview(organ, picture)
    console.print(f"Look at {picture}.")


def _rows(facts: OrganFacts) -> list[tuple[str, str]]:
    size = " × ".join(f"{side / CM:.1f}" for side in facts.size)
    calibre = [
        f"{c / MM:.1f}" for c in (facts.calibre_min, facts.calibre_median, facts.calibre_max)
    ]
    rows = [
        ("organ", facts.name),
        ("size", f"{size} cm"),
        ("lumen volume", f"{facts.volume / CM**3:.0f} ml"),
        ("wall area", f"{facts.area / CM**2:.0f} cm²"),
        ("length", f"{facts.length / CM:.1f} cm along the centreline"),
        ("calibre", f"{calibre[1]} mm (median), from {calibre[0]} to {calibre[2]} mm"),
    ]
    if len(facts.calibre_by_segment) > 1:
        rows += [
            (f"  {name}", f"{calibre / MM:.1f} mm")
            for name, calibre in facts.calibre_by_segment.items()
        ]
    quality = f"mean quality {facts.quality_mean:.2f}, 5th percentile {facts.quality_p5:.2f}"
    return [
        *rows,
        ("mesh", f"{facts.num_vertices} vertices, {facts.num_faces} triangles, {quality}"),
    ]
