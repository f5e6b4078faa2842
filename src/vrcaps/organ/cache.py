"""Organs on disk under the user's cache folder, so that each is generated only once."""

from __future__ import annotations

import atexit
import contextlib
import hashlib
import json
import os
import shutil
import tempfile
import warnings
from collections.abc import Callable, Iterator
from contextvars import ContextVar
from functools import cache
from pathlib import Path
from types import CodeType
from typing import Any, TypeVar

import numpy as np
from platformdirs import user_cache_path

from vrcaps.files import atomic_write, read_arrays
from vrcaps.made_with import ORGAN_PACKAGES, core_sha256, versions
from vrcaps.organ.arrays import organ_from_arrays, organ_to_arrays
from vrcaps.organ.surface import OrganSurface
from vrcaps.temporary_files import is_temporary

Stored = TypeVar("Stored")

_BROKEN = (OSError, ValueError, LookupError, TypeError, AttributeError)
"""What reading a truncated, overwritten or outdated file raises."""

_MAKERS = ("mesh", "organ", "mucosa", "anatomy", "lesion")
"""Packages whose code decides what an organ is."""

_MAKER_MODULES = (
    *("color", "errors", "files", "geometry", "limits", "locks", "made_with", "narrow"),
    *("rng", "scenario/build", "temporary_files", "transforms", "units"),
)
"""Other modules that they use, and the one that calls them."""

_MOST_BYTES = 10 * 10**9
"""Size of the kept organs beyond which those that were not used for longest are removed.

Organs that an older version made are among them: no other version reads them.
"""

_MOST_PASSING_BYTES = 4 * 10**9
"""The same for organs that are needed for a short time only (`passing_organs`)."""

_is_passing: ContextVar[bool] = ContextVar("is_passing", default=False)

_other_folder: ContextVar[Path | None] = ContextVar("other_folder", default=None)


def cache_folder() -> Path:
    r"""Folder of what vrcaps can make again: ``VRCAPS_CACHE``, or the platform's cache folder.

    The latter is ``~/.cache/vrcaps`` (or below ``XDG_CACHE_HOME``) on Linux,
    ``~/Library/Caches/vrcaps`` on macOS, ``%LOCALAPPDATA%\vrcaps\Cache`` on Windows. A user
    without a home folder has a temporary folder, which this process removes when it ends.
    """
    if (other := _other_folder.get()) is not None:
        return other
    try:
        if chosen := os.environ.get("VRCAPS_CACHE"):
            return Path(chosen).expanduser()
        return user_cache_path("vrcaps", appauthor=False)
    except RuntimeError:  # neither HOME nor an entry in the list of users
        return _temporary_folder()


@cache
def _temporary_folder() -> Path:
    """A cache folder for as long as this process runs."""
    folder, owner = Path(tempfile.mkdtemp(prefix="vrcaps-")), os.getpid()

    def remove() -> None:
        if os.getpid() == owner:  # not a process that was forked from it
            shutil.rmtree(folder, ignore_errors=True)

    atexit.register(remove)
    warnings.warn(
        f"This user has no home folder, so organs are kept in {folder} until the process ends. Set "
        "VRCAPS_CACHE to an absolute path to keep them.",
        stacklevel=2,
    )
    return folder


def cached_organ(name: str, make: Callable[[], OrganSurface]) -> OrganSurface:
    """The organ stored under a name, or else the made one, stored for the next time.

    A file that cannot be read is made again. A folder that cannot be written to is a warning. The
    organs used last are kept, up to 10 GB of them, and 4 GB of `passing_organs`.

    Args:
        name: Names the organ, all its parameters and the code that makes it.
        make: Makes the organ.
    """
    return _cached(name, make, _read_organ, _write_organ)


def cached_files(name: str, make: Callable[[], dict[str, bytes]]) -> dict[str, bytes]:
    """Files that belong to an organ, such as its coded textures, kept as `cached_organ` does.

    Args:
        name: Names the organ, what the files are and the code that makes them.
        make: Makes the files.
    """
    return _cached(name, make, _read_files, _write_files)


def _cached(
    name: str,
    make: Callable[[], Stored],
    read: Callable[[Path], Stored],
    write: Callable[[Path, Stored], None],
) -> Stored:
    kept = cache_folder() / "organs" / f"{name}.npz"
    passing = kept.parent / "passing" / kept.name
    for path in (kept, passing):
        try:
            if path.is_file():
                found = read(path)
                _mark_used(path)
                return found
        except _BROKEN:
            pass  # Made again and overwritten below.
    made, path = make(), passing if _is_passing.get() else kept
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        write(path, made)
        _forget_unused(path.parent, _MOST_PASSING_BYTES if _is_passing.get() else _MOST_BYTES)
    except OSError as error:
        warnings.warn(
            f"Cannot write to the cache folder {path.parent}: {error.strerror}. The organ is made "
            "again each time; set VRCAPS_CACHE to a folder that can be written to.",
            stacklevel=3,
        )
    return made


