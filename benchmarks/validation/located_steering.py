"""Claim: steering by the located pose costs millimeters against steering by the true one.

The same capsule, magnet and commands, once with the simulation's own pose and once with that of the
Kalman filter, from IMU and Hall sensors with their noise and calibration errors.

    python -m benchmarks.validation.located_steering [--size SEEDS]
"""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from benchmarks.common.scripts import options, table, write_section
from benchmarks.validation.steering import PUSH, RISE, STAY, SUBSTEP, Tube, bent_tube, straight_gut
from vrcaps.actuation.capsule_target import centerline_target
from vrcaps.actuation.steering_program import MagnetSteering, Waypoint
from vrcaps.anatomy.stomach import StomachParameters, generate_stomach
from vrcaps.capsule.device_file import read_device
from vrcaps.core.geometry import rotation_vector
from vrcaps.motion.dynamics import Dynamics
from vrcaps.motion.motion import Step
from vrcaps.motion.rollout import Rollout
from vrcaps.world.model import Model, posture_transform
from vrcaps.world.schedule import Wrench

FPS, SETTLE = 20.0, 1.0
ENDS = np.cumsum([2.0, RISE, STAY, 2.0 * RISE, STAY])
STEER_HEAD = ("held or led in", "pose", "from the target: mean", "95 %", "largest", "heading, mean")
LOCATE_HEAD = (
    "located in", "position: mean", "95 %", "largest", "axis, mean", "roll, mean", "95 %",
    "velocity, RMS", "stated σ: position, roll",
)  # fmt: skip


@dataclass
class Errors:
    """Errors of all frames: from the target, and of the estimate.

    Attributes:
        place: Distance from the target along the gut [mm].
        heading: From the target's look [°].
        located: Position [mm], axis [°], roll [°], velocity [mm/s], and σ of position and roll.
    """

    place: list[float] = field(default_factory=list)
    heading: list[float] = field(default_factory=list)
    located: list[tuple[float, ...]] = field(default_factory=list)


def main() -> None:
    """Measure, write the tables."""
    given = options(__doc__ or "", size=3)
    steered, located = [], []
    for name, model, motion in runs():
        for pose in ("true", "located"):
            errors = Errors()
            for seed in range(given.size):
                measure(model, motion(pose), seed, errors)
            steered.append(steer_row(name, pose, errors))
            if errors.located:
                located.append(locate_row(name, errors))
    text = f"""## Steering with the localized pose

`python -m benchmarks.validation.located_steering`: capsule `magnetic`, magnet `cylinder-76.2` by
hand, {FPS:g} frames/s, {given.size} seeds of the sensors. *true*: the controller has the
simulation's pose, velocity and contact force; *located*: those of an error-state Kalman filter of
the IMU's and the Hall sensors' readings at 100 Hz, with noise, resolution, bias and errors of
calibration. In tubes the capsule is held against {PUSH:g} N along the gut, in both directions; in
the stomach it is moved along its upper wall, far from the sensors and near the magnet. The first
second after settling is excluded.

{table(STEER_HEAD, steered)}

{table(LOCATE_HEAD, located)}"""
    write_section(given.out, Path(__file__), text)


def runs():
    """Name, model, and the motion for each source of the pose."""
    tubes = (
        Tube("straight tube", straight_gut({"jejunum": 0.2}, radius=0.014), 0.1),
        Tube("bent tube", bent_tube(), 0.16),
    )
    for tube in tubes:
        model = Model(tube.organ, read_device("magnetic"), np.eye(4))
        yield tube.name, model, lambda pose, tube=tube: held(tube, pose)
    stomach = generate_stomach(StomachParameters().at("inflated"), seed=0)
    model = Model(stomach, read_device("magnetic"), posture_transform("supine"))
    yield "stomach", model, led


