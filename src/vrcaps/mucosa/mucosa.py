"""Mucosae: color, vessels, wetness and relief of each organ's wall, and selection by name."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from vrcaps.core.errors import UnknownNameError
from vrcaps.core.units import MM
from vrcaps.organ.segments import find_mucosa

if TYPE_CHECKING:
    from vrcaps.organ.surface import OrganSurface

MUCUS_TINT = (1.2, 2.8, 1.45)
"""Reflectance of bile-stained mucus relative to the wall, red, green, blue: median ratio of yellow
to red areas in seven real frames of clean colons (docs/concepts/mucosa.md)."""


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
        network: Weight of the finest network of vessels in the redness.
        flecks: Fraction of cells, 3.2 mm wide, with a fleck of mucus, on the wall or off it.
        mucus: Amount of mucus, 0 to 1: film and strands cover a third of this fraction of the wall.
        mucus_tint: Reflectance of mucus relative to the wall, red, green, blue.
        roughness: Perceptual roughness of the wall under its wet film, 0 to 1.
        clearcoat: Strength of the wet film, 0 (dry, or broken up) to 1 (full).
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
    network: float = 1.1
    flecks: float = 0.03
    mucus: float = 0.10
    mucus_tint: tuple[float, float, float] = MUCUS_TINT
    roughness: float = 0.65
    clearcoat: float = 1.0
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
        base_color=(0.400, 0.182, 0.088),
        redness_variation=0.24,
        patchiness=0.45,
        patient_variation=(0.35, 0.65),
        bile=0.55,
        vessel_contrast=0.06,
        pit_spacing=0.42 * MM,
        pit_slope=0.48,
        pit_shade=0.24,
        network=0.04,
        flecks=0.03,
        mucus=0.0,
        mucus_tint=(1.10, 1.5, 1.5),
        roughness=0.85,
        clearcoat=0.16,
    ),
}
"""Mucosae by organ."""

ABSORPTION = np.array([[0.16, 1.0, 0.92], [0.04, 0.16, 1.0]])
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
