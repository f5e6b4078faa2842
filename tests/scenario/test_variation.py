"""Open settings of a scenario, drawn by prevalence."""

from dataclasses import replace

import numpy as np
import pytest

from vrcaps.lumen.contents import Bubbles, Contents, Film, Medium
from vrcaps.lumen.preparation import PREPARATIONS
from vrcaps.motion.dynamics import Dynamics
from vrcaps.motion.fly_through import FlyThrough
from vrcaps.scenario.build import resolve
from vrcaps.scenario.scenario import (
    OrganFile,
    OrganGenerated,
    Scenario,
    scenario_from_plain,
    scenario_to_plain,
)
from vrcaps.scenario.variation import PREVALENCES, Prevalence, drawn_contents, varied

_LITTERED = Prevalence(
    {None: 1.0}, (0.1, 0.3), bubbles=0.35, chyme=0.1, liquid=(0.4, 0.3, 0.3), medium=0.3, film=0.5
)


def _patient(seed: int, organ: str = "small-bowel", **more) -> Scenario:
    generated = OrganGenerated(organ, seed=seed)
    return Scenario(organ=generated, seed=seed, contents=Contents(seed=seed), **more)


def test_all_open_settings_are_drawn_and_stored():
    resolved = resolve(_patient(3)).scenario
    contents = resolved.contents
    assert None not in (contents.bubbles, contents.chyme, contents.liquid)
    assert isinstance(contents.medium, Medium)
    assert isinstance(contents.film, Film)
    assert resolved.organ.distension in (None, "normal")
    assert 1.0 <= resolved.motion.tilt <= 1.3
    assert isinstance(contents.bubbles, Bubbles)
    # Recording it again draws the same.
    assert resolve(resolved).scenario == resolved
    assert scenario_from_plain(scenario_to_plain(resolved)) == resolved


def test_given_settings_stay_and_do_not_change_others():
    free = varied(_patient(5))
    given = _patient(5, motion=FlyThrough(tilt=0.2))
    given = replace(given, contents=Contents(bubbles=2, medium=0, seed=5))
    drawn = varied(given)
    assert drawn.motion.tilt == 0.2
    assert (drawn.contents.bubbles, drawn.contents.medium) == (2, 0)
    assert (drawn.contents.chyme, drawn.contents.film) == (free.contents.chyme, free.contents.film)
    assert drawn.organ == free.organ


def test_variation_can_be_switched_off():
    plain = varied(_patient(1, variation=False))
    assert plain.contents == Contents(0, 0, 0, 0, 0, seed=1)
    assert plain.organ == OrganGenerated("small-bowel", seed=1)
    assert plain.motion == FlyThrough()


@pytest.mark.parametrize("organ", PREVALENCES)
def test_quasi_static_motion_gets_nothing_that_moves_with_inertia(organ):
    """Physics gets bubbles in some of the same patients; bubbles that are given stay."""
    kinds = {}
    for dynamics in ("physics", "quasi-static"):
        motion = Dynamics(dynamics=dynamics)
        drawn = [varied(_patient(seed, organ, motion=motion)).contents for seed in range(8)]
        kinds[dynamics] = [(one.bubbles, one.chyme, one.liquid) for one in drawn]
        assert any(one.film for one in drawn)
    assert kinds["quasi-static"] == [(0, 0, 0)] * 8
    assert any(bubbles for bubbles, _, _ in kinds["physics"])
    given = _patient(1, organ, motion=Dynamics(dynamics="quasi-static"))
    given = replace(given, contents=Contents(bubbles=2, seed=1))
    assert varied(given).contents.bubbles == 2


def test_organ_files_are_not_varied():
    scenario = Scenario(organ=OrganFile("gut.ply", unit="mm"))
    assert varied(scenario).contents.is_empty
    assert varied(scenario).contents.medium_and_film == (None, None)


@pytest.mark.parametrize("organ", PREVALENCES)
def test_frequencies_over_patients_are_the_prevalences(organ):
    found = PREVALENCES[organ]
    drawn = [varied(_patient(seed, organ)) for seed in range(300)]
    for kind in ("medium", "film", *(() if found.preparations else ("bubbles", "chyme"))):
        values = [getattr(one.contents, kind) for one in drawn]
        mean = np.mean([getattr(value, "prevalence", 0.0) for value in values])
        assert mean == pytest.approx(getattr(found, kind), rel=0.12, abs=0.01)
    for distension, probability in found.distensions.items():
        share = np.mean([one.organ.distension == distension for one in drawn])
        assert share == pytest.approx(probability, abs=0.05)
    assert sum(found.liquid) == pytest.approx(1.0)
    tilts = [one.motion.tilt for one in drawn]
    assert found.tilt[0] <= min(tilts) < np.mean(tilts) < max(tilts) <= found.tilt[1]


def test_quantities_are_independent():
    drawn = [varied(_patient(seed)).contents for seed in range(300)]
    littered = [drawn_contents(Contents(seed=seed), _LITTERED) for seed in range(300)]
    columns = [
        [each.medium.prevalence for each in drawn],
        [each.medium.scattering[0] for each in drawn],
        [each.film.prevalence for each in drawn],
        [each.bubbles.prevalence for each in littered],
        [each.chyme.prevalence for each in littered],
        [each.bubbles.per_area for each in littered],
    ]
    correlation = np.corrcoef(columns) - np.eye(len(columns))
    assert np.abs(correlation).max() < 0.2


def test_bubbles_and_chyme_have_their_prevalence():
    drawn = [drawn_contents(Contents(seed=seed), _LITTERED) for seed in range(300)]
    for kind, mean in (("bubbles", 0.35), ("chyme", 0.1)):
        values = [getattr(each, kind).prevalence for each in drawn]
        assert np.mean(values) == pytest.approx(mean, rel=0.1)
    shares = np.bincount([each.liquid for each in drawn]) / len(drawn)
    assert shares == pytest.approx(_LITTERED.liquid, abs=0.07)


def test_preparation_sets_what_is_left_in_the_lumen():
    found = Prevalence({None: 1.0}, (0.1, 0.3), preparations=(0.5, 0.3, 0.15, 0.05))
    drawn = [drawn_contents(Contents(seed=seed), found) for seed in range(300)]
    known = [each.bubbles for each in PREPARATIONS]
    shares = np.bincount([known.index(each.bubbles) for each in drawn]) / len(drawn)
    assert shares == pytest.approx(found.preparations[::-1], abs=0.07)  # from score 0 up
    assert all(each.chyme in [one.chyme for one in PREPARATIONS] for each in drawn)
