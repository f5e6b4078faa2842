"""Capsule in an inflated stomach: it rolls to the lowest point as the patient turns.

    python examples/05_stomach_roll.py

Dropped in the middle, the capsule falls onto the wall; then the patient turns from the back onto
the left side, and onto the front. Prints the capsule's position and height, and records its images.
The same from the shell:

    vrcaps record --organ stomach --distension inflated --motion dynamics --start 0.4 \
        --set motion.settle=0.2 \
        --set 'motion.posture_changes=[{posture="left-lateral", time=2, duration=3},
        {posture="prone", time=8, duration=3}]' --frames 52 --fps 4 --out runs/roll
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np

import vrcaps
from vrcaps.core.geometry import invert, transform_points
from vrcaps.core.units import CM, DEG
from vrcaps.world.schedule import PostureChange


def main(out: Path, frames: int, fps: float, substep: float) -> None:
    """Record the fall and the turns, and print the capsule's position."""
    motion = vrcaps.Dynamics(
        start=0.4,
        posture_changes=(
            PostureChange("left-lateral", time=2.0, duration=3.0),
            PostureChange("prone", time=8.0, duration=3.0),
        ),
        settle=0.2,
        substep=substep,
    )
    organ = vrcaps.OrganGenerated("stomach", distension="inflated")
    vrcaps.record(vrcaps.Scenario(organ=organ, motion=motion, frames=frames, fps=fps), out)

    # Poses are in the world, where z is up. The patient's pose is in the table as well, so the
    # position in the patient (x left, y back, z head) can be computed.
    episode = vrcaps.read_episode(out)
    run = episode.table.columns
    world = episode.Ts_world_capsule[:, :3, 3]
    Ts_world_patient = episode.table.poses("patient")
    patient = transform_points(invert(Ts_world_patient), world[:, None])[:, 0]
    moved = patient - patient[0]
    turned = np.arccos((np.trace(Ts_world_patient[0, :3, :3].T @ Ts_world_patient[:, :3, :3],
                                 axis1=1, axis2=2) - 1.0).clip(-2.0, 2.0) / 2.0)  # fmt: skip
    print("time [s]  turned [°]  moved left, back, up [cm]  wall pushes [mN]  segment")
    for k in range(0, len(episode), max(1, round(fps / 2))):
        left, back, up = moved[k] / CM
        push = 1e3 * np.linalg.norm([run[f"contact_force_{axis}_n"][k] for axis in "xyz"])
        print(
            f"{run['time_s'][k]:8.2f}  {turned[k] / DEG:10.0f}"
            f"  {left:9.1f} {back:7.1f} {up:7.1f}  {push:16.1f}  {run['segment'][k]}"
        )
    print(f"Look at {out / 'preview.mp4'} and {out / 'sheet.png'}.")


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--out", type=Path, default=Path("runs/roll"))
    parser.add_argument("--frames", type=int, default=52)
    parser.add_argument("--fps", type=float, default=4.0)
    parser.add_argument("--smoke", action="store_true", help="record three frames only, coarsely")
    args = parser.parse_args()
    if args.smoke:
        main(args.out, 3, args.fps, 1e-3)
    else:
        main(args.out, args.frames, args.fps, 2e-4)
