"""Random controller in an environment: a minimal example with a reward.

    python examples/08_environment.py

Prints the coverage of a stomach by a capsule that is pushed about at random, and writes the last
image of its camera (`last.png`).
"""

from __future__ import annotations

import argparse
from pathlib import Path

import gymnasium
from PIL import Image


def main(out: Path, steps: int) -> None:
    """Act at random, print, draw."""
    env = gymnasium.make("vrcaps.env:Coverage-v0", organs=("stomach",), render_mode="rgb_array")
    _, info = env.reset(seed=0)
    env.action_space.seed(0)
    for _ in range(steps):
        _, _, terminated, truncated, info = env.step(env.action_space.sample())
        if terminated or truncated:
            break
    print(f"{info['time']:.1f} s: {100.0 * info['coverage_visible']:.1f} % of the wall was seen.")
    out.mkdir(parents=True, exist_ok=True)
    Image.fromarray(env.render()).save(out / "last.png")


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--out", type=Path, default=Path("runs/environment"))
    parser.add_argument("--steps", type=int, default=60, help="actions, six a second")
    parser.add_argument("--smoke", action="store_true", help="a few steps only, as a test")
    args = parser.parse_args()
    main(args.out, 3 if args.smoke else args.steps)
