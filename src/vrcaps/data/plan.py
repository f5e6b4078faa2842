"""Plan of a data set: a scenario in which distributions may replace values.

A plan is a scenario file with an additional table ``[dataset]``; the scenario may also be in a
table ``[scenario]``. A distribution may replace any other value. Values under ``organ`` and
``lesions`` are drawn once per patient, all others once per recording.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, fields
from pathlib import Path
from typing import Annotated, Any

from vrcaps.config.convert import from_plain, to_plain
from vrcaps.config.plain_files import as_floats, read_plain
from vrcaps.core.errors import InputError, UnknownNameError
from vrcaps.core.fields import Range, check_fields
from vrcaps.core.names import require_name
from vrcaps.core.rng import MAX_SEED
from vrcaps.data.distribution import slots

PATIENT_SLOTS = ("organ", "lesions")
"""Keys of a scenario that belong to the patient."""

LICENSES = (
    *("apache-2.0", "bsd-3-clause", "cc0-1.0", "cc-by-4.0", "cc-by-nc-4.0", "cc-by-nc-nd-4.0"),
    *("cc-by-nc-sa-4.0", "cc-by-nd-4.0", "cc-by-sa-4.0", "cdla-permissive-2.0", "mit", "odbl"),
    *("odc-by", "other", "pddl", "unknown"),
)
"""License identifiers of the Hugging Face Hub."""


@dataclass(frozen=True)
class Split:
    """Fractions of patients per split; they add up to 1.

    Attributes:
        train: Fraction of the training set.
        val: Fraction of the validation set.
        test: Fraction of the test set.
    """

    train: Annotated[float, Range(0.0, 1.0)] = 0.7
    val: Annotated[float, Range(0.0, 1.0)] = 0.15
    test: Annotated[float, Range(0.0, 1.0)] = 0.15

    def __post_init__(self) -> None:
        check_fields(self)
        total = self.train + self.val + self.test
        if abs(total - 1.0) > 1e-6:
            parts = ", ".join(f"{f.name} {getattr(self, f.name):g}" for f in fields(self))
            default = ", ".join(f"{f.name} {f.default:g}" for f in fields(self))
            raise InputError(
                f"split adds up to {total:g}: {parts}. Allowed: 1; an omitted part has its "
                f"default: {default}."
            )


@dataclass(frozen=True)
class DatasetSettings:
    """Table ``[dataset]`` of a plan.

    Attributes:
        name: Name of the data set, for its data card.
        seed: Random seed.
        patients: Number of patients.
        repeats: Recordings of each patient with each combination of `each`.
        split: Fractions of the patients.
        stratify: Paths of scenario values that are balanced over the splits.
        license: License of the data set, such as ``cc-by-4.0``, for its data card. `unknown` grants
            nothing; `other` is explained in the description.
        description: Purpose of the data set, for its data card.
    """

    name: str
    seed: Annotated[int, Range(0, MAX_SEED)] = 0
    patients: Annotated[int, Range(min=1, max=10**6)] = 1
    repeats: Annotated[int, Range(min=1, max=10**6)] = 1
    split: Split = field(default_factory=Split)
    stratify: tuple[str, ...] = ()
    license: str = "unknown"
    description: str = ""

    def __post_init__(self) -> None:
        check_fields(self)
        if not self.name.strip():
            raise InputError("name is empty. Allowed: a name for the data set.")
        require_name("data set", self.name)
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
    """Parsed plan.

    Attributes:
        settings: Settings of the data set.
        scenario: Scenario as plain values, with distributions.
        has_units: Whether its devices have keys with the units of device files.
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
            f"{path} has no table [dataset], which a plan requires, with name and patients. To "
            "record a single scenario, use vrcaps record."
        )
    settings = from_plain(DatasetSettings, plain["dataset"], at=f"{path}: dataset")
    scenario = _scenario_of(plain, path)
    try:
        list(slots(scenario))
    except InputError as error:
        raise InputError(f"{path}: {error}") from error
    return Plan(settings, scenario, has_units=path.suffix == ".toml")


def _scenario_of(plain: Mapping[str, Any], path: Path) -> dict[str, Any]:
    """Scenario of a plan: all tables except [dataset]; it may be in [scenario].

    Raises:
        InputError: If a key is in both places.
    """
    outer = {key: value for key, value in plain.items() if key not in ("dataset", "scenario")}
    inner = plain.get("scenario", {})
    if not isinstance(inner, dict):
        raise InputError(f"{path}: scenario is {inner!r}. Allowed: a table [scenario], or none.")
    twice = sorted(outer.keys() & inner.keys())
    if twice:
        raise InputError(f"{path} has {twice[0]} both in [scenario] and outside it. Allowed: once.")
    return {**outer, **inner}


def plan_to_plain(plan: Plan) -> dict[str, Any]:
    """Plan in JSON form."""
    scenario = as_floats(dict(plan.scenario))
    return {
        "dataset": to_plain(plan.settings, DatasetSettings),
        "scenario": scenario,
        "units": plan.has_units,
    }


def plan_from_plain(plain: Mapping[str, Any], *, at: str) -> Plan:
    """Inverse of `plan_to_plain`.

    Args:
        plain: Plan in JSON form.
        at: Source of the plan, for messages.

    Raises:
        InputError: If it is not a plan.
    """
    if not isinstance(plain.get("scenario"), dict):
        raise InputError(f"{at} is not a plan of a data set: it has no scenario.")
    settings = from_plain(DatasetSettings, plain.get("dataset"), at=f"{at}: dataset")
    return Plan(settings, plain["scenario"], has_units=bool(plain.get("units")))
