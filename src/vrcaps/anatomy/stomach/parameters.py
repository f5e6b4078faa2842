"""Stomach parameters: every dimension of a generated stomach, and its variation over patients."""

from __future__ import annotations

from dataclasses import dataclass, fields, replace
from typing import TYPE_CHECKING, Annotated

from vrcaps.anatomy.distension import at_distension
from vrcaps.errors import require
from vrcaps.limits import Range, check_fields
from vrcaps.organ.segments import STOMACH
from vrcaps.rng import truncated_normal
from vrcaps.units import MM

if TYPE_CHECKING:
    import numpy as np

SEGMENTS = STOMACH.labels
"""Segments from the oral to the anal end; the cardia and the incisura are patches of wall."""


@dataclass(frozen=True)
class StomachParameters:
    """A patient's stomach, distended; the defaults are the mean adult.

    Textbooks give the distended stomach 1 to 1.5 l and its greater curvature 25 to 30 cm, which
    no J of that volume can have: here the greater curvature is 29 cm in the nearly empty stomach
    and grows to 40 cm at 1.1 l (`curvatures`). In 851 resected, fixed stomachs it was
    22.2 ± 3.1 cm, the lesser curvature 16.3 ± 2.6 cm (Seoul National University Hospital
    2008-2013, anthropometric reference for gastric cancer surgery): the spread of the drawn
    patients follows them. Folds and ring are read off endoscopy and barium images, not from a
    measured series; normal rugae are up to 5 mm thick when distended, thicker when not.

    Attributes:
        length: Along the axis from the top of the fundus to the pyloric ring [m].
        fundus_diameter: Of the fundus [m].
        body_diameter: Of the body at its widest [m].
        antrum_diameter: Of the antrum at its widest [m].
        pylorus_diameter: Of the open pyloric ring [m]; a capsule of 11 mm passes.
        flattening: How much less deep than wide the section is, 0 for round.
        cardia_distance: Along the axis from the top of the fundus to the cardia [m].
        incisura_depth: How far the angular notch stands into the lumen [m].
        num_rugae: Number of longitudinal folds around the body.
        rugae_height: Of the folds of the greater curvature [m].
        rugae_winding: Sideways swing of the folds as a fraction of their spacing.
        wave_depth: Fraction of the antrum's radius that a peristaltic wave takes away.
        roughness: Standard deviation of the smooth irregularity of the wall [m].
        edge: Mean length of the triangles' edges [m].
    """

    length: Annotated[float, Range(0.10, 0.35, unit="m")] = 196 * MM
    fundus_diameter: Annotated[float, Range(0.03, 0.14, unit="m")] = 100 * MM
    body_diameter: Annotated[float, Range(0.03, 0.14, unit="m")] = 110 * MM
    antrum_diameter: Annotated[float, Range(0.025, 0.1, unit="m")] = 65 * MM
    pylorus_diameter: Annotated[float, Range(0.008, 0.025, unit="m")] = 13 * MM
    flattening: Annotated[float, Range(0.0, 0.6)] = 0.12
    cardia_distance: float = 50 * MM
    incisura_depth: Annotated[float, Range(0.0, 0.02, unit="m")] = 13 * MM
    num_rugae: Annotated[int, Range(6, 30)] = 15
    rugae_height: Annotated[float, Range(0.0, 0.01, unit="m")] = 1.0 * MM
    rugae_winding: Annotated[float, Range(0.0, 1.5)] = 0.9
    wave_depth: Annotated[float, Range(0.0, 0.5)] = 0.16
    roughness: Annotated[float, Range(0.0, 0.002, unit="m")] = 0.5 * MM
    edge: Annotated[float, Range(0.0008, 0.005, unit="m")] = 1.7 * MM

    def __post_init__(self) -> None:
        """Check what the construction relies on."""
        check_fields(self)
        low, high = 0.2 * self.length, 0.35 * self.length
        is_valid = low <= self.cardia_distance <= high
        require(is_valid, "cardia_distance", self.cardia_distance, f"{low:g} to {high:g} m")
        require(
            self.antrum_diameter <= self.body_diameter,
            "antrum_diameter",
            self.antrum_diameter,
            f"up to the body's diameter, {self.body_diameter:g} m",
        )

    @classmethod
    def draw(cls, rng: np.random.Generator) -> StomachParameters:
        """A distended stomach from the population.

        Its length varies by 13 %, so that the lesser curvature has the published relative spread,
        its diameter by 7 %, long stomachs being the narrower ones (a correlation of -0.3 is
        assumed); the fractions of fundus, antrum and folds by 4 to 15 % on their own.
        """

        def vary(deviation: float) -> float:
            return 1.0 + deviation * truncated_normal(rng)

        mean = cls()
        size = truncated_normal(rng)
        length = 1.0 + 0.13 * size
        diameter = 1.0 + 0.07 * (-0.3 * size + 0.91**0.5 * truncated_normal(rng))
        return cls(
            length=mean.length * length,
            fundus_diameter=mean.fundus_diameter * diameter * vary(0.04),
            body_diameter=mean.body_diameter * diameter,
            antrum_diameter=mean.antrum_diameter * diameter * vary(0.06),
            pylorus_diameter=mean.pylorus_diameter * vary(0.05),
            flattening=mean.flattening * vary(0.15),
            cardia_distance=mean.cardia_distance * length * vary(0.04),
            incisura_depth=mean.incisura_depth * vary(0.15),
            num_rugae=round(mean.num_rugae * vary(0.1)),
            rugae_height=mean.rugae_height * vary(0.15),
            rugae_winding=mean.rugae_winding * vary(0.15),
            wave_depth=mean.wave_depth * vary(0.15),
        )

    def at(self, distension: str) -> StomachParameters:
        """The same stomach at another distension.

        Args:
            distension: One of `DISTENSIONS`.
        """
        factors = at_distension(DISTENSIONS, distension)
        scaled = {f.name: getattr(self, f.name) * factors.get(f.name, 1.0) for f in fields(self)}
        scaled["num_rugae"] = self.num_rugae
        return replace(self, **scaled)


DISTENSIONS: dict[str, dict[str, float]] = {
    "inflated": {},
    "normal": {
        "length": 0.93,
        "fundus_diameter": 0.80,
        "body_diameter": 0.76,
        "antrum_diameter": 0.76,
        "cardia_distance": 0.93,
        "flattening": 2.0,
        "rugae_height": 4.8,
        "wave_depth": 1.5,
    },
    "collapsed": {
        "length": 0.86,
        "fundus_diameter": 0.58,
        "body_diameter": 0.52,
        "antrum_diameter": 0.60,
        "cardia_distance": 0.86,
        "flattening": 3.0,
        "incisura_depth": 0.5,
        "rugae_height": 6.5,
        "wave_depth": 1.4,
    },
}
"""Factors on the distended dimensions for each distension: gas or a liter of water; half a liter;
nearly empty. As the wall slackens its surplus area gathers in the rugae."""
