"""Readers fed with mutated files: each input is read, or refused in one line, within a time."""

from __future__ import annotations

import json
import signal
import traceback
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from tests.support.mutations import changed_plain, json_text, mutated
from vrcaps.core.errors import VrcapsError

SECONDS = 20
OUTCOMES = ("read", "refused", "traceback", "panic", "hang", "invalid")


class HangError(BaseException):
    """An input that takes too long; no `except Exception` of a reader catches it."""


class InvalidError(Exception):
    """A value that no reader may give."""


@dataclass
class Target:
    """A reader and what it reads.

    Attributes:
        name: Of the reader.
        folder: Whole files that it reads.
        read: Reads the folder and checks what it gives, raising InvalidError.
        depth: How many folders deep files are mutated.
    """

    name: str
    folder: Path
    read: Callable[[Path], None]
    depth: int = 9

    @property
    def files(self) -> list[Path]:
        """Files that are mutated: a few of each folder and end."""
        found: dict[tuple[Path, str], list[Path]] = {}
        for path in sorted(self.folder.rglob("*")):
            if path.is_file() and len(path.relative_to(self.folder).parts) <= self.depth:
                found.setdefault((path.parent, path.suffix), []).append(path)
        return [path for paths in found.values() for path in paths[:3]]


@dataclass
class Findings:
    """Outcomes of one reader, and inputs that failed."""

    counts: Counter[str] = field(default_factory=Counter)
    failures: list[str] = field(default_factory=list)


def fuzz(target: Target, seed: int, count: int) -> Findings:
    """Read mutated inputs of a target; its files are put back after each.

    Args:
        target: The reader.
        seed: Of the mutations.
        count: Number of inputs.
    """
    rng, findings, files = np.random.default_rng(seed), Findings(), target.files
    for number in range(count):
        path = files[rng.integers(len(files))]
        whole = path.read_bytes()
        data = _mutated(rng, whole, path.suffix)
        path.write_bytes(data)
        try:
            outcome, detail = outcome_of(target)
        finally:
            path.write_bytes(whole)
        findings.counts[outcome] += 1
        if outcome not in ("read", "refused"):
            findings.failures.append(f"{target.name} {seed}:{number} {path.name}: {detail}")
            _keep(target, seed, number, path, data)
    return findings


KEEP: list[Path] = []
"""A folder that failing inputs are copied to, if there is one."""


def _keep(target: Target, seed: int, number: int, path: Path, data: bytes) -> None:
    for folder in KEEP:
        folder.mkdir(parents=True, exist_ok=True)
        (folder / f"{target.name}-{seed}-{number}-{path.name}").write_bytes(data)


def _mutated(rng: np.random.Generator, whole: bytes, suffix: str) -> bytes:
    if suffix == ".npz" and rng.random() < 0.7:
        return _mutated_arrays(rng, whole)
    if suffix == ".parquet" and rng.random() < 0.7:
        return _mutated_table(rng, whole)
    return mutated(rng, whole, suffix)


def outcome_of(target: Target) -> tuple[str, str]:
    """Outcome of reading a target, with the line of an error."""
    try:
        with _limited():
            target.read(target.folder)
    except VrcapsError as error:
        return ("refused", "") if "\n" not in str(error) else ("invalid", repr(str(error)))
    except InvalidError as error:
        return "invalid", str(error)
    except HangError:
        return "hang", f"more than {SECONDS} s"
    except Exception as error:
        return "traceback", _line_of(error)
    except BaseException as error:
        if type(error).__name__ != "PanicException":
            raise
        return "panic", _line_of(error)
    return "read", ""


def _line_of(error: BaseException) -> str:
    place = traceback.extract_tb(error.__traceback__)
    own = [frame for frame in place if "/vrcaps/" in frame.filename] or place
    where = f"{Path(own[-1].filename).name}:{own[-1].lineno}"
    return f"{where} {type(error).__name__}: {str(error)[:150]}"


@contextmanager
def _limited() -> Iterator[None]:
    def stop(*_: object) -> None:
        raise HangError

    before = signal.signal(signal.SIGALRM, stop)
    signal.setitimer(signal.ITIMER_REAL, SECONDS)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0)
        signal.signal(signal.SIGALRM, before)


def _mutated_arrays(rng: np.random.Generator, whole: bytes) -> bytes:
    """An archive with a value, a shape or the JSON of an array changed."""
    import io

    with np.load(io.BytesIO(whole)) as stored:
        arrays = {name: stored[name] for name in stored.files}
    name = sorted(arrays)[rng.integers(len(arrays))] if rng.random() < 0.7 else "header"
    name = name if name in arrays else sorted(arrays)[0]
    array = arrays[name]
    if array.dtype.kind == "U":
        try:
            arrays[name] = np.array(json_text(changed_plain(rng, json.loads(str(array)))))
        except ValueError:
            arrays[name] = np.array("")
    else:
        arrays[name] = _other_array(rng, array)
    if rng.random() < 0.1:
        del arrays[name]
    data = io.BytesIO()
    np.savez(data, **arrays)
    return data.getvalue()


def _other_array(rng: np.random.Generator, array: np.ndarray) -> np.ndarray:
    pick = int(rng.integers(6))
    if pick == 0:
        return array[:-1] if array.ndim and len(array) > 1 else array.reshape(-1)
    if pick == 1:
        return array.astype(complex)
    if pick == 2:
        return np.array(["x"] * 3)
    if pick == 3:
        return array[None]
    changed = array.astype(float).copy()
    if changed.size:
        changed.reshape(-1)[rng.integers(changed.size)] = (np.nan, np.inf, -1.0)[rng.integers(3)]
    return changed


def _mutated_table(rng: np.random.Generator, whole: bytes) -> bytes:
    """A Parquet table with a cell replaced, or a column taken away."""
    import pyarrow as pa
    import pyarrow.parquet as pq

    table = pq.read_table(pa.BufferReader(whole))
    k = int(rng.integers(table.num_columns))
    name, column = table.column_names[k], table.column(k).to_pylist()
    if rng.random() < 0.15 or not column:
        table = table.remove_column(k)
    else:
        row = int(rng.integers(len(column)))
        column[row] = _other_cell(rng, column[row])
        try:
            table = table.set_column(k, name, pa.array(column))
        except (pa.ArrowException, TypeError, ValueError, OverflowError):
            table = table.remove_column(k)
    sink = pa.BufferOutputStream()
    pq.write_table(table, sink)
    return sink.getvalue().to_pybytes()


def _other_cell(rng: np.random.Generator, cell: Any) -> Any:
    if isinstance(cell, list) and cell and rng.random() < 0.8:
        k = int(rng.integers(len(cell)))
        return [*cell[:k], _other_cell(rng, cell[k]), *cell[k + 1 :]]
    if isinstance(cell, str):
        try:
            return json_text(changed_plain(rng, json.loads(cell)))
        except ValueError:
            cell = "text"
    choices = _CELLS.get(type(cell), (None,))
    return choices[rng.integers(len(choices))]


_CELLS: dict[type, tuple[Any, ...]] = {
    dict: ({"bytes": b"no image", "path": ""}, {"bytes": None, "path": "../x"}, None),
    float: (float("nan"), float("inf"), -1.0, 1e300, None),
    int: (-1, 0, 2**40, None),
    str: ("", "../../x", "text", None),
}
"""Other values of a cell by its type."""
