"""What the scripts share: options, and tables written into the pages of docs/."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

from vrcaps.cli.benchmarks import page as pages
from vrcaps.cli.benchmarks.report import PAGE_TITLE as SPEED_TITLE

ROOT = Path(__file__).resolve().parents[1]
PAGE, SPEED_PAGE = (
    ROOT / "docs" / "results" / "validation.md",
    ROOT / "docs" / "results" / "benchmarks.md",
)
DATASET_PAGE = ROOT / "docs" / "concepts" / "datasets.md"
DATA = ROOT.parent / "shared" / "data" / "organs"
"""Optional organs from CT; rows that need them are left out where it is absent."""

_TITLE = """# Validation

Each table below is written by the command named below it; nobody types results.
"""

table = pages.table
_OF_DATASETS = ("organ_files", "frame_codecs", "memory_dataset")


def page_of(name: str) -> Path:
    """The page of docs/ that a command, `vrcaps bench …` or a script, writes its section into."""
    if "bench " in name or Path(name).name.startswith("speed_"):
        return SPEED_PAGE
    return DATASET_PAGE if Path(name).stem in _OF_DATASETS else PAGE


def parser(description: str) -> argparse.ArgumentParser:
    """Command-line options with `--out`: the script's page."""
    made = argparse.ArgumentParser(description=description)
    page = page_of(sys.argv[0])
    made.add_argument("--out", type=Path, default=page, help="Markdown page to write into")
    return made


def options(description: str, size: int) -> argparse.Namespace:
    """Command-line options: `--size` (frames or pixels) and `--out` (page to write into)."""
    made = parser(description)
    made.add_argument("--size", type=int, default=size, help=f"default {size}")
    return made.parse_args()


def write_section(page: Path, script: str, text: str, *, title: str | None = None) -> None:
    """Put the section of one script into the page, in place of what it wrote before."""
    known = {PAGE.name: _TITLE, SPEED_PAGE.name: SPEED_TITLE}
    name = f"benchmarks/{script}"
    words = iter(["python", name, *sys.argv[1:]])
    command = " ".join(word for word in words if word != "--out" or not next(words, ""))
    title = known.get(page.name, "") if title is None else title
    pages.write_section(page, name, text, command=command, title=title)
    print(text)
