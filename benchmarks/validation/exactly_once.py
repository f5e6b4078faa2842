"""Claim: a data set whose workers and heads are killed has every unit once, with equal bytes.

200 units on a pool of processes and on Ray, with 1, 2 and 4 workers: a random worker is killed by
SIGKILL at 100 random moments and the head at five, each time started again with the same command,
at last to the end. Reference: the same plan made in one process, undisturbed.

An interrupted run resumes with the next row.

    python -m benchmarks.validation.exactly_once [--size UNITS] [--kills 100] [--heads 5]
"""

from __future__ import annotations

import json
import os
import random
import subprocess
import sys
import tempfile
import time
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

from benchmarks.common.scripts import ROOT, parser, table, write_section
from benchmarks.common.sources import digest
from vrcaps.core.files import file_sha256, files_in

STORE = ROOT / "build" / "exactly_once.json"
ROWS = [(runner, workers) for workers in (1, 2, 4) for runner in ("pool", "Ray")]
WORDS = {"pool": "spawn_main", "Ray": "ray::_make"}
"""Texts in the command lines of workers; a worker of Ray has this name while it makes a unit."""
HEAD = (
    *("runner", "workers", "workers killed", "of it while recording", "heads killed"),
    *("units in the ledger", "each once", "faults of `dataset check`", "same bytes"),
)
SEED = 7
LONGEST = 600.0
"""Time without a new unit after which a run counts as stuck [s]."""


@dataclass(frozen=True)
class Kills:
    """Counts of killed processes.

    Attributes:
        workers: Number of workers.
        recording: Of it those killed while a recording was under way.
        heads: Number of heads.
    """

    workers: int = 0
    recording: int = 0
    heads: int = 0


def main() -> None:
    """Make the data set undisturbed, then every row, and write the table."""
    made = parser(__doc__ or "")
    made.add_argument("--size", type=int, default=200, help="units")
    made.add_argument("--kills", type=int, default=100, help="kills of workers")
    made.add_argument("--heads", type=int, default=5, help="kills of heads")
    given = made.parse_args()
    key = f"{digest(Path(__file__))} {given.size} {given.kills} {given.heads}"
    known = json.loads(STORE.read_text()) if STORE.exists() else {}
    rows = known.get(key, {})
    with tempfile.TemporaryDirectory(prefix="vrcaps-once-") as name:
        folder = Path(name)
        before, interval = undisturbed(folder, given.size)
        for runner, workers in ROWS:
            title = f"{runner} {workers}"
            if title not in rows:
                out = folder / title.replace(" ", "-")
                kills = disturbed(out, given, runner, workers, interval)
                rows[title] = [runner, str(workers), *judged(out, before, kills, given.size)]
                print(rows[title], flush=True)
                STORE.parent.mkdir(exist_ok=True)
                STORE.write_text(json.dumps({key: rows}, indent=1))
    text = f"""## Crash safety of dataset generation

`python -m benchmarks.validation.exactly_once`: {given.size} recordings of two frames. A random
worker is killed by SIGKILL {given.kills} times and the head {given.heads} times, at random
moments spread over the run; a killed head is restarted with the same command, and finally runs
to the end. Ray is started by each head and dies with it. Every file of the data set is compared
byte by byte with the same plan made in one process.

{table(HEAD, [rows[f"{runner} {workers}"] for runner, workers in ROWS])}
"""
    write_section(given.out, Path(__file__), text)


def undisturbed(folder: Path, units: int) -> tuple[dict[str, str], float]:
    """Checksums of the data set made in one process, and the time of a unit [s]."""
    from tests.support.tiny_dataset import write_tiny_plan

    write_tiny_plan(folder, units)
    out, began = folder / "whole", time.monotonic()
    head(out, "--workers", "0").wait()
    return checksums(out), (time.monotonic() - began) / units


