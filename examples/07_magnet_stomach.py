"""Magnet on an arm that leads a capsule through an inflated stomach, from inlet to pylorus.

    python examples/07_magnet_stomach.py

The Panda holds a magnet above the patient's belly. It bears the capsule's weight, draws it gently
against the upper wall and leads it along a path on that wall, which follows the centerline from
just inside the cardia; it waits where the capsule does not follow. The drive is first simulated
to find when the pylorus is reached; then exactly that is recorded. Writes the capsule's images,
and its path from the patient's front and side (`way.png`). The same from the shell:

    vrcaps record --organ stomach --distension inflated --capsule magnetic --motion dynamics \
        --set motion.magnet.arm=panda --set motion.magnet.wall=upper \
        --set motion.magnet.standoff=0.03 --set motion.magnet.speed=0.01 \
        --start 0.05 --set motion.magnet.end=0.85 --set motion.substep=2e-4 --frames 38 --fps 2 \
        --out runs/magnet
"""

from __future__ import annotations

import argparse
from dataclasses import replace
from pathlib import Path

import matplotlib
import numpy as np

import vrcaps
from vrcaps.core.units import CM, DEG
from vrcaps.motion.rollout import Rollout
from vrcaps.recording.episode import Episode

matplotlib.use("Agg")

LONGEST = 60.0  # maximum duration of the drive [s]
STEERING = vrcaps.MagnetSteering(
    magnet="cylinder-76.2", arm="panda", standoff=3.0 * CM, wall="upper", speed=1.0 * CM, end=0.85
)


def main(out: Path, fps: float, substep: float, frames: int | None) -> None:
    """Drive, record the drive, print and plot the result."""
    scenario = vrcaps.Scenario(
        organ=vrcaps.OrganGenerated("stomach", distension="inflated"),
        capsule="magnetic",
        motion=vrcaps.Dynamics(start=0.05, magnet=STEERING, substep=substep),
        frames=round(LONGEST * fps) + 1 if frames is None else frames,
        fps=fps,
    )
    if frames is None:
        scenario = replace(scenario, frames=drive(scenario))
    vrcaps.record(
        scenario, out, progress=lambda done, all: print(f"recorded {done} of {all}", end="\r")
    )
    episode = vrcaps.read_episode(out)
    draw(episode, out / "way.png")
    print(f"\nLook at {out / 'way.png'}, {out / 'preview.mp4'} and {out / 'sheet.png'}.")


def drive(scenario: vrcaps.Scenario) -> int:
    """Simulate until the capsule arrives; print the progress; return the number of frames."""
    _, run = vrcaps.build(scenario)
    assert isinstance(run, Rollout)
    assert run.program is not None
    follower = run.program.follower
    assert follower is not None
    print("time [s]  along the way [cm]  distance [cm]  pull [mN]  off field [°]  state")
    frame = 0
    for step in run.steps():
        assert step.command is not None
        status, coupling, frame = step.command.controller, step.state.coupling, step.index
        assert status is not None
        assert coupling is not None
        if follower.has_arrived or frame % round(2.0 * run.fps) == 0:
            print(
                f"{step.state.time:8.1f}  {follower.arc_length / CM:12.1f} of"
                f" {follower.path.length / CM:.1f}  {coupling.distance / CM:13.1f}"
                f"  {1e3 * np.linalg.norm(coupling.force_world):9.0f}"
                f"  {coupling.angle / DEG:13.1f}  {status.lost or 'held'}"
            )
        if follower.has_arrived:
            print("The pylorus is reached.")
            break
    return min(frame + 2, len(run))  # the follower already knows the next frame


def draw(episode: Episode, path: Path) -> None:
    """Plot the stomach's outline, the paths of capsule and magnet, from the front and the side."""
    import matplotlib.pyplot as plt

    run, organ = episode.table.columns, episode.organ
    capsule = episode.Ts_world_capsule[:, :3, 3] / CM
    magnet = np.stack([run[f"magnet_{axis}_m"] for axis in "xyz"], axis=1) / CM
    figure, views = plt.subplots(1, 2, figsize=(10, 4.5), sharey=True, layout="constrained")
    for view, axis, name in ((views[0], 0, "towards the left"), (views[1], 1, "towards the head")):
        wall = organ.vertices[:, [axis, 2]] / CM
        view.triplot(*wall.T, organ.faces, color="#d07070", lw=0.05)
        view.plot(*magnet[:, [axis, 2]].T, "-", color="#b03030", label="magnet")
        view.plot(*capsule[:, [axis, 2]].T, "-o", color="#205080", ms=2.5, label="capsule")
        view.plot(*capsule[-1, [axis, 2]], "s", color="black", label="end")
        view.set(aspect="equal", xlabel=f"{name} [cm]")
    views[0].set(ylabel="height [cm]")
    views[0].legend(loc="lower left")
    figure.savefig(path, dpi=150)
    plt.close(figure)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--out", type=Path, default=Path("runs/magnet"))
    parser.add_argument("--fps", type=float, default=2.0)
    parser.add_argument("--smoke", action="store_true", help="record three frames only, coarsely")
    args = parser.parse_args()
    if args.smoke:
        main(args.out, args.fps, 1e-3, 3)
    else:
        main(args.out, args.fps, 2e-4, None)
