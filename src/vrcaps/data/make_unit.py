"""Make one unit of a data set: record it, commit it in one step, enter it in the ledger."""

from __future__ import annotations

import errno
import shlex
import shutil
import time
from collections.abc import Mapping
from dataclasses import dataclass
from functools import partial
from pathlib import Path

from vrcaps.core.build_info import made_here
from vrcaps.core.errors import InputError, StorageError, VrcapsError, reason_of
from vrcaps.data.ledger import EPISODES, enter, entry_of, is_complete
from vrcaps.data.plan import Plan
from vrcaps.data.store import Store, open_store, organ_entry, store_organ
from vrcaps.data.units import Unit, Units
from vrcaps.organ.cache import short_lived_organs

_WAIT = 0.2
"""Interval between checks of a unit that another process is making [s]."""

_FULL = {errno.ENOSPC, errno.EDQUOT}


@dataclass(frozen=True)
class Job:
    """Job description shared by all workers.

    Attributes:
        plan: The plan.
        url: URL of the store; an absolute path for a folder.
        folder: Working directory for relative paths in the plan.
        source: Name of the plan on the command line.
        made_with: Versions that every worker must have; None checks none.
    """

    plan: Plan
    url: str
    folder: Path
    source: str = "PLAN"
    made_with: Mapping[str, str] | None = None

    def command(self, index: int) -> str:
        """Command that makes one unit again."""
        source, url = shlex.quote(self.source), shlex.quote(self.url)
        return f"vrcaps dataset make {source} --out {url} --units {index}:{index + 1} --workers 0"


@dataclass(frozen=True)
class Outcome:
    """Result of making a unit.

    Attributes:
        index: Index of the unit.
        fault: Reason of the failure; None if the unit is complete.
        stops_all: Whether the fault is of the store, so that no other unit can be made either.
    """

    index: int
    fault: str | None = None
    stops_all: bool = False


class Maker:
    """Make units of a job, one after the other; each worker has one instance."""

    def __init__(self, job: Job) -> None:
        """Open the store.

        Raises:
            VrcapsError: If that is not possible.
            InputError: If this worker has other versions than the head node, so bytes would differ.
        """
        here = made_here()
        for name, version in (job.made_with or here).items():
            if here.get(name) != version:
                raise InputError(
                    f"A worker has {name} {here.get(name) or 'none'}, the head node has {version}. "
                    "Install the same version everywhere; otherwise bytes differ."
                )
        self._units, self._store = Units(job.plan), open_store(job.url)

    def make(self, index: int) -> Outcome:
        """Make a unit; plan and storage errors are returned in the outcome."""
        try:
            make_unit(self._units, self._store, index)
        except StorageError as error:
            return Outcome(index, str(error), stops_all=True)
        except OSError as error:
            return Outcome(index, str(error), stops_all=error.errno in _FULL)
        except VrcapsError as error:
            return Outcome(index, str(error))
        return Outcome(index)

    def make_always(self, index: int) -> Outcome:
        """Make a unit; all errors are returned in the outcome, including internal ones."""
        try:
            return self.make(index)
        except Exception as error:  # any error: the other units are still to be made
            return Outcome(index, f"{type(error).__name__}: {reason_of(error)}")


def make_unit(units: Units, store: Store, index: int) -> None:
    """Record one unit and commit it; wait if another process is making it.

    Raises:
        VrcapsError: If it cannot be made.
        OSError: If it cannot be written.
    """
    from vrcaps.core.processes import FolderInUseError, file_lock

    unit = units[index]
    lock = store.staging(f"{unit.name}.lock")
    while not is_complete(store, unit.name):
        try:
            # Keep the lock: a process between recording and entry would write moved files.
            with file_lock(lock, f"the recording {unit.name}"):
                if not is_complete(store, unit.name):
                    _make_alone(unit, store)
        except FolderInUseError:
            time.sleep(_WAIT)


def _make_alone(unit: Unit, store: Store) -> None:
    """Record and commit a unit that no other process is making."""
    from vrcaps.recording.layout import EPISODE_JSON
    from vrcaps.recording.recorder import record

    folder = store.staging(unit.name)
    if folder.exists() and not (folder / EPISODE_JSON).exists():
        shutil.rmtree(folder)  # a recording without a head cannot be resumed
    with short_lived_organs():  # an interrupted recording resumes
        record(unit.scenario, folder, store_organ=partial(store_organ, store))
    entry = entry_of(unit, folder) | {"organ": organ_entry(store, folder)}
    store.put(folder, f"{EPISODES}/{unit.name}")
    enter(store, unit, entry)
