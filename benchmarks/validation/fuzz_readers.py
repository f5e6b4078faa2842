"""Feed all readers with mutated files, and print the outcomes.

An input is read, or rejected in one line; a traceback, a panic of the core, more than 20 s, or a
impossible value (poses that are not rigid, numbers that are not finite, negative depth) is a
fault. The same seed gives the same inputs::

    python -m benchmarks.validation.fuzz_readers --count 10000 --seed 0 --keep /tmp/failing
"""

from __future__ import annotations

import argparse
import sys
import tempfile
from pathlib import Path

from tests.support.reader_fuzz import KEEP, OUTCOMES, fuzz
from tests.support.reader_targets import all_targets, recorded_tube


def main() -> int:
    """Exit status: 1 if a fault occurred, otherwise 0."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--count", type=int, default=10_000, help="inputs, over all readers")
    parser.add_argument("--seed", type=int, default=0, help="of the mutations")
    parser.add_argument("--only", nargs="*", default=[], help="names of readers; default: all")
    parser.add_argument("--keep", type=Path, help="folder for inputs that failed")
    given = parser.parse_args()
    KEEP.extend([given.keep] if given.keep else [])
    with tempfile.TemporaryDirectory(prefix="vrcaps-fuzz-") as folder:
        targets = all_targets(Path(folder) / "inputs", recorded_tube(Path(folder) / "tube"))
        targets = [one for one in targets if not given.only or one.name in given.only]
        print("| reader | inputs |", " | ".join(OUTCOMES), "|")
        print("|---|" + "---|" * (1 + len(OUTCOMES)))
        failures: list[str] = []
        for k, target in enumerate(targets):
            count = given.count // len(targets) + (k < given.count % len(targets))
            found = fuzz(target, given.seed, count)
            numbers = " | ".join(str(found.counts[outcome]) for outcome in OUTCOMES)
            print(f"| {target.name} | {count} | {numbers} |", flush=True)
            failures += found.failures
    print(*failures, sep="\n")
    return int(bool(failures))


if __name__ == "__main__":
    sys.exit(main())
