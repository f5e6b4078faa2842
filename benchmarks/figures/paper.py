"""Write the table of docs/results/paper.md: the experiments of VR-Caps next to those of vrcaps.

Lists the command of each experiment, and its missing data; with `--run`, first measures those that
have data. The values are cells of the tables that these commands write into the pages of results,
and of the card of `depth`, which is written when weights are published.

    python -m benchmarks.figures.paper [--run] [--only pose depth] [--real FOLDER]
"""

from __future__ import annotations

import argparse
import re
import shlex
import subprocess
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from benchmarks.common.scripts import PAGE, ROOT
from benchmarks.figures.summary import find, read_rows
from vrcaps.cli.benchmarks.report import read_sections, table
from vrcaps.core.files import write_bytes

PAPER = ROOT / "docs" / "results" / "paper.md"
TRANSFER = ROOT / "docs" / "results" / "sim-to-real.md"
CARD = ROOT / "weights" / "depth.md"
HEAD = ("task", "VR-Caps", "vrcaps", "baselines of vrcaps")
_TABLE = re.compile(r"\| task \| VR-Caps \|.*?(?=\n\n)", re.DOTALL)
_DEPTH = "vrcaps-12"


@dataclass(frozen=True)
class Experiment:
    """Experiment of the paper.

    Attributes:
        name: Name of its section on the page of results.
        task: Task, metric and images.
        printed: Values of the paper.
        ours: Values of vrcaps; `{column | first cells}` is a cell of the section.
        baseline: Values of a trivial baseline, in the same form.
        section: Section of the tables.
        command: Command that measures; REAL is the folder of real images.
        data: Folders that it needs, and how to get each.
    """

    name: str
    task: str
    printed: str
    ours: str
    baseline: str
    section: str
    command: str
    data: tuple[tuple[str, str], ...] = ()

    def words(self, real: Path) -> list[str]:
        """Command line for this interpreter."""
        first, *words = [str(real) if w == "REAL" else w for w in shlex.split(self.command)]
        main = ["-c", "from vrcaps.cli import main; main()"] if first == "vrcaps" else []
        return [sys.executable, *main, *words]

    def missing(self, real: Path) -> list[str]:
        """Missing data, and how to get them."""
        folders = [(real if name == "REAL" else Path(name), how) for name, how in self.data]
        return [f"{folder} is missing; {how}" for folder, how in folders if not folder.is_dir()]


def _plan(name: str) -> tuple[str, str]:
    """Data set of a plan of weights/plans, and the command that makes it."""
    made = f"runs/{name}"
    return made, f"make it by `vrcaps dataset make weights/plans/{name}.toml --out {made}`"


def _transfer(name: str, data: str, plan: str) -> tuple[str, str, tuple[tuple[str, str], ...]]:
    """Section, command and data of a task of the experiments on real images."""
    words = f"--real REAL --ours {data} --run runs/transfer --tasks {name}"
    made = f"make it by `vrcaps dataset make benchmarks/sim_to_real/{plan} --out {data}`"
    needs = (("REAL", "give --real FOLDER, see docs/results/sim-to-real.md"), (data, made))
    return f"benchmarks.sim_to_real {name}", f"python -m benchmarks.sim_to_real {words}", needs


