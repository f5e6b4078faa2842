"""Training presets by task: the paper's hyperparameters, the defaults, and a smoke test."""

from __future__ import annotations

from dataclasses import replace

from vrcaps.env.actuation import Wrench
from vrcaps.env.landmarks import LandmarksObservation
from vrcaps.env.observations import StateObservation
from vrcaps.env.randomization import Start
from vrcaps.env.rewards import LogGain, PaperGain
from vrcaps.env.settings import EnvSettings
from vrcaps.env.tasks import CoverageTask
from vrcaps.policy.ppo import PpoSettings
from vrcaps.policy.training import TrainingSettings


def paper() -> TrainingSettings:
    """Training for coverage as in the paper (Incetan et al. 2021).

    It states the reward, the discrete actions, 7,500 steps of 1/30 s per episode, three stomachs,
    3 layers of 256, minibatches of 64, the learning rate and 500,000 steps. Epochs, γ, λ, the
    clipping and the entropy weight are the defaults of ML-Agents, which it used.
    """
    env = EnvSettings(
        task=CoverageTask(level="frustum"),
        actuation=Wrench("discrete", is_weightless=True),
        observations=(StateObservation(),),
        rewards=(PaperGain(level="frustum"),),
        organs=("stomach:0-2",),
        episode_time=250.0,
        stuck_time=250.0,
    )
    learner = PpoSettings(
        num_envs=3,
        num_actions=500_000,
        updates=1,
        hidden=(256, 256, 256),
        batch=64,
        epochs=3,
        entropy=5e-3,
        evaluate_every=10,
    )
    return TrainingSettings(env, learner)


def default() -> TrainingSettings:
    """Default preset: visible coverage, with observations that are the same for every organ.

    Observations and actions are in the capsule's frame, so that a policy generalizes over poses.
    In free motion, the capsule reaches 55 mm/s and about 2 rad/s. The last hundredths are rewarded
    as well, and no episode ends early, so that the policy seeks full coverage.
    """
    env = EnvSettings(
        task=CoverageTask(target=1.0),
        rewards=(LogGain(),),
        actuation=Wrench(force=5e-3, torque=1e-5, is_weightless=True, frame="capsule"),
        observations=(LandmarksObservation(),),
        organs=("stomach:0-15",),
        start=Start(settle=0.0),
        episode_time=50.0,
    )
    return TrainingSettings(env, PpoSettings(num_actions=3_000_000, entropy=0.0, initial_std=0.5))


def ci() -> TrainingSettings:
    """Smoke-test preset: runs in seconds, with too few actions to improve."""
    ours = default()
    env = replace(ours.env, organs=("stomach:0",), episode_time=1.0, num_points=256)
    learner = replace(
        ours.learner, num_envs=2, num_actions=36, updates=1, hidden=(16,), evaluation_episodes=2
    )
    return TrainingSettings(env, learner)


PRESETS = {"default": default, "paper": paper, "ci": ci}
"""Presets of the task `coverage` by name."""
