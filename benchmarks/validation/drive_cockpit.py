"""Claim: a gamepad or the keyboard drives the capsule from the stomach's inlet to the pylorus.

A script drives through the page in a headless Chromium; everything else is the unmodified
cockpit: its page, a free magnet or that of the Panda, and physics in real time or as close to it as
two cores allow. `gamepad`: it moves the sticks and triggers of a mocked gamepad, reads the poses of
capsule and magnet and the time, and steers like the policy `navigator`. `keyboard`: it knows only
values on the screen: the dot and the segment of the map, the magnetic force and the time. It holds
one of the keys A, S, W, D as long as the dot moves towards the outlet, otherwise it tries the next
one, and it lowers or raises the magnet by F and R to keep its force in a range. When the capsule is
in the pylorus, the drive is recorded from its commands, the recorded poses are compared with those
that were driven, and the episode is checked as by `vrcaps check`.

    python -m benchmarks.validation.drive_cockpit [--patients 0] [--arms panda] [--seconds 240]
        [--by gamepad keyboard]
"""

from __future__ import annotations

import os
import shutil
import tempfile
import time
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from playwright.sync_api import Browser, Page, sync_playwright

from benchmarks.common.scripts import parser, table, write_section

# isort: split
from tests.support.key_pilot import KeyPilot
from tests.support.pad_pilot import PAD, PadPilot, push
from vrcaps.actuation.steering_program import MagnetSteering
from vrcaps.cockpit.cockpit import Cockpit, open_cockpit
from vrcaps.core.geometry import quaternion_from_matrix, transform_points
from vrcaps.core.units import CM, MM
from vrcaps.motion.dynamics import Dynamics
from vrcaps.recording.check import check_episode
from vrcaps.recording.episode import read_episode
from vrcaps.recording.recorder import record
from vrcaps.recording.table import POSE_COLUMNS
from vrcaps.render.settings import RenderSettings
from vrcaps.scenario.scenario import OrganGenerated, Scenario, read_scenario

FLAGS = ["--no-sandbox", "--use-angle=swiftshader", "--enable-unsafe-swiftshader"]
PORT = 8951
LOOK_MS = 40
"""Time between looks at the page [ms]."""
FPS = 4.0
HEAD = (
    *("patient", "arm", "by", "way [cm]", "arrived", "to the outlet's end [mm]"),
    *("simulated [s]", "real [s]"),
    *("commands", "frames recorded", "poses as driven", "problems found by check"),
)


@dataclass(frozen=True)
class Drive:
    """Result of one drive.

    Attributes:
        folder: Folder of the drive.
        poses: `T_world_capsule` of each frame.
        way: First and last arc length [m].
        left: From the capsule to the end of the centerline [m].
        has_arrived: Whether the capsule is in the pylorus.
        simulated: Time that passed in the simulation [s].
        real: Time that passed here [s].
        commands: Number of joystick commands.
    """

    folder: Path
    poses: np.ndarray
    way: tuple[float, float]
    left: float
    has_arrived: bool
    simulated: float
    real: float
    commands: int


def main() -> None:
    """Drive, record, check, write the table."""
    made = parser(__doc__ or "")
    made.add_argument("--patients", type=int, nargs="+", default=[0], help="seeds of stomachs")
    made.add_argument("--arms", nargs="+", default=["none"], help="none, or names of arms")
    made.add_argument("--seconds", type=float, default=240.0, help="most simulated time of a drive")
    made.add_argument("--by", nargs="+", default=["gamepad"], help="gamepad or keyboard")
    args = made.parse_args()
    root, rows = Path(tempfile.mkdtemp()), []
    program = shutil.which("chromium") or shutil.which("chromium-browser")
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=program, args=FLAGS)
        for seed in args.patients:
            for arm in args.arms:
                for by in args.by:
                    folder = root / f"{seed}-{arm}-{by}"
                    drive = driven(browser, scenario_of(seed, arm), folder, args.seconds, by)
                    rows.append((str(seed), arm, by, *result(drive)))
        browser.close()
    shutil.rmtree(root)
    text = (
        f"## Manual control\n\n{' '.join((__doc__ or '').split('    python')[0].split())}\n\n"
        f"{table(HEAD, rows)}\n\nLoad of the machine at the end: {os.getloadavg()[0]:.1f} on "
        f"{os.cpu_count()} cores."
    )
    write_section(args.out, Path(__file__), text)


