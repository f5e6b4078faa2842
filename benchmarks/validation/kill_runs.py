"""Claim: a run killed by SIGKILL at any time loses and leaves no files, and can be repeated.

Each kill hits one process, the head, at a seeded moment of its usual duration. Then no process of
the run may be alive after 2 s; the same command must succeed; its files must be those of an
undisturbed run; and no temporary file, partial folder or lock may be left, in the output folder,
beside it or in the cache.

    python -m benchmarks.validation.kill_runs [--size KILLS] [--verbs record …]
"""

from __future__ import annotations

import os
import random
import re
import shutil
import signal
import subprocess
import sys
import tempfile
import time
import uuid
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

from benchmarks.common.scripts import ROOT, parser, table, write_section
from vrcaps.core.files import file_sha256, files_in

SEED = 39
MARK = "VRCAPS_KILL_RUN"
"""Variable of the environment by which all processes of a run are found."""

PATIENCE = 2.0
"""Time after which no process of a killed run may be alive [s]."""

STALE = re.compile(r"\.tmp$|\.partial$|\.lock$|^\.resume$")
VOLATILE = {"progress.csv", "checkpoint.pt", "checkpoint.npz"}
"""Files of a training that hold the seconds that it took."""


HEAD = ("verb", "kills", "while files are written", "longest life of a process", "repeated")
HEAD += ("same files", "stale files")


@dataclass(frozen=True)
class Verb:
    """A command whose runs are killed.

    Attributes:
        words: Arguments of `vrcaps`, with OUT for the output folder.
        share: Kills of it among 100.
        is_endless: Whether the command runs until it is interrupted.
    """

    words: str
    share: int
    is_endless: bool = False


VERBS = {
    "record": Verb(
        "record --organ tube.glb --capsule tiny.toml --frames 120 --channels rgb depth --out OUT",
        20,
    ),
    "dataset, pool": Verb("dataset make plan.toml --workers 2 --out OUT", 18),
    "dataset, Ray": Verb("dataset make plan.toml --ray local --workers 2 --out OUT", 10),
    "train": Verb(
        "train depth --data images --preset ci --start scratch --set steps=12 "
        "--set evaluate_every=3 --device cpu --out OUT",
        14,
    ),
    "predict": Verb("predict depth --weights best.safetensors --images images --out OUT", 14),
    "export": Verb("export kitti images --rectify 60 --out OUT", 14),
    "cockpit": Verb("cockpit --organ tube.glb --out OUT --port PORT", 10, is_endless=True),
}


@dataclass
class Kills:
    """Outcome of the kills of one verb."""

    writing: int = 0
    lives: list[float] = field(default_factory=list)
    repeated: int = 0
    same: int = 0
    stale: list[str] = field(default_factory=list)


class Place:
    """Folder with small inputs, and runs of vrcaps in it."""

    def __init__(self, folder: Path) -> None:
        self.folder, self.cache = folder, folder / "cache"

    def start(self, words: str, out: Path, mark: str = "none") -> subprocess.Popen[str]:
        """Start a run without waiting for it."""
        given = [str(out) if word == "OUT" else word for word in words.split()]
        code = "from vrcaps.cli import main\nif __name__ == '__main__':\n    main()\n"
        script = self.folder / "run.py"
        if not script.exists():
            script.write_text(code)
        return subprocess.Popen(
            [sys.executable, script, *given],
            cwd=self.folder,
            env={**os.environ, MARK: mark, "VRCAPS_CACHE": str(self.cache)},
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
        )

    def run(self, words: str, out: Path, mark: str = "none") -> None:
        """Complete a run.

        Raises:
            RuntimeError: If it fails.
        """
        process = self.start(words, out, mark)
        text, _ = process.communicate()
        if process.returncode:
            raise RuntimeError(f"{words}: {text[-2000:]}")


def main() -> None:
    """Kill all verbs and write the table."""
    made = parser(__doc__ or "")
    made.add_argument("--size", type=int, default=100, help="kills")
    made.add_argument("--verbs", nargs="*", default=list(VERBS), help="of all these")
    given = made.parse_args()
    rows = []
    with tempfile.TemporaryDirectory(prefix="vrcaps-kills-") as name:
        place = prepared(Path(name), given.verbs)
        for verb in given.verbs:
            count = max(1, round(VERBS[verb].share * given.size / 100))
            rows.append(row(verb, count, killed(place, verb, count)))
            print(rows[-1], flush=True)
    text = f"""## Crash safety of commands

`python -m benchmarks.validation.kill_runs`: the process of a command is killed by SIGKILL at a
seeded moment, {sum(int(row[1]) for row in rows)} times in all; then the same command runs to its
end. Compared with an undisturbed run: every file, byte by byte; of a training its weights,
pictures and settings. A drive of the cockpit has no end: its files must make an episode. Stale
files are temporary files, partial folders and locks in the output folder, beside it and in the
cache.

{table(HEAD, rows)}
"""
    write_section(given.out, Path(__file__), text)


def prepared(folder: Path, verbs: list[str]) -> Place:
    """Small inputs of some verbs."""
    from tests.support.tiny_dataset import write_tiny_plan

    write_tiny_plan(folder, 6)
    place = Place(folder)
    record = VERBS["record"].words
    if {"train", "predict", "export"} & {*verbs}:
        place.run(record.replace("120", "24"), folder / "images")
    if "predict" in verbs:
        place.run(VERBS["train"].words, folder / "trained")
        shutil.copy(folder / "trained" / "best.safetensors", folder / "best.safetensors")
    return place


