"""Lesion interface: a specification creates a form, a form displaces and paints the wall.

A specification (`Polyp`, `Colitis`, …) is plain data: class, grade, size, location. Its form is
the specification with random irregularities. A form is evaluated at samples of the wall
(`WallSamples`), vertices of the refined wall or texels, so that shape, mask and color agree.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, fields
from functools import cache
from typing import (
    TYPE_CHECKING,
    Annotated,
    Any,
    ClassVar,
    Literal,
    Protocol,
    get_args,
    get_origin,
    get_type_hints,
)

import numpy as np

from vrcaps.config.convert import register_family
from vrcaps.core.errors import InputError
from vrcaps.core.fields import Range, check_fields, range_of
from vrcaps.core.registry import Registry
from vrcaps.core.units import DEG, MM, parse_length

if TYPE_CHECKING:
    from jaxtyping import Float

    from vrcaps.organ.surface import OrganSurface


LENGTH = Range(unit="m")
"""Annotation of a length of any size: ``Annotated[float, LENGTH]``."""


@dataclass(frozen=True)
class Setting:
    """Field of a specification.

    Attributes:
        name: Name of the field.
        words: Allowed named values.
        limits: Limits of a number, a length for the unit "m". None if there are none.
        is_text: Whether it accepts any string.
        is_integer: Whether it accepts integers only.
    """

    name: str
    words: tuple[Any, ...]
    limits: Range | None
    is_text: bool
    is_integer: bool

    @property
    def is_length(self) -> bool:
        """Whether it is a length."""
        return self.limits is not None and self.limits.unit == "m"

    def parse(self, text: str) -> Any:
        """Parse a value from the command line.

        Raises:
            InputError: If the text is not a value of this setting.
        """
        for word in self.words:
            if text == str(word):
                return word
        allowed = [str(word) for word in self.words]
        if self.is_length:
            try:
                return parse_length(text)
            except InputError:
                allowed.append("a length such as 8mm")
        if allowed:
            raise InputError(f"{self.name} is {text!r}. Allowed: {', '.join(allowed)}.")
        if self.is_text:
            return text
        scale, value = (DEG, text.removesuffix("deg")) if text.endswith("deg") else (1.0, text)
        try:
            return int(value) if self.is_integer else scale * float(value)
        except ValueError:
            raise InputError(f"{self.name} is {text!r}. Allowed: a number.") from None

    def check(self, value: Any, kind: str) -> None:
        """Check a value for a lesion kind.

        Raises:
            InputError: If it is not allowed.
        """
        if value is None or value in self.words:
            return
        is_number = isinstance(value, float | int) and self.limits is not None
        if not is_number and not self.words:
            return
        if not is_number or value not in self.limits:  # type: ignore[operator]
            given = f"{value / MM:g} mm" if is_number and self.is_length else repr(value)
            raise InputError(
                f"{kind.capitalize()} {self.name} is {given}. Allowed: {self.allowed}."
            )

    @property
    def allowed(self) -> str:
        """Allowed values in words; empty if any number or text is allowed."""
        parts = [str(word) for word in self.words]
        if self.limits is not None and self.limits != LENGTH:
            scale = MM if self.is_length else 1.0
            low, high = self.limits.min / scale, self.limits.max / scale
            parts.append(f"{low:g} to {high:g}{' mm' if self.is_length else ''}")
        return ", ".join(parts)


@cache
def settings_of(cls: type) -> dict[str, Setting]:
    """Settings of a dataclass by name, except fields that hold another dataclass."""
    hints = get_type_hints(cls, include_extras=True)
    settings = {}
    for name in (f.name for f in fields(cls)):
        parts = _parts(hints[name])
        limits = next((r for r in map(range_of, (hints[name], *parts)) if r is not None), None)
        words = [w for part in parts if get_origin(part) is Literal for w in get_args(part)]
        bare = {get_args(p)[0] if hasattr(p, "__metadata__") else p for p in parts}
        if words or bare & {float, int, str}:
            settings[name] = Setting(name, tuple(words), limits, str in bare, int in bare)
    return settings


def _parts(hint: Any) -> tuple[Any, ...]:
    """Members of a union, or the type itself."""
    is_single = get_origin(hint) is Literal or hasattr(hint, "__metadata__")
    return (hint,) if is_single or not get_args(hint) else get_args(hint)


@dataclass(frozen=True)
class Location:
    """Location of a lesion on the wall; unspecified values are drawn at random.

    Attributes:
        segment: Name of a segment (label) of the organ.
        arc_length: Position along the centerline from the oral end [m].
        theta: Angle around the centerline [rad], −π to π.
    """

    segment: str | None = None
    arc_length: Annotated[float, LENGTH] | None = None
    theta: float | None = None

    def __post_init__(self) -> None:
        check_fields(self, of="Location")


@dataclass(frozen=True)
class WallSamples:
    """Points of the wall around a lesion.

    Attributes:
        xy: Wall coordinates [m]. Focal lesion: geodesic log map about its center. Circumferential
            lesion: arc length and 0. Flow: distance along its path, distance from the path, and
            distance along the wall from the pool's hollow.
        rest: Position without the lesion [m], patient frame.
        normal: Unit normal into the lumen at that position.
        inward: Offset to the centerline [m].
    """

    xy: Float[np.ndarray, "n k"]
    rest: Float[np.ndarray, "n 3"]
    normal: Float[np.ndarray, "n 3"]
    inward: Float[np.ndarray, "n 3"]


@dataclass(frozen=True)
class LesionSite:
    """Site of a placed lesion, as required by its form.

    Attributes:
        center: Center of a focal lesion, else any point of the footprint [m], patient frame.
        axes: Columns are x and y of the log map at the center and the normal into the lumen.
        down: Unit vector of gravity, patient frame.
        arc_length_range: Circumferential lesion: first and last arc length [m].
        bottom: Flow: end point [m], patient frame.
        reach: Flow: maximum distance of the pool from its bottom [m].
    """

    center: Float[np.ndarray, " 3"]
    axes: Float[np.ndarray, "3 3"]
    down: Float[np.ndarray, " 3"]
    arc_length_range: tuple[float, float] = (-np.inf, np.inf)
    bottom: Float[np.ndarray, " 3"] | None = None
    reach: float = 0.0


@dataclass(frozen=True)
class BloodFlow:
    """Dimensions of a bleeding severity.

    Attributes:
        source: Radius of the bleeding source [m].
        run: Maximum path length of blood from it [m].
        width: Half-width of the flow [m].
        film: Thickness of the flow [m].
        pool: Depth of the pool at the end [m].
        clots: Height of clots over source and pool [m].
    """

    source: float
    run: float = 0.0
    width: float = 0.0
    film: float = 0.0
    pool: float = 0.0
    clots: float = 0.0


@dataclass(frozen=True)
class AppearanceSample:
    """Appearance of texels, before or after a lesion is painted on them.

    Attributes:
        color: Linear reflectance, red, green, blue.
        roughness: Perceptual roughness, 0 to 1.
        height: Relief towards the lumen [m].
        plain: Linear reflectance of the surrounding mucosa, with vessels smoothed away.
    """

    color: Float[np.ndarray, "n 3"]
    roughness: Float[np.ndarray, " n"]
    height: Float[np.ndarray, " n"]
    plain: Float[np.ndarray, "n 3"]


class Form(Protocol):
    """Lesion with its irregularities drawn.

    Attributes:
        edge_length: Edge length of the triangles that represent its shape [m].
        border_length: Edge length of the triangles on the border of its footprint [m].
    """

    edge_length: float
    border_length: float

    def signed_distance(self, wall: WallSamples) -> Float[np.ndarray, " n"]:
        """Signed distance [m] to the footprint's border; positive inside."""
        ...

    def displaced(self, wall: WallSamples) -> Float[np.ndarray, "n 3"]:
        """Positions with the lesion [m]; unchanged outside the footprint."""
        ...

    def chart(self, wall: WallSamples) -> Float[np.ndarray, "n 2"]:
        """Flat map [m] of the lesion's surface, with low enough distortion for painting."""
        ...

    def paint(
        self, wall: WallSamples, points: Float[np.ndarray, "n 3"], clean: AppearanceSample
    ) -> AppearanceSample:
        """Return the appearance with the lesion.

        Args:
            wall: Samples within the footprint.
            points: Positions of the samples with the lesion, relative to the site's center [m].
            clean: Appearance of the samples without it.
        """
        ...


