"""Lesion interface: a specification makes a form, a form displaces and paints the wall.

A specification (`Polyp`, `Colitis`, …) is plain data: class, grade, size, location. Its form is
the specification with its irregularities drawn. A form works on samples of wall (`WallSamples`), be
they vertices of the refined wall or texels, so that shape, mask and color agree.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Annotated, Any, ClassVar, Literal, Protocol

import numpy as np

from vrcaps.lesion.settings import LENGTH, settings_of

if TYPE_CHECKING:
    from jaxtyping import Float

    from vrcaps.lesion.blood import BloodFlow
    from vrcaps.organ.surface import OrganSurface


@dataclass(frozen=True)
class Location:
    """Location of a lesion on the wall; what is not given is drawn at random.

    Attributes:
        segment: Name of a segment (label) of the organ.
        arc_length: Along the centerline from the oral end [m].
        theta: Angle around the centerline [rad], −π to π.
    """

    segment: str | None = None
    arc_length: Annotated[float, LENGTH] | None = None
    theta: float | None = None


@dataclass(frozen=True)
class WallSamples:
    """Points of the wall around a lesion.

    Attributes:
        xy: Coordinates in the wall [m]. Of a focal lesion: geodesic log map about its center. Of a
            circumferential one: arc length and 0. Of a flow: distance along its path, distance
            from the path, and distance along the wall from the pool's hollow.
        rest: Position without the lesion [m], patient frame.
        normal: Unit normal into the lumen there.
        inward: Offset to the centerline [m].
    """

    xy: Float[np.ndarray, "n k"]
    rest: Float[np.ndarray, "n 3"]
    normal: Float[np.ndarray, "n 3"]
    inward: Float[np.ndarray, "n 3"]


@dataclass(frozen=True)
class LesionSite:
    """The site of a placed lesion, as its form needs it.

    Attributes:
        center: Of a focal lesion its center; else any point of the footprint [m], patient frame.
        axes: Columns are x and y of the log map at the center and the normal into the lumen.
        down: Unit vector of gravity, patient frame.
        arc_length_range: Of a circumferential lesion: first and last arc length [m].
        bottom: Of a flow: where it ends [m], patient frame.
        reach: Of a flow: how far from its bottom a pool may reach [m].
    """

    center: Float[np.ndarray, " 3"]
    axes: Float[np.ndarray, "3 3"]
    down: Float[np.ndarray, " 3"]
    arc_length_range: tuple[float, float] = (-np.inf, np.inf)
    bottom: Float[np.ndarray, " 3"] | None = None
    reach: float = 0.0


@dataclass(frozen=True)
class AppearanceSample:
    """Appearance of texels, before or after a lesion is painted on them.

    Attributes:
        color: Linear reflectance, red, green, blue.
        roughness: Perceptual roughness, 0 to 1.
        height: Relief towards the lumen [m].
        plain: Linear reflectance of the mucosa around, its vessels smoothed away.
    """

    color: Float[np.ndarray, "n 3"]
    roughness: Float[np.ndarray, " n"]
    height: Float[np.ndarray, " n"]
    plain: Float[np.ndarray, "n 3"]


class Form(Protocol):
    """One lesion with its irregularities drawn.

    Attributes:
        edge_length: Of the triangles that draw its shape [m].
        border_length: Of the triangles on the border of its footprint [m].
    """

    edge_length: float
    border_length: float

    def signed_distance(self, wall: WallSamples) -> Float[np.ndarray, " n"]:
        """Signed distance [m] to the footprint's border; positive inside."""
        ...

    def displaced(self, wall: WallSamples) -> Float[np.ndarray, "n 3"]:
        """Positions with the lesion [m]; at rest outside the footprint."""
        ...

    def chart(self, wall: WallSamples) -> Float[np.ndarray, "n 2"]:
        """Flat map [m] of the lesion's surface, true in scale near enough to paint on."""
        ...

    def paint(
        self, wall: WallSamples, points: Float[np.ndarray, "n 3"], clean: AppearanceSample
    ) -> AppearanceSample:
        """The appearance with the lesion.

        Args:
            wall: Samples within the footprint.
            points: Their positions with the lesion, relative to the site's center [m].
            clean: Their appearance without it.
        """
        ...


