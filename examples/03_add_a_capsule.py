"""Add a custom capsule with one small file.

    python examples/03_add_a_capsule.py

The file below describes a wide-angle capsule with four LEDs; `mirocam.toml` in the package's
`capsule/devices` explains every key. The path of such a file can be used wherever a capsule's name
is expected:

    vrcaps record --capsule runs/my-capsule/wide.toml --out runs/wide
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np

import vrcaps

WIDE = """
title = "Wide-angle capsule"
source = "A design study."
length_mm = 24.0
radius_mm = 5.5
mass_g = 3.0
frame_rate_hz = 10

[[cameras]]
name = "front"
width_px = 256
height_px = 256
position_mm = [0, 0, 7.0]
rotation = [[1, 0, 0], [0, 1, 0], [0, 0, 1]]
exposure_m2_sr_per_w = 0.08
image_circle_px = 126

[cameras.lens]
kind = "equidistant" # a pixel's distance from the center grows evenly with the angle
focal_px = 84.0 # pixels a radian
cx_px = 127.5
cy_px = 127.5
max_angle_deg = 86

[[cameras.led_rings]]
center_mm = [0, 0, -0.5]
radius_mm = 3.5
angles_deg = [45, 135, 225, 315]
intensity_mw_per_sr = [2, 2, 2]
lobe_exponent = 1
"""


def main(out: Path, frames: int) -> None:
    """Write the device file, plot its lens, record with it."""
    out.mkdir(parents=True, exist_ok=True)
    path = out / "wide.toml"
    path.write_text(WIDE, encoding="utf-8")

    # Reading validates the file: a lens that folds back or a camera without light is an error.
    device = vrcaps.read_device(path)
    (camera,) = device.cameras
    rays = camera.lens.unproject(np.array([[127.5, 127.5], [127.5 + 120.0, 127.5]]))
    angle = np.degrees(np.arccos(rays[1] @ rays[0]))
    print(f"{device.title}: 120 pixels off the axis is {angle:.1f}° off the axis.")

    scenario = vrcaps.Scenario(capsule=str(path), frames=frames, channels=("rgb", "depth"))
    vrcaps.record(scenario, out / "episode")
    print(f"Look at {out / 'episode' / 'sheet.png'}.")


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--out", type=Path, default=Path("runs/my-capsule"))
    parser.add_argument("--frames", type=int, default=30)
    parser.add_argument("--smoke", action="store_true", help="record three frames only")
    args = parser.parse_args()
    main(args.out, 3 if args.smoke else args.frames)
