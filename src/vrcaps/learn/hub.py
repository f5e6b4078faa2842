"""Published weights: an index of files with checksums, in a folder or at a URL.

A checkout of vrcaps contains them in its folder `weights`. An installed package has none, since
they are larger than the rest of it: `pull` copies them into the user's data folder. The variable
`VRCAPS_WEIGHTS` names another folder or the URL of such a folder; files from a URL are kept in the
cache folder.
"""

from __future__ import annotations

import hashlib
import os
import re
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass
from http import HTTPStatus
from http.client import HTTPException
from pathlib import Path
from urllib.error import HTTPError
from urllib.request import urlopen

from vrcaps.config.convert import from_plain, to_plain
from vrcaps.config.plain_files import decode_json
from vrcaps.core.errors import InputError, StorageError, UnknownNameError, reason_of, require
from vrcaps.core.files import cache_folder, file_sha256, write_bytes, write_json
from vrcaps.core.processes import ProgressReport, no_report
from vrcaps.data.store import open_store

INDEX, VARIABLE, SUFFIX = "index.json", "VRCAPS_WEIGHTS", ".safetensors"
_FORMAT = "vrcaps-published/1"
_NAME = re.compile(r"[a-z0-9]+(-[a-z0-9]+)*")
_SHA256 = re.compile(r"[0-9a-f]{64}")
_CHECKOUT = Path(__file__).parents[3] / "weights"
_MAX_TEXT_BYTES = 10**6
"""Maximum size of an index or a card."""
_MAX_BYTES = 10**10
"""Maximum size of a file of weights."""
_TIMEOUT = 30.0
"""Timeout of a web server that does not respond [s]."""


@dataclass(frozen=True)
class PublishedWeights:
    """Published weights, an entry of the index.

    Attributes:
        name: The task, for its default weights, or the task with a suffix after a dash.
        task: Name of the task.
        file: Name of the file next to the index.
        sha256: Its checksum, in hexadecimal.
        bytes: Its size.
        summary: One-line description.
    """

    name: str
    task: str
    file: str
    sha256: str
    bytes: int
    summary: str

    def __post_init__(self) -> None:
        check_name(self.name, self.task)
        require(self.file == self.name + SUFFIX, "file", self.file, self.name + SUFFIX)
        # Part of a file's name in the cache.
        is_checksum = _SHA256.fullmatch(self.sha256) is not None
        require(is_checksum, "sha256", repr(self.sha256), "64 hexadecimal digits")
        is_size = 0 < self.bytes <= _MAX_BYTES
        require(is_size, f"bytes of {self.name}", self.bytes, f"1 to {_MAX_BYTES}")


@dataclass(frozen=True)
class Index:
    """Index of the weights published in one location.

    Attributes:
        format: Version of the index.
        weights: The files, sorted by name.
    """

    format: str = _FORMAT
    weights: tuple[PublishedWeights, ...] = ()

    def __post_init__(self) -> None:
        require(self.format == _FORMAT, "format", self.format, _FORMAT)


def check_name(name: str, task: str) -> None:
    """Check the name of published weights.

    Raises:
        InputError: If it does not start with the task, or has other characters than allowed.
    """
    is_name = _NAME.fullmatch(name) is not None and f"{name}-".startswith(f"{task}-")
    allowed = f"{task}, or {task}-NAME of small letters, digits and dashes"
    require(is_name, "The name of published weights", name, allowed)


def weights_folder() -> str:
    """Folder or URL of published weights.

    It is `VRCAPS_WEIGHTS`, `weights` of the checkout, or the folder of pulled weights.

    Raises:
        InputError: If there is none of them.
    """
    if chosen := os.environ.get(VARIABLE):
        return chosen.rstrip("/")
    for folder in (_CHECKOUT, download_folder()):
        if (folder / INDEX).is_file():
            return str(folder)
    raise InputError(
        "There are no published weights on this machine. Fetch them with `vrcaps weights pull "
        f"--from URL`, set {VARIABLE} to a folder or URL that has them, or give a file (--weights "
        "FILE)."
    )


def download_folder() -> Path:
    """Folder of pulled weights: the user's data folder, such as ~/.local/share/vrcaps/weights."""
    from platformdirs import user_data_path

    return user_data_path("vrcaps", appauthor=False) / "weights"


def pull(
    source: str,
    names: Sequence[str] = (),
    *,
    folder: Path | None = None,
    progress: ProgressReport = no_report,
) -> tuple[PublishedWeights, ...]:
    """Copy published weights and their cards from a folder or URL, and check their checksums.

    Existing files with the checksum of the index are not copied again.

    Args:
        source: Folder or URL with an index.
        names: Names to copy; empty copies all.
        folder: Folder to copy to; None is `download_folder`.
        progress: Called with the bytes copied so far and in total.

    Returns:
        The entries.

    Raises:
        InputError: If there is no index, or a file is missing or differs from it; complete files
            are kept.
        UnknownNameError: If no published weights have the name.
        StorageError: If the source cannot be reached, or the folder cannot be written.
    """
    source, folder = source.rstrip("/"), folder or download_folder()
    index = read_index(source)
    for name in names:
        if name not in index:
            raise UnknownNameError("published weights", name, index)
    entries = tuple(index[name] for name in names or index)
    total, done = sum(entry.bytes for entry in entries), 0
    for entry in entries:
        _copy(source, entry, folder)
        add_to_index(folder, entry)
        done += entry.bytes
        progress(done, total)
    return entries


