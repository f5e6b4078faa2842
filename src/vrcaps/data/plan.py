"""Plan of a data set: a scenario in which distributions may stand for values.

A plan is a scenario file with one more table, ``[dataset]``; the scenario may also lie below a
table ``[scenario]``. Anywhere else a distribution may stand in the place of a value. What lies
under ``organ`` and ``lesions`` is drawn once for each patient, everything else for each recording.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Any

from vrcaps.data.distribution import slots
from vrcaps.decimals import as_floats
from vrcaps.errors import InputError, UnknownNameError
from vrcaps.limits import Range, check_fields
from vrcaps.plain_files import read_plain
from vrcaps.serialization import from_plain, to_plain

PATIENT_SLOTS = ("organ", "lesions")
"""Keys of a scenario that belong to the patient."""

LICENSES = (
    *("apache-2.0", "bsd-3-clause", "cc0-1.0", "cc-by-4.0", "cc-by-nc-4.0", "cc-by-nc-nd-4.0"),
    *("cc-by-nc-sa-4.0", "cc-by-nd-4.0", "cc-by-sa-4.0", "cdla-permissive-2.0", "mit", "odbl"),
    *("odc-by", "other", "pddl", "unknown"),
)
"""Identifiers of licenses as the Hugging Face Hub calls them."""


@dataclass(frozen=True)
class Split:
    """Fractions of the patients; they add up to 1.

    Attributes:
        train: To learn from.
        val: To choose by.
        test: To judge by.
    """

    train: Annotated[float, Range(0.0, 1.0)] = 0.7
    val: Annotated[float, Range(0.0, 1.0)] = 0.15
    test: Annotated[float, Range(0.0, 1.0)] = 0.15

    def __post_init__(self) -> None:
        check_fields(self)
        total = self.train + self.val + self.test
        if abs(total - 1.0) > 1e-6:
            raise InputError(f"split adds up to {total:g}. Allowed: 1.")


@dataclass(frozen=True)
class DatasetSettings:
    """The table ``[dataset]`` of a plan.

    Attributes:
        name: Name of the data set, for its data card.
        seed: Of everything that is drawn.
        patients: Number of patients.
        repeats: Recordings of each patient with each combination of `each`.
        split: Fractions of the patients.
        stratify: Paths of a scenario whose values are spread evenly over the splits.
        license: Under which others may use it, such as ``cc-by-4.0``, for its data card. `unknown`
            grants nothing; `other` is said in the description.
        description: What it is for, for its data card.
    """

    name: str
    seed: Annotated[int, Range(least=0)] = 0
    patients: Annotated[int, Range(least=1, most=10**6)] = 1
    repeats: Annotated[int, Range(least=1, most=10**6)] = 1
    split: Split = field(default_factory=Split)
    stratify: tuple[str, ...] = ()
    license: str = "unknown"
    description: str = ""

    def __post_init__(self) -> None:
        check_fields(self)
        if not self.name.strip():
            raise InputError("name is empty. Allowed: a name for the data set.")
        if self.license not in LICENSES:
            raise UnknownNameError("license", self.license, LICENSES)
        for path in self.stratify:
            if path.split(".")[0] not in PATIENT_SLOTS:
                raise InputError(
                    f"stratify names {path}, which differs between recordings of a patient. "
                    f"Allowed: paths under {' or '.join(PATIENT_SLOTS)}."
                )


@dataclass(frozen=True)
class Plan:
    """A plan as read.

    Attributes:
        settings: What it says of the data set as a whole.
        scenario: Its scenario as plain values, with distributions.
        has_units: Whether devices in it have keys in the units of device files.
    """

    settings: DatasetSettings
    scenario: Mapping[str, Any]
    has_units: bool = False


def read_plan(path: str | Path) -> Plan:
    """Read a plan from a TOML or JSON file.

    Raises:
        InputError: If the file cannot be read, the table of the data set is missing or wrong, or a
            distribution is impossible.
    """
    path = Path(path)
    plain = read_plain(path, "plan")
    if not isinstance(plain, dict) or not isinstance(plain.get("dataset"), dict):
        raise InputError(
            f"{path} has no table [dataset]. A plan has one, with name and patients; to record a "
            "scenario without it: vrcaps record."
        )
    settings = from_plain(DatasetSettings, plain["dataset"], at=f"{path}: dataset")
    scenario = _scenario_of(plain, path)
    try:
        list(slots(scenario))
    except InputError as error:
        raise InputError(f"{path}: {error}") from error
    return Plan(settings, scenario, has_units=path.suffix == ".toml")


def _scenario_of(plain: Mapping[str, Any], path: Path) -> dict[str, Any]:
    """The scenario of a plan: its tables but for [dataset], which may lie below [scenario].

    Raises:
        InputError: If a key is in both places.
    """
    outer = {key: value for key, value in plain.items() if key not in ("dataset", "scenario")}
    inner = plain.get("scenario", {})
    if not isinstance(inner, dict):
        raise InputError(f"{path}: scenario is {inner!r}. Allowed: a table [scenario], or none.")
    twice = sorted(outer.keys() & inner.keys())
    if twice:
        raise InputError(f"{path} has {twice[0]} beside [scenario] and in it. Allowed: once.")
    return {**outer, **inner}


def plan_to_plain(plan: Plan) -> dict[str, Any]:
    """A plan as JSON holds it."""
    scenario = as_floats(dict(plan.scenario))
    return {
        "dataset": to_plain(plan.settings, DatasetSettings),
        "scenario": scenario,
        "units": plan.has_units,
    }


def plan_from_plain(plain: Mapping[str, Any], *, at: str) -> Plan:
    """The plan that `plan_to_plain` wrote.

    Args:
        plain: As JSON holds it.
        at: Where it was read, for messages.

    Raises:
        InputError: If it is no plan.
    """
    if not isinstance(plain.get("scenario"), dict):
        raise InputError(f"{at} is no plan of a data set: it has no scenario.")
    settings = from_plain(DatasetSettings, plain.get("dataset"), at=f"{at}: dataset")
    return Plan(settings, plain["scenario"], has_units=bool(plain.get("units")))
