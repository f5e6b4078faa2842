"""Distributions: what may stand in a plan in the place of a value."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from vrcaps.errors import InputError, nearest

PROBABILITY = "probability"

Plain = Any
"""A value of TOML or JSON."""


@dataclass(frozen=True)
class Choice:
    """One of some values: ``{ choice = ["colon", "stomach"], weights = [2, 1] }``."""

    choice: Sequence[Plain]
    weights: Sequence[float] = ()

    def draw(self, rng: np.random.Generator) -> Plain:
        """One of the values; all alike without weights."""
        weights = np.array([float(w) for w in self.weights] or [1.0] * len(self.choice))
        return self.choice[int(rng.choice(len(self.choice), p=weights / weights.sum()))]

    def extremes(self) -> Sequence[Plain]:
        """All values."""
        return [value for k, value in enumerate(self.choice) if not self.weights or self.weights[k]]

    def check(self, path: str) -> None:
        """Raise InputError if nothing can be drawn."""
        numbers = [_number(weight, path) for weight in self.weights]
        fits = not numbers or (len(numbers) == len(self.choice) and min(numbers) >= 0.0)
        if not self.choice or not fits or (numbers and sum(numbers) <= 0.0):
            raise InputError(
                f"{path}: {len(self.choice)} choices with weights {numbers}. Allowed: at least one "
                "choice, and a weight of 0 or more for each."
            )


@dataclass(frozen=True)
class Uniform:
    """A number evenly between two: ``{ uniform = [0.005, 0.02] }``."""

    uniform: Sequence[float]

    def draw(self, rng: np.random.Generator) -> float:
        """A number."""
        low, high = map(float, self.uniform)
        return float(rng.uniform(low, high))

    def extremes(self) -> Sequence[Plain]:
        """Its limits."""
        return list(map(float, self.uniform))

    def check(self, path: str) -> None:
        """Raise InputError if the limits are no two rising numbers."""
        _check_limits(self.uniform, path)


@dataclass(frozen=True)
class LogUniform:
    """A number even in its logarithm: ``{ log-uniform = [0.003, 0.03] }``."""

    log_uniform: Sequence[float]

    def draw(self, rng: np.random.Generator) -> float:
        """A number."""
        low, high = (math.log(float(x)) for x in self.log_uniform)
        return math.exp(float(rng.uniform(low, high)))

    def extremes(self) -> Sequence[Plain]:
        """Its limits."""
        return list(map(float, self.log_uniform))

    def check(self, path: str) -> None:
        """Raise InputError if the limits are no two rising numbers above 0."""
        _check_limits(self.log_uniform, path, above=0.0)


@dataclass(frozen=True)
class Normal:
    """A normal number within limits: ``{ normal = [0.01, 0.002], limits = [0.005, 0.02] }``.

    It is drawn again until it lies within.
    """

    normal: Sequence[float]
    limits: Sequence[float] = ()

    def draw(self, rng: np.random.Generator) -> float:
        """A number."""
        mean, deviation = map(float, self.normal)
        low, high = map(float, self.limits or (-math.inf, math.inf))
        while not low <= (value := float(rng.normal(mean, deviation))) <= high:
            pass
        return value

    def extremes(self) -> Sequence[Plain]:
        """Its limits; the mean without them."""
        return list(map(float, self.limits or self.normal[:1]))

    def check(self, path: str) -> None:
        """Raise InputError if mean, deviation or limits are impossible or hardly ever met."""
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


@dataclass(frozen=True)
class Integer:
    """A whole number from one to another, both included: ``{ integer = [0, 4] }``."""

    integer: Sequence[int]

    def draw(self, rng: np.random.Generator) -> int:
        """A number."""
        low, high = self.integer
        return int(rng.integers(low, high + 1))

    def extremes(self) -> Sequence[Plain]:
        """Its limits."""
        return list(self.integer)

    def check(self, path: str) -> None:
        """Raise InputError if the limits are no two rising whole numbers."""
        if len(self.integer) != 2 or not all(type(x) is int for x in self.integer):
            raise InputError(f"{path}: integer is {list(self.integer)}. Allowed: two integers.")
        _check_limits(self.integer, path)


@dataclass(frozen=True)
class Each:
    """Every one of some values, as recordings of their own: ``{ each = ["mirocam", "mono"] }``."""

    each: Sequence[Plain]

    def extremes(self) -> Sequence[Plain]:
        """All values."""
        return self.each

    def check(self, path: str) -> None:
        """Raise InputError if there is no value."""
        if not self.each:
            raise InputError(f"{path}: each is empty. Allowed: at least one value.")


@dataclass(frozen=True)
class Prevalence:
    """A patient's lesions, of the table of a screening population: ``{ prevalence = 2.0 }``.

    The number multiplies the mean number of every lesion, for rare disease to be seen at all. The
    table is of the colon; organs without one have no lesions.
    """

    prevalence: float

    def draw(self, rng: np.random.Generator) -> list[Plain]:
        """Lesions in plain form."""
        from vrcaps.lesion import AnyLesion, draw_lesions
        from vrcaps.serialization import to_plain

        lesions = draw_lesions(None, rng, exaggerate=float(self.prevalence))
        return to_plain(lesions, tuple[AnyLesion, ...])

    def extremes(self) -> Sequence[Plain]:
        """None: all that it draws are lesions."""
        return ()

    def check(self, path: str) -> None:
        """Raise InputError if the factor is negative."""
        if _number(self.prevalence, path) < 0.0:
            raise InputError(f"{path}: prevalence is {self.prevalence}. Allowed: 0 or more.")


@dataclass(frozen=True)
class Probability:
    """Whether an item of a list is there: ``probability = 0.3`` in its table."""

    probability: float

    def draw(self, rng: np.random.Generator) -> bool:
        """Whether it is."""
        return bool(rng.random() < float(self.probability))

    def extremes(self) -> Sequence[Plain]:
        """Both."""
        return (True, False)

    def check(self, path: str) -> None:
        """Raise InputError if it is no probability."""
        if not 0.0 <= _number(self.probability, path) <= 1.0:
            raise InputError(f"{path}: probability is {self.probability}. Allowed: 0 to 1.")


_KINDS = (Choice, Uniform, LogUniform, Normal, Integer, Each, Prevalence)
_BY_KEY = {next(iter(cls.__dataclass_fields__)).replace("_", "-"): cls for cls in _KINDS}


def distribution_of(plain: Plain, path: str) -> Any:
    """The distribution that a table states; None if it is no distribution.

    Args:
        plain: What a plan holds at a place.
        path: The place, for messages.

    Raises:
        InputError: If it is one, but an impossible one.
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
    found = cls(**{name.replace("-", "_"): value for name, value in plain.items()})
    found.check(path)
    return found


