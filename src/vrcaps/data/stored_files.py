"""Files of an episode in a store, read one by one on demand."""

from __future__ import annotations

import os
import posixpath
from collections.abc import Callable, Iterable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import lru_cache
from typing import TypeVar

from vrcaps.data.store import LocalStore, Store, open_store
from vrcaps.recording.layout import EpisodeFiles, LocalFiles

Item = TypeVar("Item")
Result = TypeVar("Result")

_READS = 32
"""Concurrent reads; reads of a remote store mostly wait."""


@dataclass(frozen=True)
class StoredFiles:
    """Files of an episode in a remote store, in this process and its child processes.

    Attributes:
        store_url: URL of the store.
        folder: Folder of the episode in the store; names may lead out of it, to shared files.
    """

    store_url: str
    folder: str = "."

    @property
    def url(self) -> str:
        """URL of the episode."""
        return self.store_url if self.folder == "." else f"{self.store_url}/{self.folder}"

    def read(self, name: str) -> bytes:
        """Return the bytes of a file."""
        path, root = posixpath.normpath(posixpath.join(self.folder, name)), self.store_url
        while path.startswith("../"):
            path, root = path.removeprefix("../"), root.rpartition("/")[0]
        return _connection(root, os.getpid()).read(path)


def episode_files(store: Store, folder: str = ".") -> EpisodeFiles:
    """Files of an episode in a folder of a store, or at the root of the store."""
    if isinstance(store, LocalStore):
        return LocalFiles(store.folder / folder)
    return StoredFiles(store.url, folder)


def read_at_once(read: Callable[[Item], Result], items: Iterable[Item]) -> list[Result]:
    """Read several items at once; results are in the order of the items."""
    with ThreadPoolExecutor(_READS) as pool:
        return list(pool.map(read, items))


@lru_cache(maxsize=16)
def _connection(url: str, process: int) -> Store:
    """Store of a URL for a process: a forked process cannot use its parent's."""
    return open_store(url)
