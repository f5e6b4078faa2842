"""Segments of the organs: the table of labels, mucosae and motilities; distensions.

An organ is declared here by its segments from the oral to the anal end. It provides the labels
of the generators, the mucosa and its factors of `bake_appearance`, and the motility presets of
the wall. Labels of CT segmentations (TotalSegmentator) that name a whole organ are also known.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Literal, TypeVar, get_args

from vrcaps.core.errors import InputError, UnknownNameError
from vrcaps.core.units import MM


@dataclass(frozen=True)
class Segment:
    """Part of an organ with uniform appearance and motility.

    Attributes:
        label: Name in `OrganSurface.label_names`.
        mucosa: Name in `vrcaps.mucosa.mucosa.MUCOSAE`.
        motility: Name in `vrcaps.tissue.motility.segment.MOTILITIES`.
        pits: Factor on the pits or villi of the mucosa.
        bile: Factor on the bile.
        vessels: Factor on the vessels.
        villi: Mean length of villi that stands out over their neighbors [m], 0 for none.
    """

    label: str
    mucosa: str
    motility: str
    pits: float = 1.0
    bile: float = 1.0
    vessels: float = 1.0
    villi: float = 0.0


@dataclass(frozen=True)
class OrganSegments:
    """An organ and its segments.

    Attributes:
        name: Name in messages, flags and keys.
        segments: Segments from the oral to the anal end.
        fractions: Fractions of its length by segment, for a wall with a single label.
    """

    name: str
    segments: tuple[Segment, ...]
    fractions: Mapping[str, float] = field(default_factory=dict)

    @property
    def label(self) -> str:
        """Label of a wall that is not divided into segments."""
        return self.name.replace("-", "_")

    @property
    def labels(self) -> tuple[str, ...]:
        """Labels of the segments."""
        return tuple(segment.label for segment in self.segments)

    @property
    def mucosa(self) -> str:
        """Mucosa of the first segment."""
        return self.segments[0].mucosa


ORGANS: dict[str, OrganSegments] = {}
"""Organs by name."""


def declare_organ(organ: OrganSegments) -> OrganSegments:
    """Add an organ to `ORGANS`."""
    ORGANS[organ.name] = organ
    return organ


def organ_segments(name: str) -> tuple[str, ...]:
    """Names of the segments of a generated organ, in order from its oral end.

    Raises:
        UnknownNameError: If there is no such organ.
    """
    if name not in ORGANS:
        raise UnknownNameError("organ", name, ORGANS)
    return ORGANS[name].labels


def find_segment(label: str) -> Segment | None:
    """Declared segment with a label, or None."""
    segments = (segment for organ in ORGANS.values() for segment in organ.segments)
    return next((segment for segment in segments if segment.label == label), None)


def find_mucosa(label: str) -> str | None:
    """Mucosa of a segment, or of an organ with one mucosa for all segments; None if unknown."""
    if (segment := find_segment(label)) is not None:
        return segment.mucosa
    organ = next((organ for organ in ORGANS.values() if organ.label == label), None)
    if organ is None or any(s.mucosa != organ.mucosa for s in organ.segments):
        return None
    return organ.mucosa


STOMACH = declare_organ(
    OrganSegments(
        "stomach",
        (
            Segment("fundus", "stomach", "fundus", pits=0.7, vessels=1.2),
            Segment("cardia", "stomach", "fundus", pits=0.5, vessels=1.2),
            Segment("body", "stomach", "gastric-body", pits=1.2, bile=0.9),
            Segment("incisura", "stomach", "incisura"),
            Segment("antrum", "stomach", "antrum", pits=0.6, bile=1.3, vessels=0.6),
            Segment("pylorus", "stomach", "pylorus", pits=0.4, bile=1.6, vessels=0.4),
        ),
        {"fundus": 0.2, "body": 0.4, "antrum": 0.35, "pylorus": 0.05},
    )
)
"""Segments of the stomach; the cardia and the incisura are patches of wall."""

SMALL_BOWEL = declare_organ(
    OrganSegments(
        "small-bowel",
        (
            Segment("duodenal_bulb", "small-bowel", "duodenum", 0.6, 1.2, 0.8, 0.45 * MM),
            Segment("duodenum", "small-bowel", "duodenum", 1.0, 1.5, 0.3, 0.65 * MM),
            Segment("jejunum", "small-bowel", "jejunum", 1.1, 1.1, 0.4, 0.65 * MM),
            Segment("ileum", "small-bowel", "ileum", 0.6, 0.7, 1.3, 0.45 * MM),
        ),
        {"jejunum": 0.4, "ileum": 0.6},
    )
)
"""Villi are tall and bile is strong in duodenum and jejunum; in the ileum villi are short and
vessels are visible (Steinbrück et al., Atlas of Video Capsule Endoscopy, 2014, chapter 5).
They are 0.5 to 1 mm long, of which two thirds stand out at an outline (chosen by eye)."""

COLON = declare_organ(
    OrganSegments(
        "colon",
        tuple(
            Segment(label, "colon", "colon")
            for label in (
                "caecum",
                "ascending",
                "hepatic_flexure",
                "transverse",
                "splenic_flexure",
                "descending",
                "sigmoid",
                "rectum",
            )
        ),
    )
)

FULL_TRACT = declare_organ(
    OrganSegments("full-tract", (*STOMACH.segments, *SMALL_BOWEL.segments, *COLON.segments))
)
"""Stomach, small bowel and colon as one wall."""


Distension = Literal["inflated", "normal", "collapsed"]

DISTENSIONS: tuple[str, ...] = get_args(Distension)
"""Distensions of a generated organ."""

T = TypeVar("T")


def at_distension(values: Mapping[str, T], distension: str) -> T:
    """Return the value for a distension.

    Raises:
        InputError: If there is no such distension.
    """
    if distension not in values:
        raise InputError(f"Distension is {distension!r}. Allowed: {', '.join(values)}.")
    return values[distension]
