"""All kinds of lesions, the library of named ones, and lesions as short texts."""

from __future__ import annotations

from dataclasses import fields
from typing import Any, Literal, Union, get_args, get_origin, get_type_hints

from vrcaps.errors import InputError, UnknownNameError
from vrcaps.lesion.base import Lesion, Location
from vrcaps.lesion.bleeding import Bleeding
from vrcaps.lesion.colitis import Colitis
from vrcaps.lesion.polyp import PATTERNS, Polyp
from vrcaps.lesion.structural import Diverticulum, Stricture, Tumor
from vrcaps.lesion.ulcer import Erosion, Ulcer
from vrcaps.lesion.vascular import Angioectasia, Lymphangiectasia
from vrcaps.units import CM, DEG, MM, parse_length

AnyLesion = Union[
    *(Polyp, Colitis, Bleeding, Angioectasia, Erosion, Ulcer),
    *(Stricture, Diverticulum, Tumor, Lymphangiectasia),
]

LESIONS: dict[str, type[Lesion]] = {cls.kind: cls for cls in get_args(AnyLesion)}
"""Specifications by kind."""

_LENGTHS = {"size", "length", "spread", "arc_length"}


def _library() -> dict[str, Lesion]:
    """The named lesions of the VR-Caps paper: 20 polyps, 60 of colitis, 40 cases of bleeding."""
    sizes = {"Ip": 14.0, "Is": 9.0, "IIa": 11.0, "IIc": 10.0}
    named: dict[str, Lesion] = {}
    for shape, size in sizes.items():
        for number, pattern in enumerate(PATTERNS):
            named[f"polyp-{shape}-{pattern}"] = Polyp(
                shape=shape,  # type: ignore[arg-type]
                size=(size + number) * MM,
                pattern=pattern,  # type: ignore[arg-type]
                variant=number,
            )
    for mayo in (1, 2, 3):
        for number in range(1, 21):
            spread = (6.0 + 3.0 * ((7 * number) % 20)) * CM
            named[f"colitis-{mayo}-{number:02d}"] = Colitis(
                mayo=mayo, spread=spread, variant=number
            )
    for severity in (1, 2, 3, 4):
        for number in range(1, 11):
            named[f"bleeding-{severity}-{number:02d}"] = Bleeding(severity=severity, variant=number)
    return named


LIBRARY: dict[str, Lesion] = _library()
"""Named lesions: polyp-<shape>-<pattern>, colitis-<Mayo>-<01 to 20>, bleeding-<severity>-<01 to
10>."""

LIBRARY_SHORT = ("polyp-Ip-tubular", "colitis-1-01", "bleeding-1-01")
"""A name of each kind in the library, for messages."""


def parse_lesion(text: str) -> Lesion:
    """A lesion from a short text.

    A name, then whatever differs from its defaults: ``polyp-Ip``, ``colitis-2``,
    ``ulcer-deep:size=15mm``, ``polyp-Is-villous:segment=sigmoid,theta=90deg``,
    ``bleeding-3:arc_length=80cm``. The name is a kind, with its grade after a hyphen, or one
    of `LIBRARY`. Lengths have a unit.

    Raises:
        InputError: If a value cannot be read or is out of range.
        UnknownNameError: If there is no such lesion or key.
    """
    name, _, rest = text.strip().partition(":")
    cls, values = _named(name.strip())
    hints = get_type_hints(cls)
    known = [
        *(f.name for f in fields(cls) if f.name != "location"),
        *(f.name for f in fields(Location)),
    ]
    location: dict[str, Any] = {}
    for item in filter(None, (part.strip() for part in rest.split(","))):
        key, equals, value = (part.strip() for part in item.partition("="))
        if not equals or not value:
            raise InputError(f"{item!r} in lesion {text!r}. Allowed: key=value, such as size=8mm.")
        if key not in known:
            raise UnknownNameError(f"setting of {cls.kind}", key, known)
        target, hint = (
            (values, hints[key]) if key in hints else (location, get_type_hints(Location)[key])
        )
        target[key] = _value(key, value, hint)
    return cls(**values, location=Location(**location))


def _named(name: str) -> tuple[type[Lesion], dict[str, Any]]:
    """Kind and values that a name stands for."""
    if name in LIBRARY:
        found = LIBRARY[name]
        return type(found), {
            f.name: getattr(found, f.name) for f in fields(found) if f.name != "location"
        }
    kind, _, grade = name.partition("-")
    if kind not in LESIONS:
        raise UnknownNameError("lesion", name, [*LESIONS, *LIBRARY_SHORT])
    cls = LESIONS[kind]
    if not grade:
        return cls, {}
    if not cls.grade_field:
        raise InputError(f"Lesion {name!r}: {kind} has no grades. Write {kind!r}.")
    key = cls.grade_field
    words = [str(word) for word in get_args(get_type_hints(cls)[key])]
    if grade not in words:
        known = [f"{kind}-{word}" for word in words]
        raise UnknownNameError("lesion", name, [*known, *_library_range(kind)])
    return cls, {key: _value(key, grade, get_type_hints(cls)[key])}


def _library_range(kind: str) -> list[str]:
    """First to last name of a kind in the library."""
    names = [name for name in LIBRARY if name.startswith(f"{kind}-")]
    return [f"{names[0]} to {names[-1]}"] if names else []


def _value(key: str, text: str, hint: Any) -> Any:
    """A text as the type that its field has."""
    options = [hint, *get_args(hint)] if get_origin(hint) is not Literal else [hint]
    words = [word for part in options if get_origin(part) is Literal for word in get_args(part)]
    for word in words:
        if text == str(word):
            return word
    if key in _LENGTHS:
        try:
            return parse_length(text)
        except InputError:
            words.append("a length such as 8mm")
    if words:
        raise InputError(f"{key} is {text!r}. Allowed: {', '.join(map(str, words))}.")
    if hint is str or str in get_args(hint):
        return text
    scale, number = (DEG, text.removesuffix("deg")) if text.endswith("deg") else (1.0, text)
    try:
        return int(number) if hint is int else scale * float(number)
    except ValueError:
        raise InputError(f"{key} is {text!r}. Allowed: a number.") from None
