"""Units of a data set: one recording each, independent of the number of workers."""

from __future__ import annotations

import itertools
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

from vrcaps.core import rng
from vrcaps.core.errors import InputError, UnknownNameError, VrcapsError, require
from vrcaps.data.distribution import PROBABILITY, Each, Prevalence, slots
from vrcaps.data.plan import PATIENT_SLOTS, Plan
from vrcaps.organ.segments import ORGANS, organ_segments
from vrcaps.recording.frame_sequence import SPLITS
from vrcaps.scenario.scenario import OrganGenerated, Scenario, scenario_from_plain

_SEEDS = 2**31
_MAX_UNITS = 10**6
"""Maximum number of recordings; a plan of a million takes weeks."""
_TWIN = "clean_twin"
"""Key of a clean twin, which shares all draws with the recording that shows the lesions."""


@dataclass(frozen=True)
class Unit:
    """Recording of a data set.

    Attributes:
        index: Index in the plan, from 0.
        patient: Index of the patient, from 0.
        split: `train`, `val` or `test`, by patient.
        name: Name of its folder.
        scenario: Scenario to record.
    """

    index: int
    patient: int
    split: str
    name: str
    scenario: Scenario


class Units:
    """All units of a plan, resolved on demand."""

    def __init__(self, plan: Plan) -> None:
        """Collect the plan's distributions; nothing is drawn."""
        self.plan = plan
        self.slots = dict(slots(plan.scenario))
        self._each = [(path, slot) for path, slot in self.slots.items() if isinstance(slot, Each)]
        patient_each = [path for path, _ in self._each if _is_patients(path)]
        if patient_each:
            raise InputError(
                f"{patient_each[0]} is `each`, but belongs to the patient. Allowed: a distribution "
                "such as choice; one patient has one organ."
            )
        sizes = [len(slot.each) for _, slot in self._each]
        self.per_patient = math.prod(sizes) * plan.settings.repeats
        total = plan.settings.patients * self.per_patient
        allowed = f"up to {_MAX_UNITS:,}: fewer patients, repeats or values of `each`"
        require(total <= _MAX_UNITS, "The number of recordings", f"{total:,}", allowed)

    def __len__(self) -> int:
        return self.plan.settings.patients * self.per_patient

    def __getitem__(self, index: int) -> Unit:
        """Return one unit.

        Raises:
            IndexError: If there is no such unit.
            InputError: If the drawn scenario is invalid; the message names the unit.
        """
        if not 0 <= index < len(self):
            raise IndexError(f"No unit {index}. Allowed: 0 to {len(self) - 1}.")
        try:
            scenario = self.scenario(index)
        except VrcapsError as error:
            raise InputError(f"Unit {index} of the plan: {error}") from error
        patient = index // self.per_patient
        return Unit(index, patient, self.splits[patient], self.name(index), scenario)

    def scenario(self, index: int, others: Mapping[str, Any] | None = None) -> Scenario:
        """Scenario of a unit.

        Args:
            index: Index of the unit.
            others: Values by path that replace the drawn ones.

        Raises:
            VrcapsError: If the drawn scenario is invalid.
        """
        patient, position = divmod(index, self.per_patient)
        repeat, combination = divmod(position, len(self._combinations))
        values = self._combinations[combination]
        drawn = self._draw(patient, False) | values
        # Twins have the draws of the recording that shows the lesions.
        key = self._kinds.index(_without_twin(values)) + len(self._kinds) * repeat
        drawn |= self._draw(patient, True, key) | {**(others or {})}
        plain = _filled(self.plan.scenario, drawn)
        plain.setdefault("seed", self._number("seed", patient, key))
        contents = plain.setdefault("contents", {})
        if isinstance(contents, dict):
            contents.setdefault("seed", self._number("contents.seed", patient, key))
        organ = plain.setdefault("organ", {})
        if isinstance(organ, dict) and organ.get("kind", OrganGenerated.kind) == "generated":
            plain["organ"] = {"seed": self._number("organ.seed", patient), **organ}
        scenario = scenario_from_plain(plain, units=self.plan.has_units)
        given = scenario.organ
        if isinstance(given, OrganGenerated) and given.name not in ORGANS:
            raise UnknownNameError("organ", given.name, ORGANS)
        return scenario

    def name(self, index: int) -> str:
        """Name of a unit: its patient and index."""
        return f"p{index // self.per_patient:05d}-{index:06d}"

    @cached_property
    def splits(self) -> tuple[str, ...]:
        """Split of each patient; patients with equal stratified values are distributed evenly."""
        settings, groups = self.plan.settings, {}
        for patient in range(settings.patients):
            drawn = self._draw(patient, False, only=settings.stratify)
            values = tuple(
                str(drawn.get(path, _at(self.plan.scenario, path))) for path in settings.stratify
            )
            groups.setdefault(values, []).append(patient)
        order: list[int] = []
        for values in sorted(groups):
            shuffle = rng.stream(settings.seed, f"data/split/{values}")
            order += shuffle.permutation(groups[values]).tolist()
        fractions = [getattr(settings.split, name) for name in SPLITS]
        return _spread(order, fractions)

    @cached_property
    def _combinations(self) -> list[dict[str, Any]]:
        paths = [path for path, _ in self._each]
        values = itertools.product(*(slot.each for _, slot in self._each))
        return [dict(zip(paths, chosen, strict=True)) for chosen in values]

    @cached_property
    def _kinds(self) -> list[list[Any]]:
        """Unique values of all combinations, without the keys of twins."""
        kinds: list[list[Any]] = []
        for values in self._combinations:
            others = _without_twin(values)
            if others not in kinds:
                kinds.append(others)
        return kinds

    def _draw(
        self, patient: int, of_recording: bool, *key: int, only: Sequence[str] | None = None
    ) -> dict[str, Any]:
        """Values of the slots of a patient or of one of the patient's recordings.

        Args:
            patient: Index of the patient.
            of_recording: Whether to draw the slots of the recording.
            key: Distinguishes recordings of the patient.
            only: Paths of the required slots; None draws all. The splits require draws for a whole
                cohort, and most slots do not affect them.
        """
        seed = self.plan.settings.seed
        wanted = self.slots if only is None or "lesions" in only else only
        drawn = {
            path: slot.draw(rng.stream(seed, f"data/slot/{path}", patient, *key))
            for path, slot in self.slots.items()
            if not isinstance(slot, Each) and _is_patients(path) != of_recording and path in wanted
        }
        if "lesions" in drawn and isinstance(self.slots["lesions"], Prevalence):
            drawn["lesions"] = drawn["lesions"] if self._has_colon(drawn) else []
        return drawn

    def _has_colon(self, drawn: Mapping[str, Any]) -> bool:
        organ = _filled(self.plan.scenario.get("organ", {}), drawn, "organ")
        name = organ if isinstance(organ, str) else organ.get("name", OrganGenerated.name)
        return name not in ORGANS or "sigmoid" in organ_segments(name)

    def _number(self, purpose: str, *key: int) -> int:
        stream = rng.stream(self.plan.settings.seed, f"data/number/{purpose}", *key)
        return int(stream.integers(_SEEDS))


