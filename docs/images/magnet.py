"""Draw the set-up of magnetic steering: patient, stomach, capsule, magnet, arm, field lines.

python -m docs.images.magnet
"""

from __future__ import annotations

from pathlib import Path

import matplotlib
import numpy as np

matplotlib.use("agg")
import matplotlib.pyplot as plt
from matplotlib.patches import Ellipse

from vrcaps.actuation.arm.arm import frames
from vrcaps.actuation.steering_program import MagnetSteering
from vrcaps.anatomy.stomach import StomachParameters, generate_stomach
from vrcaps.capsule.device_file import read_device
from vrcaps.core.geometry import invert, transform_points
from vrcaps.core.units import CM
from vrcaps.magnet.field import SourceSet
from vrcaps.motion.dynamics import Dynamics
from vrcaps.motion.rollout import Rollout
from vrcaps.world.model import Model, posture_transform

SECONDS, FPS = 8.0, 1.0
WIDTH, HEIGHT = (-68.0, 32.0), (-20.0, 62.0)
"""Limits of the drawing [cm]."""
SKIN = "#c98f76"


def main() -> None:
    """Simulate some seconds and draw where everything is, seen from the patient's feet."""
    stomach = generate_stomach(StomachParameters().at("inflated"), seed=0)
    model = Model(stomach, read_device("magnetic"), posture_transform("supine"))
    steering = MagnetSteering(arm="panda", wall="upper", standoff=3.0 * CM, speed=1.0 * CM)
    motion = Dynamics(start=0.05, substep=2e-4, magnet=steering)
    run = Rollout(model, motion, frames=int(SECONDS * FPS), fps=FPS, seed=0)
    step = list(run.steps())[-1]
    assert run.program is not None and step.command is not None
    state = step.command.controller.actuator
    robot = run.program.controller.actuator.robot
    figure, axes = plt.subplots(figsize=(9.0, 6.7), dpi=150)
    draw_patient(axes, model)
    draw_lines(axes, run.program.controller.sources, HEIGHT, WIDTH, state.T_world_magnet[1, 3])
    joints = transform_points(robot.T_world_base, frames(robot.arm, state.joint_angles)[:, :3, 3])
    places = np.vstack([robot.T_world_base[:3, 3], joints, state.T_world_magnet[:3, 3]]) / CM
    axes.plot(places[:, 0], places[:, 2], "-", color="0.55", lw=9, solid_capstyle="round", zorder=3)
    axes.plot(places[:-1, 0], places[:-1, 2], "o", color="0.25", ms=5, zorder=4)
    outline(axes, cylinder(robot.magnet, state.T_world_magnet), "#b03030")
    outline(axes, capsule(model, step.state.T_world_capsule), "#205080")
    axes.set(aspect="equal", xlabel="towards the patient's left [cm]", ylabel="height [cm]")
    axes.set(xlim=WIDTH, ylim=HEIGHT)
    figure.tight_layout()
    figure.savefig(Path(__file__).with_suffix(".jpg"), pil_kwargs={"quality": 88})


def draw_patient(axes: plt.Axes, model: Model) -> None:
    """The trunk as an ellipse around the stomach's section, and the stomach's triangles."""
    points = model.vertices_world / CM
    top = points[:, 2].max() + 3.0
    trunk = Ellipse((2.0, top - 11.0), 34.0, 22.0, fc="#f3dccf", ec=SKIN, lw=1.5, zorder=0)
    axes.add_patch(trunk)
    axes.plot([-60, 60], [top - 22.3] * 2, color="0.4", lw=4, zorder=0)
    axes.triplot(*points[:, [0, 2]].T, model.organ.faces, color="#d07070", lw=0.06, zorder=1)


def draw_lines(axes: plt.Axes, sources: list, height: tuple, width: tuple, depth: float) -> None:
    """Field lines in the plane across the patient through the magnet's center."""
    x, z = np.linspace(*width, 90) * CM, np.linspace(*height, 80) * CM
    points = np.stack(np.meshgrid(x, [depth], z, indexing="ij"), -1).reshape(-1, 3)
    flux = SourceSet(sources).field(points)[0]
    # At the magnet's rim the field jumps between points of the grid: no lines in it.
    inside = transform_points(invert(sources[0].T_world_magnet), points)
    size = np.hypot(*inside[:, :2].T) < 0.5 * sources[0].diameter + CM
    flux[size & (np.abs(inside[:, 2]) < 0.5 * sources[0].length + CM)] = np.nan
    flux = flux.reshape(len(x), len(z), 3)
    axes.streamplot(
        *(x / CM, z / CM, flux[..., 0].T, flux[..., 2].T),
        density=1.3,
        color="#3060a0",
        linewidth=0.5,
        arrowsize=0.6,
        zorder=2,
    )


def unit(vectors: np.ndarray) -> np.ndarray:
    """Vectors of unit length."""
    return vectors / np.linalg.norm(vectors, axis=1, keepdims=True)


def cylinder(magnet, T_world_magnet: np.ndarray) -> np.ndarray:
    """Points on the rims of a magnet [n 3]."""
    angle = np.linspace(0.0, 2.0 * np.pi, 60)
    ring = 0.5 * magnet.diameter * np.stack([np.cos(angle), np.sin(angle), 0.0 * angle], -1)
    half = np.array([0.0, 0.0, 0.5 * magnet.length])
    ends = [ring + half, ring - half]
    return transform_points(T_world_magnet, np.vstack(ends))


def capsule(model: Model, T_world_capsule: np.ndarray) -> np.ndarray:
    """Points on a capsule's round ends [n 3]."""
    radius, half = model.device.radius, 0.5 * model.device.length - model.device.radius
    rng = np.random.default_rng(0)
    ball, end = radius * unit(rng.normal(size=(600, 3))), np.array([0.0, 0.0, half])
    return transform_points(T_world_capsule, np.vstack([ball + end, ball - end]))


def outline(axes: plt.Axes, points: np.ndarray, color: str) -> None:
    """Fills the hull of points, seen from the feet."""
    from scipy.spatial import ConvexHull

    flat = points[:, [0, 2]] / CM
    axes.fill(*flat[ConvexHull(flat).vertices].T, color=color, zorder=5)


if __name__ == "__main__":
    main()
