"""Write validation.md, benchmarks.md, summary.md and paper.md of docs/results: `make figures`.

Each command measures into a separate page; its section is copied into the page of docs/ when the
command succeeds. Sections whose sources have not changed are skipped unless they are named, so an
interrupted run resumes. Timed commands run alone, all others two at a time. Needs an idle machine.

A change of the sources that computes the same values, such as a renamed module, also outdates
sections. `--accept REASON` then accepts the current sources of the named or outdated sections
without measuring; the stamp records the measured sources and the reason.

    python -m benchmarks.figures [--only speed.path radiosity] [--list] [--accept REASON]
"""

from __future__ import annotations

import argparse
import os
import subprocess
import sys
import time
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import partial
from pathlib import Path

from benchmarks.common.scripts import PAGE, ROOT, SPEED_PAGE, page_of
from benchmarks.common.sections import accepted, sources, stamp_of, stamped
from benchmarks.figures import paper, summary
from vrcaps.cli.benchmarks.report import read_sections, write_page

BUILD = ROOT / "build" / "figures"
BLENDER = os.environ.get("BLENDER_PYTHON", "")
"""Python with bpy; without it the section about Cycles is kept."""


LEROBOT = os.environ.get("LEROBOT_PYTHON", "")
"""Python with lerobot; without it the section about its loader is kept."""


@dataclass(frozen=True)
class Figure:
    """Command that measures one section.

    Attributes:
        name: Name of the section: `vrcaps bench render`, `benchmarks.validation.light`.
        options: Options of the command.
        is_timed: Whether it reports times, so that nothing else may run at the same time.
    """

    name: str
    options: tuple[str, ...] = ()
    is_timed: bool = False

    @property
    def page(self) -> Path:
        """Page of its section."""
        return page_of(self.name)

    @property
    def command(self) -> list[str]:
        """Command line."""
        if self.name.startswith("vrcaps "):
            run = "from vrcaps.cli import main; main()"
            return [sys.executable, "-c", run, *self.name.split()[1:], *self.options]
        return [sys.executable, "-m", self.name, *self.options]

    @property
    def log(self) -> Path:
        """File of its output; its section is next to it."""
        return BUILD / f"{self.name.replace(' ', '_')}.log"

    @property
    def measured(self) -> Path:
        """Page that the command writes."""
        return BUILD / f"{self.name.replace(' ', '_')}.md"


def _modules(folder: str, names: str, *, is_timed: bool = False) -> list[Figure]:
    return [Figure(f"benchmarks.{folder}.{name}", is_timed=is_timed) for name in names.split()]


_speed = partial(_modules, "speed", is_timed=True)
_validation = partial(_modules, "validation")

FIGURES = (
    *(Figure(f"vrcaps bench {name}", is_timed=True) for name in ("render", "record", "world")),
    *_speed("compare_peers effects magnets path fem ct worlds views env dataset reading cockpit"),
    Figure(
        "benchmarks.validation.drive_cockpit",
        (
            *("--patients", "0", "1", "2", "--arms", "none", "panda"),
            *("--by", "gamepad", "keyboard"),
        ),
        is_timed=True,
    ),
    *_speed("organ_files frame_codecs dataset_memory"),
    *([Figure("benchmarks.speed.cycles", ("--blender-python", BLENDER), True)] * bool(BLENDER)),
    *_validation("radiosity scattering denoise magnets motility sensing steering", is_timed=True),
    *_validation("textures quasi_static", is_timed=True),
    Figure("benchmarks.validation.small_bowel_transit", ("--size", "40")),
    *_validation("capsule_designs collapsed_walls contact coverage ct defaults fem labels"),
    *_validation("lesion_sizes resume exactly_once kill_runs"),
    Figure("benchmarks.validation.learning", ("--size", "20")),
    Figure("benchmarks.validation.device_policies"),
    *_validation("lesions light moving_labels path placing sensor located_steering reconstruction"),
    *([Figure("benchmarks.validation.lerobot", ("--python", LEROBOT))] * bool(LEROBOT)),
)
KEPT = (
    "benchmarks.speed.cycles",
    "benchmarks.validation.lerobot",
    "benchmarks.validation.motion",
    "benchmarks.validation.motion sinus",
)
"""Sections that are kept if their requirements are missing; they state their sources."""


