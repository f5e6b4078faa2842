"""Passive transit: the small bowel's strongest contractions carry a capsule along.

    python examples/04_small_bowel_phase_three.py

Phase III of the fasting gut: every slow wave contracts, the rings propagate at 1 to 2 cm/s and
carry the capsule with them through contact alone; mucus damps it. Where a ring has passed and the
gut rises, the capsule slides back. Prints distance, contact force and friction work, and records
the camera's images. Without the mucus, from the shell:

    vrcaps record --organ small-bowel --motion dynamics --start 0.3 \
        --set motion.motility=phase-three --frames 120 --fps 6 --out runs/phase-three

A custom mesh gets the muscle of the jejunum:

    python examples/04_small_bowel_phase_three.py --organ bowel.ply --unit mm
"""

from __future__ import annotations

import argparse
from pathlib import Path

import trimesh

import vrcaps
from vrcaps.core.units import CM, MM
from vrcaps.tissue.tissue import Drag


def make_phantom(path: Path) -> None:
    """Write a straight bowel with round ends, 22 mm wide and 16 cm long, as STL in mm."""
    trimesh.creation.capsule(height=140.0, radius=11.0, count=(32, 32)).export(path)


def main(out: Path, organ: Path | None, unit: str, frames: int, substep: float) -> None:
    """Record the transit and print it as a table."""
    bowel = vrcaps.OrganGenerated("small-bowel")
    if organ is not None:
        bowel = vrcaps.OrganFile(str(organ), unit=unit)
    mucus = Drag(viscosity=1.0)  # N·s/m
    motion = vrcaps.Dynamics(
        start=0.3, motility="phase-three", fallback_segment="jejunum", drag=mucus, substep=substep
    )
    scenario = vrcaps.Scenario(organ=bowel, motion=motion, frames=frames, fps=6.0)
    vrcaps.record(scenario, out)

    # The table of an episode has one row per frame; units are in the names of its columns.
    episode = vrcaps.read_episode(out)
    run = episode.table.columns
    start = run["arc_length_m"][0]
    print("time [s]  traveled [cm]  speed [mm/s]  grip [N]  touched [mm]  segment")
    for k in range(0, len(episode), max(1, len(episode) // 20)):
        print(
            f"{run['time_s'][k]:8.1f}  {(run['arc_length_m'][k] - start) / CM:14.2f}"
            f"  {run['capsule_along_gut_m_per_s'][k] / MM:12.1f}"
            f"  {run['normal_force_total_n'][k]:8.2f}"
            f"  {run['contact_depth_m'][k] / MM:12.2f}  {run['segment'][k]}"
        )
    traveled, seconds = run["arc_length_m"][-1] - start, max(run["time_s"][-1], 1e-9)
    print(f"Mean speed {traveled / seconds / MM:.1f} mm/s.", end=" ")
    print(f"Friction took {1e3 * run['friction_work_j'].sum():.2f} mJ.")
    print(f"Look at {out / 'preview.mp4'} and {out / 'sheet.png'}.")


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--out", type=Path, default=Path("runs/phase-three"))
    parser.add_argument("--organ", type=Path, help="PLY, OBJ, STL or GLB")
    parser.add_argument("--unit", default="mm", help="its length unit: m, cm, mm, or e.g. 5cm")
    parser.add_argument("--frames", type=int, default=120, help="at 6 per second")
    parser.add_argument("--smoke", action="store_true", help="three frames of a phantom, coarsely")
    args = parser.parse_args()
    if args.smoke:
        args.out.parent.mkdir(parents=True, exist_ok=True)
        phantom = args.out.parent / "bowel.stl"
        make_phantom(phantom)
        main(args.out, phantom, "mm", 3, 1e-3)
    else:
        main(args.out, args.organ, args.unit, args.frames, 2e-4)
