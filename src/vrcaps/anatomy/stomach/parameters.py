"""Stomach parameters: dimensions of a generated stomach and their variation between patients."""

from __future__ import annotations

from dataclasses import dataclass, fields, replace
from typing import TYPE_CHECKING, Annotated

from vrcaps.core.errors import require
from vrcaps.core.fields import Range, check_fields
from vrcaps.core.rng import truncated_normal
from vrcaps.core.units import MM
from vrcaps.organ.segments import STOMACH, at_distension

if TYPE_CHECKING:
    import numpy as np

SEGMENTS = STOMACH.labels
"""Segments from the oral to the anal end; the cardia and the incisura are patches of wall."""


@dataclass(frozen=True)
class StomachParameters:
    """Dimensions of a patient's distended stomach; the defaults are the mean adult.

    Textbooks state 1 to 1.5 l for the distended stomach and 25 to 30 cm for its greater curvature,
    which is impossible for a J of that volume. Here the greater curvature is 29 cm in the nearly
    empty stomach and grows to 40 cm at 1.1 l (`curvatures`). In 851 resected, fixed stomachs it was
    22.2 ± 3.1 cm, the lesser curvature 16.3 ± 2.6 cm (Seoul National University Hospital
    2008-2013, anthropometric reference for gastric cancer surgery); the variation between drawn
    patients follows these values. Folds and ring are estimated from endoscopy and barium images,
    not from a measured series; normal rugae are up to 5 mm thick when distended, thicker when not.

    Attributes:
        length: Length along the axis from the top of the fundus to the pyloric ring [m].
        fundus_diameter: Diameter of the fundus [m].
        body_diameter: Maximum diameter of the body [m].
        antrum_diameter: Maximum diameter of the antrum [m].
        pylorus_diameter: Diameter of the open pyloric ring [m]; a capsule of 11 mm passes.
        flattening: Flattening of the section, 1 minus depth over width; 0 for round.
        cardia_distance: Distance along the axis from the top of the fundus to the cardia [m].
        incisura_depth: Height of the angular notch above the wall, into the lumen [m].
        num_rugae: Number of longitudinal folds around the body.
        rugae_height: Height of the folds of the greater curvature [m].
        rugae_winding: Sideways swing of the folds as a fraction of their spacing.
        wave_depth: Fraction of the antrum's radius taken by a peristaltic wave.
        roughness: Standard deviation of the smooth irregularity of the wall [m].
        edge: Mean edge length of the triangles [m].
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
        """Check the assumptions of the construction."""
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
        """Draw a distended stomach from the population.

        The length varies by 13 %, so that the lesser curvature has the published relative spread,
        and the diameter by 7 %, with narrower long stomachs (an assumed correlation of -0.3). The
        fractions of fundus, antrum and folds vary independently by 4 to 15 %.
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
"""Factors on the distended dimensions for each distension: with gas or a liter of water, half a
liter, or nearly empty. As the wall slackens, its surplus area forms rugae."""
