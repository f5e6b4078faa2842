"""Render settings: global illumination, sampling, subsurface scattering, mucus film, imaging."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Literal

from vrcaps.core.errors import InputError
from vrcaps.core.fields import Range, check_fields
from vrcaps.core.rng import MAX_SEED

MAX_FILM_UM = 1000.0
"""Maximum thickness of a mucus film [µm]; thicker liquid is a pool."""

Light = Literal["direct", "radiosity", "path"]


@dataclass(frozen=True)
class RenderSettings:
    """Settings of the renderer.

    Example:
        >>> renderer = vrcaps.Renderer(model, vrcaps.RenderSettings(light="path", spp=64))

    Attributes:
        supersampling: Rays per pixel along each axis, 1 to 16; the color of a pixel is the mean
            over all of them. All other channels hold the value at the pixel's center.
        shadows: Whether folds cast shadows from each LED, which takes half of the frame time;
            always on with path tracing.
        light: Light transport: `direct` (LEDs only), `radiosity` (indirect light between gather
            points of the wall, for real time) or `path` (path tracing).
        spp: Samples per pixel: paths traced per ray. Noise falls with their square root.
        max_bounces: Maximum number of reflections of a path, 1 to 100; 1 is direct light with
            shadows.
        path_seed: Seed of the random numbers of path tracing.
        scattering: Whether light scatters in the tissue behind the wall (subsurface
            scattering), which softens shadows and relief and lets light through thin folds: by
            random walks with path tracing, by transport rows precomputed from such walks with
            radiosity; not available with direct light.
        denoise: Whether Open Image Denoise filters light beyond the first reflection; only with
            path tracing. Needs `pip install 'vrcaps[denoise]'`.
        villi: Length of the villi of the small bowel relative to normal, 0 (none) to 2; below 1 the
            gaps between them fade as well; not available with direct light. Only colors change:
            depth and labels are those of the wall at the bases of the villi.
        mucus_film_um: Thickness of the mucus film on the wall [µm], 0 (dry) to 1000; default:
            the film of the organ's own appearance, which is wet.
        imaging: Illumination: white light of the capsule's LEDs, or narrow bands at 415 and 540
            nm, which make vessels stand out.
    """

    supersampling: Annotated[int, Range(1, 16)] = 1
    shadows: bool = True
    light: Light = "radiosity"
    spp: Annotated[int, Range(1, 2**31)] = 16
    max_bounces: Annotated[int, Range(1, 100)] = 4
    path_seed: Annotated[int, Range(0, MAX_SEED)] = 0
    scattering: bool = False
    denoise: bool = False
    villi: Annotated[float, Range(0.0, 2.0)] = 1.0
    mucus_film_um: Annotated[float | None, Range(0.0, MAX_FILM_UM, unit="µm")] = None
    imaging: Literal["white-light", "narrow-band"] = "white-light"

    @property
    def is_supersampled(self) -> bool:
        """True if a pixel's color depends on more than its own ray."""
        return self.supersampling > 1 or self.denoise

    def __post_init__(self) -> None:
        check_fields(self)
        if self.scattering and self.light == "direct":
            raise InputError(
                "Scattering requires light 'radiosity' or 'path', not 'direct'. Change one of them."
            )
        if self.denoise and self.light != "path":
            raise InputError(
                f"denoise requires path tracing, but light is {self.light!r}. "
                "Set denoise to false or light to 'path'."
            )
