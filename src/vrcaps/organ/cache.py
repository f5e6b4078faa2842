"""Disk cache of generated organs in the user's cache folder."""

from __future__ import annotations

import contextlib
import hashlib
import json
import os
import warnings
from collections.abc import Callable, Iterator
from contextvars import ContextVar
from functools import cache
from pathlib import Path
from typing import Any, TypeVar

import numpy as np

from vrcaps.core.build_info import ORGAN_PACKAGES, core_sha256, versions
from vrcaps.core.files import atomic_write, cache_folder, is_temporary, read_arrays
from vrcaps.organ.surface import OrganSurface, organ_from_arrays, organ_to_arrays

Stored = TypeVar("Stored")

_BROKEN = (OSError, ValueError, LookupError, TypeError, AttributeError)
"""Exceptions raised by reading a truncated, overwritten or outdated file."""

_MAKERS = ("core", "mesh", "organ", "mucosa", "anatomy", "lesion")
"""Packages whose code determines an organ."""

_MAKER_MODULES = (
    *("config/convert", "core/fields", "config/plain_files"),
    "scenario/build",
)
"""Other modules used by them, and their caller."""

_MAX_BYTES = 10 * 10**9
"""Maximum size of the cache; beyond it the least recently used organs are removed.

These include organs of older versions, which no other version reads.
"""

_MAX_SHORT_LIVED_BYTES = 4 * 10**9
"""Maximum size for organs that are needed only briefly (`short_lived_organs`)."""

_is_short_lived: ContextVar[bool] = ContextVar("is_passing", default=False)


def cached_organ(name: str, make: Callable[[], OrganSurface]) -> OrganSurface:
    """Load the organ stored under a name, or make it and store it.

    An unreadable file is replaced. A folder that is not writable causes a warning. The most
    recently used organs are kept, up to 10 GB, and up to 4 GB of `short_lived_organs`.

    Args:
        name: Identifies the organ, all its parameters and the code that makes it.
        make: Makes the organ.
    """
    return _cached(name, make, _read_organ, _write_organ)


def cached_files(name: str, make: Callable[[], dict[str, bytes]]) -> dict[str, bytes]:
    """Load or make files that belong to an organ, such as its coded textures (see `cached_organ`).

    Args:
        name: Identifies the organ, the kind of files and the code that makes them.
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
    short_lived = kept.parent / "passing" / kept.name
    for path in (kept, short_lived):
        try:
            if path.is_file():
                entries = read(path)
                _mark_used(path)
                return entries
        except _BROKEN:
            pass  # Regenerated and overwritten below.
    made, path = make(), short_lived if _is_short_lived.get() else kept
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        write(path, made)
        _remove_unused(path.parent, _MAX_SHORT_LIVED_BYTES if _is_short_lived.get() else _MAX_BYTES)
    except OSError as error:
        warnings.warn(
            f"Cannot write to the cache folder {path.parent}: {error.strerror}. The organ is "
            "generated again each time; set VRCAPS_CACHE to a writable folder.",
            stacklevel=3,
        )
    return made


@contextlib.contextmanager
def short_lived_organs() -> Iterator[None]:
    """Store organs made in this block in a separate, smaller part of the cache.

    A data set of many patients needs each organ only for the recordings of one patient, and would
    otherwise evict the organs that the user needs again.
    """
    token = _is_short_lived.set(True)
    try:
        yield
    finally:
        _is_short_lived.reset(token)


def fingerprint(parameters: dict[str, Any]) -> str:
    """Hash of the parameters and of the code and packages that make organs."""
    digest = hashlib.sha256(json.dumps(parameters, sort_keys=True).encode())
    digest.update(_code_digest(Path(__file__).parents[1]))
    return digest.hexdigest()[:16]


@cache
def _code_digest(package: Path) -> bytes:
    """Checksum of the modules that make organs, of the compiled core and of the packages."""
    digest = hashlib.sha256()
    for path in _files(package):
        digest.update(path.relative_to(package).as_posix().encode())
        digest.update(hashlib.sha256(path.read_bytes()).digest())
    digest.update(json.dumps([core_sha256(), versions(ORGAN_PACKAGES)]).encode())
    return digest.digest()


def _files(package: Path) -> list[Path]:
    """Source files that make organs."""
    files = [path for name in _MAKERS for path in (package / name).rglob("*.py")]
    return sorted([*files, *(package / f"{name}.py" for name in _MAKER_MODULES)])


def _write_organ(path: Path, organ: OrganSurface) -> None:
    """Write an organ under a temporary name, then rename it, so that no partial file is visible."""
    arrays, plain = organ_to_arrays(organ)
    arrays["plain"] = np.array(json.dumps(plain))
    with atomic_write(path) as temporary, temporary.open("wb") as file:
        np.savez(file, **arrays)  # pyright: ignore[reportArgumentType]


def _mark_used(path: Path) -> None:
    """Set a file's modification time to now."""
    with contextlib.suppress(OSError):  # a read-only folder needs no order
        os.utime(path)


def _remove_unused(folder: Path, max_bytes: float) -> None:
    """Remove the least recently used organs if the total size exceeds the limit."""
    entries, total = [], 0
    for path in folder.iterdir():
        with contextlib.suppress(OSError):  # removed by another process meanwhile
            stat = path.stat()
            if path.suffix == ".npz":
                entries.append((stat.st_mtime_ns, stat.st_size, path))
            elif is_temporary(path.name):  # another process is writing it
                total += stat.st_size
    for rank, (_, size, path) in enumerate(sorted(entries, reverse=True)):
        total += size
        if rank > 0 and total > max_bytes:
            with contextlib.suppress(OSError):  # open in another process, on Windows
                path.unlink()


def _read_organ(path: Path) -> OrganSurface:
    """Read an organ written by `_write_organ`."""
    values = read_arrays(path)
    values |= json.loads(str(values.pop("plain")))
    return organ_from_arrays(values)


def _write_files(path: Path, files: dict[str, bytes]) -> None:
    """Write files into one archive, under a temporary name first."""
    with atomic_write(path) as temporary, temporary.open("wb") as file:
        arrays: dict[str, Any] = {n: np.frombuffer(data, np.uint8) for n, data in files.items()}
        np.savez(file, **arrays)


def _read_files(path: Path) -> dict[str, bytes]:
    """Read files written by `_write_files`."""
    return {name: array.tobytes() for name, array in read_arrays(path).items()}
