"""Open settings of a scenario, drawn by prevalence."""

from dataclasses import replace

import numpy as np
import pytest

from vrcaps.lumen.contents import Bubbles, Contents
from vrcaps.lumen.medium import Film, Medium
from vrcaps.motion.fly_through import FlyThrough
from vrcaps.scenario.build import resolve
from vrcaps.scenario.scenario import (
    OrganFile,
    OrganGenerated,
    Scenario,
    scenario_from_plain,
    scenario_to_plain,
)
from vrcaps.scenario.variation import PREVALENCES, varied


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
    assert 0.3 <= resolved.motion.tilt <= 0.78
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
    columns = [
        [each.medium.prevalence for each in drawn],
        [each.medium.scattering[0] for each in drawn],
        [each.film.prevalence for each in drawn],
        [each.bubbles.prevalence for each in drawn],
        [each.chyme.prevalence for each in drawn],
    ]
    correlation = np.corrcoef(columns) - np.eye(len(columns))
    assert np.abs(correlation).max() < 0.2


def test_colon_is_as_clean_as_a_score_of_preparation():
    bubbles = [varied(_patient(seed, "colon")).contents.bubbles for seed in range(20)]
    assert all(isinstance(each, Bubbles) for each in bubbles)
    assert len({each.per_area for each in bubbles}) > 1
