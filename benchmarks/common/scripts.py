"""Options of the scripts, and tables written into the pages of docs/."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

from benchmarks.common import sections
from benchmarks.common.sources import ROOT
from vrcaps.cli.benchmarks.report import PAGE_TITLE as SPEED_TITLE
from vrcaps.cli.benchmarks.report import table

__all__ = ["DATA", "PAGE", "ROOT", "SPEED_PAGE", "options", "page_of", "parser", "table"]

PAGE, SPEED_PAGE = (
    ROOT / "docs" / "results" / "validation.md",
    ROOT / "docs" / "results" / "benchmarks.md",
)
DATASET_PAGE = ROOT / "docs" / "concepts" / "datasets.md"
DATA = ROOT.parent / "shared" / "data" / "organs"
"""Optional organs from CT; their rows are omitted if it is absent."""

_TITLE = """# Validation

Each table below is written by the command named below it; nobody types results.
"""

_OF_DATASETS = tuple(
    f"benchmarks.speed.{name}" for name in ("organ_files", "frame_codecs", "dataset_memory")
)


def page_of(name: str) -> Path:
    """Page of docs/ that a command, `vrcaps bench …` or a module, writes its section into."""
    if name in _OF_DATASETS:
        return DATASET_PAGE
    return SPEED_PAGE if name.startswith(("vrcaps bench ", "benchmarks.speed.")) else PAGE


def parser(description: str) -> argparse.ArgumentParser:
    """Command-line options with `--out`; the default is the page of the running script."""
    name = sections.module_of(Path(sys.argv[0]))
    result = argparse.ArgumentParser(prog=f"python -m {name}", description=description)
    result.add_argument(
        "--out", type=Path, default=page_of(name), help="Markdown page to write into"
    )
    return result


def options(description: str, size: int) -> argparse.Namespace:
    """Command-line options: `--size` (frames or pixels) and `--out` (page to write into)."""
    result = parser(description)
    result.add_argument("--size", type=int, default=size, help=f"default {size}")
    return result.parse_args()


def write_section(
    page: Path, script: Path, text: str, *, title: str | None = None, part: str = ""
) -> None:
    """Write the section of a script into a page, replacing its previous one, and print it.

    Args:
        page: Markdown file.
        script: File of the script.
        text: Markdown of the section.
        title: Title of a new page; by default that of the page of this name.
        part: Word that distinguishes the section from others of the script.
    """
    titles = {PAGE.name: _TITLE, SPEED_PAGE.name: SPEED_TITLE}
    name = sections.module_of(script)
    words = iter(["python", "-m", name, *sys.argv[1:]])
    command = " ".join(word for word in words if word != "--out" or not next(words, ""))
    title = titles.get(page.name, "") if title is None else title
    name = f"{name} {part}".strip()
    sections.write_section(page, name, text, command=command, title=title)
    print(text)
