"""Settings of a mucosa: its name or texture, and the parameters that differ from it."""

from __future__ import annotations

from dataclasses import dataclass, fields, replace
from typing import Annotated

from vrcaps.config.fields import FileRef, Range, check_fields
from vrcaps.core.errors import InputError
from vrcaps.mucosa.mucosa import MUCOSAE, Mucosa, is_texture_path

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
        network: Weight of the finest network of vessels in the redness.
        flecks: Fraction of cells, 3.2 mm wide, with a fleck of mucus.
        mucus: Amount of mucus.
        roughness: Perceptual roughness of the wall under its wet film.
        clearcoat: Strength of the wet film, 0 (dry) to 1 (full).
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
    network: _Amount = None
    flecks: _Fraction = None
    mucus: _Fraction = None
    roughness: _Fraction = None
    clearcoat: _Fraction = None
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
        return replace(MUCOSAE[name], **self.changes) if self.changes else name