LESIONS: Registry[Lesion] = Registry(
    "lesion",
    {
        "bleeding": ("vrcaps.lesion.bleeding:Bleeding", "bleeding; blood runs with gravity"),
        "colitis": ("vrcaps.lesion.colitis:Colitis", "ulcerative colitis"),
        "polyp": ("vrcaps.lesion.polyp:Polyp", "polyp of a Paris type"),
        "tumor": ("vrcaps.lesion.structural:Tumor", "ulcerated mass with a rolled edge"),
        "diverticulum": ("vrcaps.lesion.structural:Diverticulum", "outward pouch of the lumen"),
        "stricture": ("vrcaps.lesion.structural:Stricture", "scarred narrowing of the lumen"),
        "erosion": ("vrcaps.lesion.mucosal:Erosion", "superficial break of the mucosa"),
        "ulcer": ("vrcaps.lesion.mucosal:Ulcer", "aphthous or deep ulcer"),
        "angioectasia": ("vrcaps.lesion.mucosal:Angioectasia", "dilated capillaries"),
        "lymphangiectasia": ("vrcaps.lesion.mucosal:Lymphangiectasia", "dilated lymph vessels"),
    },
)
"""Kinds of lesions by name, including those of plug-ins.

Each subclass of `Lesion` that declares its `kind` registers itself.
"""


