"""Markdown pages of measured tables: each section is written by the command that measured it."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from vrcaps.core.files import write_bytes

_MARK = "<!-- written by "


def table(head: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """Format a Markdown table."""
    lines = (head, ["---"] * len(head), *rows)
    return "\n".join(
        "| " + " | ".join(cell.replace("|", "\\|") for cell in line) + " |" for line in lines
    )


def read_sections(page: Path) -> dict[str, str]:
    """Read the sections of a page by name; the text before them has an empty name."""
    parts = page.read_text(encoding="utf-8").split(_MARK) if page.exists() else [""]
    named = (part.split(" -->\n", 1) for part in parts[1:])
    return {"": parts[0], **{name: text.strip() for name, text in named}}


def write_section(page: Path, name: str, text: str, *, title: str) -> None:
    """Write a section to a page, replacing the one of the same name.

    Args:
        page: Markdown file; created if it does not exist.
        name: Command that measures it, such as `vrcaps bench render`.
        text: Markdown of the section.
        title: Title of a new page.
    """
    sections = read_sections(page)
    before = sections.pop("") or title
    write_page(page, {"": before, **sections, name: text.strip()})


def write_page(page: Path, sections: dict[str, str]) -> None:
    """Write a page of sections as returned by `read_sections`, sorted by name."""
    parts = [
        text.strip() if not name else f"{_MARK}{name} -->\n{text.strip()}"
        for name, text in sorted(sections.items())
    ]
    page.parent.mkdir(parents=True, exist_ok=True)
    write_bytes(page, ("\n\n".join(parts) + "\n").encode())
