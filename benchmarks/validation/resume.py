"""Claim: a training killed by SIGKILL at any time and resumed gives the same policy.

Reference: the same training undisturbed.

    python -m benchmarks.validation.resume [--size KILLS]
"""

from __future__ import annotations

import signal
import subprocess
import sys
import tempfile
import time
from dataclasses import replace
from pathlib import Path

import numpy as np

from benchmarks.common.scripts import ROOT, options, table, write_section
from vrcaps.core.files import file_sha256
from vrcaps.policy.ppo import PpoSettings
from vrcaps.policy.training import BEST, POLICY, TrainingSettings, train
from vrcaps.training import PROGRESS

SEED = 7
LEARNER = PpoSettings(
    num_envs=8, num_actions=7_200, updates=2, hidden=(64, 64), batch=256, evaluate_every=5
)
FILES = (BEST, POLICY)
LONGEST = 3.0
"""Longest time from the first checkpoint of a process to its kill [s]; drawn evenly."""


def main() -> None:
    """Train twice, once disturbed, and write the table."""
    given = options(__doc__ or "", size=5)
    with tempfile.TemporaryDirectory() as name:
        whole, cut = Path(name) / "whole", Path(name) / "cut"
        run(whole, None)
        draw = np.random.default_rng(SEED)
        waits = draw.uniform(0.0, LONGEST, given.size)
        rounds = [run(cut, float(wait)) for wait in waits]
        run(cut, None)
        rows = [[f"`{f}`", file_sha256(whole / f)[:16], file_sha256(cut / f)[:16]] for f in FILES]
        same = all(file_sha256(whole / f) == file_sha256(cut / f) for f in FILES)
    text = f"""## Resuming interrupted training

`python -m benchmarks.validation.resume`: PPO in a short tube, {LEARNER.num_actions:,} actions in 8
worlds. Killed by SIGKILL {given.size} times, {", ".join(f"{w:.1f}" for w in waits)} s after the
first checkpoint that the process wrote, when {", ".join(map(str, rounds))} rounds were done, each
time restarted; then to the end. The same bytes: {"yes" if same else "NO"}.

{table(["file", "SHA-256 undisturbed", "killed and resumed"], rows)}
"""
    write_section(given.out, Path(__file__), text)


def run(out: Path, wait: float | None) -> int:
    """Train in a process that is killed after its first checkpoint; return the completed rounds."""
    before = num_rounds(out)
    process = subprocess.Popen(
        [sys.executable, "-m", "benchmarks.validation.resume", "--train", str(out)], cwd=ROOT
    )
    while wait is not None and process.poll() is None and num_rounds(out) == before:
        time.sleep(0.05)
    try:
        process.wait(wait)
    except subprocess.TimeoutExpired:
        process.send_signal(signal.SIGKILL)
    if process.wait() > 0:
        raise SystemExit(process.returncode)
    return num_rounds(out)


def num_rounds(out: Path) -> int:
    """Rounds that a training's folder holds."""
    path = out / PROGRESS
    return len(path.read_text().splitlines()) - 1 if path.is_file() else 0


def train_here(out: Path) -> None:
    """The training itself, in this process."""
    from tests.support.small_envs import SHORT_GUT, small_settings

    env = small_settings(organs=(SHORT_GUT,), control_period=0.01, episode_time=0.3, num_points=256)
    train(TrainingSettings(env, replace(LEARNER, evaluation_episodes=2)), out)


if __name__ == "__main__":
    if "--train" in sys.argv:
        train_here(Path(sys.argv[-1]))
    else:
        main()