_CLASSES = (
    "**{points | 10 % | ImageNet + ours − ImageNet}** with a tenth of the real images, over "
    "ImageNet weights; {points | 10 % | ours − from scratch} without ImageNet weights"
)
_SAME = "0: the same network without virtual images, F1 {ImageNet | 10 %}"
EXPERIMENTS = (
    Experiment(
        "coverage",
        "area coverage of a stomach, frustum, at 47.62 s",
        "96.04 % in its training stomach",
        "**{frustum at 47.62 s | coverage-ppo}** in 20 unseen stomachs, full physics; visible "
        "{visible | coverage-ppo}, resolved {resolved | coverage-ppo}",
        "along the centerline: {frustum at 47.62 s | centerline}, visible {visible | centerline}, "
        "resolved {resolved | centerline}",
        "benchmarks.validation.learning",
        "python -m benchmarks.validation.learning --size 20",
    ),
    Experiment(
        "pose",
        "pose, ATE on unseen patients",
        '"improves in all cases" by pre-training; values in a picture only',
        "**{ATE [mm] | sfm}** mm; cosine of the direction of steps {direction, cosine | sfm}",
        "constant velocity {ATE [mm] | constant velocity} mm, static {ATE [mm] | static} mm; not "
        "trivial: P3P with joint adjustment {ATE [mm] | P3P, adjusted} mm",
        "benchmarks.validation.motion",
        "python -m benchmarks.validation.motion --data runs/vrcaps-motion-18 --split test",
        (_plan("vrcaps-motion-18"),),
    ),
    Experiment(
        "depth",
        "depth, AbsRel on unseen patients",
        "pictures only",
        "**{network | AbsRel | none}**, after median scaling {network | AbsRel | median}",
        "after median scaling: mean image {mean image | AbsRel | median}, constant "
        "{constant | AbsRel | median}, brightness {brightness | AbsRel | median}",
        "weights/depth.md",
        f"vrcaps evaluate depth --data runs/{_DEPTH} --split test",
        (_plan(_DEPTH),),
    ),
    Experiment(
        "reconstruction",
        "3D reconstruction, RMSE of the wall: stomach / small bowel",
        "22.6 / 9.3 mm on virtual images and 9.2 / 8.0 mm on porcine organs, with pre-training "
        "(24.5 / 16.9 and 13.0 / 11.1 mm without)",
        "{wall RMSE [mm] | stomach | network of ours | true} / "
        "**{wall RMSE [mm] | small-bowel | network of ours | true}** mm with true poses, "
        "{wall RMSE [mm] | stomach | network of ours | odometry} / "
        "{wall RMSE [mm] | small-bowel | network of ours | odometry} mm with odometry, virtual",
        "true depth and odometry: {wall RMSE [mm] | stomach | true | odometry} / "
        "{wall RMSE [mm] | small-bowel | true | odometry} mm",
        "benchmarks.validation.reconstruction",
        "python -m benchmarks.validation.reconstruction --steps 100",
    ),
    Experiment(
        "polyps",
        "classification of polyps or colitis, gain of F1 by virtual images",
        "+21 % polyp, +11 % ulcer, over training on 425 real images of each class",
        _CLASSES,
        _SAME,
        *_transfer("polyp-classes", "runs/ours", "plan.toml"),
    ),
    Experiment(
        "bleeding",
        "classification of bleeding or not, gain of F1 by virtual images",
        "no such class",
        _CLASSES,
        _SAME,
        *_transfer("bleeding-classes", "runs/ours", "plan.toml"),
    ),
    Experiment(
        "super-resolution",
        "super-resolution × 4, PSNR on real images",
        "32.98 dB to 35.27 dB by pre-training",
        "{from scratch | 100 %} dB to **{ours | 100 %}** dB with all real images, 120 images of 96 "
        "pixels",
        "gain over bicubic: {PSNR [dB] | 100 % | ours} dB",
        *_transfer("super-resolution", "runs/flights", "flights.toml"),
    ),
)


def main() -> None:
    """Run or list the commands, write the table."""
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks.figures.paper",
        description=__doc__,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    names = [one.name for one in EXPERIMENTS]
    parser.add_argument("--run", action="store_true", help="measure before the table is written")
    parser.add_argument("--only", nargs="*", choices=names, default=names, help="default: all")
    parser.add_argument("--real", type=Path, default=Path("real"), help="folder of real images")
    given = parser.parse_args()
    chosen = [one for one in EXPERIMENTS if one.name in given.only]
    failed = run(chosen, given.real, lists=not given.run)
    write()
    print(table_text())
    sys.exit(f"Failed: {', '.join(failed)}" if failed else 0)


def run(chosen: Sequence[Experiment], real: Path, *, lists: bool) -> list[str]:
    """List the commands of experiments, and measure those with data; return names of failed ones.

    Args:
        chosen: Experiments.
        real: Folder of real images.
        lists: Whether to list only.
    """
    failed = []
    for one in chosen:
        missing = one.missing(real)
        reason = f" (skipped: {'; '.join(missing)})" if missing else ""
        print(f"{one.name}: {one.command}{reason}", flush=True)
        if not (lists or missing) and subprocess.run(one.words(real), check=False).returncode:
            failed.append(one.name)
    return failed


def table_text() -> str:
    """Table of the pages of results as they are."""
    sections = read_sections(PAGE) | read_sections(TRANSFER)
    sections["weights/depth.md"] = CARD.read_text(encoding="utf-8")
    lines = []
    for one in EXPERIMENTS:
        rows = list(read_rows(sections.get(one.section, "")))
        shown = [
            re.sub(r"\{([^{}]+)\}", lambda match, rows=rows: find(rows, match[1]), template)
            for template in (one.ours, one.baseline)
        ]
        lines.append((one.task, one.printed, *shown))
    return table(HEAD, lines)


def write() -> None:
    """Write the table into the page."""
    text = PAPER.read_text(encoding="utf-8")
    write_bytes(PAPER, _TABLE.sub(lambda match: table_text(), text, count=1).encode())


if __name__ == "__main__":
    main()
