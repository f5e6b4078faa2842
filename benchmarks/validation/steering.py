"""Claim: a magnet holds the capsule in a tube, by hand and by arm, within 2 mm and 3°.

In a straight and in a bent tube a push along the tube of 0.1 N rises within 2 s, stays, reverses
within 4 s and stays.

    python -m benchmarks.validation.steering
"""

from __future__ import annotations

import time
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from benchmarks.common.scripts import parser, table, write_section
from tests.support.tubes import bent_tube, straight_gut
from vrcaps.actuation.arm.arm import read_arm
from vrcaps.actuation.arm.arm_with_payload import ArmWithPayload, transverse_mount
from vrcaps.actuation.capsule_target import CapsuleTarget, centerline_target
from vrcaps.actuation.magnet_actuator import FreeActuator, MagnetActuator, RobotActuator
from vrcaps.actuation.magnet_controller import ControllerGains, MagnetController
from vrcaps.actuation.magnet_pose_solver import Workspace
from vrcaps.capsule.device_file import read_device
from vrcaps.core.geometry import transform_from
from vrcaps.magnet.presets import read_magnet
from vrcaps.magnet.sources import Coil, Cylinder, Dipole, magnet_pose
from vrcaps.organ.surface import OrganSurface
from vrcaps.tissue.tissue import Tissue
from vrcaps.world.control import GRAVITY, Control
from vrcaps.world.model import Model, State
from vrcaps.world.world import World

DT, SUBSTEP = 0.01, 2e-4
PUSH, RISE, STAY = 0.1, 2.0, 2.0
HOLD_HEAD = (
    "tube",
    "held by",
    "pressed",
    "worst place",
    "worst heading",
    "once settled",
    "claimed",
)
SPEED_HEAD = ("what", "CPU time", "claimed")


@dataclass(frozen=True)
class Tube:
    """Tube, and position of the capsule in it [m]."""

    name: str
    organ: OrganSurface
    arc_length: float


def main() -> None:
    """Measure, write the tables."""
    given = parser(__doc__ or "").parse_args()
    tubes = (
        Tube("straight, 28 mm wide", straight_gut({"jejunum": 0.2}, radius=0.014), 0.1),
        Tube("bent by 45 mm, sloping 22°, 36 mm wide", bent_tube(), 0.16),
    )
    held = [hold_row(tube, arm, 0.5) for tube in tubes for arm in (False, True)]
    held += [hold_row(tube, True, 1.0) for tube in tubes]
    hand = FreeActuator()
    text = f"""## Magnetic steering

`python -m benchmarks.validation.steering`: capsule `magnetic`, wet walls with `physical` drag. In
tubes: magnet `cylinder-76.2`, a push of {PUSH:g} N along the tube that rises within {RISE:g} s,
stays, turns round within {2 * RISE:g} s and stays. By hand: {hand.max_speed:g} m/s and
{hand.max_acceleration:g} m/s² at most; by arm: within the Panda's limits of joint speed,
acceleration and jerk. *Once settled* is the largest error in the last second of each push.

{table(HOLD_HEAD, held)}

{table(SPEED_HEAD, speed_rows())}"""
    write_section(given.out, Path(__file__), text)


def begin(tube: Tube, by_arm: bool, press: float) -> tuple[MagnetController, World, CapsuleTarget]:
    """The capsule held in a tube."""
    model = Model(tube.organ, read_device("magnetic"), np.eye(4))
    line = tube.organ.centerline
    target = centerline_target(line, np.eye(4), tube.arc_length)
    nearest = int(np.argmin(np.abs(line.arc_length - tube.arc_length)))
    pose = transform_from(line.frames[nearest], line.points[nearest])
    magnet = read_magnet("cylinder-76.2")
    actuator = (
        panda(magnet, pose[:3, 3] + [-0.5, 0.0, -0.15], Workspace()) if by_arm else FreeActuator()
    )
    controller = MagnetController(
        model, magnet, actuator, pose, target, gains=ControllerGains(upper_wall_force=press)
    )
    world = World(model, Tissue(), State(0.0, pose), sources=controller.sources, substep=SUBSTEP)
    lead(world, controller, target, 3.0)
    return controller, world, target