def scenario_of(seed: int, arm: str) -> Scenario:
    """A stomach with the capsule at its inlet, few images per second and simple light."""
    steering = MagnetSteering(arm=None if arm == "none" else arm)
    return Scenario(
        OrganGenerated("stomach", seed=seed),
        capsule="magnetic",
        motion=Dynamics(start=0.0, substep=2e-4, magnet=steering),
        fps=FPS,
        channels=("rgb", "depth"),
        render=RenderSettings(light="direct"),
    )


def driven(browser: Browser, scenario: Scenario, folder: Path, seconds: float, by: str) -> Drive:
    """One drive through the page."""
    with open_cockpit(scenario, folder, port=PORT, on_message=print) as cockpit:
        tab = browser.new_page(viewport={"width": 900, "height": 600}, device_scale_factor=0.2)
        tab.add_init_script(PAD)
        tab.add_init_script("localStorage.setItem('vrcaps-tour', 'seen')")
        tab.goto(cockpit.gate.address)
        tab.get_by_role("button", name="Pause").wait_for()
        session = cockpit.session
        while session.view is None or session.view.state.time <= 0.0:
            tab.wait_for_timeout(LOOK_MS)
        goal = pylorus(session.model.organ)
        pilot = PadPilot(session, session.model.organ.centerline.length)
        first, began = pilot.arc_length, time.perf_counter()
        if by == "keyboard":
            tab.get_by_text("You drive").wait_for()
            KeyPilot(tab).drive_to("pylorus", seconds)
            pilot.axes()
        else:
            lead(tab, cockpit, pilot, goal, seconds)
        real = time.perf_counter() - began
        push(tab, [0.0] * 6)
        tab.wait_for_timeout(300)
        cockpit.session.clock.pause()
        tab.wait_for_timeout(300)
        tab.close()
        _, commands = session.operator.commands()
        way, poses = (first, pilot.arc_length), session.poses
        end = transform_points(session.model.T_world_patient, session.model.organ.centerline.points)
        left = float(np.linalg.norm(poses[-1][:3, 3] - end[-1]))
    has_arrived = way[1] >= goal
    return Drive(folder, poses, way, left, has_arrived, len(poses) / FPS, real, len(commands))


def lead(tab: Page, cockpit: Cockpit, pilot: PadPilot, goal: float, seconds: float) -> None:
    """Steer until the capsule is at the goal or the time is over."""
    told = 0.0
    while pilot.arc_length < goal:
        tab.wait_for_timeout(LOOK_MS)
        view = cockpit.session.view
        assert view is not None
        if view.state.time > seconds:
            return
        axes = pilot.axes()
        if axes is not None:
            push(tab, axes.tolist())
        if view.state.time > told:
            told += 5.0
            where = f"{pilot.arc_length / CM:5.1f} of {goal / CM:.1f} cm"
            print(f"{view.state.time:6.1f} s  {where}  {view.limit}  {view.lost}", flush=True)


def pylorus(organ: object) -> float:
    """Arc length at which the capsule enters the pylorus [m]."""
    label = organ.label_names.index("pylorus")  # type: ignore[attr-defined]
    return float(organ.arc_length[organ.label == label].min())  # type: ignore[attr-defined]


def result(drive: Drive) -> tuple[str, ...]:
    """Cells of a row: the drive and its episode."""
    scenario = read_scenario(drive.folder / "drive.json")
    scenario = replace(scenario, frames=len(drive.poses))
    episode = record(scenario, drive.folder / "episode")
    columns = read_episode(episode).table.columns
    recorded = np.transpose([columns[f"capsule_{name}"] for name in POSE_COLUMNS])
    wxyz = [quaternion_from_matrix(pose[:3, :3]) for pose in drive.poses]
    same = np.array_equal(recorded, np.hstack([drive.poses[:, :3, 3], wxyz]))
    return (
        f"{drive.way[0] / CM:.1f} to {drive.way[1] / CM:.1f}",
        "yes" if drive.has_arrived else "no",
        f"{drive.left / MM:.0f}",
        f"{drive.simulated:.0f}",
        f"{drive.real:.0f}",
        str(drive.commands),
        str(len(recorded)),
        "to the last bit" if same else "no",
        str(len(check_episode(episode))),
    )


if __name__ == "__main__":
    main()
