"""Environments that are made in milliseconds: a capsule in a straight tube."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from tests.support.tubes import straight_gut
from vrcaps.env.env import CapsuleEnv
from vrcaps.env.randomization import Start
from vrcaps.env.settings import EnvSettings, env_settings
from vrcaps.env.simulation import Simulation

GUT = straight_gut({"upper": 0.10, "lower": 0.08}, radius=0.02, edge=4e-3)
"""A tube about x in the patient frame, 18 cm long and 4 cm wide."""
_LOWEST = GUT.vertices[:, 1] > 0.012  # posterior is below a patient who lies supine
LESION_GUT = replace(
    GUT, instance=((np.abs(GUT.arc_length - 0.12) < 6e-3) & _LOWEST).astype(np.uint16)
)
"""The same with a lesion on its lower wall."""
SHORT_GUT = straight_gut({"upper": 0.06, "lower": 0.06}, radius=0.018, edge=4e-3)


def small_settings(**keywords: Any) -> EnvSettings:
    """Settings of a tube, with a start in its middle that needs no time to settle."""
    start = Start(fraction=(0.5, 0.5), settle=0.0)
    small = {"organs": (GUT,), "start": start, "num_points": 2048, "grid": (18, 12)}
    return env_settings(**(small | {"substep": 1e-3} | keywords))


def short_settings(**keywords: Any) -> EnvSettings:
    """Settings of episodes of four actions of 10 ms."""
    return small_settings(control_period=0.01, episode_time=0.04, num_points=256, **keywords)


def small_env(seed: int = 0, **keywords: Any) -> CapsuleEnv:
    """An environment of one capsule after its reset."""
    env = CapsuleEnv(small_settings(**keywords))
    env.reset(seed=seed)
    return env


def simulation_of(num_worlds: int = 1, **keywords: Any) -> Simulation:
    """Worlds after their reset, world k seeded with k."""
    simulation = Simulation(small_settings(**keywords), num_worlds)
    for index in range(num_worlds):
        simulation.reset(index, np.random.default_rng(index))
    return simulation
