"""Mucosae: color, vessels, wetness and relief of each organ's wall, by name and with changes."""

from __future__ import annotations

from dataclasses import asdict, dataclass, fields, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import numpy as np

from vrcaps.core.errors import InputError, UnknownNameError
from vrcaps.core.fields import FileRef, Range, check_fields
from vrcaps.core.units import MM
from vrcaps.organ.segments import find_mucosa

if TYPE_CHECKING:
    from vrcaps.organ.surface import OrganSurface


MUCUS_TINT = (1.2, 2.4, 1.3)
"""Reflectance of bile-stained mucus relative to the wall, red, green, blue: less green than the
median ratio of yellow to red areas in seven real frames (docs/concepts/mucosa.md)."""


@dataclass(frozen=True)
class Mucosa:
    """Parameters of a mucosa.

    Colors are chosen by hand, so that hue and ratio of blue to green of recorded frames lie within
    the 10 to 90 % range of capsule frames (`vrcaps compare-looks`). Shapes and sizes are chosen by
    eye.

    Attributes:
        base_color: Linear reflectance of the wall between its vessels, red, green, blue.
        redness_variation: Spread of the optical density of blood in the mucosa, over positions
            along the gut and patches.
        patchiness: Weight of patches of centimeters and below in redness and bile, 0 to 1; slow
            variation along the gut takes the variance that they lack.
        patient_variation: Standard deviation over patients of the optical density of blood in green
            light, and of bile in blue light.
        bile: Optical density of bile-stained mucus in blue light.
        vessel_contrast: Fraction of green light absorbed by a wide, shallow vessel, 0 to 1.
        vessel_spacing: Distance between the ends of the finest visible branches [m].
        trunk_spacing: Distance between the points where vessel trunks reach the mucosa [m].
        capillary_radius: Radius of the finest visible branches [m]; wider ones follow from it
            by Murray's law.
        relief_slope: RMS slope of the millimeter-sized relief, which breaks up highlights.
        pit_spacing: Distance between villi, gastric areae or groups of crypts [m].
        pit_slope: RMS slope of the gaps between them.
        pit_shade: Optical density of those gaps in green light; bile also collects there.
        pit_breaks: Blend between a closed network of gaps around round pits (0) and separate dark
            strokes, 3.5 times as long as wide (1), as between the leaf-shaped villi of jejunum.
        pit_variation: Standard deviation of the logarithm of their depth and density over the wall,
            as villi are more or less swollen and covered by mucus; the mean is nearly preserved.
        network: Weight of the finest network of vessels in the redness.
        flecks: Fraction of cells, 3.2 mm wide, with a fleck of mucus, on the wall or off it.
        mucus: Amount of mucus, 0 to 1: film and strands cover a third of this fraction of the wall.
        mucus_tint: Reflectance of mucus relative to the wall, red, green, blue.
        roughness: Perceptual roughness of the wall under its wet film, 0 to 1.
        clearcoat: Median strength of the wet film over patients, 0 (dry, or broken up) to 1 (full).
        clearcoat_variation: Standard deviation of its natural logarithm over patients.
        clearcoat_gloss: Gloss of the wet film, 0 (satin) to 1 (mirror-like).
    """

    base_color: tuple[float, float, float]
    redness_variation: float = 0.35
    patchiness: float = 1.0
    patient_variation: tuple[float, float] = (0.20, 0.30)
    bile: float = 0.45
    vessel_contrast: float = 1.0
    vessel_spacing: float = 1.0 * MM
    trunk_spacing: float = 30.0 * MM
    capillary_radius: float = 0.046 * MM
    relief_slope: float = 0.06
    pit_spacing: float = 0.6 * MM
    pit_slope: float = 0.03
    pit_shade: float = 0.05
    pit_breaks: float = 0.0
    pit_variation: float = 0.0
    network: float = 1.1
    flecks: float = 0.03
    mucus: float = 0.10
    mucus_tint: tuple[float, float, float] = MUCUS_TINT
    roughness: float = 0.65
    clearcoat: float = 1.0
    clearcoat_variation: float = 0.0
    clearcoat_gloss: float = 0.93


MUCOSAE: dict[str, Mucosa] = {
    "colon": Mucosa(
        base_color=(0.430, 0.172, 0.100),
        bile=0.65,
        redness_variation=0.40,
        vessel_contrast=0.55,
        network=0.6,
        relief_slope=0.038,
        roughness=0.90,
        clearcoat=0.8,
        clearcoat_gloss=0.97,
    ),
    "stomach": Mucosa(
        base_color=(0.420, 0.168, 0.092),
        bile=0.20,
        vessel_contrast=0.25,
        vessel_spacing=1.5 * MM,
        pit_spacing=2.2 * MM,
        pit_slope=0.085,
        pit_shade=0.10,
        network=0.35,
        flecks=0.4,
        mucus_tint=(1.15, 2.2, 2.0),
        clearcoat=0.7,
    ),
    "small-bowel": Mucosa(
        base_color=(0.326, 0.177, 0.145),
        redness_variation=0.30,
        patchiness=0.6,
        patient_variation=(0.11, 0.36),
        bile=0.36,
        vessel_contrast=0.2,
        pit_spacing=0.36 * MM,
        pit_slope=0.11,
        pit_shade=0.10,
        pit_breaks=1.0,
        pit_variation=0.5,
        network=0.4,
        flecks=0.03,
        mucus=0.0,
        mucus_tint=(1.10, 1.5, 1.5),
        roughness=1.0,
        clearcoat=0.08,
        clearcoat_variation=0.9,
    ),
}
"""Mucosae by organ."""

