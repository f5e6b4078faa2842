"""Navigate and Inspect: what counts as the way and as a look, and what they ask of an organ."""

from dataclasses import replace

import numpy as np
import pytest

from tests.support.small_envs import GUT, LESION_GUT, simulation_of, small_settings
from vrcaps.core.errors import InputError, UnknownNameError
from vrcaps.env.env import ENVIRONMENTS
from vrcaps.env.episode import Episode
from vrcaps.env.randomization import Start
from vrcaps.env.rewards import ProgressGain
from vrcaps.env.settings import env_settings
from vrcaps.env.simulation import Simulation
from vrcaps.env.tasks import InspectTask, NavigateTask
from vrcaps.metrics.point_coverage import wall_points

ONE = np.array([0])


def moved_to(simulation: Simulation, arc_length: float) -> tuple[float, bool]:
    """Progress and whether the task is done, of a capsule that is put somewhere."""
    task = simulation.settings.task
    simulation.worlds.arc_length[0] = arc_length
    task.update(simulation.view, ONE)
    return float(task.progress(simulation.view)[0]), bool(task.is_done(simulation.view)[0])


@pytest.mark.parametrize(("goal", "place"), [(1.0, 0.18), (0.0, 0.0), ("lower", 0.1), (0.5, 0.09)])
def test_the_way_leads_to_a_fraction_or_to_the_near_end_of_a_segment(goal, place) -> None:
    task = NavigateTask(goal=goal, tolerance=0.01)
    start = Start(fraction=(0.3, 0.3), settle=0.0)
    simulation = simulation_of(task=task, actuation="wrench", organs=(GUT,), start=start)
    here = simulation.worlds.arc_length[0]
    assert task.measures(simulation.view)["distance_to_goal"] == pytest.approx([abs(place - here)])
    sign = np.sign(place - here)
    assert moved_to(simulation, here - 0.02 * sign) == (0.0, False)
    middle, is_done = moved_to(simulation, 0.5 * (here + place))
    assert middle == pytest.approx(0.5 * abs(place - here) / (abs(place - here) - 0.01))
    assert not is_done
    assert moved_to(simulation, here) == (middle, False)
    assert moved_to(simulation, place - 0.009 * sign) == (1.0, True)
    assert moved_to(simulation, here) == (1.0, True)


def test_a_start_within_the_goal_is_done() -> None:
    simulation = simulation_of(task=NavigateTask(goal="upper"), actuation="wrench", organs=(GUT,))
    assert simulation.settings.task.is_done(simulation.view).all()


def test_navigation_is_paid_once_for_each_part_of_the_way() -> None:
    task = NavigateTask(tolerance=0.01)
    start = Start(fraction=(0.2, 0.2), settle=0.0)
    given = {"task": task, "actuation": "wrench", "organs": (GUT,), "start": start}
    reward = ProgressGain()
    episode, gains = Episode(small_settings(**given, rewards=(reward,)), 1), []
    episode.begin(0, np.random.default_rng(0))
    for arc_length in (0.05, 0.0501, 0.05, 0.0501, 0.1, 0.17):
        moved_to(episode.simulation, arc_length)
        reward.update(episode.view, np.ones(1, bool))
        gains.append(reward.value(episode.view)[0])
    assert np.sum(gains) == pytest.approx(1.0)
    assert gains[2:4] == [0.0, 0.0]


def test_a_lesion_counts_after_a_look_without_a_break() -> None:
    task = InspectTask(dwell=0.5)
    simulation = simulation_of(task=task, actuation="wrench", organs=(LESION_GUT,), lesions=())
    first, told = simulation.worlds.patient(0).points.first_of_lesions, []
    for is_seen in (True, True, False, True, True, True):
        simulation.coverage.flags[0][first:] = 7 if is_seen else 3
        task.update(simulation.view, ONE)
        told.append(float(task.progress(simulation.view)[0]))
        assert (simulation.coverage.flags[0][first:] == 0).all()
    assert told == pytest.approx([1 / 3, 2 / 3, 2 / 3, 2 / 3, 2 / 3, 1.0])
    measures = task.measures(simulation.view)
    assert [int(measures[name][0]) for name in measures] == [1, 1, 1]
    assert task.is_done(simulation.view).all()


def test_a_small_part_of_a_lesion_is_no_look() -> None:
    task = InspectTask(fraction=0.5)
    simulation = simulation_of(task=task, actuation="wrench", organs=(LESION_GUT,), lesions=())
    flags = simulation.coverage.flags[0][simulation.worlds.patient(0).points.first_of_lesions :]
    flags[: len(flags) // 2 - 1] = 7
    task.update(simulation.view, ONE)
    assert task.progress(simulation.view)[0] == 0.0


def test_points_on_lesions_lie_on_them_and_change_no_coverage() -> None:
    plain, points = wall_points(GUT, 512), wall_points(LESION_GUT, 512)
    first = points.first_of_lesions
    assert (plain.first_of_lesions, list(points.lesions)) == (len(plain), [1])
    assert (points.face[:first] == plain.face).all()
    assert (points.fractions[:first] == plain.fractions).all()
    assert (points.fractions[first:] == 0.0).all()
    on_lesion = LESION_GUT.instance[LESION_GUT.faces[points.face[first:]]] > 0
    assert on_lesion.any(axis=1).all()


def test_tasks_bring_settings_that_suit_them() -> None:
    settings = env_settings(task="navigate", episode_time=5.0)
    assert (settings.actuation.kind, settings.start.fraction) == ("magnet", (0.0, 0.0))
    assert settings.episode_time == 5.0
    assert len(env_settings(task="inspect").lesions) == 3
    assert set(ENVIRONMENTS.values()) == {"coverage", "navigate", "inspect"}


def test_bad_tasks_are_one_clear_line() -> None:
    with pytest.raises(InputError, match="NavigateTask's goal is 1"):
        NavigateTask(goal=1.5)
    with pytest.raises(InputError, match="NavigateTask's goal is None"):
        NavigateTask(goal=None)  # pyright: ignore[reportArgumentType]
    with pytest.raises(UnknownNameError, match="No segment of gut named"):
        simulation_of(task=NavigateTask(goal="duodenum"), actuation="wrench", organs=(GUT,))
    with pytest.raises(UnknownNameError, match="level of coverage for a task"):
        InspectTask(level="readable")
    with pytest.raises(InputError, match="gut has 0 lesions"):
        simulation_of(task="inspect", actuation="wrench", organs=(GUT,), lesions=())
    many = replace(LESION_GUT, instance=np.arange(len(LESION_GUT.vertices), dtype=np.uint16) % 40)
    with pytest.raises(InputError, match="gut has 39 lesions"):
        simulation_of(task="inspect", actuation="wrench", organs=(many,), lesions=())
