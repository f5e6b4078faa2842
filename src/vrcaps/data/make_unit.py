"""One unit of a data set made: recorded, committed in one step, entered in the ledger."""

from __future__ import annotations

import errno
import shlex
import shutil
import time
from collections.abc import Mapping
from dataclasses import dataclass
from functools import partial
from pathlib import Path

from vrcaps.data.ledger import EPISODES, enter, entry_of, is_whole
from vrcaps.data.organs import organ_entry, store_organ
from vrcaps.data.plan import Plan
from vrcaps.data.store import Store, open_store
from vrcaps.data.units import Unit, Units
from vrcaps.errors import InputError, StorageError, VrcapsError, reason_of
from vrcaps.made_with import made_here
from vrcaps.organ.cache import passing_organs

_WAIT = 0.2
"""Between looks at a unit that another process is making [s]."""

_FULL = {errno.ENOSPC, errno.EDQUOT}


@dataclass(frozen=True)
class Job:
    """What every worker needs to know.

    Attributes:
        plan: The plan.
        url: Of the store; an absolute path where it is a folder.
        folder: Working directory, from which paths in the plan lead.
        source: How the command line named the plan.
        made_with: Versions that every worker must have; None asks for none.
    """

    plan: Plan
    url: str
    folder: Path
    source: str = "PLAN"
    made_with: Mapping[str, str] | None = None

    def command(self, number: int) -> str:
        """The line that makes one unit again."""
        source, url = shlex.quote(self.source), shlex.quote(self.url)
        return f"vrcaps dataset make {source} --out {url} --units {number}:{number + 1} --workers 0"


@dataclass(frozen=True)
class Outcome:
    """How the making of a unit ended.

    Attributes:
        number: Of the unit.
        fault: Why it could not be made; None if it is whole.
        stops_all: Whether the fault is of the place where the data set lies, so that no other
            unit can be made either.
    """

    number: int
    fault: str | None = None
    stops_all: bool = False


class Maker:
    """Makes units of a job, one after the other; each worker has one."""

    def __init__(self, job: Job) -> None:
        """Opens the store.

        Raises:
            VrcapsError: If that is not possible.
            InputError: If this worker has other versions than the head, so that its bytes differ.
        """
        here = made_here()
        for name, version in (job.made_with or here).items():
            if here.get(name) != version:
                raise InputError(
                    f"a worker has {name} {here.get(name) or 'none'}, and the head has {version}. "
                    "All need the same, for the same bytes."
                )
        self._units, self._store = Units(job.plan), open_store(job.url)

    def make(self, number: int) -> Outcome:
        """Make a unit; a mistake of the plan or the place is told in the outcome."""
        try:
            make_unit(self._units, self._store, number)
        except StorageError as error:
            return Outcome(number, str(error), stops_all=True)
        except OSError as error:
            return Outcome(number, str(error), stops_all=error.errno in _FULL)
        except VrcapsError as error:
            return Outcome(number, str(error))
        return Outcome(number)

    def make_always(self, number: int) -> Outcome:
        """Make a unit; every fault is told in the outcome, also one of vrcaps itself."""
        try:
            return self.make(number)
        except Exception as error:  # whatever it is, the other units are still to be made
            return Outcome(number, f"{type(error).__name__}: {reason_of(error)}")


def make_unit(units: Units, store: Store, number: int) -> None:
    """Record one unit and commit it; one that another process is making is waited for.

    Raises:
        VrcapsError: If it cannot be made.
        OSError: If it cannot be written.
    """
    from vrcaps.locks import FolderInUseError, file_lock

    unit = units[number]
    lock = store.staging(f"{unit.name}.lock")
    while not is_whole(store, unit.name):
        try:
            # To the end: one who comes between recording and entry would write what is moved away.
            with file_lock(lock, f"the recording {unit.name}"):
                if not is_whole(store, unit.name):
                    _make_alone(unit, store)
        except FolderInUseError:
            time.sleep(_WAIT)


def _make_alone(unit: Unit, store: Store) -> None:
    """Record a unit that nobody else is making, and commit it."""
    from vrcaps.recording.layout import EPISODE_JSON
    from vrcaps.recording.recorder import record

    folder = store.staging(unit.name)
    if folder.exists() and not (folder / EPISODE_JSON).exists():
        shutil.rmtree(folder)  # what has no head cannot be gone on with
    with passing_organs():  # one that was broken off goes on where it stopped
        record(unit.scenario, folder, store_organ=partial(store_organ, store))
    entry = entry_of(unit, folder) | {"organ": organ_entry(store, folder)}
    store.put(folder, f"{EPISODES}/{unit.name}")
    enter(store, unit, entry)