ABSORPTION = np.array([[0.16, 1.0, 0.92], [0.08, 0.13, 1.0]])
"""Optical density in red, green and blue of blood, relative to green, and of bile, relative to
blue; as in the compiled core (tissue.rs)."""


def own_mucosa(organ: OrganSurface) -> str:
    """Name in `MUCOSAE` of the mucosa that matches an organ's labels.

    The label of most of its wall decides, or the organ's name if that label is not conclusive; the
    colon's if neither indicates a stomach or small bowel.
    """
    label = organ.label_names[int(np.bincount(organ.label).argmax())]
    name = organ.name if label == "wall" else label
    return find_mucosa(name.replace("-", "_")) or "colon"


def is_texture_path(mucosa: str) -> bool:
    """Check whether a mucosa is given as the path of a texture, not as a name in `MUCOSAE`.

    Raises:
        UnknownNameError: If it is neither.
    """
    if mucosa in MUCOSAE:
        return False
    if len(Path(mucosa).parts) == 1 and not Path(mucosa).exists():
        raise UnknownNameError("mucosa", mucosa, (*MUCOSAE, "the folder of a texture"))
    return True


def mucosa_fingerprint(mucosa: str | Mucosa | None) -> dict[str, Any]:
    """Contribution of a mucosa to the name of a cached organ; empty for the organ's own.

    Raises:
        UnknownNameError: If the mucosa does not exist.
        InputError: If there is no texture at a path.
    """
    from vrcaps.mucosa.texture import texture_sha256

    if mucosa is None:
        return {}
    if isinstance(mucosa, Mucosa):
        return {"mucosa": asdict(mucosa)}
    return {"mucosa": texture_sha256(mucosa) if is_texture_path(mucosa) else mucosa}


_Fraction = Annotated[float | None, Range(0.0, 1.0)]
_Amount = Annotated[float | None, Range(min=0.0, max=10.0)]
_Length = Annotated[float | None, Range(above=0.0, unit="m")]


@dataclass(frozen=True)
class MucosaSettings(FileRef):
    """Mucosa of a wall by name or texture, with changes of its parameters.

    A parameter that is None is that of the mucosa. A texture has no parameters.

    Example:
        >>> mucosa = MucosaSettings(bile=0.6)
        >>> vrcaps.Scenario(organ=vrcaps.OrganGenerated("small-bowel", mucosa=mucosa))

    Attributes:
        path: Name of a mucosa (colon, stomach or small-bowel), or the folder of a texture; empty
            for the organ's own.
        sha256: Checksum of the texture's head file.
        redness_variation: Spread of the optical density of blood.
        patchiness: Weight of patches in redness and bile, relative to variation along the gut.
        bile: Optical density of bile-stained mucus in blue light.
        vessel_contrast: Fraction of green light absorbed by a wide, shallow vessel.
        vessel_spacing: Distance between the ends of the finest visible branches [m].
        relief_slope: RMS slope of the millimeter-sized relief.
        pit_spacing: Distance between villi, gastric areae or groups of crypts [m].
        pit_slope: RMS slope of the gaps between them.
        pit_shade: Optical density of those gaps in green light.
        pit_breaks: Blend between a closed network of gaps (0) and separate strokes (1).
        pit_variation: Standard deviation of the logarithm of their depth over the wall.
        network: Weight of the finest network of vessels in the redness.
        flecks: Fraction of cells, 3.2 mm wide, with a fleck of mucus.
        mucus: Amount of mucus.
        roughness: Perceptual roughness of the wall under its wet film.
        clearcoat: Strength of the wet film, 0 (dry) to 1 (full), the same for all patients if it is
            set alone.
        clearcoat_variation: Standard deviation of its natural logarithm over patients.
        clearcoat_gloss: Gloss of the wet film, 0 (satin) to 1 (mirror-like).
    """

    path: str = ""
    redness_variation: _Amount = None
    patchiness: _Fraction = None
    bile: _Amount = None
    vessel_contrast: _Fraction = None
    vessel_spacing: _Length = None
    relief_slope: _Fraction = None
    pit_spacing: _Length = None
    pit_slope: _Fraction = None
    pit_shade: _Amount = None
    pit_breaks: _Fraction = None
    pit_variation: _Amount = None
    network: _Amount = None
    flecks: _Fraction = None
    mucus: _Fraction = None
    roughness: _Fraction = None
    clearcoat: _Fraction = None
    clearcoat_variation: _Amount = None
    clearcoat_gloss: _Fraction = None

    def __post_init__(self) -> None:
        check_fields(self)
        if self.path and is_texture_path(self.path) and self.changes:
            raise InputError(
                f"mucosa changes {', '.join(self.changes)} of the texture {self.path}, which has "
                f"no parameters. Allowed: changes of {', '.join(MUCOSAE)}."
            )

    @property
    def changes(self) -> dict[str, float]:
        """Parameters that differ from the mucosa."""
        values = {f.name: getattr(self, f.name) for f in fields(self)}
        return {k: v for k, v in values.items() if k not in ("path", "sha256") and v is not None}

    def checked(self) -> MucosaSettings:
        """Return the settings with the current checksum of a texture.

        Raises:
            InputError: If the texture cannot be read, or does not match the given checksum.
        """
        if not self.path or not is_texture_path(self.path):
            return self
        return replace(self, sha256=FileRef(self.path, self.sha256).checked().sha256)

    def of(self, own: str) -> str | Mucosa:
        """Name of a mucosa, path of a texture, or a changed mucosa.

        Args:
            own: Name of the organ's own mucosa.
        """
        name = self.path or own
        if not self.changes:
            return name
        fixed = {} if self.clearcoat is None else {"clearcoat_variation": 0.0}
        return replace(MUCOSAE[name], **(fixed | self.changes))
