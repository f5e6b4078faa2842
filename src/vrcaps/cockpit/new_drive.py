"""Changes of a scenario from one drive to the next, in the same page."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any

from vrcaps.camera_pipeline.effect.base import ImageEffect
from vrcaps.camera_pipeline.effects import EFFECTS, SEVERITIES
from vrcaps.capsule.catalog import device_names, device_of, read_device
from vrcaps.scenario.chosen_lesions import PREVALENCE, chosen_lesions
from vrcaps.scenario.scenario import OrganGenerated, organ_named

if TYPE_CHECKING:
    from vrcaps.scenario.scenario import Scenario

NO_LESIONS = "none"
"""Value of the lesion text that removes all lesions."""

CONTENTS = ("bubbles", "chyme", "liquid")
"""Lumen contents that can be set, by severity."""

LASTING_EFFECTS = tuple(name for name in SEVERITIES if not issubclass(EFFECTS[name], ImageEffect))
"""Effects that are fixed during a drive: those of the capsule's cameras, of the wall and of the
lumen contents. Image effects can change at any time."""


@dataclass(frozen=True)
class Choice:
    """Changes to a scenario; omitted values stay the same.

    Attributes:
        organ: Name of a generated organ, or a file.
        seed: Seed of the patient.
        lesions: Short texts separated by spaces, `prevalence` for as many as in a screening
            patient has, or `none`.
        capsule: Name in the catalog, or a device file.
        contents: Severities by name, see `CONTENTS`.
        effects: Severities by name, see `LASTING_EFFECTS`.
    """

    organ: str | None = None
    seed: int | None = None
    lesions: str = ""
    capsule: str | None = None
    contents: Mapping[str, int] = field(default_factory=dict)
    effects: Mapping[str, int] = field(default_factory=dict)


def magnetic_capsules() -> tuple[str, ...]:
    """Names of the catalog's capsules that can be steered by magnet."""
    return tuple(name for name in device_names() if read_device(name).magnets)


def chosen_scenario(scenario: Scenario, choice: Choice) -> Scenario:
    """Return the scenario of the next drive.

    Args:
        scenario: Scenario of the previous drive.
        choice: Changes to it.

    Raises:
        InputError: If a text or a device file cannot be read, or a value is invalid.
        UnknownNameError: If a name of a lesion, capsule or generator is unknown.
    """
    changed: dict[str, Any] = {"organ": _organ(scenario, choice)}
    contents: dict[str, Any] = dict(choice.contents)
    if choice.seed is not None:
        contents["seed"] = choice.seed
    changed["contents"] = replace(scenario.contents, **contents)
    changed["effects"] = replace(scenario.effects, **choice.effects)
    if choice.lesions.strip():
        changed["lesions"] = _lesions(choice.lesions, changed["organ"], scenario.seed)
    if choice.capsule is not None:
        changed["capsule"] = read_device(choice.capsule)
        before = device_of(scenario.capsule)
        if scenario.fps == before.frame_rate:
            changed["fps"] = None  # the capsule's own
        changed["effects"] = changed["effects"].without_device(before)
    return replace(scenario, **changed)


def _organ(scenario: Scenario, choice: Choice) -> Any:
    organ = scenario.organ if choice.organ is None else organ_named(choice.organ)
    if isinstance(organ, OrganGenerated):
        seed = getattr(scenario.organ, "seed", 0) if choice.seed is None else choice.seed
        return replace(organ, seed=seed)
    return organ


def _lesions(text: str, organ: Any, seed: int) -> tuple[Any, ...]:
    words = text.split()
    if words == [NO_LESIONS]:
        return ()
    table = PREVALENCE if PREVALENCE in words else None
    is_generated = isinstance(organ, OrganGenerated)
    seed, name = (organ.seed, organ.name) if is_generated else (seed, "")
    return chosen_lesions([word for word in words if word != PREVALENCE], table, seed, name)
