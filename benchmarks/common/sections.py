"""Sections of the pages of results, each stamped with its command, its sources and its duration."""

from __future__ import annotations

import re
import time
from pathlib import Path

from benchmarks.common.sources import PACKAGE, ROOT, digest
from vrcaps.cli.benchmarks import report

_STARTED = time.monotonic()
_STAMP = re.compile(
    r"\n\nWritten by `[^`]+`(?: from sources `(?P<measured>\w+)` in (?P<seconds>\d+) s)?"
    r"(?:\. Accepted for sources `(?P<accepted>\w+)`: (?P<reason>[^\n]+))?\.$"
)


def module_of(script: Path) -> str:
    """Dotted name of a script as a module: `benchmarks.speed.env`."""
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


def stamp_of(text: str) -> tuple[str, str, str]:
    """Stamp of a section: digest, duration [s], and accepted digest; empty if there is none."""
    match = _STAMP.search(text)
    values = match.group("measured", "seconds", "accepted") if match else (None, None, None)
    measured, seconds, accepted = (value or "" for value in values)
    return measured, seconds, accepted


def accepted(text: str, name: str, reason: str) -> str:
    """Text of a section whose stamp also accepts the current sources, without a measurement.

    The stamp keeps the measured digest, so that a reader sees that the table is older.

    Args:
        text: Section with a stamp.
        name: Name of the section.
        reason: Evidence that the sources compute the same values, in one line.

    Raises:
        ValueError: If the section was never measured, or the reason is not one line of text.
    """
    match = _STAMP.search(text)
    reason = reason.strip().rstrip(".")
    if match is None or match["measured"] is None:
        raise ValueError(f"{name} has no measured sources. Measure it.")
    if not reason or "\n" in reason:
        raise ValueError("The reason is empty or has several lines. Give one line.")
    measured = match[0].partition(". Accepted for sources")[0].removesuffix(".")
    stamp = f"{measured}. Accepted for sources `{sources(name)}`: {reason}."
    return f"{text[: match.start()]}{stamp}"


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
    report.write_section(page, name, text, title=title)
