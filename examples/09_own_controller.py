"""Custom controller, compared with a baseline.

    python examples/09_own_controller.py

A policy is a class with `reset` and `act`; it acts in many worlds at once. This one pushes the
capsule to and fro along the stomach, towards the side with more unseen wall. Prints its coverage
and that of random actions, in the same worlds.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from vrcaps.env import CapsuleVectorEnv, env_settings
from vrcaps.policy import Requirements, read_policy


class Frontier:
    """Policy that pushes the capsule along its gut to the side with more unseen wall."""

    requires = Requirements(observations=("map",), actuations=("wrench",))

    def reset(self, indices: np.ndarray, seeds: Sequence[int]) -> None:
        """Do nothing: the policy has no state."""

    def act(self, observations: dict[str, np.ndarray], env: CapsuleVectorEnv) -> np.ndarray:
        """Full force along the centerline, and a slow turn to look around."""
        view = env.view
        unseen = 1.0 - observations["map"][:, 0].mean(axis=2)  # by position along the gut
        rows = (np.arange(unseen.shape[1]) + 0.5) / unseen.shape[1]
        actions = np.zeros((len(unseen), 6), np.float32)
        for k, row in enumerate(unseen):
            line = view.patient(k).model.organ.centerline
            here = view.arc_length[k]
            ahead = row[rows > here / line.length].sum() > row[rows <= here / line.length].sum()
            frame = line.frames[np.abs(line.arc_length - here).argmin()]
            tangent = view.patient(k).model.T_world_patient[:3, :3] @ frame[:, 2]
            actions[k, :3] = tangent if ahead else -tangent
            actions[k, 3:] = 0.3 * view.T_world_capsule[k, :3, 1]
        return actions.clip(-1.0, 1.0)


def main(out: Path, worlds: int, seconds: float) -> None:
    """Evaluate both, print, write."""
    settings = env_settings(organs=("stomach",), observations=("map",), episode_time=seconds)
    lines = []
    for name, policy in (("frontier", Frontier()), ("random", read_policy("random"))):
        env = CapsuleVectorEnv(settings, worlds, autoreset_mode="Disabled")
        observations, infos = env.reset(seed=0)
        policy.reset(np.arange(worlds), range(worlds))
        over = np.zeros(worlds, bool)
        while not over.any():
            observations, _, terminated, truncated, infos = env.step(policy.act(observations, env))
            over = terminated | truncated
        seen = 100.0 * np.median(infos["coverage_visible"])
        lines.append(f"{name}: {seen:.1f} % of the wall was seen in {infos['time'].max():.0f} s")
    print("\n".join(lines))
    out.mkdir(parents=True, exist_ok=True)
    (out / "coverage.txt").write_text("\n".join(lines) + "\n")


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--out", type=Path, default=Path("runs/own-controller"))
    parser.add_argument("--worlds", type=int, default=8)
    parser.add_argument("--seconds", type=float, default=30.0)
    parser.add_argument("--smoke", action="store_true", help="one world for a second, as a test")
    args = parser.parse_args()
    main(args.out, *((1, 0.5) if args.smoke else (args.worlds, args.seconds)))
