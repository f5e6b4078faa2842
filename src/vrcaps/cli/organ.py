"""`vrcaps organ`: generate an organ, inspect an organ file, list the catalog."""

from __future__ import annotations

from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

from tyro.conf import Positional, UseAppendAction

from vrcaps.cli.arguments import require_out
from vrcaps.cli.console import console
from vrcaps.core.errors import InputError
from vrcaps.core.units import CM, LENGTH_UNITS, MM
from vrcaps.organ.organ_file import is_organ_file
from vrcaps.organ.segments import Distension
from vrcaps.scenario.scenario import OrganFile, organ_named, parse_lesions

if TYPE_CHECKING:
    from vrcaps.organ.measure import OrganMeasures
    from vrcaps.organ.surface import OrganSurface


def lesion_lines(records: Sequence[dict[str, Any]], length: float) -> list[str]:
    """One line per lesion of an organ.

    Args:
        records: Lesions of `OrganSurface.metadata` or `episode.json`.
        length: Length of the centerline [m].
    """
    lines = []
    for record in records:
        fraction = record["arc_length_m"] / length
        size = record["specification"].get("size")
        words = [record["kind"], record["grade"], f"of {size / MM:.1f} mm" if size else ""]
        lines.append(
            f"{record['instance']}: {' '.join(word for word in words if word)}, "
            f"{record['segment']}, {record['arc_length_m'] / CM:.1f} cm "
            f"({fraction:.3f} of the centerline)"
        )
    return lines


_PICTURES = (".png", ".jpg", ".pdf", ".svg")


@dataclass(frozen=True)
class Inspect:
    """Measure an organ and draw it: outside, inside each segment, unrolled, width, lesions.

    The organ is a mesh file, which is first repaired as for a recording (every repair is listed),
    an organ file written by vrcaps, or a generated organ.

    For example:
      vrcaps organ inspect colon.ply --unit mm
      vrcaps organ inspect scan.stl --unit 5cm --picture scan.png
      vrcaps organ inspect colon-3.glb
      vrcaps organ inspect stomach --seed 3 --distension collapsed
    """

    organ: Positional[str]
    """Mesh file (PLY, OBJ, STL, GLB), organ file (GLB), or an organ of `vrcaps organ list`."""

    unit: str | None = None
    """Length unit of a mesh file: m, dm, cm, mm, um, or e.g. 5cm. Never guessed. An organ file
    needs none."""

    open_ends: Literal["cap", "keep"] = "cap"
    """Cap or keep the open ends of a mesh file's lumen."""

    reverse: bool = False
    """Use the narrower end of a mesh file's lumen as the oral one."""

    seed: int | None = None
    """Patient seed of a generated organ; by default 0."""

    distension: Distension | None = None
    """Distension of a generated organ."""

    mucosa: str | None = None
    """Mucosa of `vrcaps organ list` to apply to a mesh file in the figure."""

    picture: Path | None = None
    """Image to write; by default <file>-overview.png, or <name>-<seed>-overview.png of a generated
    organ, in the working directory."""

    def run(self) -> None:
        """Inspect and report."""
        picture = self.picture
        if picture is not None and picture.suffix.lower() not in _PICTURES:
            raise InputError(f"--picture is {picture}. Allowed: {', '.join(_PICTURES)}.")
        with console.status("reading, repairing and measuring the organ"):
            organ = self._load()
        for line in lesion_lines(organ.metadata.get("lesions", []), organ.centerline.length):
            console.print(f"Lesion {line}.")
        report_organ(organ, picture or Path(f"{self._stem()}-overview.png"))

    def _stem(self) -> str:
        """Start of the default name of the picture."""
        is_file = isinstance(organ_named(self.organ), OrganFile)
        return Path(self.organ).stem if is_file else f"{self.organ}-{self.seed or 0}"

    def _load(self) -> OrganSurface:
        from vrcaps.anatomy.catalog import generate_organ

        if isinstance(organ_named(self.organ), OrganFile):
            if self.seed is not None or self.distension is not None:
                raise InputError("--seed and --distension require a generated organ, not a file.")
            return self._load_file(Path(self.organ))
        if (self.unit, self.open_ends, self.reverse, self.mucosa) != (None, "cap", False, None):
            raise InputError(
                f"--unit, --open-ends, --reverse and --mucosa require a file, but {self.organ!r} "
                "is a name. Omit them, or give the path of a PLY, OBJ, STL or GLB."
            )
        return generate_organ(self.organ, seed=self.seed or 0, distension=self.distension)

    def _load_file(self, path: Path) -> OrganSurface:
        from vrcaps.mucosa.bake import bake_appearance
        from vrcaps.organ.read_organ import read_organ

        if not path.is_file():
            raise InputError(f"No file at {path}. Give the path of a PLY, OBJ, STL or GLB.")
        unit = self.unit
        if not is_organ_file(path):
            unit = _require_unit(unit, path)
        organ = read_organ(path, unit=unit, open_ends=self.open_ends, reverse=self.reverse)
        if self.mucosa is None:
            return organ
        if organ.appearance is not None:
            raise InputError(f"{path} already has textures. Omit --mucosa.")
        return replace(organ, appearance=bake_appearance(organ, seed=0, mucosa=self.mucosa))


