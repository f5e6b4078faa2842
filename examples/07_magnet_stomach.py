"""A magnet on an arm leads a capsule through an inflated stomach, from the body to the pylorus.

    python examples/07_magnet_stomach.py

The Panda holds a magnet above the patient's belly. It bears half the capsule's weight, pulls it
along the wall and turns it the way it goes. Prints where capsule and magnet are, and records what
the capsule saw. The same from the shell:

    vrcaps record --organ stomach --condition inflated --capsule magnetic --motion magnet \
        --arm panda --start 0.3 --frames 21 --fps 2 --out runs/magnet
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np

import vrcaps
from vrcaps.record.recorder import record
from vrcaps.units import CM, DEG
from vrcaps.world.magnet_motion import MagnetSteering


def main(out: Path, frames: int, fps: float, substep: float) -> None:
    """Record the way, and print how the magnet led."""
    steering = MagnetSteering(arm="panda")
    motion = vrcaps.Physics(start=0.3, magnet=steering, substep=substep)
    organ = vrcaps.OrganGenerated("stomach", condition="inflated")
    scenario = vrcaps.Scenario(
        organ=organ, capsule="magnetic", motion=motion, frames=frames, fps=fps
    )
    record(scenario, out)

    run = vrcaps.read_episode(out).table.columns
    print(
        "time [s]  along [cm]  magnet x, y, z [cm]  distance [cm]  pull [mN]  off field [°]  state"
    )
    for k in range(0, frames, max(1, round(2.0 * fps))):
        x, y, z = (run[f"magnet_{axis}_m"][k] / CM for axis in "xyz")
        pull = 1e3 * np.linalg.norm([run[f"magnetic_force_{axis}_n"][k] for axis in "xyz"])
        print(
            f"{run['time_s'][k]:8.1f}  {run['arc_length_m'][k] / CM:10.1f}"
            f"  {x:7.1f} {y:5.1f} {z:5.1f}  {run['coupling_distance_m'][k] / CM:13.1f}"
            f"  {pull:9.0f}  {run['coupling_angle_rad'][k] / DEG:13.1f}"
            f"  {run['coupling_lost'][k] or 'held'} in the {run['segment'][k]}"
        )
    print(f"Look at {out / 'preview.mp4'} and {out / 'sheet.png'}.")


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--out", type=Path, default=Path("runs/magnet"))
    parser.add_argument("--frames", type=int, default=21)
    parser.add_argument("--fps", type=float, default=2.0)
    parser.add_argument("--smoke", action="store_true", help="record three frames only, coarsely")
    args = parser.parse_args()
    if args.smoke:
        main(args.out, 3, args.fps, 1e-3)
    else:
        main(args.out, args.frames, args.fps, 2e-4)