def _copy(source: str, entry: PublishedWeights, folder: Path) -> None:
    """Store a file and its card in a folder, unless the file exists."""
    try:
        if _store(source, entry, folder / entry.file):
            with suppress(InputError):  # a card is not required
                write_bytes(folder / f"{entry.name}.md", _read(source, f"{entry.name}.md"))
    except OSError as error:
        raise StorageError(
            f"Cannot write {folder / entry.file}: {reason_of(error)}. Give another folder (--out "
            "FOLDER)."
        ) from error


def _store(source: str, entry: PublishedWeights, path: Path) -> bool:
    """Store a published file with the checksum of the index; return False if it exists."""
    if path.is_file() and file_sha256(path) == entry.sha256:
        return False
    data = _read(source, entry.file, entry.bytes)
    actual = hashlib.sha256(data).hexdigest()
    if actual != entry.sha256:
        raise InputError(
            f"{source}/{entry.file} has sha256 {actual[:12]}…, but {INDEX} states "
            f"{entry.sha256[:12]}…. Try again, or report it to whoever published it."
        )
    path.parent.mkdir(parents=True, exist_ok=True)
    write_bytes(path, data)
    return True


def read_index(location: str) -> dict[str, PublishedWeights]:
    """Read the index of a folder or URL; returns its entries by name.

    Raises:
        InputError: If there is no index, or it is damaged.
        StorageError: If the location cannot be reached.
    """
    at, text = f"{location}/{INDEX}", _read(location, INDEX)
    index = from_plain(Index, decode_json(text, at), at=at)
    return {one.name: one for one in index.weights}


def find_weights(given: str, task: str = "") -> Path:
    """Resolve a command's argument to a file of weights.

    Args:
        given: A file, or the name of published weights; empty for those of the task.
        task: The task, if `given` may be empty.

    Raises:
        InputError: If there are none, or a published file is missing or differs from the index.
        UnknownNameError: If nothing of that name is published.
    """
    path = Path(given)
    if given and path.is_file():
        return path
    if given and (path.suffix == SUFFIX or path.name != given):
        raise InputError(
            f"No file at {given}. Give a file of weights ({SUFFIX}), or the name of published ones "
            "(`vrcaps weights list`)."
        )
    location = weights_folder()
    index = read_index(location)
    if not given and task not in index:
        raise InputError(
            f"No weights of the task {task!r} are published in {location}. Give --weights FILE; "
            f"`vrcaps train {task}` writes one."
        )
    if (given or task) not in index:
        raise UnknownNameError("file or published weights", given, index or ("none",))
    return fetch(location, index[given or task])


def fetch(location: str, entry: PublishedWeights) -> Path:
    """Return a local copy of a published file, with the checksum of the index.

    Raises:
        InputError: If it is missing, or differs from the index.
        StorageError: If the location cannot be reached.
    """
    if "://" not in location:
        path = Path(location) / entry.file
        if not path.is_file():
            raise InputError(
                f"{path} is missing, but {INDEX} lists it. Copy the whole folder again, or give "
                "another file (--weights FILE)."
            )
        _check(path, entry)
        return path
    path = cache_folder() / "weights" / f"{entry.name}-{entry.sha256[:16]}{SUFFIX}"
    _store(location, entry, path)
    return path


def add_to_index(folder: Path, entry: PublishedWeights) -> None:
    """Add an entry to the index of a folder, or replace the one of the same name.

    Raises:
        InputError: If the index is damaged.
    """
    known = read_index(str(folder)) if (folder / INDEX).is_file() else {}
    entries = {**known, entry.name: entry}
    index = Index(weights=tuple(entries[name] for name in sorted(entries)))
    write_json(folder / INDEX, to_plain(index, Index))


def _check(path: Path, entry: PublishedWeights) -> None:
    actual = file_sha256(path)
    if actual != entry.sha256:
        raise InputError(
            f"{path} has sha256 {actual[:12]}…, but {INDEX} states {entry.sha256[:12]}…. Copy both "
            "from one location again, or publish the weights again (vrcaps weights publish)."
        )


def _read(location: str, name: str, limit: int = _MAX_TEXT_BYTES) -> bytes:
    """Read a file of a folder or URL.

    Args:
        location: Folder or URL.
        name: Name of the file.
        limit: Maximum number of bytes to accept from a web server.
    """
    try:
        if location.startswith(("http://", "https://")):
            return _download(f"{location}/{name}", limit)
        return open_store(location).read(name)
    except FileNotFoundError as error:
        raise InputError(f"{location}, the folder of published weights, contains no {name}.") from (
            error
        )
    except StorageError as error:
        reason = error.__cause__ or error
        raise StorageError(
            f"Cannot read published weights from {location}: {str(reason).splitlines()[0]}. Set "
            f"{VARIABLE} to a folder that contains them, or give a file (--weights FILE)."
        ) from error


def _download(url: str, limit: int) -> bytes:
    """Read a file of a web server, without the packages that other stores need."""
    try:
        with urlopen(url, timeout=_TIMEOUT) as response:
            data = response.read(limit + 1)
    except HTTPError as error:
        if error.code == HTTPStatus.NOT_FOUND:
            raise FileNotFoundError(url) from error
        raise StorageError(f"the server responds {error.code} {error.reason}") from None
    except (OSError, HTTPException, ValueError) as error:
        raise StorageError(reason_of(str(getattr(error, "reason", error)))) from None
    if len(data) > limit:
        raise StorageError(f"{url} has more than {limit} bytes")
    return data
