"""The same work of a test module in processes with other numbers of threads."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Iterable
from pathlib import Path


def digests_by_threads(test: Path, threads: Iterable[int]) -> tuple[list[int], set[str]]:
    """The number of threads of each process, and what the module's `digest` gave in them.

    Each is a process of its own, for the number of threads is fixed when the core loads.
    """
    code = (
        f"import sys; sys.path[:0] = [{str(test.parent)!r}]\n"
        f"import {test.stem} as test\n"
        "from vrcaps import _core\n"
        "print(_core.num_threads(), test.digest())"
    )
    results = [
        subprocess.run(
            [sys.executable, "-c", code],
            env={**os.environ, "RAYON_NUM_THREADS": str(count), "OIDN_NUM_THREADS": str(count)},
            capture_output=True,
            text=True,
            check=True,
        ).stdout.split()
        for count in threads
    ]
    return [int(count) for count, _ in results], {checksum for _, checksum in results}