def hold_row(tube: Tube, by_arm: bool, press: float) -> tuple[str, ...]:
    """A row of the table of tubes."""
    controller, world, target = begin(tube, by_arm, press)
    along, errors = np.asarray(target.tangent), []
    ends = np.cumsum([0.0, RISE, STAY, 2.0 * RISE, STAY])
    for time_now in np.arange(0.0, ends[-1], DT):
        push = np.interp(time_now, ends, [0.0, PUSH, PUSH, -PUSH, -PUSH]) * along
        world.step(replace(controller.track(world, target, DT), force_world=push), DT)
        errors.append(error_of(world, target, np.outer(along, along)))
    worst = np.max(errors, axis=0)
    times = np.arange(len(errors)) * DT
    late = [(times > end - 1.0) & (times <= end) for end in (ends[2], ends[4])]
    settled = np.max(np.array(errors)[late[0] | late[1]], axis=0)
    good = worst[0] <= 2.0 and worst[1] <= 3.0
    return (
        tube.name,
        "arm" if by_arm else "hand",
        f"{press:g} N",
        f"{worst[0]:.1f} mm",
        f"{worst[1]:.1f}°",
        f"{settled[0]:.2f} mm, {settled[1]:.1f}°",
        f"≤ 2 mm, ≤ 3°: {'yes' if good else 'NO'}",
    )


def panda(magnet: Cylinder, place: np.ndarray, workspace: Workspace) -> MagnetActuator:
    """Panda at a position, with the magnet across its flange."""
    base = transform_from(np.eye(3), place)
    return RobotActuator(
        ArmWithPayload(read_arm("panda"), magnet, base, transverse_mount(magnet)), workspace
    )


def lead(world: World, controller: MagnetController, target: CapsuleTarget, seconds: float) -> None:
    """Step a world to a target."""
    for _ in range(round(seconds / DT)):
        world.step(controller.track(world, target, DT), DT)


def error_of(world: World, target: CapsuleTarget, counted: np.ndarray) -> tuple[float, float]:
    """Distance from the target in the controlled directions [mm], and angle [°]."""
    T = world.T_world_capsule
    off = np.linalg.norm(counted @ (T[:3, 3] - np.asarray(target.position)))
    cosine = np.clip(np.asarray(target.direction) @ T[:3, 2], -1.0, 1.0)
    return 1e3 * float(off), float(np.degrees(np.arccos(cosine)))


def speed_rows() -> list[tuple[str, ...]]:
    """Rows of the time of 8 sources in a substep, and of the substep without them."""
    organ = bent_tube(radius=0.04, around=24, along=60)
    model = Model(organ, read_device("magnetic"), np.eye(4))
    pose = transform_from(organ.centerline.frames[15], organ.centerline.points[15])
    places = 0.3 * np.array([[np.cos(a), np.sin(a), 0.5] for a in range(8)]) + pose[:3, 3]
    poses = [magnet_pose(place, (1, 2, 3)) for place in places]
    kinds = {
        "dipoles": [Dipole(1.0, T) for T in poses],
        "cylinders of 50 mm": [Cylinder(0.05, 0.05, 0.01, T) for T in poses],
        "coils of 100 mm": [Coil(0.05, 1.0, 1, T) for T in poses],
    }
    moved = np.array([magnet_pose(1.01 * place, (1, 2, 2.9)) for place in places])
    bare = substep_time(model, pose, [], Control())
    rows = []
    for name, sources in kinds.items():
        taken = substep_time(model, pose, sources, Control(Ts_world_magnet=moved)) - bare
        what = f"field, gradient and wrench of 8 moving {name}, a substep"
        rows.append((what, f"{1e6 * taken:.2f} µs", "≤ 2 µs"))
    return rows


def substep_time(model: Model, pose: np.ndarray, sources: list, control: Control) -> float:
    """CPU time of a substep in free flight, the shortest of five runs [s]."""
    lifted = replace(control, force_world=(0.0, 0.0, model.device.mass * GRAVITY))
    count, spent = 2000, []
    for _ in range(5):
        world = World(model, Tissue(), State(0.0, pose), sources=sources)
        start = time.process_time()
        world.step(lifted, count * 5e-5)
        spent.append(time.process_time() - start)
    return min(spent) / count


if __name__ == "__main__":
    main()