@dataclass(frozen=True, kw_only=True)
class Lesion:
    """Specification of a lesion; each kind is a subclass that declares its `kind`.

    The type of a number states its limits, as in ``Annotated[float, Range(...)]``; they are
    checked here, parsed by `parse_lesion`, and listed by the command line and the docs.

    Attributes:
        location: Location on the wall; unspecified values are drawn at random.
        variant: Seed of the random variation; each value gives another lesion.
    """

    location: Location = field(default_factory=Location)
    variant: int = 0

    kind: ClassVar[str]
    """Name of the kind on the command line, in scenarios and in records."""
    grade_field: ClassVar[str] = ""
    """Field given after the hyphen in a name like `polyp-Ip`."""
    grade_scale: ClassVar[str] = ""
    """Name of the clinical scale of its grades."""
    grade_meanings: ClassVar[Mapping[str, str]] = {}
    """Meaning of a grade, if its name does not state it."""
    notes: ClassVar[Mapping[str, str]] = {}
    """Notes on settings beyond their types; the empty name holds notes on the kind."""

    def __init_subclass__(cls, **options: Any) -> None:
        super().__init_subclass__(**options)
        if "kind" in cls.__dict__:
            LESIONS.register(cls)

    def __post_init__(self) -> None:
        for name, setting in settings_of(type(self)).items():
            setting.check(getattr(self, name), self.kind)
        check_fields(self, of=self.kind)

    @classmethod
    def library(cls) -> dict[str, Lesion]:
        """Named lesions of this kind; each name starts with the kind and a hyphen."""
        return {}

    @property
    def extent(self) -> Literal["focal", "circumferential", "flow"]:
        """Extent: about a center, around the whole lumen, or along a flow of blood."""
        return "focal"

    @property
    def grade(self) -> str:
        """Grade, type or subtype in words; empty for kinds without grades."""
        return str(getattr(self, self.grade_field)) if self.grade_field else ""

    @property
    def footprint_radius(self) -> float:
        """Focal lesion: radius of its footprint on the wall [m]."""
        raise NotImplementedError

    @property
    def head_radius(self) -> float:
        """Focal lesion: radius of its part in front of the wall, or behind it [m]."""
        return self.footprint_radius

    @property
    def protrusion(self) -> float:
        """Height into the lumen [m]; negative for an outward pouch."""
        return 0.0

    @property
    def flow(self) -> BloodFlow:
        """Flow: its dimensions."""
        raise NotImplementedError

    def form(self, site: LesionSite, rng: np.random.Generator) -> Form:
        """Draw the irregularities."""
        raise NotImplementedError

    def arc_length_range(self, organ: OrganSurface, middle: float | None) -> tuple[float, float]:
        """Circumferential lesion: first and last arc length [m].

        Args:
            organ: Organ.
            middle: Arc length of its location [m]; None if unspecified.
        """
        raise NotImplementedError


@dataclass(frozen=True, kw_only=True)
class SizedLesion(Lesion):
    """Focal lesion with a diameter.

    Attributes:
        size: Diameter [m].
    """

    size: float

    @property
    def footprint_radius(self) -> float:
        """Half the size [m]."""
        return 0.5 * self.size


register_family(Lesion, LESIONS)
