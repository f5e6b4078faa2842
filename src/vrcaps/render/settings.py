"""How images are computed."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, get_args

from vrcaps.errors import InputError, UnknownNameError, require
from vrcaps.render.mucus_film import THICKEST_UM

Light = Literal["direct", "quick", "path"]


@dataclass(frozen=True)
class RenderSettings:
    """How images are computed.

    Attributes:
        supersampling: Colour of a pixel is the mean over this many by this many rays. All other
            channels hold the value at the pixel's centre.
        shadows: Whether folds cast shadows from each LED; path tracing always has them.
        light: Light that reaches the wall straight from an LED (direct), or also after other
            places of the wall have reflected it (path: path tracing; quick: radiosity on points of
            the wall, for real time).
        samples: Paths that path tracing follows for each ray; noise falls with their square root.
        depth: Most reflections of a path, 1 to 100; 1 is direct light with shadows.
        light_seed: Chooses the paths.
        scattering: Whether light goes through the tissue behind the wall, so that shadows and
            relief are soft and thin folds shine through: by random walks with path tracing, by rows
            of such walks kept for the wall with quick light; not with direct light.
        denoise: Whether Open Image Denoise filters light beyond the first reflection; only with
            path tracing. Needs `pip install 'vrcaps[denoise]'`.
        film_um: Thickness of the wet film on the wall [µm], 0 (dry) to 1000; by default that of the
            organ's own look, which is wet.
        imaging: White light of the capsule's LEDs, or narrow bands about 415 and 540 nm, in which
            vessels stand out.
    """

    supersampling: int = 1
    shadows: bool = False
    light: Light = "direct"
    samples: int = 16
    depth: int = 4
    light_seed: int = 0
    scattering: bool = False
    denoise: bool = False
    film_um: float | None = None
    imaging: Literal["white-light", "narrow-band"] = "white-light"

    @property
    def takes_means(self) -> bool:
        """Whether a pixel's colour is made of more than what its own ray sees."""
        return self.supersampling > 1 or self.denoise

    def __post_init__(self) -> None:
        if self.light not in get_args(Light):
            raise UnknownNameError("light", self.light, get_args(Light))
        if self.scattering and self.light == "direct":
            raise InputError("Scattering goes with light quick or path, not direct. Drop one.")
        film = 0.0 if self.film_um is None else self.film_um
        for name, value, valid, allowed in (
            ("Supersampling", self.supersampling, self.supersampling >= 1, "1, 2, 3, …"),
            ("Samples", self.samples, 1 <= self.samples <= 2**31, "1 to 2147483648"),
            ("Depth", self.depth, 1 <= self.depth <= 100, "1 to 100"),
            ("Film", film, 0.0 <= film <= THICKEST_UM, f"0 to {THICKEST_UM:g} [µm]"),
            ("Light seed", self.light_seed, 0 <= self.light_seed < 2**64, "0 to 2^64 − 1"),
        ):
            require(valid, name, value, allowed)
        if self.denoise and self.light != "path":
            raise InputError(
                f"Light {self.light!r} has no noise to take away. "
                "Drop denoise, or ask for light 'path'."
            )


RECORDED = RenderSettings(light="quick")
"""How recordings are rendered unless told otherwise."""
