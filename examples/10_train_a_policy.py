"""Train a policy by PPO for a custom reward, and compare it with a baseline.

    python examples/10_train_a_policy.py

Trains for some minutes in one stomach, for coverage at the level `resolved`, and prints the
coverage of the policy and of the centerline baseline in the same worlds. To resume an interrupted
training, repeat the command. `vrcaps train coverage` does the same from the command line.
"""

from __future__ import annotations

import argparse
from dataclasses import replace
from pathlib import Path

import numpy as np

import vrcaps
from vrcaps.env import ForcePenalty, LogGain
from vrcaps.policy import Score, TrainingSettings, read_policy, train
from vrcaps.policy.training import BEST, ci, default
from vrcaps.training import Progress


def main(out: Path, preset: TrainingSettings, actions: int) -> None:
    """Train, evaluate, print."""
    env = replace(
        preset.env,
        organs=(vrcaps.OrganGenerated("stomach", seed=0),),
        rewards=(LogGain(level="resolved"), ForcePenalty(0.1)),
    )
    learner = replace(preset.learner, num_actions=actions)
    train(TrainingSettings(env, learner), out, report=print_progress)
    score = Score(env, num_episodes=4, seed=1)
    for name in (str(out / BEST), "centerline"):
        seen = 100.0 * score(read_policy(name))["coverage_resolved"]
        print(f"{name}: {seen:.1f} % resolved")


def print_progress(progress: Progress) -> None:
    """Print a summary of the last round."""
    if progress.rows:
        seen = 100.0 * progress.rows[-1].get("coverage_resolved", np.nan)
        print(f"round {progress.step} of {progress.total}: {seen:.1f} % resolved")


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--out", type=Path, default=Path("runs/policy"))
    parser.add_argument("--actions", type=int, default=200_000, help="actions to learn from")
    parser.add_argument("--smoke", action="store_true", help="one second of learning, as a test")
    args = parser.parse_args()
    main(args.out, *((ci(), 12) if args.smoke else (default(), args.actions)))
