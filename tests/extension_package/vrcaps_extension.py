"""Extension of vrcaps: a reward, a task, an observation, a task on images, a format, a motion."""

from dataclasses import dataclass

import numpy as np
from gymnasium.spaces import Box

from vrcaps.env import OBSERVATIONS, REWARDS, TASKS, Observation, Reward, Task
from vrcaps.formats import FORMATS, Needs
from vrcaps.learn import TASKS as IMAGE_TASKS
from vrcaps.learn import DepthTask
from vrcaps.motion import MOTIONS, FlyThrough


@REWARDS.register
@dataclass(frozen=True)
class Slowness(Reward):
    kind = "slowness"

    def term(self, view):
        return -np.linalg.norm(view.velocity_world[:, 0], axis=1)


@TASKS.register
@dataclass(frozen=True)
class RestTask(Task):
    kind = "rest"
    rewards = (Slowness(),)

    def progress(self, view):
        return np.exp(-np.linalg.norm(view.velocity_world[:, 0], axis=1))


@OBSERVATIONS.register
@dataclass(frozen=True)
class VelocityObservation(Observation):
    kind = "velocity"

    def space(self, view):
        return Box(-np.inf, np.inf, (3,), np.float32)

    def observe(self, view):
        return view.velocity_world[:, 0].astype(np.float32)


@IMAGE_TASKS.register
@dataclass(frozen=True)
class SharpDepthTask(DepthTask):
    """Depth with sharper edges."""

    gradient_weight: float = 2.0
    kind = "sharp-depth"


@FORMATS.register
@dataclass(frozen=True)
class Positions:
    """Camera positions as NPY files."""

    kind, needs = "positions", Needs()

    def write(self, sequences, folder, advance):
        for index, sequence in enumerate(sequences):
            np.save(folder / f"{index}.npy", sequence.Ts_world_camera[:, :3, 3])
            [advance() for _ in sequence.times]


@MOTIONS.register
@dataclass(frozen=True)
class SlowFlight(FlyThrough):
    speed: float = 2e-3
    kind = "slow-flight"
