"""Sections of the pages of results, each stamped with its command, its sources and its duration."""

from __future__ import annotations

import re
import time
from pathlib import Path

from benchmarks.common.sources import PACKAGE, ROOT, digest
from vrcaps.cli.benchmarks import page as pages

_STARTED = time.monotonic()
_STAMP = re.compile(r"\n\nWritten by `[^`]+`(?: from sources `(\w+)` in (\d+) s)?\.$")


def module_of(script: Path) -> str:
    """Dotted name by which a script is run: `benchmarks.speed.env`."""
    if not script.resolve().is_relative_to(ROOT):
        return script.stem
    names = script.resolve().relative_to(ROOT).with_suffix("").parts
    return ".".join(names[:-1] if names[-1] == "__main__" else names)


def file_of(name: str) -> Path:
    """Source file of a section: of a module or `vrcaps bench NAME`, ignoring further words."""
    first, *words = name.split()
    if first == "vrcaps":
        return PACKAGE / "cli" / "benchmarks" / f"{words[1]}.py"
    path = ROOT.joinpath(*first.split("."))
    return path / "__main__.py" if path.is_dir() else path.with_suffix(".py")


def sources(name: str) -> str:
    """Ten-digit digest of the sources that a section depends on."""
    return digest(file_of(name))


def stamped(text: str, name: str, command: str, seconds: float) -> str:
    """Text of a section with its command, the digest of its sources and its duration."""
    stamp = f"Written by `{command}` from sources `{sources(name)}` in {seconds:.0f} s."
    return f"{_STAMP.sub('', text.strip())}\n\n{stamp}"


def stamp_of(text: str) -> tuple[str, str]:
    """Digest and duration [s] in the stamp of a section; empty without a stamp."""
    match = _STAMP.search(text)
    return (match[1] or "", match[2] or "") if match else ("", "")


def write_section(page: Path, name: str, text: str, *, command: str, title: str) -> None:
    """Write a stamped section to a page, replacing the one of the same name.

    Args:
        page: Markdown file; created if it does not exist.
        name: Module that measures it, such as `benchmarks.speed.env`; words after it distinguish
            its sections.
        text: Markdown of the section.
        command: Command line that was run.
        title: Title of a new page.
    """
    text = stamped(text, name, command, time.monotonic() - _STARTED)
    pages.write_section(page, name, text, title=title)
