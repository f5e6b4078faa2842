"""A passive transit: the small bowel's strongest contractions carry a capsule along.

    python examples/04_small_bowel_phase_three.py

Phase III of the fasting gut: every slow wave contracts, the rings run on at 1 to 2 cm/s and take
the capsule with them through contact alone; mucus damps it. It slides back where a ring has passed
and the gut rises. Prints how far it got, how hard the wall held it and what friction cost, and
records what the camera saw. Without the mucus, from the shell:

    vrcaps record --organ small-bowel --motion physics --motility phase-three --start 0.3 \
        --frames 120 --fps 6 --out runs/phase-three
"""

from __future__ import annotations

import argparse
from pathlib import Path

import vrcaps
from vrcaps.record.recorder import record
from vrcaps.tissue.drag import Drag
from vrcaps.units import CM, MM


def main(out: Path, frames: int, fps: float, substep: float) -> None:
    """Record the transit and print it as a table."""
    mucus = Drag(viscosity=1.0)  # N·s/m
    motion = vrcaps.Physics(start=0.3, motility="phase-three", drag=mucus, substep=substep)
    scenario = vrcaps.Scenario(
        organ=vrcaps.OrganGenerated("small-bowel"),
        motion=motion,
        frames=frames,
        fps=fps,
    )
    record(scenario, out)

    # The table of an episode has one row a frame; units are in the names of its columns.
    episode = vrcaps.read_episode(out)
    run = episode.table.columns
    start = run["arc_length_m"][0]
    print("time [s]  travelled [cm]  speed [mm/s]  grip [N]  touched [mm]  segment")
    for k in range(0, len(episode), max(1, len(episode) // 20)):
        print(
            f"{run['time_s'][k]:8.1f}  {(run['arc_length_m'][k] - start) / CM:14.2f}"
            f"  {run['capsule_along_gut_m_per_s'][k] / MM:12.1f}  {run['grip_n'][k]:8.2f}"
            f"  {run['contact_depth_m'][k] / MM:12.2f}  {run['segment'][k]}"
        )
    travelled, seconds = run["arc_length_m"][-1] - start, max(run["time_s"][-1], 1e-9)
    print(f"Mean speed {travelled / seconds / MM:.1f} mm/s.", end=" ")
    print(f"Friction took {1e3 * run['friction_work_j'].sum():.2f} mJ.")
    print(f"Look at {out / 'preview.mp4'} and {out / 'sheet.png'}.")


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--out", type=Path, default=Path("runs/phase-three"))
    parser.add_argument("--frames", type=int, default=120)
    parser.add_argument("--fps", type=float, default=6.0)
    parser.add_argument("--smoke", action="store_true", help="record three frames only, coarsely")
    args = parser.parse_args()
    if args.smoke:
        main(args.out, 3, args.fps, 1e-3)
    else:
        main(args.out, args.frames, args.fps, 2e-4)