@contextlib.contextmanager
def passing_organs() -> Iterator[None]:
    """In this block organs are stored for a short time: few of them, apart from all others.

    A data set of many patients needs each organ for the recordings of one patient, and would drive
    out those that the user comes back to.
    """
    token = _is_passing.set(True)
    try:
        yield
    finally:
        _is_passing.reset(token)


@contextlib.contextmanager
def cache_in(folder: Path) -> Iterator[None]:
    """In this block another folder is the cache, such as an empty one, to measure without it."""
    token = _other_folder.set(folder)
    try:
        yield
    finally:
        _other_folder.reset(token)


def fingerprint(parameters: dict[str, Any]) -> str:
    """Changes with the parameters, and with the code and the packages that make organs.

    Comments, docstrings and formatting of that code do not count.
    """
    digest = hashlib.sha256(json.dumps(parameters, sort_keys=True).encode())
    digest.update(_code_digest(Path(__file__).parents[1]))
    return digest.hexdigest()[:16]


@cache
def _code_digest(package: Path) -> bytes:
    """Checksum of the statements that make organs, of the compiled core and of the packages."""
    digest = hashlib.sha256()
    for path in _files(package):
        digest.update(path.relative_to(package).as_posix().encode())
        code = compile(path.read_bytes(), path.name, "exec", optimize=2, dont_inherit=True)
        digest.update(_instructions(code).encode())
    digest.update(json.dumps([core_sha256(), versions(ORGAN_PACKAGES)]).encode())
    return digest.digest()


def _files(package: Path) -> list[Path]:
    """Source files whose statements make organs."""
    files = [path for name in _MAKERS for path in (package / name).rglob("*.py")]
    return sorted([*files, *(package / f"{name}.py" for name in _MAKER_MODULES)])


def _instructions(code: CodeType) -> str:
    """Bytecode, names and constants of a module or function, those within it included.

    Of code compiled with `optimize=2`, which has no docstrings. Line numbers are left out.
    """
    constants = []
    for constant in code.co_consts:
        if isinstance(constant, CodeType):
            constants.append(_instructions(constant))
        elif isinstance(constant, frozenset):  # in another order in each process
            constants.append(str(sorted(map(repr, constant))))
        else:
            constants.append(repr(constant))
    names = (code.co_names, code.co_varnames, code.co_freevars, code.co_cellvars)
    counts = (code.co_flags, code.co_argcount, code.co_posonlyargcount, code.co_kwonlyargcount)
    instructions = code.co_code.hex() + code.co_exceptiontable.hex()
    return f"{code.co_name} {counts} {names} {instructions} {constants}"


def _write_organ(path: Path, organ: OrganSurface) -> None:
    """Write an organ under a temporary name, then rename it, so that no half file is ever seen."""
    arrays, plain = organ_to_arrays(organ)
    arrays["plain"] = np.array(json.dumps(plain))
    with atomic_write(path) as temporary, temporary.open("wb") as file:
        np.savez(file, **arrays)  # pyright: ignore[reportArgumentType]


def _mark_used(path: Path) -> None:
    """Set a file's time to now."""
    with contextlib.suppress(OSError):  # a folder that is only read needs no order
        os.utime(path)


def _forget_unused(folder: Path, most_bytes: float) -> None:
    """Remove the organs used longest ago where all take too much space."""
    found, total = [], 0
    for path in folder.iterdir():
        with contextlib.suppress(OSError):  # removed by another process meanwhile
            stat = path.stat()
            if path.suffix == ".npz":
                found.append((stat.st_mtime_ns, stat.st_size, path))
            elif is_temporary(path.name):  # another process is writing it
                total += stat.st_size
    for rank, (_, size, path) in enumerate(sorted(found, reverse=True)):
        total += size
        if rank > 0 and total > most_bytes:
            with contextlib.suppress(OSError):  # open in another process, on Windows
                path.unlink()


def _read_organ(path: Path) -> OrganSurface:
    """Read an organ that `_write_organ` wrote."""
    values = read_arrays(path)
    values |= json.loads(str(values.pop("plain")))
    return organ_from_arrays(values)


def _write_files(path: Path, files: dict[str, bytes]) -> None:
    """Write files into one archive, under a temporary name at first."""
    with atomic_write(path) as temporary, temporary.open("wb") as file:
        arrays: dict[str, Any] = {n: np.frombuffer(data, np.uint8) for n, data in files.items()}
        np.savez(file, **arrays)


def _read_files(path: Path) -> dict[str, bytes]:
    """Read files that `_write_files` wrote."""
    return {name: array.tobytes() for name, array in read_arrays(path).items()}
