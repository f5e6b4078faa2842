"""Claim: `import vrcaps` costs 50 ms of processor time beyond NumPy, and `vrcaps --help` 0.5 s.

Prints the minimum of some runs: ``python -m benchmarks.speed.start [--size RUNS]``.
"""

from __future__ import annotations

import argparse
import subprocess
import sys

STARTS = {
    "import vrcaps": "import numpy, time; t = time.process_time(); import vrcaps",
    "vrcaps --help": (
        "import contextlib, io, time; t = time.process_time(); import vrcaps.cli\n"
        "with contextlib.suppress(SystemExit), contextlib.redirect_stdout(io.StringIO()):\n"
        "    vrcaps.cli.main(['--help'])"
    ),
}


def main() -> None:
    """Print the processor time of each start."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--size", type=int, default=5, help="runs")
    runs = parser.parse_args().size
    for name, code in STARTS.items():
        command = [sys.executable, "-c", f"{code}\nprint(time.process_time() - t)"]
        found = [float(subprocess.check_output(command, text=True)) for _ in range(runs)]
        print(f"{name}: {1e3 * min(found):.0f} ms")


if __name__ == "__main__":
    main()