LESIONS: dict[str, type[Lesion]] = {}
"""Kinds of lesions by name; a subclass of `Lesion` that declares its `kind` enters itself."""


@dataclass(frozen=True, kw_only=True)
class Lesion:
    """A lesion's specification; each kind is a subclass that declares its `kind`.

    Limits of a number stand in its type, as in ``Annotated[float, Range(...)]``; they are checked
    here, parsed from texts by `parse_lesion`, and listed by the command line and the docs.

    Attributes:
        location: Where it is; drawn at random where left open.
        variant: Another lesion of the same specification for each number.
    """

    location: Location = field(default_factory=Location)
    variant: int = 0

    kind: ClassVar[str]
    """Name of the kind in texts, scenarios and records."""
    grade_field: ClassVar[str] = ""
    """Field that a name like `polyp-Ip` gives after its hyphen."""
    grade_scale: ClassVar[str] = ""
    """Name of the clinical scale of its grades."""
    grade_meanings: ClassVar[Mapping[str, str]] = {}
    """What a grade means, where its name does not say it."""
    notes: ClassVar[Mapping[str, str]] = {}
    """What its type does not say of a setting; under the empty name, what holds for the kind."""

    def __init_subclass__(cls, **options: Any) -> None:
        super().__init_subclass__(**options)
        if "kind" in cls.__dict__:
            LESIONS[cls.kind] = cls

    def __post_init__(self) -> None:
        for name, setting in settings_of(type(self)).items():
            setting.check(getattr(self, name), self.kind)

    @classmethod
    def library(cls) -> dict[str, Lesion]:
        """Named lesions of this kind; each name begins with the kind and a hyphen."""
        return {}

    @property
    def extent(self) -> Literal["focal", "circumferential", "flow"]:
        """How it lies: about a center, all around the lumen, or where blood flows."""
        return "focal"

    @property
    def grade(self) -> str:
        """Its grade, type or subtype in words; empty for kinds without any."""
        return str(getattr(self, self.grade_field)) if self.grade_field else ""

    @property
    def footprint_radius(self) -> float:
        """Of a focal lesion: radius of the wall that it takes [m]."""
        raise NotImplementedError

    @property
    def head_radius(self) -> float:
        """Of a focal lesion: radius of what stands on the wall, or behind it [m]."""
        return self.footprint_radius

    @property
    def protrusion(self) -> float:
        """How far it stands into the lumen [m]; negative for a pouch out of it."""
        return 0.0

    @property
    def flow(self) -> BloodFlow:
        """Of a flow: its dimensions."""
        raise NotImplementedError

    def form(self, site: LesionSite, rng: np.random.Generator) -> Form:
        """Draw its irregularities."""
        raise NotImplementedError

    def arc_length_range(self, organ: OrganSurface, middle: float | None) -> tuple[float, float]:
        """Of a circumferential lesion: first and last arc length [m].

        Args:
            organ: The organ.
            middle: Arc length of its location [m]; None where that is open.
        """
        raise NotImplementedError


@dataclass(frozen=True, kw_only=True)
class SizedLesion(Lesion):
    """A focal lesion that has a diameter.

    Attributes:
        size: Diameter [m].
    """

    size: float

    @property
    def footprint_radius(self) -> float:
        """Half the size [m]."""
        return 0.5 * self.size


def mix(
    a: Float[np.ndarray, "n 3"], b: Float[np.ndarray, "*n 3"], weight: Float[np.ndarray, " n"]
) -> Float[np.ndarray, "n 3"]:
    """Linear blend from `a` (weight 0) to `b` (weight 1).

    Args:
        a: Colors.
        b: Colors, or one color.
        weight: Of `b`, 0 to 1.
    """
    return a + (b - a) * weight[:, None]
