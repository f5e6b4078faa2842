"""Store of a data set at a URL, such as ``s3://bucket/name``: any file system of fsspec.

The service's own package waits and retries failed requests; a remaining error is reported on
one line. A unit is complete once its entry is in the ledger, so partly written units are ignored.
"""

from __future__ import annotations

import hashlib
import shutil
import uuid
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from typing import Any

from vrcaps.core.errors import InputError, MissingExtraError, StorageError
from vrcaps.core.files import cache_folder, files_in

_TRANSFERS = 8
"""Concurrent reads or writes; each needs at most the file's size of memory, or 100 MB."""


class RemoteStore:
    """Store on a file system of fsspec."""

    def __init__(self, url: str) -> None:
        """Initialize without connecting.

        Raises:
            MissingExtraError: If fsspec or its package for this kind of URL is not installed.
            InputError: If the kind of URL is unknown.
        """
        try:
            import fsspec
        except ImportError as error:
            raise MissingExtraError("fsspec", "scale") from error
        self.url = url.rstrip("/")
        try:
            self._system: Any
            self._system, self._root = fsspec.core.url_to_fs(self.url)
        except ImportError as error:
            raise MissingExtraError(error.name or str(error).rstrip("."), "scale") from error
        except ValueError as error:
            raise InputError(f"Cannot open {url}: {error}. Allowed: a folder or a URL.") from error
        # Object stores have no folders, show a file once it is complete, and serve many requests at
        # once; fsspec accesses them asynchronously. Others, such as SFTP, do not.
        self._is_object_store = bool(self._system.async_impl)

    def read(self, name: str) -> bytes:
        """Return the bytes of a file."""
        with self._storage_errors("read"):
            return self._system.cat_file(self._path(name))

    def has(self, name: str) -> bool:
        """Return whether a file exists."""
        with self._storage_errors("read"):
            self._system.invalidate_cache()
            return self._system.isfile(self._path(name))

    def write(self, name: str, data: bytes) -> None:
        """Write a file atomically."""
        path = self._path(name)
        with self._storage_errors("write"):
            if self._is_object_store:
                self._system.pipe_file(path, data)
                return
            self._make_parent(path)
            temporary = f"{path}.{uuid.uuid4().hex}.tmp"
            self._system.pipe_file(temporary, data)
            self._system.mv(temporary, path)

    def create(self, name: str, data: bytes) -> bool:
        """Write a file that does not exist yet."""
        path = self._path(name)
        with self._storage_errors("write"):
            if not self._is_object_store:
                self._make_parent(path)
            try:
                self._system.pipe_file(path, data, mode="create")
            except FileExistsError:
                return False
        return True

    def remove(self, name: str) -> None:
        """Remove a file, if it exists."""
        if self.has(name):
            with self._storage_errors("write"):
                self._system.rm_file(self._path(name))

    def is_empty(self) -> bool:
        """Return whether the store is empty."""
        return not self._list(self._root)

    def names(self, folder: str) -> list[str]:
        """Names of the files in a folder, except those being written."""
        entries = self._list(self._path(folder))
        names = (e["name"].rpartition("/")[2] for e in entries if e["type"] == "file")
        return sorted(name for name in names if not name.endswith(".tmp"))

    def staging(self, name: str) -> Path:
        """Folder in this machine's cache, where a killed recording can be resumed."""
        key = hashlib.sha256(self.url.encode()).hexdigest()[:16]
        return cache_folder() / "unfinished" / key / name.replace("/", "_")

    def put(self, staged: Path, name: str) -> None:
        """Copy all files, several at once; the ledger marks the unit complete afterwards."""
        transfer = partial(self._upload, staged, name)
        with ThreadPoolExecutor(_TRANSFERS if self._is_object_store else 1) as pool:
            list(pool.map(transfer, files_in(staged)))
        shutil.rmtree(staged)

    def free_bytes(self) -> int | None:
        """Unknown."""
        return None

    def _upload(self, staged: Path, name: str, file: Path) -> None:
        path = self._path(f"{name}/{file.relative_to(staged).as_posix()}")
        with self._storage_errors("write"):
            if not self._is_object_store:
                self._make_parent(path)
            self._system.put_file(str(file), path)

    def _list(self, path: str) -> list[dict[str, Any]]:
        with self._storage_errors("read"):
            self._system.invalidate_cache()
            try:
                return self._system.ls(path, detail=True)
            except FileNotFoundError:
                return []

    def _make_parent(self, path: str) -> None:
        self._system.makedirs(path.rpartition("/")[0], exist_ok=True)

    def _path(self, name: str) -> str:
        return f"{self._root}/{name}"

    @contextmanager
    def _storage_errors(self, action: str) -> Iterator[None]:
        """Convert errors of the service to one line; a missing file on reading is passed on.

        Raises:
            StorageError: If the block fails.
        """
        try:
            yield
        except FileNotFoundError as error:
            if action == "read":
                raise
            raise self._error(action, error) from error
        except Exception as error:  # each service has its own exception types
            raise self._error(action, error) from error

    def _error(self, action: str, error: Exception) -> StorageError:
        lines = str(error).strip().splitlines() or [type(error).__name__]
        return StorageError(
            f"Cannot {action} the data set {self.url}: {lines[0].rstrip('.')}. Completed files are "
            "kept. Fix the cause and repeat the command to resume."
        )
