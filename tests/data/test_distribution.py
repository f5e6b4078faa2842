"""Distributions: their moments, their limits, and what is refused."""

import math

import numpy as np
import pytest

from vrcaps.core.errors import InputError
from vrcaps.data.distribution import distribution_of, slots


def draws(plain: dict, count: int = 4000) -> list:
    found = distribution_of(plain, "slot")
    rng = np.random.default_rng(0)
    return [found.draw(rng) for _ in range(count)]


def test_choices_follow_their_weights() -> None:
    values = draws({"choice": ["a", "b"], "weights": [3, 1]})
    assert values.count("a") / len(values) == pytest.approx(0.75, abs=0.03)
    assert set(draws({"choice": [1, 2, 3]})) == {1, 2, 3}


def test_numbers_have_the_moments_of_their_law() -> None:
    uniform = np.array(draws({"uniform": [2.0, 4.0]}))
    assert uniform.mean() == pytest.approx(3.0, abs=0.05)
    assert uniform.var() == pytest.approx(4.0 / 12.0, rel=0.1)
    logs = np.log(draws({"log-uniform": [0.001, 0.1]}))
    assert logs.mean() == pytest.approx((math.log(0.001) + math.log(0.1)) / 2.0, abs=0.1)
    normal = np.array(draws({"normal": [1.0, 0.5], "limits": [0.0, 2.0]}))
    assert normal.min() >= 0.0
    assert normal.max() <= 2.0
    assert normal.mean() == pytest.approx(1.0, abs=0.05)
    assert set(draws({"integer": [0, 2]})) == {0, 1, 2}


def test_lesions_come_in_the_numbers_of_their_prevalence() -> None:
    means = [np.mean([len(x) for x in draws({"prevalence": k}, 400)]) for k in (1.0, 2.0)]
    assert means[1] == pytest.approx(2.0 * means[0], rel=0.15)
    assert draws({"prevalence": 0.0}, 5) == [[]] * 5


def test_paths_of_slots_lead_into_tables_and_lists() -> None:
    plan = {
        "motion": {"speed": {"uniform": [1, 2]}},
        "lesions": [{"probability": 0.5, "kind": "x"}],
    }
    assert [path for path, _ in slots(plan)] == ["motion.speed", "lesions.0.probability"]


@pytest.mark.parametrize(
    ("plain", "message"),
    [
        ({"choice": []}, "0 choices"),
        ({"choice": ["a"], "weights": [1, 2]}, "a weight of 0 or more for each"),
        ({"uniform": [2, 1]}, "two ascending numbers"),
        ({"uniform": ["a", 1]}, "not a finite number"),
        ({"log-uniform": [0, 1]}, "above 0"),
        ({"normal": [0, 1], "limits": [9, 10]}, "3 deviations"),
        ({"normal": [0.1, 0.05], "limits": [0.1, 0.1]}, "less than 0.0001 of the normal"),
        ({"normal": [0.1, 1e308], "limits": [0.1, 0.2]}, "Allowed: wider limits, or a uniform"),
        ({"choice": [1, 2], "weights": [1e308, 1e308]}, "2 choices with weights"),
        ({"uniform": [-1.7e308, 1.7e308]}, "Allowed: a finite difference"),
        ({"integer": [0.5, 2]}, "two integers"),
        ({"each": []}, "at least one value"),
        ({"uniform": 3}, "a list"),
        ({"uniform": [0, 1], "sigma": 2}, "unknown key sigma"),
        ({"integer": [0, 10**20]}, r"Allowed: two integers between -2\^63 and 2\^63\."),
        ({"prevalence": -1}, "0 to 100"),
        ({"prevalence": 1e30}, r"prevalence is 1e\+30\. Allowed: 0 to 100\."),
    ],
)
def test_impossible_distributions_are_one_clear_line(plain: dict, message: str) -> None:
    with pytest.raises(InputError, match=message):
        distribution_of(plain, "motion.speed")
