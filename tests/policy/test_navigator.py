"""The navigator leads a capsule to its goal by magnet, over a fold too, and under both dynamics."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from tests.support.small_envs import GUT, small_settings
from vrcaps.core.errors import InputError
from vrcaps.env.randomization import Start
from vrcaps.env.tasks import CoverageTask, NavigateTask
from vrcaps.env.vector_env import CapsuleVectorEnv
from vrcaps.organ.surface import OrganSurface
from vrcaps.policy.catalog import read_policy
from vrcaps.policy.navigator import Guide, NavigatorPolicy


def folded(height: float) -> OrganSurface:
    """The tube with a fold across its lower wall at 12 cm, a half wave of 2 cm."""
    along = np.clip(1.0 - np.abs(GUT.arc_length - 0.12) / 0.01, 0.0, 1.0)
    vertices = GUT.vertices.copy()
    lower = np.maximum(vertices[:, 1], 0.0) / 0.02  # posterior is below
    vertices[:, 1] -= height * along * lower
    return replace(GUT, vertices=vertices)


def led(seconds: float, **keywords: Any) -> tuple[CapsuleVectorEnv, np.ndarray, Guide]:
    """The environment after the navigator has led the capsule, and whether the goal was reached."""
    start = Start(fraction=(0.5, 0.5), settle=0.3)
    task = NavigateTask(0.85, tolerance=5e-3)
    given: dict[str, Any] = {"task": task, "start": start, "control_period": 0.05, "num_points": 64}
    envs = CapsuleVectorEnv(small_settings(**given | keywords), 1, autoreset_mode="Disabled")
    observations, _ = envs.reset(seed=0)
    policy, done = NavigatorPolicy(), np.zeros(1, bool)
    policy.reset(np.arange(1), [0])
    for _ in range(round(seconds / 0.05)):
        actions = policy.act(observations, envs)
        assert np.abs(actions).max() <= 1.0
        observations, _, terminated, truncated, _ = envs.step(actions)
        assert not envs.episode.simulation.worlds.is_outside.any()
        done |= terminated
        if (terminated | truncated).all():
            break
    return envs, done, policy._guides[0]


@pytest.mark.parametrize("dynamics", ["quasi-static", "physics"])
def test_it_reaches_a_goal_along_a_tube(dynamics: Any) -> None:
    """6 cm at about 2 cm/s."""
    envs, done, _ = led(8.0, dynamics=dynamics)
    assert done.all()
    assert envs.view.time[0] < 6.0
    assert envs.view.normal_force_total[0] < 0.15


def test_it_hops_over_a_fold() -> None:
    """A fold as high as the capsule is thick stops what is only pulled."""
    _, done, _ = led(25.0, organs=(folded(10e-3),))
    assert done.all()


def test_without_a_goal_it_leads_to_the_farther_end() -> None:
    _, _, guide = led(0.05, task=CoverageTask(), actuation="magnet")
    assert len(guide.path.positions) == pytest.approx(90, abs=5)


def test_it_needs_a_magnet() -> None:
    settings = small_settings(actuation="wrench")
    with pytest.raises(InputError, match="navigator acts by magnet; the environment's actuation"):
        read_policy("navigator").requires.check(settings, "navigator")
    rope = SimpleNamespace(actuation=SimpleNamespace(kind="rope"))
    rope.patient, rope.memory = lambda _: SimpleNamespace(model=None), {}
    with pytest.raises(InputError, match="navigator does not support actuation 'rope'"):
        Guide(rope, 0)  # type: ignore[arg-type]
