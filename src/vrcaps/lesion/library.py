"""Lesions by name, parsed from strings, and drawn by prevalence."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, fields, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from vrcaps.core.errors import InputError, UnknownNameError
from vrcaps.core.units import MM
from vrcaps.lesion.base import LESIONS, Lesion, Location, settings_of

if TYPE_CHECKING:
    from vrcaps.organ.surface import OrganSurface


def lesion_library() -> dict[str, Lesion]:
    """Named lesions of all kinds: those of the VR-Caps paper.

    Names are polyp-<shape>-<pattern>, colitis-<Mayo>-<01 to 20> and bleeding-<severity>-<01 to 10>.
    """
    return {name: lesion for cls in LESIONS.values() for name, lesion in cls.library().items()}


def parse_lesion(text: str) -> Lesion:
    """Parse a lesion from a string.

    The string is a name, then all non-default values: ``polyp-Ip``, ``colitis-2``,
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
    """Kind and values of a named lesion."""
    words = name.split("-")
    kinds = ("-".join(words[:count]) for count in range(len(words), 0, -1))
    kind = next((kind for kind in kinds if kind in LESIONS), "")
    grade = name[len(kind) + 1 :]
    if not kind:
        raise UnknownNameError("lesion", name, [*LESIONS, *_first_names()])
    cls = LESIONS[kind]
    library = cls.library()
    if name in library:
        named = library[name]
        return cls, {f.name: getattr(named, f.name) for f in fields(named) if f.name != "location"}
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


@dataclass(frozen=True)
class Prevalence:
    """One row of a table.

    Attributes:
        lesion: Text for `parse_lesion`.
        mean: Mean number per patient (Poisson).
        sizes: Log-uniform range of its size [m]; None keeps the lesion's own.
        segments: Relative frequency by segment; empty for any position.
    """

    lesion: str
    mean: float
    sizes: tuple[float, float] | None = None
    segments: dict[str, float] = field(default_factory=dict)


_POLYP_SEGMENTS = {
    "caecum": 0.10,
    "ascending": 0.20,
    "transverse": 0.20,
    "descending": 0.12,
    "sigmoid": 0.26,
    "rectum": 0.12,
}

COLON_PREVALENCE: tuple[Prevalence, ...] = (
    *(
        Prevalence(f"polyp-{shape}:pattern={pattern}", mean, (low * MM, high * MM), _POLYP_SEGMENTS)
        for shape, pattern, mean, low, high in (
            ("Is", "hyperplastic", 0.45, 2, 5),
            ("Is", "tubular", 0.45, 3, 8),
            ("IIa", "tubular", 0.25, 4, 15),
            ("IIa", "serrated", 0.12, 5, 15),
            ("Ip", "tubular", 0.07, 8, 20),
            ("Is", "villous", 0.03, 10, 25),
            ("IIb", "hyperplastic", 0.05, 4, 8),
            ("IIc", "tubular", 0.02, 5, 12),
            ("Ip", "inflammatory", 0.02, 6, 15),
        )
    ),
    Prevalence("diverticulum", 1.5, (3 * MM, 9 * MM), {"sigmoid": 0.75, "descending": 0.25}),
    Prevalence("angioectasia", 0.03, (2 * MM, 8 * MM), {"caecum": 0.5, "ascending": 0.5}),
    Prevalence("tumor", 0.006, (15 * MM, 40 * MM), {"sigmoid": 0.5, "rectum": 0.3, "caecum": 0.2}),
    *(Prevalence(f"colitis-{k}:spread=E1", 0.004) for k in (1, 2, 3)),
    *(Prevalence(f"bleeding-{k}", 0.004) for k in (1, 2, 3, 4)),
    Prevalence("erosion", 0.05, (2 * MM, 6 * MM)),
    Prevalence("ulcer-aphthous", 0.02, (3 * MM, 6 * MM)),
    Prevalence("stricture", 0.003),
)
"""Screening population in round numbers, similar to those of colonoscopy trials (an adenoma
in one of three, a diverticulum in one of three, a cancer in 0.6 %). Supply your own for a study."""


def draw_lesions(
    organ: OrganSurface | None,
    rng: np.random.Generator,
    *,
    table: Sequence[Prevalence] = COLON_PREVALENCE,
    exaggerate: float = 1.0,
) -> tuple[Lesion, ...]:
    """Draw a patient's lesions; their position within the segments is left open.

    Args:
        organ: Organ with the segments; lesions of a missing segment may be anywhere. None uses the
            table's segments unchanged.
        rng: Draws kinds, numbers, sizes, segments.
        table: Frequency of each lesion.
        exaggerate: Factor on all means, to make rare disease more frequent.
    """
    names = None if organ is None else {organ.label_names[k] for k in np.unique(organ.label)}
    lesions: list[Lesion] = []
    for row in table:
        for _ in range(rng.poisson(row.mean * exaggerate)):
            lesion = parse_lesion(row.lesion)
            if row.sizes is not None:
                low, high = np.log(row.sizes)
                size = float(np.exp(rng.uniform(low, high)))
                lesion = replace(lesion, size=size)  # type: ignore[call-arg]
            segment = None
            if row.segments:
                weights = np.array(list(row.segments.values()))
                segment = list(row.segments)[rng.choice(len(weights), p=weights / weights.sum())]
            if names is not None and segment not in names:
                segment = None
            location = Location(segment=segment)
            lesions.append(replace(lesion, location=location, variant=int(rng.integers(1000))))
    return tuple(lesions)
