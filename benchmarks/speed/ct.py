"""Conversion of a whole scan to an organ: duration and memory.

Claim: 512 × 512 × 600 voxels to an organ in ≤ 3 minutes on two cores; 512 × 512 × 1000 voxels in
< 6 GB. Reference: radiology's usual matrix; the longest scan is a whole trunk at half a millimeter.

Each scan is a simulated one of a generated colon that fills it, written as a DICOM series. The
command runs in a separate process, from reading the files to `organ.glb` and its picture.
"""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
import time
from dataclasses import replace
from pathlib import Path

import numpy as np

from benchmarks.common.scripts import options, table, write_section
from tests.support.phantom import Scanner, scan_of, write_dicom
from vrcaps.anatomy.catalog import generate_organ
from vrcaps.core.units import MM
from vrcaps.mesh.mesh import Mesh
from vrcaps.tools.ct.volume import Volume

PIXEL = 0.88 * MM  # 450 mm across 512 pixels
HEIGHT = 552 * MM  # of the scan, whatever the number of slices
SECONDS, GIGABYTES = 180.0, 6.0
HEAD = ("voxels", "options", "time", "peak memory", "triangles", "claimed")


def whole_scan(num_slices: int, *, fluid_depth: float) -> Volume:
    """Scan of 512 × 512 pixels per slice, filled by body, gut and surrounding air."""
    organ = generate_organ("colon", seed=1)
    spacing = (HEIGHT / num_slices, PIXEL, PIXEL)
    scanner = Scanner(spacing=spacing, turn_deg=(0.0, 0.0, 0.0), fluid_depth=fluid_depth)
    scan = scan_of(Mesh(organ.vertices, organ.faces), scanner, np.random.default_rng(0))
    shape = (num_slices, 512, 512)
    missing = np.maximum(np.array(shape) - scan.values.shape, 0)
    missing[0] = 0
    values = np.pad(scan.values, [(m // 2, m - m // 2) for m in missing], constant_values=-1000)
    values = values[:num_slices, :512, :512]
    values = np.pad(values, [(0, num_slices - len(values)), (0, 0), (0, 0)], mode="edge")
    return replace(scan, values=values)


def run(arguments: list[str]) -> tuple[float, float]:
    """Seconds and peak memory [GB] of the command in a separate process.

    Raises:
        SystemExit: If it fails.
    """
    start = time.perf_counter()
    command = [sys.executable, "-c", "from vrcaps.cli import main; main()", *arguments]
    child = subprocess.Popen(command, stdout=subprocess.DEVNULL)
    _, status, usage = os.wait4(child.pid, 0)
    child.returncode = os.waitstatus_to_exitcode(status)
    if child.returncode:
        raise SystemExit(f"vrcaps {' '.join(arguments)} failed.")
    return time.perf_counter() - start, usage.ru_maxrss / 2**20


def measure(num_slices: int, flags: list[str], fluid_depth: float) -> tuple[str, ...]:
    """One row of the table."""
    from vrcaps.mesh.read_mesh import read_mesh

    with tempfile.TemporaryDirectory() as folder:
        dicom, out = Path(folder, "dicom"), Path(folder, "organ.glb")
        write_dicom(dicom, whole_scan(num_slices, fluid_depth=fluid_depth))
        seconds, peak = run(["organ", "from-ct", str(dicom), "--out", str(out), *flags])
        triangles = len(read_mesh(out, unit="m").faces)
    return (
        f"512 × 512 × {num_slices}",
        f"`{' '.join(flags)}`",
        f"{seconds:.0f} s",
        f"{peak:.1f} GB",
        f"{triangles:,}",
        "yes" if seconds <= SECONDS * num_slices / 600 and peak < GIGABYTES else "NO",
    )


def main() -> None:
    """Measure, write the table."""
    given = options(__doc__ or "", size=600)
    supine = ["--tagged-fluid", "supine"]
    rows = []
    for num in (600, 1000):
        rows.append(measure(num * given.size // 600, supine, 60 * MM))
        print(*rows[-1], sep=" | ", flush=True)
    text = (
        "## CT: time and memory\n\n`python -m benchmarks.speed.ct`: simulated scan of a generated "
        f"colon with tagged fluid, on\n{os.cpu_count()} cores, from DICOM files to the "
        "organ's file and its picture, including the start of the command.\n\n"
        + table(HEAD, rows)
        + f"\n\nClaimed: 600 slices in ≤ {SECONDS:.0f} s (others in proportion), and "
        f"< {GIGABYTES:.0f} GB."
    )
    write_section(given.out, Path(__file__), text)


if __name__ == "__main__":
    main()
