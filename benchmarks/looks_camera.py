"""The cameras that take our frames beside real ones: lens, sensor and recorder of each class."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace

import numpy as np

from looks_images import disc
from looks_scenes import Shot, even_exposure
from vrcaps.camera_pipeline.effects import Effects
from vrcaps.camera_pipeline.exposure import AutoExposure
from vrcaps.camera_pipeline.pipeline import CameraChain, Moment, Seen
from vrcaps.camera_pipeline.sensor import Jpeg, WhiteBalance
from vrcaps.color import luminance
from vrcaps.render.frame import inside

MEAN_LUMINANCE = {True: 0.20, False: 0.15}
"""Linear luminance that an automatic exposure aims at, of colonoscopes and of capsules: the mean
of the real frames."""
EXPOSURE_SPREAD = 0.25
"""Deviation of its logarithm from frame to frame; 0.19 to 0.59 in the classes of real frames."""
WHITE_SPREAD = np.array([0.12, 0.0, 0.20])
"""Deviation of the logarithm of red, green and blue gain from frame to frame: real frames come
from many makers' cameras. Over classes the ratios of mean red and blue to green deviate by 0.12 to
0.48 and 0.06 to 0.55, medians 0.18 and 0.27; this is what patients do not account for."""
JPEG_QUALITY = {"clean_colon": 94, "polyp": 75, "colitis": 75}
"""Of the real files, by how their class begins; capsule frames are PNG files."""
EFFECTS = {
    True: Effects(chromatic=(0, 2), vignette=(0, 1), bloom=(0, 1), noise=(1, 2)),
    False: Effects(
        **{"depth_of_field": (0, 1), "chromatic": (0, 1), "vignette": (0, 2), "bloom": (0, 2)},
        **{"noise": (0, 1), "jpeg": (0, 1)},
        mosaic="rggb",
    ),
}
"""Of colonoscopes and of capsules: grades drawn for each frame, as each is another camera's. Those
of noise were chosen by gradients of all frames, the others beforehand."""
_LIT = AutoExposure(time_constant=1.0, light_max=1e9)
"""All of the exposure by light, none by gain."""


def is_colonoscopy(name: str) -> bool:
    """Whether a class of real frames was taken by colonoscopes."""
    return not name.startswith("capsule")


def our_discs(name: str, shots: Iterable[Shot]) -> list[np.ndarray]:
    """Frames of a class as sRGB discs, as a camera and its recorder would leave them."""
    return [disc(photographed(name, shot, number)) for number, shot in enumerate(shots)]


def photographed(name: str, shot: Shot, number: int) -> np.ndarray:
    """A frame of a class as its camera sends it.

    The mean luminance at the sensor, each pixel cut at white, is what automatic exposure aims at.
    """
    rng = np.random.default_rng([11, number])
    light = MEAN_LUMINANCE[is_colonoscopy(name)] * np.exp(EXPOSURE_SPREAD * rng.normal())
    gains = np.exp(WHITE_SPREAD * rng.normal(size=3))
    effects = drawn(name, gains, number)
    radiance = np.nan_to_num(shot.frame.radiance)
    shade = effects.figures("vignette")
    reaching = radiance if shade is None else radiance * shade.profile(shot.camera)[..., None]
    exposure = even_exposure(reaching * gains, light) / shot.camera.exposure
    chain = CameraChain(effects, shot.camera, number=0, fps=1.0, seed=number)
    moment = Moment(number, shot.state, exposure=exposure)
    planes = chain.room()
    inside(planes, *radiance.shape[:2])[...] = np.moveaxis(radiance, -1, 0)
    known = {name: array for name, array in vars(shot.frame).items() if array is not None}
    seen = Seen(known, planes, None, moment)
    sent = chain.apply(seen, shot.renderer)
    assert sent.rgb is not None
    return sent.rgb


def drawn(name: str, gains: np.ndarray, number: int) -> Effects:
    """Lens and sensor of one frame; white stays as bright as it is."""
    effects = EFFECTS[is_colonoscopy(name)].drawn(number)
    red, green, blue = (gains / luminance(gains)).tolist()
    quality = JPEG_QUALITY.get(name.partition("_grade")[0])
    return replace(
        effects,
        exposure=_LIT,
        white_balance=WhiteBalance((red, green, blue)),
        jpeg=effects.jpeg if quality is None else Jpeg(quality),
    )