def main() -> None:
    """Measure the named or outdated sections, then write the summary."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.figures", description=__doc__)
    parser.add_argument("--only", nargs="*", default=[], help="parts of names")
    parser.add_argument("--list", action="store_true", help="list all sections and their state")
    parser.add_argument(
        "--accept",
        default="",
        metavar="REASON",
        help="accept the current sources without measuring; gives the evidence for equal values",
    )
    given = parser.parse_args()
    if given.list:
        print(*(f"{figure.name}: {age(figure)}" for figure in FIGURES), sep="\n")
        return
    unknown = [word for word in given.only if not any(word in f.name for f in FIGURES)]
    if unknown:
        sys.exit(f"No sections named {', '.join(unknown)}. Run with --list to see all names.")
    chosen = [f for f in FIGURES if any(word in f.name for word in given.only)]
    if not given.only:
        chosen = [f for f in FIGURES if not is_current(f)]
    if given.accept:
        accept(chosen, given.accept)
        return
    BUILD.mkdir(parents=True, exist_ok=True)
    failed = [f.name for f in chosen if f.is_timed and not measure(f)]
    others = [f for f in chosen if not f.is_timed]
    with ThreadPoolExecutor(2) as pool:
        done = pool.map(partial(measure, merge=False), others)
        for figure, good in zip(others, done, strict=True):
            failed += [] if good and enter(figure) else [figure.name]
    forget()
    summary.write()
    paper.write()
    old = [f"{f.name} ({age(f)})" for f in FIGURES if not is_current(f)]
    for title, names in (("Failed", failed), ("Outdated", old)):
        print(*([f"{title}: {', '.join(names)}"] if names else []))
    sys.exit(bool(failed))


def measure(figure: Figure, *, merge: bool = True) -> bool:
    """Run a command; return whether it succeeded."""
    part, started = figure.measured, time.monotonic()
    part.unlink(missing_ok=True)
    print(f"{figure.name} …", flush=True)
    with figure.log.open("w", encoding="utf-8") as log:
        command = [*figure.command, "--out", str(part)]
        code = subprocess.run(command, stdout=log, stderr=log, cwd=ROOT, check=False).returncode
    seconds = time.monotonic() - started
    good = not code and part.exists()
    if good and figure.name.startswith("vrcaps "):
        text = read_sections(part)[figure.name]
        write_page(part, {"": "", figure.name: stamped(text, figure.name, figure.name, seconds)})
    result = "done" if good else f"FAILED, see {figure.log}"
    print(f"{figure.name}: {seconds / 60.0:.1f} min, {result}", flush=True)
    return good and (not merge or enter(figure))


def enter(figure: Figure) -> bool:
    """Copy the section that a command has written into its page of docs/."""
    section = read_sections(figure.measured).get(figure.name, "")
    if section:
        write_page(figure.page, read_sections(figure.page) | {figure.name: section})
    return bool(section)


def accept(chosen: Sequence[Figure], reason: str) -> None:
    """Accept the current sources of sections, with the reason why their values are the same."""
    for figure in chosen:
        own = read_sections(figure.page)
        try:
            text = accepted(own.get(figure.name, ""), figure.name, reason)
        except ValueError as error:
            sys.exit(str(error))
        write_page(figure.page, own | {figure.name: text})
        print(f"{figure.name}: {age(figure)}")


def forget() -> None:
    """Remove sections that no command writes."""
    for page in (PAGE, SPEED_PAGE):
        names = {"", *KEPT, *(figure.name for figure in FIGURES if figure.page == page)}
        write_page(page, {k: text for k, text in read_sections(page).items() if k in names})


def _stamp(figure: Figure) -> tuple[str, str, str]:
    return stamp_of(read_sections(figure.page).get(figure.name, ""))


def is_current(figure: Figure) -> bool:
    """Return whether a section was measured with or accepted for the sources of its command."""
    measured, _, accepted_for = _stamp(figure)
    return sources(figure.name) in (measured, accepted_for)


def age(figure: Figure) -> str:
    """State of a section, and the duration of its measurement."""
    digest, seconds, accepted_for = _stamp(figure)
    if not digest:
        return "not measured"
    state = f"of sources {digest}"
    if is_current(figure):
        state = f"accepted, {state}" if accepted_for else "up to date"
    return f"{state}, took {seconds} s"


if __name__ == "__main__":
    main()