def disturbed(out: Path, given, runner: str, workers: int, interval: float) -> Kills:
    """Make the data set while its processes are killed; return the counts.

    Args:
        out: Of the data set.
        given: Numbers of units and of kills.
        runner: `pool` or `Ray`.
        workers: Number of workers.
        interval: Time that one worker takes for a unit [s].
    """
    draw = random.Random(f"{SEED} {runner} {workers}")
    flags = ["--workers", str(workers), *(["--ray", "local"] if runner == "Ray" else [])]
    events = [*[False] * given.kills, *[True] * given.heads]
    draw.shuffle(events)
    kills, process = Kills(), head(out, *flags)
    for number, is_head in enumerate(events):
        # A few units are left for the last kill.
        process = wait_for(out, (number * (given.size - 5)) // len(events), process, flags)
        time.sleep(draw.uniform(0.0, 1.5 * interval / workers))
        if is_head:
            process.kill()
            process.wait()
            process, kills = head(out, *flags), add(kills, heads=1)
            continue
        while not (found := workers_of(process.pid, runner)):
            process = wait_for(out, 0, process, flags)
            time.sleep(0.02)
        recording = any((out / ".staging").glob("*/episode.json"))
        kill(draw.choice(found))
        kills = add(kills, workers=1, recording=int(recording))
    while process.wait():
        process = head(out, *flags)
    return kills


def wait_for(out: Path, units: int, process: subprocess.Popen, flags: list[str]):
    """Head process, once some units are complete; if it has ended, a new one.

    Args:
        out: Of the data set.
        units: Number that are to be whole.
        process: The head.
        flags: Of the command.
    """
    until = time.monotonic() + LONGEST
    while True:
        if process.poll() is not None:
            process = head(out, *flags)
        if num_whole(out) >= units:
            return process
        if time.monotonic() > until:
            raise SystemExit(f"{out} has {num_whole(out)} units and gets no more.")
        time.sleep(0.02)


def head(out: Path, *flags: str) -> subprocess.Popen:
    """Running command that makes the data set."""
    words = ["dataset", "make", "plan.toml", "--out", str(out), *flags]
    script = out.parent / "run.py"
    script.write_text(
        "import sys\nfrom vrcaps.cli import main\n"
        "if __name__ == '__main__':\n    main(sys.argv[1:])\n"
    )
    return subprocess.Popen([sys.executable, script, *words], cwd=out.parent)


def workers_of(pid: int, runner: str) -> list[int]:
    """Processes below a head that make units."""
    from tests.support.processes import command_of, descendants

    return [one for one in descendants(pid) if WORDS[runner] in command_of(one)]


def kill(pid: int) -> None:
    """SIGKILL a process, which may have ended."""
    with suppress(ProcessLookupError):
        os.kill(pid, 9)


def add(kills: Kills, workers: int = 0, recording: int = 0, heads: int = 0) -> Kills:
    """One more kill."""
    return Kills(kills.workers + workers, kills.recording + recording, kills.heads + heads)


def num_whole(out: Path) -> int:
    """Entries of the ledger."""
    return len(list((out / "ledger").glob("p*.json"))) if out.exists() else 0


def judged(out: Path, before: dict[str, str], kills: Kills, units: int) -> list[str]:
    """Cells of a row after that of its runner."""
    from vrcaps.data.check import check_dataset
    from vrcaps.data.ledger import entries
    from vrcaps.data.store import LocalStore

    numbers = sorted(entry["number"] for entry in entries(LocalStore(out)).values())
    episodes = len(list((out / "episodes").iterdir()))
    once = numbers == list(range(units)) and episodes == units
    faults = len(check_dataset(out, checksums_only=True))
    same = checksums(out) == before
    shown = [kills.workers, kills.recording, kills.heads, len(numbers)]
    return [*map(str, shown), "yes" if once else "NO", str(faults), "yes" if same else "NO"]


def checksums(out: Path) -> dict[str, str]:
    """Checksums of all complete files."""
    return {
        path.relative_to(out).as_posix(): file_sha256(path)
        for path in files_in(out)
        if path.relative_to(out).parts[0] != ".staging"
    }


if __name__ == "__main__":
    main()