def _refuse_misspelled(plain: Mapping[str, Plain], path: str) -> None:
    """Refuse a table that is a distribution but for its name.

    No key of a scenario that holds a list resembles one of them.

    Raises:
        InputError: If it is one; names the nearest.
    """
    for name, value in plain.items():
        if isinstance(value, list) or name.startswith("prev"):
            meant = nearest(str(name), _BY_KEY)
            if meant:
                known = ", ".join(_BY_KEY)
                raise InputError(f"{path}: unknown distribution {name}. Known: {known}.{meant}")


def slots(plain: Plain, path: str = "") -> Iterator[tuple[str, Any]]:
    """Paths of all distributions in a plan's scenario, in its order; list items by number."""
    found = distribution_of(plain, path) if path else None
    if found is not None:
        yield path, found
    elif isinstance(plain, Mapping):
        for key, value in plain.items():
            yield from slots(value, f"{path}.{key}" if path else str(key))
    elif isinstance(plain, list):
        for index, value in enumerate(plain):
            if isinstance(value, Mapping) and PROBABILITY in value:
                found = Probability(value[PROBABILITY])
                found.check(f"{path}.{index}")
                yield f"{path}.{index}.{PROBABILITY}", found
            yield from slots(value, f"{path}.{index}")


def _number(value: Plain, path: str) -> float:
    try:
        number = float(value)
    except (TypeError, ValueError, OverflowError):
        number = math.nan
    if isinstance(value, bool) or not math.isfinite(number):
        raise InputError(f"{path}: {value!r} is no finite number.")
    return number


def _check_limits(
    limits: Sequence[float], path: str, above: float = -math.inf
) -> tuple[float, float]:
    numbers = [_number(x, path) for x in limits]
    if len(numbers) != 2 or numbers[0] > numbers[1] or numbers[0] <= above:
        allowed = "two rising numbers" + (f" above {above:g}" if above > -math.inf else "")
        raise InputError(f"{path}: limits are {numbers}. Allowed: {allowed}.")
    return numbers[0], numbers[1]
