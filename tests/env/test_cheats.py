"""Ways to be paid for nothing, each as a policy that tries it: none of them pays."""

from dataclasses import replace
from itertools import product
from typing import Any

import numpy as np
import pytest

from tests.support.small_envs import GUT, LESION_GUT, SHORT_GUT, simulation_of, small_settings
from vrcaps.env.actuation import Wrench
from vrcaps.env.episode import Episode
from vrcaps.env.randomization import Start
from vrcaps.env.tasks import InspectTask
from vrcaps.metrics.point_coverage import POINT_LEVELS
from vrcaps.organ.surface import OrganSurface

EVERYWHERE = np.array([d for d in product((-1.0, 0.0, 1.0), repeat=3) if any(d)])
"""The 26 directions to the faces, edges and corners of a cube."""
STRONGEST = Wrench(force=2.0, torque=0.05)


def episode_of(num_worlds: int, **keywords: Any) -> Episode:
    given = {"organs": (SHORT_GUT,), "start": Start(fraction=(0.5, 0.5), settle=0.2)}
    episode = Episode(
        small_settings(**given | {"num_points": 512, "dynamics": "physics"} | keywords), num_worlds
    )
    for index in range(num_worlds):
        episode.begin(index, np.random.default_rng(index))
    return episode


def run(episode: Episode, actions: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Sum of rewards of each world until its end, and whether it ended; actions are [steps n k]."""
    count = episode.simulation.num_worlds
    total, is_active = np.zeros(count), np.ones(count, bool)
    for action in actions:
        step = episode.step(action, is_active)
        total += step.reward
        is_active &= ~(step.terminated | step.truncated)
    return total, ~is_active


def blocked(organ: OrganSurface, place: float) -> OrganSurface:
    """The tube about x with a disk across it at a place [m], open to both sides of the wall."""
    angle = np.arange(64) * (2.0 * np.pi / 64)
    rim = np.stack([np.full(64, place), 0.02 * np.cos(angle), 0.02 * np.sin(angle)], -1)
    first, around = len(organ.vertices), np.arange(64)
    fan = np.stack([np.full(64, first + 64), first + around, first + (around + 1) % 64], -1)
    more = np.ones(65)
    return replace(
        organ,
        vertices=np.vstack([organ.vertices, rim, [[place, 0.0, 0.0]]]),
        faces=np.vstack([organ.faces, fan, fan[:, ::-1]]),
        normals=np.vstack([organ.normals, np.tile([1.0, 0.0, 0.0], (65, 1))]),
        uv=np.vstack([organ.uv, np.zeros((128, 3, 2))]),
        label=np.append(organ.label, more).astype(np.uint8),
        instance=np.append(organ.instance, 0 * more).astype(np.uint16),
        arc_length=np.append(organ.arc_length, place * more),
        theta=np.append(organ.theta, 0 * more),
        radius=np.append(organ.radius, 0.01 * more),
    )


@pytest.mark.slow
def test_no_push_leads_through_the_wall() -> None:
    """The largest force in all directions, at up to 4 m/s; where it ends it still pushes."""
    actuation = replace(STRONGEST, torque=0.0)
    episode = episode_of(
        26, actuation=actuation, max_speed=100.0, num_points=64, control_period=0.01
    )
    action = np.concatenate([EVERYWHERE, np.zeros_like(EVERYWHERE)], axis=1)
    for _ in range(5):
        episode.step(action, np.ones(26, bool))
        assert not episode.simulation.worlds.is_outside.any()
        assert np.isfinite(episode.simulation.worlds.T_world_capsule).all()
        assert not any(episode.simulation.failure)


def test_a_throw_through_the_lumen_earns_nothing_and_ends_the_episode() -> None:
    episode = episode_of(1, actuation=Wrench(force=1.0, is_weightless=True), control_period=0.03)
    before, ends = episode.simulation.coverage.fraction.copy(), False
    for _ in range(10):
        step = episode.step(np.array([[1.0, 0, 0, 0, 0, 0]]), np.ones(1, bool))
        if step.measures["is_too_fast"][0]:
            ends = True
            assert step.truncated[0]
            assert step.reward[0] == 0.0
            break
    assert ends
    assert (episode.simulation.coverage.fraction >= before).all()


def test_jitter_is_paid_for_each_part_of_the_wall_once() -> None:
    """All area that shaking ever earns is the area it saw; the time is paid for."""
    episode = episode_of(1, organs=(GUT,), control_period=0.02)
    at_start = episode.simulation.coverage.seen("visible")[0]
    shake = np.zeros((12, 1, 6))
    shake[::2, 0, 3:], shake[1::2, 0, 3:] = 1.0, -1.0
    total, _ = run(episode, shake)
    seen = 100.0 * (episode.simulation.coverage.seen("visible")[0] - at_start)
    assert total[0] == pytest.approx(seen - 0.1 * 12 * 0.02, abs=1e-9)
    assert episode.simulation.coverage.fraction.max() <= 1.0 + 1e-9


def test_hovering_costs_time_and_ends_as_stuck() -> None:
    start = Start(fraction=(0.5, 0.5), settle=0.0)
    actuation = Wrench(is_weightless=True)
    episode = episode_of(1, actuation=actuation, stuck_time=0.5, start=start)
    for _ in range(3):
        step = episode.step(np.zeros((1, 6)), np.ones(1, bool))
        assert step.reward[0] <= -0.1 / 6 + 1e-9
    assert step.truncated[0]
    assert step.measures["is_stuck"][0]


@pytest.mark.slow
def test_violence_does_not_break_the_physics() -> None:
    """Random blows of the largest strength at the longest substep."""
    episode = episode_of(2, actuation=STRONGEST, max_speed=100.0, control_period=0.01)
    blows = np.sign(np.random.default_rng(0).normal(size=(3, 2, 6)))
    for blow in blows:
        step = episode.step(blow, np.ones(2, bool))
        s = episode.view
        assert not episode.simulation.worlds.is_outside.any()
        for values in (s.T_world_capsule, s.velocity_world, s.normal_force_total, step.reward):
            assert np.isfinite(values).all()


def test_what_a_fault_shows_earns_nothing() -> None:
    """Were a capsule outside, it would see much, and be paid nothing."""
    episode = episode_of(1)
    simulation = episode.simulation
    update = simulation._update

    def outside(numbers: np.ndarray) -> None:
        update(numbers)
        simulation.worlds.is_outside[numbers] = True
        simulation.coverage.gain[numbers] = 0.5

    simulation._update = outside
    step = episode.step(np.zeros((1, 6)), np.ones(1, bool))
    assert (step.reward[0], step.truncated[0], step.terminated[0]) == (0.0, True, False)


def test_a_lesion_behind_a_fold_is_not_looked_at() -> None:
    """In the frustum but behind a disk: neither seen nor inspected; without the disk both."""
    told = []
    for organ in (blocked(LESION_GUT, 0.105), LESION_GUT):
        start = Start(fraction=(0.44, 0.44), settle=0.0)
        task = InspectTask(level="frustum", fraction=0.01)
        for level in ("frustum", "visible"):
            given = {"task": replace(task, level=level), "lesions": (), "organs": (organ,)}
            simulation = simulation_of(actuation="wrench", start=start, **given)
            points = simulation.worlds.patient(0).points.first_of_lesions
            simulation.coverage.update(np.array([0]))
            flags = simulation.coverage.flags[0][points:]
            told.append(bool(((flags & (1 << POINT_LEVELS.index(level))) != 0).any()))
    assert told == [True, False, True, True]
