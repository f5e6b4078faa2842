"""No test asserts a time: the suite passes on a machine at a tenth of the speed.

Figures of speed are in `benchmarks/`. A wait ends with its condition, or by the watchdog of
`tests/support/waiting.py`.
"""

from __future__ import annotations

import ast
from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.support import once, waiting

TESTS = Path(__file__).parent
CLOCKS = {
    *("clock_gettime", "monotonic", "perf_counter", "process_time", "thread_time", "time"),
    *("getrusage", "times", "cpu_times"),
}
MODULES = {"time", "timeit", "resource", "os", "psutil"}
OWN_CLOCK = {
    "actuation/test_point_to_point.py",  # simulated time
    "support/waiting.py",  # the watchdog
    "test_clocks.py",
}


def clocks_in(tree: ast.AST) -> Iterator[str]:
    """Calls of clocks, imports of clocks, and limits in seconds, with their lines."""
    for node in ast.walk(tree):
        if isinstance(node, ast.Call) and isinstance(node.func, ast.Attribute):
            name, owner = node.func.attr.removesuffix("_ns"), node.func.value
            if name in CLOCKS and isinstance(owner, ast.Name) and owner.id in MODULES:
                yield f"{node.lineno}: {owner.id}.{node.func.attr}"
        if isinstance(node, ast.ImportFrom) and node.module in MODULES:
            names = {alias.name for alias in node.names}
            yield from (f"{node.lineno}: {name}" for name in names if name in CLOCKS)
        is_limit = isinstance(node, ast.keyword) and node.arg == "timeout"
        if is_limit and isinstance(node.value, ast.Constant):
            yield f"{node.value.lineno}: timeout={node.value.value}"


def test_no_test_reads_a_clock() -> None:
    found = {
        f"{path.relative_to(TESTS).as_posix()}:{clock}"
        for path in TESTS.rglob("*.py")
        if path.relative_to(TESTS).as_posix() not in OWN_CLOCK
        for clock in clocks_in(ast.parse(path.read_text("utf-8")))
    }
    assert not found, "Give the figure to benchmarks/, or wait by `waiting.wait_until`."


@pytest.mark.parametrize(
    ("line", "is_clock"),
    [
        ("assert time.process_time() - start < 7.0", True),
        ("end = time.monotonic_ns()", True),
        ("from time import perf_counter", True),
        ("os.times()", True),
        ("queue.get(timeout=20)", True),
        ("queue.get(timeout=WATCHDOG)", False),
        ("time.sleep(0.1)", False),
        ("world.time()", False),
        ("monkeypatch.setattr(module, 'monotonic', lambda: 0.0)", False),
    ],
)
def test_clocks_are_found(line: str, is_clock: bool) -> None:
    assert bool(list(clocks_in(ast.parse(line)))) is is_clock


def test_a_lock_that_is_never_free_fails_the_test(tmp_path, monkeypatch):
    def held(file: int) -> bool:
        raise OSError("another process holds it")

    monkeypatch.setattr(once, "try_lock", held)
    monkeypatch.setattr(waiting, "WATCHDOG", 0.0)
    with pytest.raises(pytest.fail.Exception, match="Still"), once.one_worker(tmp_path / "a"):
        raise AssertionError("entered")
