"""`make figures`: validation.md, benchmarks.md and summary.md of docs/results.

Each command measures into a page of its own; what it wrote enters the page of docs/ when it has
ended well. Those whose section is of today's sources are skipped, so that an interrupted run goes
on where it was, unless they are named. What states times runs by itself, all else two at a time.
Needs a machine that does nothing else.

    python benchmarks/figures.py [--only speed_path radiosity] [--list]
"""

from __future__ import annotations

import argparse
import os
import re
import subprocess
import sys
import time
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import readme
from validation import PAGE, ROOT, SPEED_PAGE, page_of
from vrcaps.cli.benchmarks.page import read_sections, sources, write_page

BUILD = ROOT / "build" / "figures"
BLENDER = os.environ.get("BLENDER_PYTHON", "")
"""A Python that has bpy; without it the section about Cycles stays as it is."""


LEROBOT = os.environ.get("LEROBOT_PYTHON", "")
"""A Python that has lerobot; without it the section about its loader stays as it is."""


@dataclass(frozen=True)
class Figure:
    """A command that measures one section.

    Attributes:
        name: Of the section: `vrcaps bench render`, `benchmarks/validate_light.py`.
        options: What is given to the command.
        is_timed: Whether it states times, so that nothing else may run beside it.
    """

    name: str
    options: tuple[str, ...] = ()
    is_timed: bool = False

    @property
    def page(self) -> Path:
        """The page that its section is on."""
        return page_of(self.name)

    @property
    def command(self) -> list[str]:
        """What is run."""
        if self.name.startswith("vrcaps "):
            run = "from vrcaps.cli import main; main()"
            return [sys.executable, "-c", run, *self.name.split()[1:], *self.options]
        return [sys.executable, str(ROOT / self.name), *self.options]

    @property
    def log(self) -> Path:
        """What it prints; its section stands beside it."""
        return BUILD / f"{Path(self.name.replace(' ', '_')).stem}.log"


def _scripts(names: str, *, is_timed: bool = False) -> list[Figure]:
    return [Figure(f"benchmarks/{name}.py", is_timed=is_timed) for name in names.split()]


FIGURES = (
    *(Figure(f"vrcaps bench {name}", is_timed=True) for name in ("render", "record", "world")),
    *_scripts(
        "speed_peers speed_effects speed_magnets speed_path speed_fem speed_ct speed_worlds",
        is_timed=True,
    ),
    *_scripts("speed_views speed_env speed_dataset speed_reading", is_timed=True),
    *_scripts("speed_cockpit", is_timed=True),
    Figure(
        "benchmarks/drive_cockpit.py",
        ("--patients", "0", "1", "2", "--arms", "none", "panda"),
        is_timed=True,
    ),
    *_scripts("organ_files frame_codecs memory_dataset", is_timed=True),
    *([Figure("benchmarks/speed_cycles.py", ("--blender-python", BLENDER), True)] * bool(BLENDER)),
    *_scripts("validate_radiosity validate_scattering validate_denoise", is_timed=True),
    *_scripts(
        "validate_magnets validate_motility validate_sensing validate_steering", is_timed=True
    ),
    *_scripts("validate_textures validate_quasi_static", is_timed=True),
    Figure("benchmarks/small_bowel_transit.py", ("--size", "40")),
    Figure("benchmarks/capsule_designs.py"),
    *_scripts(
        "validate_contact validate_coverage validate_ct validate_defaults validate_fem "
        "validate_labels"
    ),
    *_scripts("validate_lesion_sizes validate_resume validate_exactly_once kill_runs"),
    Figure("benchmarks/validate_learning.py", ("--size", "20")),
    *_scripts("validate_lesions validate_light validate_moving_labels validate_path"),
    *_scripts("validate_placing validate_sensor validate_located_steering validate_reconstruction"),
    *([Figure("benchmarks/validate_lerobot.py", ("--python", LEROBOT))] * bool(LEROBOT)),
)
KEPT = ("benchmarks/speed_cycles.py", "benchmarks/validate_lerobot.py")
"""Sections that stay where what they need is absent; they state the sources they were made from."""


def main() -> None:
    """Measure what is asked for or out of date, then write the summary."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--only", nargs="*", default=[], help="parts of names")
    parser.add_argument("--list", action="store_true", help="what there is, and how old it is")
    given = parser.parse_args()
    if given.list:
        print(*(f"{figure.name}: {age(figure)}" for figure in FIGURES), sep="\n")
        return
    unknown = [word for word in given.only if not any(word in f.name for f in FIGURES)]
    if unknown:
        sys.exit(f"No figures named {', '.join(unknown)}. `--list` shows what there is.")
    chosen = [f for f in FIGURES if any(word in f.name for word in given.only)]
    if not given.only:
        chosen = [f for f in FIGURES if not is_of_today(f)]
    BUILD.mkdir(parents=True, exist_ok=True)
    failed = [f.name for f in chosen if f.is_timed and not measure(f)]
    others = [f for f in chosen if not f.is_timed]
    with ThreadPoolExecutor(2) as pool:
        done = pool.map(partial(measure, merge=False), others)
        for figure, good in zip(others, done, strict=True):
            failed += [] if good and enter(figure) else [figure.name]
    forget()
    readme.write()
    old = [f"{f.name} ({age(f)})" for f in FIGURES if not is_of_today(f)]
    for title, names in (("Failed", failed), ("Of other sources", old)):
        print(*([f"{title}: {', '.join(names)}"] if names else []))
    sys.exit(bool(failed))


def measure(figure: Figure, *, merge: bool = True) -> bool:
    """Run a command; says whether it ended well."""
    part, started = figure.log.with_suffix(".md"), time.monotonic()
    part.unlink(missing_ok=True)
    print(f"{figure.name} …", flush=True)
    with figure.log.open("w", encoding="utf-8") as log:
        command = [*figure.command, "--out", str(part)]
        code = subprocess.run(command, stdout=log, stderr=log, cwd=ROOT, check=False).returncode
    minutes = (time.monotonic() - started) / 60.0
    good = not code and part.exists()
    ended = "done" if good else f"FAILED, see {figure.log}"
    print(f"{figure.name}: {minutes:.1f} min, {ended}", flush=True)
    return good and (not merge or enter(figure))


def enter(figure: Figure) -> bool:
    """Put the section that a command has written into its page of docs/."""
    found = read_sections(figure.log.with_suffix(".md"))
    section = next((text for name, text in found.items() if name == figure.name), "")
    if section:
        write_page(figure.page, read_sections(figure.page) | {figure.name: section})
    return bool(section)


def forget() -> None:
    """Drop sections that no command writes any more."""
    for page in (PAGE, SPEED_PAGE):
        names = {"", *KEPT, *(figure.name for figure in FIGURES if figure.page == page)}
        write_page(page, {k: text for k, text in read_sections(page).items() if k in names})


def _foot(figure: Figure) -> Sequence[str]:
    text = read_sections(figure.page).get(figure.name, "")
    found = re.search(r"from sources `(\w+)` in (\d+) s\.$", text)
    return found.groups() if found else ("", "")


def is_of_today(figure: Figure) -> bool:
    """Whether a section was measured with all that its command imports as it is now."""
    return _foot(figure)[0] == sources(figure.name)


def age(figure: Figure) -> str:
    """Whether a section is of today's sources, and how long it took."""
    made, seconds = _foot(figure)
    if not made:
        return "not measured"
    state = "up to date" if is_of_today(figure) else f"of sources {made}"
    return f"{state}, took {seconds} s"


if __name__ == "__main__":
    main()
