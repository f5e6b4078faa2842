"""Effects as a user writes them: `dof=2,noise=1..3`, `random`, `all=2`."""

from __future__ import annotations

import re
from typing import Any

from vrcaps.camera_pipeline.effects import Effects
from vrcaps.camera_pipeline.frame_rate import AdaptiveRate
from vrcaps.camera_pipeline.severities import GRADES, HIGHEST
from vrcaps.errors import InputError, UnknownNameError

SHORT = {
    "dof": "depth_of_field",
    "fov": "field_of_view",
    "ca": "chromatic",
    "blur": "motion_blur",
    "wb": "white_balance",
}
"""Short names of effects."""

_ALL, _RANDOM, _MOSAIC, _RATE = "all", "random", "mosaic", "frame_rate"
_GRADE = re.compile(r"(\d+)(?:\.\.(\d+))?")


def parse_effects(text: str) -> Effects:
    """Effects from a text such as `specular=3,dof=1`.

    Items are separated by commas, and a later one overrides an earlier: `NAME=GRADE`,
    `NAME=FIRST..LAST` to draw a grade, `all=GRADE` for every effect, `random` for `all=0..4`,
    `mosaic=rggb`, and `frame_rate=SLOW..FAST` in frames a second.

    Raises:
        UnknownNameError: If there is no such effect.
        InputError: If an item or a grade cannot be.
    """
    chosen: dict[str, Any] = {}
    for item in (part.strip() for part in text.split(",")):
        name, equals, value = item.partition("=")
        name = name.strip().replace("-", "_")
        name = SHORT.get(name, name)
        if name == _RANDOM and not equals:
            chosen |= dict.fromkeys(GRADES, (0, HIGHEST))
            continue
        if name not in GRADES and name not in (_ALL, _MOSAIC, _RATE):
            known = (*GRADES, *SHORT, _ALL, _MOSAIC, _RANDOM, _RATE)
            raise UnknownNameError("effect", name, known)
        if name == _MOSAIC:
            chosen[name] = value.strip()
        elif name == _RATE:
            chosen[name] = _rate(item, value)
        elif name == _ALL:
            chosen |= dict.fromkeys(GRADES, _grade(item, value))
        else:
            chosen[name] = _grade(item, value)
    return Effects(**chosen)


def _grade(item: str, value: str) -> int | tuple[int, int]:
    found = _GRADE.fullmatch(value.strip())
    if found is None:
        raise InputError(
            f"Effect {item!r} has no grade. Allowed: NAME=0 to NAME={HIGHEST}, or a range such as "
            f"NAME=0..{HIGHEST}."
        )
    first, last = found.groups()
    return int(first) if last is None else (int(first), int(last))


def _rate(item: str, value: str) -> AdaptiveRate:
    slow, dots, fast = value.partition("..")
    try:
        return AdaptiveRate(float(slow), float(fast if dots else slow))
    except ValueError as error:
        if isinstance(error, InputError):
            raise
        raise InputError(
            f"Effect {item!r} has no rates. Allowed: frame_rate=SLOW..FAST in frames a second, "
            "such as 2..6."
        ) from error
