"""Distributions that may replace values in a plan."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from statistics import NormalDist
from typing import Any

import numpy as np

from vrcaps.core.errors import InputError, nearest

PROBABILITY = "probability"

_BITS = 63
"""NumPy draws integers with fewer bits."""
_MAX_PREVALENCE = 100.0
"""Maximum factor of the prevalence of lesions; the mean patient then has hundreds."""

_LEAST_PROBABILITY = 1e-4
"""Minimum probability of the limits of a normal distribution, whose values are drawn until one lies
within them."""

Plain = Any
"""Value of TOML or JSON."""


@dataclass(frozen=True)
class Choice:
    """Random choice from a list: ``{ choice = ["colon", "stomach"], weights = [2, 1] }``."""

    choice: Sequence[Plain]
    weights: Sequence[float] = ()

    def draw(self, rng: np.random.Generator) -> Plain:
        """Draw one of the values; with equal probability if there are no weights."""
        weights = np.array([float(w) for w in self.weights] or [1.0] * len(self.choice))
        return self.choice[int(rng.choice(len(self.choice), p=weights / weights.sum()))]

    def extremes(self) -> Sequence[Plain]:
        """Return all values."""
        return [value for k, value in enumerate(self.choice) if not self.weights or self.weights[k]]

    def check(self, path: str) -> None:
        """Raise InputError if nothing can be drawn."""
        weights = [_number(weight, path) for weight in self.weights]
        fits = not weights or (len(weights) == len(self.choice) and min(weights) >= 0.0)
        if not self.choice or not fits or (weights and not 0.0 < sum(weights) < math.inf):
            raise InputError(
                f"{path}: {len(self.choice)} choices with weights {weights}. Allowed: at least one "
                "choice, and a weight of 0 or more for each."
            )


@dataclass(frozen=True)
class Uniform:
    """Uniform distribution: ``{ uniform = [0.005, 0.02] }``."""

    uniform: Sequence[float]

    def draw(self, rng: np.random.Generator) -> float:
        """Draw a number."""
        low, high = map(float, self.uniform)
        return float(rng.uniform(low, high))

    def extremes(self) -> Sequence[Plain]:
        """Return the limits."""
        return list(map(float, self.uniform))

    def check(self, path: str) -> None:
        """Raise InputError unless the limits are two increasing numbers."""
        low, high = _check_limits(self.uniform, path)
        if math.isinf(high - low):
            raise InputError(f"{path}: uniform is {[low, high]}. Allowed: a finite difference.")


@dataclass(frozen=True)
class LogUniform:
    """Log-uniform distribution: ``{ log-uniform = [0.003, 0.03] }``."""

    log_uniform: Sequence[float]

    def draw(self, rng: np.random.Generator) -> float:
        """Draw a number."""
        low, high = (math.log(float(x)) for x in self.log_uniform)
        return math.exp(float(rng.uniform(low, high)))

    def extremes(self) -> Sequence[Plain]:
        """Return the limits."""
        return list(map(float, self.log_uniform))

    def check(self, path: str) -> None:
        """Raise InputError unless the limits are two increasing positive numbers."""
        _check_limits(self.log_uniform, path, above=0.0)


@dataclass(frozen=True)
class Normal:
    """Truncated normal: ``{ normal = [0.01, 0.002], limits = [0.005, 0.02] }``.

    Values outside the limits are drawn again.
    """

    normal: Sequence[float]
    limits: Sequence[float] = ()

    def draw(self, rng: np.random.Generator) -> float:
        """Draw a number."""
        mean, deviation = map(float, self.normal)
        low, high = map(float, self.limits or (-math.inf, math.inf))
        while not low <= (value := float(rng.normal(mean, deviation))) <= high:
            pass
        return value

    def extremes(self) -> Sequence[Plain]:
        """Return the limits; without limits the mean."""
        return list(map(float, self.limits or self.normal[:1]))

    def check(self, path: str) -> None:
        """Raise InputError if mean, deviation or limits are invalid or hardly ever satisfied."""
        if len(self.normal) != 2 or _number(self.normal[1], path) < 0.0:
            raise InputError(f"{path}: normal is {list(self.normal)}. Allowed: mean, deviation.")
        mean, deviation = (_number(x, path) for x in self.normal)
        if not self.limits:
            return
        low, high = _check_limits(self.limits, path)
        if low > mean + 3.0 * deviation or high < mean - 3.0 * deviation:
            raise InputError(
                f"{path}: limits {list(self.limits)} are more than 3 deviations from the mean "
                f"{mean:g}. Allowed: limits within 3 deviations."
            )
        if deviation == 0.0:
            return
        normal = NormalDist(mean, deviation)
        if normal.cdf(high) - normal.cdf(low) < _LEAST_PROBABILITY:
            raise InputError(
                f"{path}: limits {low:g} to {high:g} contain less than {_LEAST_PROBABILITY:g} of "
                f"the normal distribution {mean:g}, {deviation:g}. Allowed: wider limits, or a "
                "uniform distribution."
            )


@dataclass(frozen=True)
class Integer:
    """Uniform integer between inclusive limits: ``{ integer = [0, 4] }``."""

    integer: Sequence[int]

    def draw(self, rng: np.random.Generator) -> int:
        """Draw a number."""
        low, high = self.integer
        return int(rng.integers(low, high + 1))

    def extremes(self) -> Sequence[Plain]:
        """Return the limits."""
        return list(self.integer)

    def check(self, path: str) -> None:
        """Raise InputError unless the limits are two increasing integers."""
        is_valid = len(self.integer) == 2 and all(
            type(x) is int and abs(x) < 2**_BITS for x in self.integer
        )
        if not is_valid:
            raise InputError(
                f"{path}: integer is {list(self.integer)}. Allowed: two integers between -2^{_BITS}"
                f" and 2^{_BITS}."
            )
        _check_limits(self.integer, path)


@dataclass(frozen=True)
class Each:
    """All values of a list, as separate recordings: ``{ each = ["mirocam", "mono"] }``."""

    each: Sequence[Plain]

    def extremes(self) -> Sequence[Plain]:
        """Return all values."""
        return self.each

    def check(self, path: str) -> None:
        """Raise InputError if there is no value."""
        if not self.each:
            raise InputError(f"{path}: `each` is empty. Allowed: at least one value.")


@dataclass(frozen=True)
class Prevalence:
    """Lesions of a patient by prevalence in a screening population: ``{ prevalence = 2.0 }``.

    The factor multiplies the mean number of every lesion, to make rare disease more frequent. The
    table is for the colon; other organs have no lesions.
    """

    prevalence: float

    def draw(self, rng: np.random.Generator) -> list[Plain]:
        """Draw lesions in plain form."""
        from vrcaps.config.convert import to_plain
        from vrcaps.lesion import Lesion, draw_lesions

        lesions = draw_lesions(None, rng, exaggerate=float(self.prevalence))
        return to_plain(lesions, tuple[Lesion, ...])

    def extremes(self) -> Sequence[Plain]:
        """Return no values: only lesions are drawn."""
        return ()

    def check(self, path: str) -> None:
        """Raise InputError if the factor is negative or too large."""
        if not 0.0 <= _number(self.prevalence, path) <= _MAX_PREVALENCE:
            raise InputError(
                f"{path}: prevalence is {self.prevalence}. Allowed: 0 to {_MAX_PREVALENCE:g}."
            )


@dataclass(frozen=True)
class Probability:
    """Presence of a list item: ``probability = 0.3`` in its table."""

    probability: float

    def draw(self, rng: np.random.Generator) -> bool:
        """Draw whether it is present."""
        return bool(rng.random() < float(self.probability))

    def extremes(self) -> Sequence[Plain]:
        """Return both values."""
        return (True, False)

    def check(self, path: str) -> None:
        """Raise InputError if it is not a probability."""
        if not 0.0 <= _number(self.probability, path) <= 1.0:
            raise InputError(f"{path}: probability is {self.probability}. Allowed: 0 to 1.")


_KINDS = (Choice, Uniform, LogUniform, Normal, Integer, Each, Prevalence)
_BY_KEY = {next(iter(cls.__dataclass_fields__)).replace("_", "-"): cls for cls in _KINDS}


def distribution_of(plain: Plain, path: str) -> Any:
    """Distribution in a table; None if the table is not a distribution.

    Args:
        plain: Value in a plan.
        path: Path of the value, for messages.

    Raises:
        InputError: If the distribution is invalid.
    """
    if not isinstance(plain, Mapping):
        return None
    key = next((key for key in _BY_KEY if key in plain), None)
    if key is None:
        _refuse_misspelled(plain, path)
        return None
    cls = _BY_KEY[key]
    known = [name.replace("_", "-") for name in cls.__dataclass_fields__]
    for name, value in plain.items():
        if name not in known:
            raise InputError(f"{path}: unknown key {name}. Allowed: {', '.join(known)}.")
        if name != "prevalence" and not isinstance(value, list):
            raise InputError(f"{path}: {name} is {value}. Allowed: a list.")
    distribution = cls(**{name.replace("-", "_"): value for name, value in plain.items()})
    distribution.check(path)
    return distribution


def _refuse_misspelled(plain: Mapping[str, Plain], path: str) -> None:
    """Reject a table that is a distribution except for its misspelled name.

    No key of a scenario that holds a list resembles one of these names.

    Raises:
        InputError: If it is one; the message gives the nearest name.
    """
    for name, value in plain.items():
        if isinstance(value, list) or name.startswith("prev"):
            meant = nearest(str(name), _BY_KEY)
            if meant:
                known = ", ".join(_BY_KEY)
                raise InputError(f"{path}: unknown distribution {name}. Known: {known}.{meant}")


def slots(plain: Plain, path: str = "") -> Iterator[tuple[str, Any]]:
    """Paths and distributions in a plan's scenario, in order; list items by index."""
    distribution = distribution_of(plain, path) if path else None
    if distribution is not None:
        yield path, distribution
    elif isinstance(plain, Mapping):
        for key, value in plain.items():
            yield from slots(value, f"{path}.{key}" if path else str(key))
    elif isinstance(plain, list):
        for index, value in enumerate(plain):
            if isinstance(value, Mapping) and PROBABILITY in value:
                distribution = Probability(value[PROBABILITY])
                distribution.check(f"{path}.{index}")
                yield f"{path}.{index}.{PROBABILITY}", distribution
            yield from slots(value, f"{path}.{index}")


def _number(value: Plain, path: str) -> float:
    try:
        parsed = float(value)
    except (TypeError, ValueError, OverflowError):
        parsed = math.nan
    if isinstance(value, bool) or not math.isfinite(parsed):
        raise InputError(f"{path}: {value!r} is not a finite number.")
    return parsed


def _check_limits(
    limits: Sequence[float], path: str, above: float = -math.inf
) -> tuple[float, float]:
    values = [_number(x, path) for x in limits]
    if len(values) != 2 or values[0] > values[1] or values[0] <= above:
        allowed = "two ascending numbers" + (f" above {above:g}" if above > -math.inf else "")
        raise InputError(f"{path}: limits are {values}. Allowed: {allowed}.")
    return values[0], values[1]
