"""Registry of lesions by name: the library, and lesions as short texts."""

from __future__ import annotations

from dataclasses import fields
from typing import Any

from vrcaps.core.errors import InputError, UnknownNameError
from vrcaps.lesion.base import LESIONS, Lesion, Location
from vrcaps.lesion.settings import settings_of


def lesion_library() -> dict[str, Lesion]:
    """Named lesions of all kinds: those of the VR-Caps paper.

    Names are polyp-<shape>-<pattern>, colitis-<Mayo>-<01 to 20> and bleeding-<severity>-<01 to 10>.
    """
    return {name: lesion for cls in LESIONS.values() for name, lesion in cls.library().items()}


def parse_lesion(text: str) -> Lesion:
    """Parse a lesion from a short text.

    The text is a name, then all non-default values: ``polyp-Ip``, ``colitis-2``,
    ``ulcer-deep:size=15mm``, ``polyp-Is-villous:segment=sigmoid,theta=90deg``,
    ``bleeding-3:arc_length=80cm``. The name is a kind, with its grade after a hyphen, or one
    of `lesion_library`. Lengths have a unit.

    Raises:
        InputError: If a value cannot be read or is out of range.
        UnknownNameError: If there is no such lesion or key.
    """
    name, _, rest = text.strip().partition(":")
    cls, values = _named(name.strip())
    own, general = settings_of(cls), settings_of(Location)
    location: dict[str, Any] = {}
    for item in filter(None, (part.strip() for part in rest.split(","))):
        key, equals, value = (part.strip() for part in item.partition("="))
        if not equals or not value:
            raise InputError(f"{item!r} in lesion {text!r}. Allowed: key=value, such as size=8mm.")
        if key in own:
            values[key] = own[key].parse(value)
        elif key in general:
            location[key] = general[key].parse(value)
        else:
            raise UnknownNameError(f"setting of {cls.kind}", key, [*own, *general])
    return cls(**values, location=Location(**location))


def _named(name: str) -> tuple[type[Lesion], dict[str, Any]]:
    """Kind and values of a name."""
    kind, _, grade = name.partition("-")
    if kind not in LESIONS:
        raise UnknownNameError("lesion", name, [*LESIONS, *_first_names()])
    cls = LESIONS[kind]
    library = cls.library()
    if name in library:
        found = library[name]
        return cls, {f.name: getattr(found, f.name) for f in fields(found) if f.name != "location"}
    if not grade:
        return cls, {}
    if not cls.grade_field:
        raise InputError(f"Lesion {name!r}: {kind} has no grades. Write {kind!r}.")
    setting = settings_of(cls)[cls.grade_field]
    if grade not in map(str, setting.words):
        known = [f"{kind}-{word}" for word in setting.words]
        ends = [f"{next(iter(library))} to {[*library][-1]}"] if library else []
        raise UnknownNameError("lesion", name, [*known, *ends])
    return cls, {cls.grade_field: setting.parse(grade)}


def _first_names() -> list[str]:
    """First library name of each kind, for messages."""
    return [next(iter(cls.library())) for cls in LESIONS.values() if cls.library()]


def describe_kind(cls: type[Lesion]) -> tuple[str, str]:
    """Grades and settings of a kind as Markdown text, for the command line and the docs."""
    settings = settings_of(cls)
    grades = ", ".join(
        " ".join(filter(None, (f"`{word}`", cls.grade_meanings.get(str(word), ""))))
        for word in (settings[cls.grade_field].words if cls.grade_field else ())
    )
    parts = [
        f"`{name}` {allowed}"
        for name, setting in settings.items()
        if name not in (cls.grade_field, "variant")
        and (allowed := cls.notes.get(name, setting.allowed))
    ]
    if "" in cls.notes:
        parts.append(cls.notes[""])
    return " ".join(filter(None, (cls.grade_scale, grades))), "; ".join(parts)
