"""Effects as a user writes them: `dof=2,noise=1..3`, `random`, `all=2`."""

from __future__ import annotations

from typing import Any

from vrcaps.camera_pipeline.effect.base import MAX_SEVERITY, Effect
from vrcaps.camera_pipeline.effects import EFFECTS, SEVERITIES, Effects
from vrcaps.errors import UnknownNameError

SHORT_NAMES = {kind.short: name for name, kind in EFFECTS.items() if kind.short}
"""Short names of effects."""

_ALL, _RANDOM = "all", "random"


class _All(Effect):
    """Every effect that has severities, as `all=SEVERITY` names it."""

    name = _ALL


def parse_effects(text: str) -> Effects:
    """Effects from a text such as `specular=3,dof=1`.

    Items are separated by commas, and a later one overrides an earlier: `NAME=SEVERITY`,
    `NAME=FIRST..LAST` to sample a severity, `all=SEVERITY` for every effect, `random` for
    `all=0..4`; `bayer=rggb`, and `afr=MIN..MAX` in frames a second.

    Raises:
        UnknownNameError: If there is no such effect.
        InputError: If an item or a severity cannot be.
    """
    chosen: dict[str, Any] = {}
    for item in (part.strip() for part in text.split(",")):
        name, equals, value = item.partition("=")
        name, value = name.strip().replace("-", "_"), value.strip()
        name = SHORT_NAMES.get(name, name)
        if name == _RANDOM and not equals:
            chosen |= dict.fromkeys(SEVERITIES, (0, MAX_SEVERITY))
        elif name == _ALL:
            chosen |= dict.fromkeys(SEVERITIES, _All.parse(value))
        elif name in EFFECTS:
            chosen[name] = EFFECTS[name].parse(value)
        else:
            raise UnknownNameError("effect", name, (*EFFECTS, *SHORT_NAMES, _ALL, _RANDOM))
    return Effects(**chosen)
