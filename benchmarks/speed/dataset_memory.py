"""Claim: the memory of making a data set does not grow with time.

Makes many short recordings of a small tube in this process, one for each patient, and compares the
resident memory after all with that after the 50th. Writes a section of docs/concepts/datasets.md
and fails if it has grown by more than 5 %. For example:

    python -m benchmarks.speed.dataset_memory
"""

from __future__ import annotations

import gc
import os
import sys
import tempfile
from dataclasses import replace
from pathlib import Path

import numpy as np

from benchmarks.common.scripts import options, table, write_section
from tests.support.write_ply import write_ply
from vrcaps.data.make import make_dataset
from vrcaps.data.plan import plan_from_plain
from vrcaps.data.runners.local import InProcess
from vrcaps.mesh.mesh import Mesh
from vrcaps.organ.organ_file import write_organ
from vrcaps.organ.read_organ import read_organ
from vrcaps.organ.surface import Appearance

_WARM, _ALLOWED = 50, 0.05
_MB = 1e6


def resident() -> float:
    """Resident memory of this process [MB]."""
    pages = int(Path("/proc/self/statm").read_text().split()[1])
    return pages * os.sysconf("SC_PAGE_SIZE") / _MB


def write_tube(folder: Path) -> Path:
    """An organ file: a tube 24 cm long and 4 cm wide, with a textured wall."""
    import trimesh

    mesh = trimesh.creation.capsule(height=0.2, radius=0.02, count=[24, 32])
    mesh = mesh.subdivide_to_size(max_edge=0.012)
    write_ply(folder / "tube.ply", Mesh(np.asarray(mesh.vertices), np.asarray(mesh.faces)))
    rng = np.random.default_rng(0)
    look = Appearance(
        albedo=rng.integers(90, 200, (256, 256, 3), np.uint8),
        roughness=np.full((256, 256), 128, np.uint8),
        height=np.zeros((256, 256), np.float32),
    )
    organ = read_organ(folder / "tube.ply", unit="m")
    write_organ(folder / "tube.glb", replace(organ, appearance=look))
    return folder / "tube.glb"


def measure(units: int, folder: Path) -> list[tuple[int, float]]:
    """Resident memory [MB] after each unit of a data set."""
    scenario = {
        "frames": 1,
        "organ": {"kind": "file", "path": str(write_tube(folder))},
        "motion": {"speed": {"uniform": [0.005, 0.01]}},
        "render": {"light": "direct", "shadows": False},
    }
    dataset = {"name": "memory", "patients": units}
    plan = plan_from_plain({"scenario": scenario, "dataset": dataset}, at="plan")
    found: list[tuple[int, float]] = []

    def note(done: int, _: int) -> None:
        gc.collect()
        found.append((done, resident()))
        if done % 50 == 0:
            print(f"{done}: {found[-1][1]:.1f} MB", file=sys.stderr, flush=True)

    made = make_dataset(plan, folder / "out", runner=InProcess(), progress=note)
    assert not made.failed, made.failed
    return found


def main() -> None:
    """Measure, write, and fail if memory grows."""
    given = options(__doc__ or "", 1000)
    with tempfile.TemporaryDirectory() as folder:
        found = dict(measure(given.size, Path(folder)))
    warm = min(_WARM, given.size // 2)
    growth = found[given.size] / found[warm] - 1.0
    marks = sorted({1, 10, warm, given.size // 4, given.size // 2, given.size})
    rows = [[f"{n:,}", f"{found[n]:.1f}"] for n in marks if n in found]
    verdict = "yes" if growth <= _ALLOWED else "NO"
    text = f"""## Memory use of dataset generation

{given.size:,} recordings of one frame (`rgb`, `depth`, `normal`, `label`, `instance`) in one
process. Growth after unit {warm}: {growth:.1%}; claimed: at most {_ALLOWED:.0%}: {verdict}.

"""
    text += table(["recordings", "resident memory [MB]"], rows)
    write_section(given.out, Path(__file__), text)
    if growth > _ALLOWED:
        sys.exit(1)


if __name__ == "__main__":
    main()
