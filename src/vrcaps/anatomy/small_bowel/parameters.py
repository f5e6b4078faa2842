"""Small bowel parameters: dimensions of a generated one and their variation between patients."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Annotated

from vrcaps.core.fields import Range, check_fields
from vrcaps.core.rng import truncated_normal
from vrcaps.core.units import CM, MM
from vrcaps.organ.segments import SMALL_BOWEL, at_distension

if TYPE_CHECKING:
    import numpy as np

SEGMENTS = SMALL_BOWEL.labels
"""Segments from the oral to the anal end."""

BULB_LENGTH = 4.5 * CM
"""Length of the smooth first part of the duodenum [m]."""


@dataclass(frozen=True)
class SmallBowelParameters:
    """Dimensions of a patient's small bowel; the defaults are the mean adult.

    The length in vivo is 3 to 4 m, of which 25 cm are duodenum; by convention two fifths of the
    rest are jejunum (Steinbrück et al., Atlas of Video Capsule Endoscopy, 2014). Diameters, fold
    thickness and number of folds are those of 65 adults at MR enterography (Cronin et al. 2010,
    Eur J Radiol): duodenum 24.8 ± 4.5 mm, jejunum 24.5 ± 4.2, proximal ileum 19.5 ± 3.6,
    distal ileum 18.9 ± 4.2, terminal ileum 18.7 ± 3.6 mm; 4.6 folds per 2.5 cm in the jejunum,
    1.5 in the terminal ileum, 2.1 mm thick in the duodenum and 1.8 mm in the terminal ileum.
    Fold heights and contractions are estimated from endoscopy images, not from a measured series.

    Attributes:
        length: Length from the pylorus to the ileocaecal valve [m].
        duodenum_length: Length of the duodenum, including the bulb [m].
        jejunum_fraction: Fraction of jejunum in the length beyond the duodenum.
        duodenum_diameter: Diameter of the lumen between folds [m].
        jejunum_diameter: Diameter of the lumen between folds [m].
        proximal_ileum_diameter: Diameter of the lumen between folds [m].
        distal_ileum_diameter: Diameter of the lumen between folds [m].
        terminal_ileum_diameter: Diameter of the lumen between folds [m].
        jejunum_folds: Circular folds per meter in duodenum and jejunum.
        terminal_folds: Circular folds per meter in the terminal ileum; falls linearly to there.
        jejunum_fold_height: Height of the circular folds in duodenum and jejunum [m].
        terminal_fold_height: Height of the circular folds in the terminal ileum [m].
        fold_thickness: Full width at half height in the duodenum [m]; 0.3 mm less at the end.
        contraction_spacing: Mean distance between contractions [m].
        contraction_depth: Fraction of the radius taken by a contraction.
        longitudinal_fold_depth: Depth of the longitudinal folds of the slack wall, as a fraction of
            the radius.
        slack_fold_height: Height of the folds into which a wall without gas or fluid buckles
            [m].
        closed_radius: Mean radius to which the slack wall closes the lumen next to the
            capsule [m], see `vrcaps.world.wall_displacement`; 0 leaves it open.
        pockets: Fraction of the length in which pockets of gas or fluid keep a closed lumen open.
        min_radius: Minimum radius of the lumen between folds and contractions [m].
        roughness: Standard deviation of the smooth irregularity of the wall [m].
        edge: Mean edge length of the triangles in a lumen of 24.5 mm, less in narrower ones [m].
    """

    length: Annotated[float, Range(1.5, 5.0, unit="m")] = 3.5
    duodenum_length: Annotated[float, Range(0.18, 0.35, unit="m")] = 25 * CM
    jejunum_fraction: Annotated[float, Range(0.2, 0.6)] = 0.4
    duodenum_diameter: Annotated[float, Range(6 * MM, 42 * MM, unit="m")] = 24.8 * MM
    jejunum_diameter: Annotated[float, Range(6 * MM, 42 * MM, unit="m")] = 24.5 * MM
    proximal_ileum_diameter: Annotated[float, Range(6 * MM, 42 * MM, unit="m")] = 19.5 * MM
    distal_ileum_diameter: Annotated[float, Range(6 * MM, 42 * MM, unit="m")] = 18.9 * MM
    terminal_ileum_diameter: Annotated[float, Range(6 * MM, 42 * MM, unit="m")] = 18.7 * MM
    jejunum_folds: Annotated[float, Range(20.0, 260.0, unit="1/m")] = 4.6 / (2.5 * CM)
    terminal_folds: Annotated[float, Range(10.0, 260.0, unit="1/m")] = 1.5 / (2.5 * CM)
    jejunum_fold_height: Annotated[float, Range(0.0, 8 * MM, unit="m")] = 4.6 * MM
    terminal_fold_height: Annotated[float, Range(0.0, 8 * MM, unit="m")] = 1.2 * MM
    fold_thickness: Annotated[float, Range(1 * MM, 4 * MM, unit="m")] = 2.1 * MM
    contraction_spacing: Annotated[float, Range(3 * CM, 2.0, unit="m")] = 11 * CM
    contraction_depth: Annotated[float, Range(0.0, 0.6)] = 0.42
    longitudinal_fold_depth: Annotated[float, Range(0.0, 0.5)] = 0.05
    slack_fold_height: Annotated[float, Range(0.0, 6 * MM, unit="m")] = 0.0
    closed_radius: Annotated[float, Range(0.0, 5 * MM, unit="m")] = 0.0
    pockets: Annotated[float, Range(min=0.0, below=1.0)] = 0.0
    min_radius: Annotated[float, Range(1 * MM, 8 * MM, unit="m")] = 4.6 * MM
    roughness: Annotated[float, Range(0.0, 1 * MM, unit="m")] = 0.22 * MM
    edge: Annotated[float, Range(0.6 * MM, 5 * MM, unit="m")] = 1.75 * MM

    def __post_init__(self) -> None:
        """Check the assumptions of the construction."""
        check_fields(self)

    @classmethod
    def draw(cls, rng: np.random.Generator) -> SmallBowelParameters:
        """Draw a small bowel from the population at MR enterography.

        The length is 3.5 ± 0.25 m, so that 95 % have 3 to 4 m. Diameters have the published
        deviations, with nine tenths of the variance shared by all parts of a patient. Folds vary by
        a tenth.
        """
        mean, whole = cls(), truncated_normal(rng)
        diameters = {
            name: getattr(mean, name) + sd * (0.9**0.5 * whole + 0.1**0.5 * truncated_normal(rng))
            for name, sd in _DEVIATIONS.items()
        }
        varied = {
            name: getattr(mean, name) * (1.0 + 0.1 * truncated_normal(rng))
            for name in ("jejunum_folds", "jejunum_fold_height", "contraction_spacing")
        }
        # Folds are as high as the lumen permits.
        varied["jejunum_fold_height"] *= diameters["jejunum_diameter"] / mean.jejunum_diameter
        return cls(
            length=mean.length + 0.25 * truncated_normal(rng),
            duodenum_length=mean.duodenum_length * (1.0 + 0.06 * truncated_normal(rng)),
            **diameters,
            **varied,
        )

    def at(self, distension: str) -> SmallBowelParameters:
        """The same small bowel at another distension.

        Args:
            distension: One of `DISTENSIONS`.
        """
        factors = at_distension(DISTENSIONS, distension)
        scaled = {f: getattr(self, f) * factor for f, factor in factors.items() if f != "diameter"}
        for name in _DEVIATIONS:
            diameter = getattr(self, name)
            # Parts that are already narrow do not collapse further.
            least = min(diameter, _COLLAPSED)
            scaled[name] = max(diameter * factors.get("diameter", 1.0), least)
        return replace(self, **scaled | _DIMENSIONS.get(distension, {}))


_DEVIATIONS = {
    "duodenum_diameter": 4.5 * MM,
    "jejunum_diameter": 4.2 * MM,
    "proximal_ileum_diameter": 3.6 * MM,
    "distal_ileum_diameter": 4.2 * MM,
    "terminal_ileum_diameter": 3.6 * MM,
}

_COLLAPSED = 14 * MM

DISTENSIONS: dict[str, dict[str, float]] = {
    "inflated": {"diameter": 1.12, "contraction_depth": 0.3, "longitudinal_fold_depth": 0.0},
    "normal": {},
    "collapsed": {
        "diameter": 0.8,
        "jejunum_fold_height": 0.35,
        "terminal_fold_height": 0.5,
        "contraction_depth": 0.4,
        "edge": 0.72,
    },
}
"""Factors on the dimensions at MR enterography for each distension: with gas, a drink, or empty.

Triangles of collapsed walls, which touch the camera, are smaller to hide corners of fold crests.
"""

_DIMENSIONS: dict[str, dict[str, float]] = {
    "collapsed": {
        "slack_fold_height": 2.5 * MM,
        "closed_radius": 1.6 * MM,
        "pockets": 0.35,
        "min_radius": 2.2 * MM,
    },
}
"""Dimensions at a distension that do not scale with the patient's: a collapsed wall is slack, with
folds 2 to 3 mm thick in contact with each other, as in capsule frames of the fasting small bowel;
estimated from frames, not from a measured series."""
