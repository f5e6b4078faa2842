"""Modules that the set-up of a recording enters, traced while it runs."""

from __future__ import annotations

import sys
import tempfile
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from types import FrameType

from benchmarks.structure.imports import NAMESPACE, part

HELPERS = ("_core", "core", "config")
"""Parts with helpers that any module may call."""


@dataclass(frozen=True)
class Walk:
    """Functions of the package in the order of their first call.

    Attributes:
        calls: Module and name of each function.
        ranks: Rank of each top-level part in the order of imports.
    """

    calls: tuple[tuple[str, str], ...]
    ranks: dict[str, int]

    @property
    def modules(self) -> tuple[str, ...]:
        """Modules entered, in the order of the first entry."""
        return tuple(dict.fromkeys(module for module, _ in self.calls))

    def moves(self, *, helpers: bool = True) -> list[tuple[str, str]]:
        """Changes of module from one function to the next."""
        modules = [m for m, _ in self.calls if helpers or part(m) not in HELPERS]
        return [(a, b) for a, b in pairwise(modules) if a != b]

    def climbs(self) -> list[tuple[str, str]]:
        """Moves to a layer that imports the last one, returns and helpers included."""
        return [(a, b) for a, b in self.moves() if self._is_upward(a, b)]

    def new_climbs(self) -> list[tuple[str, str]]:
        """Moves to a module not entered before in a higher layer; helpers do not count."""
        seen: set[str] = set()
        climbs = []
        for a, b in self.moves(helpers=False):
            seen.add(a)
            if b not in seen and self._is_upward(a, b):
                climbs.append((a, b))
        return climbs

    def _is_upward(self, a: str, b: str) -> bool:
        return self.ranks[part(b)] > self.ranks[part(a)]


def walks_of_recording(layers: Sequence[Sequence[str]]) -> tuple[Walk, Walk]:
    """Trace the set-up of the default recording, from `record` until `build` returns.

    The organ is read from the cache in the user's folder; the first, untraced run writes it and
    loads all modules.

    Returns:
        The set-up with the capsule's file parsed by an earlier recording of the process, and the
        set-up that parses it.
    """
    from vrcaps.capsule import device_file
    from vrcaps.recording.recorder import record
    from vrcaps.scenario.scenario import Scenario

    scenario = Scenario(frames=1)
    with tempfile.TemporaryDirectory() as folder:
        record(scenario, Path(folder) / "first")
        warm = _trace(lambda: record(scenario, Path(folder) / "second"))
        device_file._parsed.clear()
        cold = _trace(lambda: record(scenario, Path(folder) / "third"))
    ranks = {name: rank for rank, names in enumerate(layers) for name in names}
    return Walk(tuple(warm), ranks), Walk(tuple(cold), ranks)


def _trace(run: Callable[[], object]) -> list[tuple[str, str]]:
    """Functions called until `build` of the scenario returns."""
    calls: dict[tuple[str, str], None] = {}
    done = False

    def observe(frame: FrameType, event: str, argument: object) -> None:
        nonlocal done
        module, code = frame.f_globals.get("__name__", ""), frame.f_code
        if done or not module.startswith(f"{NAMESPACE}."):
            return
        if event == "call" and not code.co_filename.startswith("<") and code.co_name[0] != "<":
            calls[module, code.co_qualname] = None
        done = event == "return" and code.co_name == "build" and part(module) == "scenario"

    sys.setprofile(observe)
    try:
        run()
    finally:
        sys.setprofile(None)
    return list(calls)
