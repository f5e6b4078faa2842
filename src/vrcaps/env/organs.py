"""Organs of an environment: parsed from texts, and checked before any is created."""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator
from dataclasses import replace
from typing import TYPE_CHECKING

from vrcaps.anatomy.catalog import ORGANS
from vrcaps.core.errors import InputError, UnknownNameError, require
from vrcaps.organ.surface import OrganSurface
from vrcaps.scenario.scenario import OrganFile, OrganGenerated, Scenario, organ_named

if TYPE_CHECKING:
    from vrcaps.env.settings import EnvSettings

Organ = OrganGenerated | OrganFile | OrganSurface | str
"""An organ, or a text in the syntax of `parse_organs`."""

_SEEDS = re.compile(r"(\d{1,9})(?:-(\d{1,9}))?")
_MAX_SEEDS = 100_000


def organs_of(given: Iterable[Organ]) -> Iterator[OrganGenerated | OrganFile | OrganSurface]:
    """Yield the given organs; a text may name several.

    Raises:
        InputError: If a text cannot be parsed.
    """
    for organ in given:
        if isinstance(organ, str):
            yield from parse_organs(organ)
        else:
            yield organ


def parse_organs(text: str) -> list[OrganGenerated | OrganFile]:
    """Parse a text such as ``stomach``, ``stomach:3``, ``stomach:0-15`` or ``mine.ply:mm``.

    Raises:
        InputError: If the part after the colon is neither a seed or seeds, nor a unit of a mesh.
    """
    name, _, rest = text.rpartition(":") if ":" in text else (text, "", "")
    organ = organ_named(name)
    if not rest:
        return [organ]
    if isinstance(organ, OrganFile):
        return [replace(organ, unit=rest)]
    seeds = _SEEDS.fullmatch(rest)
    if seeds is None:
        raise InputError(f"The organ is {text!r}. Allowed: NAME:SEED, NAME:FIRST-LAST, FILE:UNIT.")
    first, last = int(seeds[1]), int(seeds[2] or seeds[1])
    if first > last:
        raise InputError(
            f"The organ is {text!r}. Allowed: rising seeds, such as {name}:{last}-{first}."
        )
    require(last - first < _MAX_SEEDS, "The number of seeds", last - first + 1, "up to 100,000")
    return [OrganGenerated(name, seed=seed) for seed in range(first, last + 1)]


def check_names(settings: EnvSettings) -> None:
    """Check that the organs and the capsule named in settings exist; nothing is created.

    Raises:
        InputError: If an organ's file or unit is missing, or a device file.
        UnknownNameError: If there is no organ or no capsule of a name.
    """
    from vrcaps.scenario.build import resolve

    checked: list[OrganGenerated] = []
    for organ in settings.organs:
        if isinstance(organ, OrganGenerated):
            if organ.name not in ORGANS:
                raise UnknownNameError("organ", organ.name, ORGANS)
            patient = replace(organ, seed=0)  # thousands of patients may differ by the seed alone
            if patient in checked:
                continue
            checked.append(patient)
        resolve(Scenario(organ=organ, capsule=settings.capsule))
