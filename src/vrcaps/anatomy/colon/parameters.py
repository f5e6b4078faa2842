"""Colon parameters: dimensions of a generated colon and their variation between patients."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Annotated

from vrcaps.core.errors import require
from vrcaps.core.fields import Range, check_fields
from vrcaps.core.rng import truncated_normal
from vrcaps.core.units import CM, MM
from vrcaps.organ.segments import COLON

if TYPE_CHECKING:
    import numpy as np

SEGMENTS = COLON.labels
"""Segments from the oral to the anal end."""


@dataclass(frozen=True)
class ColonSegment:
    """Segment of the colon.

    Attributes:
        length: Length along the centerline [m].
        diameter: Diameter of the distended lumen between the folds [m].
        haustra_spacing: Mean distance from fold to fold in one of the three strips between
            the taeniae [m].
        fold_height: Mean height of the semilunar folds above the wall [m]; 0 for none.
        triangularity: Flattening of the lumen between the taeniae as a fraction of its radius,
            0 for round.
    """

    length: Annotated[float, Range(0.03, 1.5, unit="m")]
    diameter: Annotated[float, Range(0.02, 0.09, unit="m")]
    haustra_spacing: Annotated[float, Range(min=0.01, unit="m")] = 30 * MM
    fold_height: Annotated[float, Range(0.0, 0.012, unit="m")] = 7 * MM
    triangularity: float = 0.05

    def __post_init__(self) -> None:
        """Check the assumptions of the construction."""
        check_fields(self)


@dataclass(frozen=True)
class ColonParameters:
    """Dimensions of a patient's colon; the defaults are the mean adult.

    The total length, 1.895 m, and the number of flexures are means of 505 adults at CT colonography
    (Khashab et al. 2009, Endoscopy 41:674). Its division keeps the proportions of the
    textbook lengths (Standring, Gray's Anatomy: caecum 6, ascending 15, transverse 50,
    descending 25, sigmoid 40, rectum 15 cm); the two flexures are taken from their neighbors.
    Diameters are within the radiological limits for the distended colon: caecum 9 cm,
    transverse 6 cm, descending and sigmoid 4 to 5 cm. Fold dimensions are estimated from CT
    colonography and endoscopy images, not from a measured series.

    Attributes:
        caecum: Blind pouch, up to the upper lip of the ileocaecal valve.
        ascending: Along the patient's right flank, upwards.
        hepatic_flexure: Bend under the liver.
        transverse: Hangs anteriorly across the abdomen; the most triangular lumen.
        splenic_flexure: Bend under the spleen, the highest point.
        descending: Along the patient's left flank, downwards.
        sigmoid: Loops from the left iliac fossa to the sacrum; tight folds.
        rectum: Along the sacrum to the anus; no haustra.
        flexures: Number of acute flexures, bends of the lumen by more than 90°.
        taenia_width: Width of each of the three muscle bands [m].
        taenia_depth: Height of a band above the wall, into the lumen [m].
        haustra_depth: Outward bulge of a sacculation as a fraction of the lumen's radius.
        fold_thickness: Full width of a fold at half its height [m].
        fold_irregularity: Relative standard deviation of the spacing and height of the folds.
        valve_height: Height of the three valves of Houston in the rectum [m].
        ileocaecal_height: Height of the lips of the ileocaecal valve above the wall [m].
        roughness: Standard deviation of the smooth irregularity of the wall [m].
        closing: Degree to which the slack wall closes between gas pockets: from 0, open, to 1, a
            star of pleats that nearly touch.
        triangles: Approximate number of triangles.
    """

    caecum: ColonSegment = ColonSegment(6.8 * CM, 6.6 * CM, 34 * MM, 8 * MM, 0.06)
    ascending: ColonSegment = ColonSegment(19.0 * CM, 5.6 * CM, 33 * MM, 9 * MM, 0.10)
    hepatic_flexure: ColonSegment = ColonSegment(8.0 * CM, 5.0 * CM, 30 * MM, 8 * MM, 0.10)
    transverse: ColonSegment = ColonSegment(54.5 * CM, 4.7 * CM, 29 * MM, 8 * MM, 0.16)
    splenic_flexure: ColonSegment = ColonSegment(8.0 * CM, 4.4 * CM, 28 * MM, 7 * MM, 0.10)
    descending: ColonSegment = ColonSegment(27.5 * CM, 4.2 * CM, 32 * MM, 5 * MM, 0.05)
    sigmoid: ColonSegment = ColonSegment(48.0 * CM, 4.0 * CM, 24 * MM, 6 * MM, 0.03)
    rectum: ColonSegment = ColonSegment(17.7 * CM, 4.8 * CM, 40 * MM, 0.0, 0.0)
    flexures: Annotated[int, Range(4, 20)] = 11
    taenia_width: Annotated[float, Range(0.0)] = 8 * MM
    taenia_depth: Annotated[float, Range(0.0)] = 1.5 * MM
    haustra_depth: Annotated[float, Range(0.0)] = 0.14
    fold_thickness: Annotated[float, Range(0.0)] = 5.0 * MM
    fold_irregularity: Annotated[float, Range(0.0)] = 0.25
    valve_height: Annotated[float, Range(0.0)] = 13 * MM
    ileocaecal_height: Annotated[float, Range(0.0)] = 11 * MM
    roughness: Annotated[float, Range(0.0)] = 0.35 * MM
    closing: Annotated[float, Range(0.0, 1.0)] = 0.0
    triangles: Annotated[int, Range(20_000, 5_000_000)] = 110_000

    def __post_init__(self) -> None:
        """Check the assumptions of the construction."""
        check_fields(self)
        require(0.9 <= self.length <= 3.0, "colon length", f"{self.length:g} m", "0.9 to 3 m")

    @property
    def segments(self) -> tuple[ColonSegment, ...]:
        """Segments from the oral to the anal end."""
        return tuple(getattr(self, name) for name in SEGMENTS)

    @property
    def length(self) -> float:
        """Total length along the centerline [m]."""
        return sum(segment.length for segment in self.segments)

    @classmethod
    def draw(cls, rng: np.random.Generator) -> ColonParameters:
        """Draw a patient from the adult population.

        Total length 1.895 ± 0.263 m and 10.9 ± 2.4 acute flexures, normally distributed (Khashab et
        al. 2009), truncated at 2.5 standard deviations. Their correlation is not published; 0.8 is
        assumed. The division and the diameters vary by 10 % and 6 %.
        """
        mean = cls()
        deviation = truncated_normal(rng, 2.3)
        length = 1.895 + 0.263 * deviation
        flexures = 10.9 + 2.4 * (0.8 * deviation + 0.6 * truncated_normal(rng, 2.3))
        fractions = {name: 1.0 + 0.10 * truncated_normal(rng, 2.3) for name in SEGMENTS}
        whole = sum(getattr(mean, name).length * fractions[name] for name in SEGMENTS)
        diameter = 1.0 + 0.06 * truncated_normal(rng, 2.3)
        drawn = {
            name: replace(
                getattr(mean, name),
                length=getattr(mean, name).length * fractions[name] * length / whole,
                diameter=getattr(mean, name).diameter
                * diameter
                * (1 + 0.03 * truncated_normal(rng, 2.3)),
                haustra_spacing=getattr(mean, name).haustra_spacing * rng.uniform(0.88, 1.12),
                fold_height=getattr(mean, name).fold_height * rng.uniform(0.85, 1.15),
            )
            for name in SEGMENTS
        }
        return cls(**drawn, flexures=max(round(flexures), 4))
