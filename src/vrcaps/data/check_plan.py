"""Check of a plan before anything is made: every value that it may draw is valid in a scenario.

Otherwise a wrong name among many would only fail in the recordings that happen to draw it.
"""

from __future__ import annotations

from collections.abc import Mapping

from vrcaps.capsule.device_file import device_of
from vrcaps.core.errors import InputError, VrcapsError
from vrcaps.data.units import Units
from vrcaps.scenario.scenario import Scenario


def check_plan(units: Units) -> None:
    """Build the scenario of each extreme of each distribution, all else as in the first unit.

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
        device_of(scenario.capsule)
    except VrcapsError as error:
        raise InputError(f"{where}: {error}") from error


def _check_stratify(units: Units) -> None:
    """Check that each path exists; an invalid one would silently group all patients together."""
    plan = units.plan
    for path in plan.settings.stratify:
        found = plan.scenario
        for name in path.split("."):
            if path in units.slots or not isinstance(found, Mapping):
                break
            if name not in found:
                own = sorted(slot for slot in units.slots if slot.startswith(("organ", "lesions")))
                raise InputError(
                    f"dataset.stratify names {path}, which the plan does not have. Allowed: values "
                    f"of the patient that it draws: {', '.join(own) or 'none'}."
                )
            found = found[name]