def _without_twin(values: Mapping[str, Any]) -> list[Any]:
    """Chosen values without the keys of twins."""
    return [value for path, value in values.items() if path != _TWIN]


def _is_patients(path: str) -> bool:
    return path.split(".", maxsplit=1)[0] in PATIENT_SLOTS


def _spread(order: Sequence[int], fractions: Sequence[float]) -> tuple[str, ...]:
    """Splits of ordered patients such that any consecutive ones have about the given fractions.

    Each patient goes to the split with the largest deficit.
    """
    counts, split = [0.0] * len(fractions), [""] * len(order)
    for position, patient in enumerate(order):
        lacks = [f * (position + 1) - n for f, n in zip(fractions, counts, strict=True)]
        chosen = max(range(len(lacks)), key=lambda k: (lacks[k], fractions[k]))
        counts[chosen] += 1.0
        split[patient] = SPLITS[chosen]
    return tuple(split)


def _at(plain: Any, path: str) -> Any:
    """Value of a plain tree at a path; None if there is none."""
    for name in path.split("."):
        if isinstance(plain, Mapping):
            plain = plain.get(name)
        elif isinstance(plain, list) and name.isdigit() and int(name) < len(plain):
            plain = plain[int(name)]
        else:
            return None
    return plain


def _filled(plain: Any, drawn: Mapping[str, Any], path: str = "") -> Any:
    """Copy of a plain tree with distributions replaced by values."""
    if path in drawn:
        return drawn[path]
    if isinstance(plain, Mapping):
        return {
            key: _filled(value, drawn, f"{path}.{key}" if path else str(key))
            for key, value in plain.items()
        }
    if isinstance(plain, list):
        items = [(f"{path}.{index}", value) for index, value in enumerate(plain)]
        kept = [item for item in items if drawn.get(f"{item[0]}.{PROBABILITY}", True)]
        filled = [_filled(value, drawn, where) for where, value in kept]
        return [_without_probability(value) for value in filled]
    return plain


def _without_probability(plain: Any) -> Any:
    if not isinstance(plain, Mapping):
        return plain
    return {key: value for key, value in plain.items() if key != PROBABILITY}


def check_plan(units: Units) -> None:
    """Build a scenario for each extreme of each distribution, otherwise equal to the first unit.

    The extremes of numeric distributions are their limits, those of names all names.

    Raises:
        InputError: If a scenario is invalid, or names a capsule or a patient's value that does not
            exist.
    """
    _check_stratify(units)
    _check_capsule(units[0].scenario, "The plan")
    for path, slot in units.slots.items():
        for value in slot.extremes():
            where = f"{path} = {value!r} of the plan"
            try:
                scenario = units.scenario(0, {path: value})
            except VrcapsError as error:
                raise InputError(f"{where}: {error}") from error
            if path.startswith("capsule"):
                _check_capsule(scenario, where)


def _check_capsule(scenario: Scenario, where: str) -> None:
    try:
        _ = scenario.device
    except VrcapsError as error:
        raise InputError(f"{where}: {error}") from error


def _check_stratify(units: Units) -> None:
    """Check that each path exists; an invalid one would silently group all patients together."""
    plan = units.plan
    for path in plan.settings.stratify:
        value = plan.scenario
        for name in path.split("."):
            if path in units.slots or not isinstance(value, Mapping):
                break
            if name not in value:
                own = sorted(slot for slot in units.slots if slot.startswith(("organ", "lesions")))
                raise InputError(
                    f"dataset.stratify names {path}, which the plan does not have. Allowed: values "
                    f"of the patient that it draws: {', '.join(own) or 'none'}."
                )
            value = value[name]
