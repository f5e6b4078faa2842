"""Pull through a narrow colon: force against distance.

    python examples/06_narrow_pull.py

A colon from which most of the gas is released grips the capsule all round. An elastic rod along the
gut pulls it at 1 cm/s, as in a measurement with a force gauge. This steps a `World` directly, as a
custom controller would. Prints force against distance, and writes it as a table (`pull.csv`) and a
figure (`pull.png`) with views from the capsule on the way.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import matplotlib
import numpy as np

import vrcaps
from vrcaps.core.geometry import transform_points
from vrcaps.core.units import CM, MM
from vrcaps.tissue.tissue import Tissue
from vrcaps.world.control import Control
from vrcaps.world.model import State
from vrcaps.world.world import World

matplotlib.use("Agg")

SPEED = 10.0 * MM  # speed of the hand that pulls [m/s]
STIFFNESS, DAMPING = 50.0, 1.0  # stiffness and damping of the rod [N/m], [N·s/m]
STEP = 2e-3  # time between two commands [s]; shorter than mass / damping, 3.3 ms
DEFLATED, LET_OUT = 0.36, 1.0  # remaining fraction of the lumen's width; release time [s]


def main(out: Path, distance: float, start: float, substep: float) -> None:
    """Pull, print, draw."""
    organ = vrcaps.generate_organ("colon", seed=0, distension="normal")
    model = vrcaps.Model(organ, vrcaps.read_device("mirocam"))
    line = organ.centerline
    points = transform_points(model.T_world_patient, line.points)
    tangents = line.frames[:, :, 2] @ model.T_world_patient[:3, :3].T

    first = int(np.searchsorted(line.arc_length, start * line.length))
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = line.frames[first], line.points[first]
    state = State(0.0, model.T_world_patient @ pose)
    world = World(model, Tissue(), state, substep=substep)

    # The gas is released while the rod holds the capsule; then the hand moves on.
    rows, views, here, hand = [], [], first, line.arc_length[first]
    count = round(distance / SPEED / STEP)
    for step in range(-round(LET_OUT / STEP), count):
        speed = SPEED if step >= 0 else 0.0
        # The search on the centerline stays near the previous position, never on another loop.
        window = slice(max(0, here - 15), here + 16)
        offset = world.T_world_capsule[:3, 3] - points[window]
        nearest = int(np.argmin(np.linalg.norm(offset, axis=1)))
        here, along = window.start + nearest, tangents[window.start + nearest]
        place = line.arc_length[here] + offset[nearest] @ along
        hand += speed * STEP
        pull = STIFFNESS * (hand - place) + DAMPING * (speed - world.velocity_world[0] @ along)
        width = 1.0 + (DEFLATED - 1.0) * min(1.0, 1.0 + step * STEP / LET_OUT)
        if step >= 0 and step % max(1, count // 6) == 0:
            views.append((place - rows[0][0] if rows else 0.0, world.state))
        world.step(Control(force_world=pull * along, insufflation=width), STEP)
        if step >= 0:
            rows.append((place, pull, world.contact.normal_force_total))

    table = np.array(rows)
    table[:, 0] -= table[0, 0]
    out.mkdir(parents=True, exist_ok=True)
    header = "distance_m,force_n,normal_force_total_n"
    np.savetxt(out / "pull.csv", table, "%.6f", ",", header=header, comments="")
    print("distance [cm]  force [mN]  grip [mN]")
    for traveled, force, grip in table[:: max(1, len(table) // 20)]:
        print(f"{traveled / CM:13.2f}  {1e3 * force:10.1f}  {1e3 * grip:9.1f}")
    print(f"Mean force {1e3 * table[:, 1].mean():.0f} mN, most {1e3 * table[:, 1].max():.0f} mN.")
    draw(out / "pull.png", model, table, views[:6])
    print(f"Look at {out / 'pull.png'}.")


def draw(
    path: Path, model: vrcaps.Model, table: np.ndarray, views: list[tuple[float, State]]
) -> None:
    """Plot force and grip against distance, with the capsule's views above."""
    from matplotlib.figure import Figure

    renderer = vrcaps.Renderer(model)
    figure = Figure(figsize=(12.0, 6.0), layout="constrained")
    grid = figure.add_gridspec(2, max(1, len(views)), height_ratios=(1.0, 1.3))
    for column, (traveled, state) in enumerate(views):
        panel = figure.add_subplot(grid[0, column])
        panel.imshow(renderer.render(state, model.device.cameras[0], channels=("rgb",)).rgb)
        panel.set_title(f"{traveled / CM:.1f} cm")
        panel.axis("off")
    plot = figure.add_subplot(grid[1, :])
    plot.plot(table[:, 0] / CM, 1e3 * table[:, 1], label="pull")
    plot.plot(table[:, 0] / CM, 1e3 * table[:, 2], label="grip of the wall", linewidth=0.8)
    plot.set(xlabel="distance [cm]", ylabel="force [mN]")
    plot.legend()
    figure.savefig(path, dpi=100)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--out", type=Path, default=Path("runs/pull"))
    parser.add_argument("--cm", type=float, default=6.0, help="how far to pull")
    parser.add_argument("--start", type=float, default=0.67, help="share of the centerline")
    parser.add_argument("--smoke", action="store_true", help="pull a millimeter, coarsely")
    args = parser.parse_args()
    if args.smoke:
        main(args.out, 0.1 * CM, args.start, 1e-3)
    else:
        main(args.out, args.cm * CM, args.start, 2e-4)