def killed(place: Place, verb: str, count: int) -> Kills:
    """Kill runs of one verb and repeat them."""
    draw, found = random.Random(f"{SEED} {verb}"), Kills()
    judge: Callable[..., None] = _drive_again if VERBS[verb].is_endless else _repeat
    whole = place.folder / "whole" / verb.replace(", ", "-")
    begin, end = _usual(place, verb, whole)
    for number in range(count):
        out = place.folder / "runs" / f"{verb.replace(', ', '-')}-{number}" / "out"
        out.parent.mkdir(parents=True)
        mark = uuid.uuid4().hex
        # A fifth while packages are imported, the others while files are written.
        moment = draw.uniform(0.0, begin) if number % 5 == 4 else draw.uniform(begin, end)
        process = place.start(_with_port(verb, number), out, mark)
        time.sleep(moment)
        found.writing += bool(files_beside(out))
        process.send_signal(signal.SIGKILL)
        process.wait()
        found.lives.append(life(mark))
        judge(place, verb, number, out, whole, found)
        found.stale += stale(out.parent) + stale(place.cache)
        shutil.rmtree(out.parent)
    return found


def _usual(place: Place, verb: str, whole: Path) -> tuple[float, float]:
    """Times of an undisturbed run at which it writes its first file, and ends [s]."""
    whole.parent.mkdir(exist_ok=True)
    began = time.monotonic()
    process = place.start(_with_port(verb, 0), whole)
    while process.poll() is None and not files_beside(whole):
        time.sleep(0.01)
    first = time.monotonic() - began
    if VERBS[verb].is_endless:
        time.sleep(3.0)
        process.kill()
    text, _ = process.communicate()
    if process.returncode and not VERBS[verb].is_endless:
        raise RuntimeError(f"{verb}: {text[-2000:]}")
    return first, time.monotonic() - began


def _repeat(place: Place, verb: str, number: int, out: Path, whole: Path, found: Kills) -> None:
    """Run the same command to its end; a complete folder needs none, and some verbs reject it."""
    try:
        place.run(VERBS[verb].words, out)
    except RuntimeError as error:
        if "exists. Give a new or empty folder" not in str(error):
            print(error, flush=True)
            return
    found.repeated += 1
    if checksums(out) == checksums(whole):
        found.same += 1
    else:
        ours, theirs = checksums(out), checksums(whole)
        different = sorted(k for k in {**ours, **theirs} if ours.get(k) != theirs.get(k))
        print(f"{verb} {number}: {different[:10]}", flush=True)


def _drive_again(
    place: Place, verb: str, number: int, out: Path, whole: Path, found: Kills
) -> None:
    """Record a drive; the same command opens the page again, or names the drive."""
    drive = out / "drive.json"
    if drive.exists():
        text, _ = place.start(_with_port(verb, number), out).communicate()
        if "contains a drive" not in text:
            print(text, flush=True)
            return
        place.run(f"record {drive} --out OUT", out.parent / "episode")
        shutil.rmtree(out.parent / "episode")
        out = out.parent / "again"
    process = place.start(_with_port(verb, number), out)
    assert process.stdout is not None
    lines = []
    for line in process.stdout:
        lines.append(line)
        if line.startswith("Open http"):
            found.repeated += 1
            found.same += 1
            break
    else:
        print("".join(lines), flush=True)
    process.kill()
    process.communicate()


def _with_port(verb: str, number: int) -> str:
    return VERBS[verb].words.replace("PORT", str(18080 + number))


def files_beside(out: Path) -> list[Path]:
    """Files written by a run so far, without its lock."""
    return [path for path in files_in(out.parent) if not path.name.endswith(".lock")]


def life(mark: str) -> float:
    """Time until no process of a run is alive [s]; after a limit they are killed."""
    began = time.monotonic()
    while alive(mark):
        if time.monotonic() - began > 60.0:
            for pid in alive(mark):
                os.kill(pid, signal.SIGKILL)
            return float("inf")
        time.sleep(0.01)
    return time.monotonic() - began


def alive(mark: str) -> list[int]:
    """Processes of this machine with a mark in their environment."""
    found = []
    for path in Path("/proc").iterdir():
        if path.name.isdigit():
            try:
                if f"{MARK}={mark}".encode() in (path / "environ").read_bytes().split(b"\0"):
                    found.append(int(path.name))
            except OSError:
                continue
    return found


def stale(folder: Path) -> list[str]:
    """Temporary files, partial folders and locks."""
    return [str(path) for path in folder.rglob("*") if STALE.search(path.name)]


def checksums(folder: Path) -> dict[str, str]:
    """Checksum of each file that a run of the same command reproduces."""
    return {
        path.relative_to(folder).as_posix(): file_sha256(path)
        for path in files_in(folder)
        if path.name not in VOLATILE and ".staging" not in path.parts
    }


def row(verb: str, count: int, found: Kills) -> list[str]:
    """A row of the table."""
    for path in found.stale:
        print(f"stale: {path}", flush=True)
    return [
        *(verb, str(count), str(found.writing), f"{max(found.lives):.2f} s"),
        *(f"{found.repeated} of {count}", f"{found.same} of {count}", str(len(found.stale))),
    ]


if __name__ == "__main__":
    assert ROOT.is_dir()
    main()
