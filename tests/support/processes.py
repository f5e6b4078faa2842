"""Processes of this machine, read from /proc: whose children they are and what they run."""

from __future__ import annotations

from pathlib import Path

PROC = Path("/proc")


def command_of(pid: int) -> str:
    """Command line of a process; empty if it has ended."""
    try:
        return (PROC / str(pid) / "cmdline").read_bytes().replace(b"\0", b" ").decode().strip()
    except OSError:
        return ""


def descendants(pid: int) -> list[int]:
    """Processes that a process has started, and those that they have."""
    children: dict[int, list[int]] = {}
    for path in PROC.iterdir():
        if path.name.isdigit() and (parent := _parent(path)) is not None:
            children.setdefault(parent, []).append(int(path.name))
    found, waiting = [], [pid]
    while waiting:
        below = children.get(waiting.pop(), [])
        found += below
        waiting += below
    return found


def _parent(path: Path) -> int | None:
    try:
        # The name, in parentheses, may hold spaces.
        return int((path / "stat").read_text().rpartition(")")[2].split()[1])
    except OSError:
        return None