def held(tube: Tube, pose: str) -> Dynamics:
    """Capsule held at a position in a tube against a push along the gut."""
    length = tube.organ.centerline.length
    steering = MagnetSteering(wall="upper", pose=pose, waypoints=(Waypoint(0.0, tube.arc_length),))
    forces = (0.0, PUSH, PUSH, -PUSH, -PUSH)
    wrenches = tuple(Wrench(float(t), (0.0, 0.0, f)) for t, f in zip(ENDS, forces, strict=True))
    return Dynamics(
        start=tube.arc_length / length, magnet=steering, wrenches=wrenches, wrench_frame="gut",
        settle=SETTLE, substep=SUBSTEP,
    )  # fmt: skip


def led(pose: str) -> Dynamics:
    """A capsule that is led along the upper wall of a stomach."""
    steering = MagnetSteering(wall="upper", pose=pose, speed=5e-3)
    return Dynamics(start=0.4, magnet=steering, settle=SETTLE, substep=SUBSTEP)


def measure(model: Model, motion: Dynamics, seed: int, errors: Errors) -> None:
    """Add the errors of one run."""
    run = Rollout(model, motion, frames=round(ENDS[-1] * FPS), fps=FPS, seed=seed)
    program = run.program
    assert program is not None
    for step in run.steps():
        if step.state.time < SETTLE:
            continue
        T = step.state.T_world_capsule
        if program.follower is None:
            line = model.organ.centerline
            arc_length = program.settings.waypoints[0].arc_length
            target = centerline_target(line, np.eye(4), arc_length, wall="upper")
            axes = np.outer(target.tangent, target.tangent)
        else:
            target = program.follower.path.target(program.follower.arc_length)
            axes = target.controlled_axes
        errors.place.append(1e3 * float(np.linalg.norm(axes @ (T[:3, 3] - target.position))))
        cosine = np.clip(np.asarray(target.direction) @ T[:3, 2], -1.0, 1.0)
        errors.heading.append(float(np.degrees(np.arccos(cosine))))
        add_estimate(step, errors)


def add_estimate(step: Step, errors: Errors) -> None:
    """Add the error of the estimate of a frame, if there is one."""
    belief = None if step.command is None else step.command.estimate
    if belief is None:
        return
    T, found = step.state.T_world_capsule, belief.T_world_capsule
    turn = np.degrees(T[:3, :3].T @ rotation_vector(T[:3, :3], found[:3, :3]))
    speed = np.linalg.norm(belief.velocity_world - step.state.linear_velocity_world)
    errors.located.append(
        (
            1e3 * float(np.linalg.norm(found[:3, 3] - T[:3, 3])),
            float(np.linalg.norm(turn[:2])),
            abs(float(turn[2])),
            1e3 * float(speed),
            1e3 * belief.position_sigma,
            float(np.degrees(belief.roll_sigma)),
        )
    )


def steer_row(name: str, pose: str, errors: Errors) -> tuple[str, ...]:
    """A row of the table of steering."""
    place = np.array(errors.place)
    return (
        name,
        pose,
        f"{place.mean():.2f} mm",
        f"{np.quantile(place, 0.95):.2f} mm",
        f"{place.max():.2f} mm",
        f"{np.mean(errors.heading):.1f}°",
    )


def locate_row(name: str, errors: Errors) -> tuple[str, ...]:
    """A row of the table of localization."""
    place, axis, roll, speed, sigma, roll_sigma = np.array(errors.located).T
    return (
        name,
        f"{place.mean():.2f} mm",
        f"{np.quantile(place, 0.95):.2f} mm",
        f"{place.max():.2f} mm",
        f"{axis.mean():.2f}°",
        f"{roll.mean():.2f}°",
        f"{np.quantile(roll, 0.95):.2f}°",
        f"{np.sqrt(np.mean(speed**2)):.1f} mm/s",
        f"{sigma.mean():.2f} mm, {roll_sigma.mean():.2f}°",
    )


if __name__ == "__main__":
    main()
