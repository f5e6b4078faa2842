"""Scene effects: specular reflection of the wet wall, and bubbles on the capsule's dome."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Annotated

from vrcaps.camera_pipeline.effect.base import SceneEffect
from vrcaps.core.errors import InputError
from vrcaps.core.fields import Range
from vrcaps.lumen.contents import Bubbles

if TYPE_CHECKING:
    from vrcaps.lumen.contents import Contents
    from vrcaps.organ.surface import OrganSurface


@dataclass(frozen=True)
class SpecularReflection(SceneEffect):
    """Strength of the wall's specular reflection, replacing the organ's own.

    This is the clearcoat of the wall's material (Burley 2012). The thickness of the mucus film,
    with its own geometry, is `RenderSettings.mucus_film_um`.

    Attributes:
        clearcoat: Strength of the clearcoat, 0 (dry) to 1 (full).
        clearcoat_gloss: Gloss of the clearcoat, 0 (satin) to 1 (mirror-like).
        ior: Refractive index of the wall below it, 1 (no reflection) or more.
    """

    clearcoat: Annotated[float, Range(min=0.0, max=1.0)]
    clearcoat_gloss: Annotated[float, Range(min=0.0, max=1.0)] = 0.93
    ior: Annotated[float, Range(min=1.0, below=3.0)] = 1.4

    name = "specular"
    severities = (
        {"clearcoat": 0.0, "ior": 1.0},
        {"clearcoat": 0.05, "ior": 1.15},
        {"clearcoat": 0.2, "ior": 1.3},
        {"clearcoat": 0.5, "ior": 1.45},
        {"clearcoat": 1.0, "ior": 1.7},
    )

    def on_organ(self, organ: OrganSurface) -> OrganSurface:
        """Return the organ with this clearcoat.

        Raises:
            InputError: If the organ has no appearance.
        """
        look = organ.appearance
        if look is None:
            raise InputError(
                f"{organ.name} has no appearance, so it cannot have a specular reflection."
            )
        look = replace(
            look, clearcoat=self.clearcoat, clearcoat_gloss=self.clearcoat_gloss, ior=self.ior
        )
        return replace(organ, appearance=look)


@dataclass(frozen=True)
class DomeBubbles(SceneEffect):
    """Bubbles on each round end of the capsule, replacing those of the contents.

    Attributes:
        count: Number of bubbles on each end.
    """

    count: Annotated[int, Range(min=0)]

    name = "dome_bubbles"
    severities = ({"count": 0}, {"count": 1}, {"count": 2}, {"count": 4}, {"count": 9})

    def on_contents(self, contents: Contents) -> Contents:
        """Return the contents with these bubbles on the capsule."""
        bubbles = contents.resolved[0] if contents.bubbles else Bubbles(per_area=0.0)
        return replace(contents, bubbles=replace(bubbles, on_dome=self.count))