@dataclass(frozen=True)
class Make:
    """Generate an organ, write it as a GLB file with textures, and draw a figure.

    For example:
      vrcaps organ make colon --seed 3 --out colon-3.glb
      vrcaps organ make colon --lesion polyp-Ip:size=12mm,segment=sigmoid --lesion colitis-2
      vrcaps organ make colon --seed 7 --lesions prevalence --clean-twin
      vrcaps organ make stomach --seed 3 --distension inflated
    """

    name: Positional[str]
    """Organ of `vrcaps organ list`, such as stomach; full-tract joins all three in one wall."""

    seed: int = 0
    """Patient seed; each seed is a different patient."""

    distension: Distension | None = None
    """Distension; by default the colon is inflated, the small bowel collapsed, all others are
    normal."""

    mucosa: str | None = None
    """Appearance of the wall: colon, stomach or small-bowel, or the folder of a texture written by
    vrcaps organ texture; by default the organ's own."""

    out: Path | None = None
    """File to write; by default <name>-<seed>.glb in the working directory. In meters."""

    lesion: Annotated[tuple[str, ...], UseAppendAction] = ()
    """Lesion to put into the organ; repeat for more: a name and values that differ from its
    defaults, such as bleeding-3:segment=jejunum or polyp-IIa-serrated. See vrcaps organ list."""

    lesions: str | None = None
    """File of lesions (TOML or JSON), or prevalence: as many as a screening patient has."""

    posture: str = "supine"
    """Posture of the patient: supine, prone, left-lateral, right-lateral or standing; blood runs
    down from its source."""

    clean_twin: bool = False
    """Also write the clean twin, as <out>-clean.glb."""

    def run(self) -> None:
        """Generate and report."""
        from vrcaps.organ.organ_file import write_organ

        out = self.out or Path(f"{self.name}-{self.seed}.glb")
        require_out(out, ".glb")
        with console.status("generating"):
            organ, clean = self._patient()
        for line in lesion_lines(organ.metadata.get("lesions", []), organ.centerline.length):
            console.print(f"Lesion {line}.")
        files = {out: organ}
        if clean is not None:
            files[out.with_name(f"{out.stem}-clean.glb")] = clean
        with ThreadPoolExecutor(1) as writer:  # the files are written while the overview is drawn
            written = {path: writer.submit(write_organ, path, own) for path, own in files.items()}
            report_organ(organ, out.with_name(f"{out.stem}-overview.png"))
            for path, done in written.items():
                done.result()
                console.print(f"Wrote {path} (unit: m).")

    def _patient(self) -> tuple[OrganSurface, OrganSurface | None]:
        """Organ with its lesions, if any, and the clean twin if requested."""
        from vrcaps.scenario.build import resolve
        from vrcaps.scenario.scenario import OrganGenerated, Scenario

        lesions = parse_lesions(self.lesion, self.lesions, self.seed, self.name)
        patient = OrganGenerated(self.name, self.seed, self.distension, self.mucosa)
        scenario = Scenario(organ=patient, lesions=lesions, posture=self.posture, variation=False)
        organ = resolve(scenario).organ
        return organ.load_pair() if self.clean_twin else (organ.load(), None)


def report_organ(organ: OrganSurface, picture: Path) -> None:
    """Print the measures as a table, and the repairs of a mesh file, and write the picture.

    Without Matplotlib, the picture is omitted.
    """
    from importlib.util import find_spec

    from rich.table import Table

    from vrcaps.organ.measure import measure_organ
    from vrcaps.tools.reports.overview import write_overview

    facts = measure_organ(organ)
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
    if find_spec("matplotlib") is None:
        console.print(r"For a figure: pip install 'vrcaps\[reports]'")
        return
    with console.status("drawing"):
        write_overview(organ, picture, facts=facts)
    console.print(f"Figure: {picture}.")


