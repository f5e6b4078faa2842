"""What the validation scripts share: options, and tables written into docs/validation.md."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
PAGE = ROOT / "docs" / "validation.md"
DATA = ROOT.parent / "shared" / "data" / "organs"
"""Optional organs from CT; rows that need them are left out where it is absent."""

_TITLE = """# Validation

Each table below is written by the script named above it; nobody types results.
"""

sys.path.append(str(ROOT / "tests" / "support"))


def options(description: str, size: int) -> argparse.Namespace:
    """Command-line options: `--size` (frames or pixels) and `--out` (page to write into)."""
    parser = argparse.ArgumentParser(description=description)
    parser.add_argument("--size", type=int, default=size, help=f"default {size}")
    parser.add_argument("--out", type=Path, default=PAGE, help="Markdown page to write into")
    return parser.parse_args()


def table(head: tuple[str, ...], rows: list[tuple[str, ...]]) -> str:
    """A Markdown table."""
    lines = [head, tuple("---" for _ in head), *rows]
    return "\n".join("| " + " | ".join(line) + " |" for line in lines)


def write_section(page: Path, script: str, text: str, *, title: str = _TITLE) -> None:
    """Put the section of one script into the page, in place of what it wrote before."""
    mark = f"<!-- written by benchmarks/{script} -->\n"
    before = page.read_text(encoding="utf-8") if page.exists() else title
    sections = before.split("<!-- written by ")
    name = f"benchmarks/{script} -->\n"
    kept = [part for part in sections[1:] if not part.startswith(name)]
    kept.append(name + text.strip() + "\n\n")
    page.parent.mkdir(parents=True, exist_ok=True)
    page.write_text(
        sections[0].rstrip() + "\n\n" + "".join("<!-- written by " + part for part in sorted(kept)),
        encoding="utf-8",
    )
    print(mark + text)