def _rows(facts: OrganMeasures) -> list[tuple[str, str]]:
    size = " × ".join(f"{side / CM:.1f}" for side in facts.size)
    diameter = [
        f"{c / MM:.1f}" for c in (facts.diameter_min, facts.diameter_median, facts.diameter_max)
    ]
    rows = [
        ("organ", facts.name),
        ("size", f"{size} cm"),
        ("lumen volume", f"{facts.volume / CM**3:.0f} ml"),
        ("wall area", f"{facts.area / CM**2:.0f} cm²"),
        ("length", f"{facts.length / CM:.1f} cm along the centerline"),
        (
            "inscribed ball",
            f"{diameter[1]} mm in diameter (median), from {diameter[0]} to {diameter[2]} mm",
        ),
    ]
    if len(facts.diameter_by_segment) > 1:
        rows += [
            (f"  {name}", f"{diameter / MM:.1f} mm")
            for name, diameter in facts.diameter_by_segment.items()
        ]
    quality = f"mean quality {facts.quality_mean:.2f}, 5th percentile {facts.quality_p5:.2f}"
    return [
        *rows,
        ("mesh", f"{facts.num_vertices} vertices, {facts.num_faces} triangles, {quality}"),
    ]


def _require_unit(unit: str | None, path: Path) -> str:
    if unit is None:
        raise InputError(
            f"--unit is missing: {path} has no unit. "
            f"Allowed: {', '.join(LENGTH_UNITS)}, or e.g. 5cm."
        )
    return unit


@dataclass(frozen=True)
class List:
    """List the built-in organs, lesions, mucosae, effects and capsules, and commands to try.

    For example:
      vrcaps organ list
    """

    def run(self) -> None:
        """Print the tables."""
        from vrcaps.camera_pipeline.effects import EFFECTS
        from vrcaps.capsule.device_file import device_names, read_device
        from vrcaps.lesion import lesion_library
        from vrcaps.mucosa.mucosa import MUCOSAE
        from vrcaps.organ.segments import DISTENSIONS, ORGANS, organ_segments

        usual = "colon inflated, small bowel collapsed, all else normal"
        _print("organs", [(name, _joined(organ_segments(name))) for name in ORGANS])
        _print("distension", [("--distension", f"{', '.join(DISTENSIONS)}; by default {usual}")])
        _print("lesions, in any organ", _lesions())
        _print(f"library of {len(lesion_library())} lesions by name", _library())
        photos = "or the folder of a texture from your photographs (vrcaps organ texture)"
        _print("mucosae", [("--mucosa", f"{', '.join(MUCOSAE)}; {photos}")])
        devices = [read_device(name) for name in device_names()]
        _print("capsules", [(device.name, device.title) for device in devices])
        _print("camera effects", [(name, kind.summary()) for name, kind in EFFECTS.items()])
        console.print("Next:")
        for line in (
            "vrcaps organ make stomach --seed 3                 write one as GLB, with a picture",
            "vrcaps organ inspect full-tract --seed 3           only the picture",
            "vrcaps organ make colon --lesion polyp-Ip:size=12mm,segment=sigmoid",
            "vrcaps record --organ colon-0.glb --out runs/mine  record in the file written",
            "vrcaps record --organ stomach --out runs/stomach   record in a generated one",
        ):
            console.print(f"  {line}")


def _print(title: str, rows: list[tuple[str, str]]) -> None:
    from rich.table import Table

    if title:
        console.print(title.upper())
    table = Table(show_header=False, box=None, padding=(0, 2, 0, 2))
    table.add_column(no_wrap=True)
    table.add_column(overflow="fold")
    for row in rows:
        table.add_row(*row)
    console.print(table)
    console.print()


def _joined(names: tuple[str, ...]) -> str:
    return ", ".join(names)


def _lesions() -> list[tuple[str, str]]:
    """Each kind with its grades in the form of `--lesion`, and its settings."""
    from vrcaps.lesion import LESIONS
    from vrcaps.lesion.base import settings_of
    from vrcaps.lesion.library import describe_kind

    rows = []
    for kind, cls in LESIONS.items():
        grades = settings_of(cls)[cls.grade_field].words if cls.grade_field else ()
        name = f"{kind}-{'|'.join(map(str, grades))}" if grades else kind
        rows.append((name, describe_kind(cls)[1].replace("`", "")))
    return [
        *rows,
        ("location of each", "segment, arc_length, theta; drawn where left out"),
        ("variant of each", "a whole number: another lesion of the same specification"),
    ]


def _library() -> list[tuple[str, str]]:
    """Names of the library by kind: their count, first and last."""
    from vrcaps.lesion import LESIONS

    libraries = {kind: list(cls.library()) for kind, cls in LESIONS.items()}
    return [
        (f"{len(names)} {kind}", f"{names[0]} to {names[-1]}")
        for kind, names in libraries.items()
        if names
    ]
