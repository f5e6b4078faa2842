"""Cameras of simulated and real frames: lens, sensor and recorder of each class."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace

import numpy as np

from benchmarks.appearance.images import disc
from benchmarks.appearance.scenes import Shot, even_exposure
from vrcaps.camera_pipeline.effect.base import CameraSetup
from vrcaps.camera_pipeline.effect.exposure import AutoExposure
from vrcaps.camera_pipeline.effect.processing import Jpeg, WhiteBalance
from vrcaps.camera_pipeline.effect.sensor import BayerFilter
from vrcaps.camera_pipeline.effects import Effects
from vrcaps.camera_pipeline.pipeline import CameraPipeline, SceneRadiance
from vrcaps.core.color import luminance
from vrcaps.motion.motion import Step
from vrcaps.render.sampling import crop_margin

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
"""JPEG quality of the real files, by the prefix of their class; capsule frames are PNG files."""
EFFECTS = {
    True: Effects(
        chromatic_aberration=(0, 2), vignetting=(0, 1), bloom=(0, 1), sensor_noise=(1, 2)
    ),
    False: Effects(
        **{
            "depth_of_field": (0, 1),
            "chromatic_aberration": (0, 1),
            "vignetting": (0, 2),
            "bloom": (0, 2),
        },
        **{"sensor_noise": (0, 1), "jpeg": (0, 1)},
        bayer_filter=BayerFilter("rggb"),
    ),
}
"""Effects of colonoscopes (True) and capsules: severities sampled for each frame.
Those of noise were chosen by gradients of all frames, the others beforehand."""
_LIT = AutoExposure(time_constant=1.0, max_light=1e9)
"""All of the exposure by light, none by gain."""


def is_colonoscopy(name: str) -> bool:
    """Return whether a class of real frames was taken by colonoscopes."""
    return not name.startswith("capsule")


def our_discs(name: str, shots: Iterable[Shot]) -> list[np.ndarray]:
    """Frames of a class as sRGB discs, processed by a camera and its recorder."""
    return [disc(photographed(name, shot, number)) for number, shot in enumerate(shots)]


def photographed(name: str, shot: Shot, number: int) -> np.ndarray:
    """Frame of a class as transmitted by its camera.

    Automatic exposure aims at the mean luminance at the sensor, with pixels clipped at white.
    """
    rng = np.random.default_rng([11, number])
    light = MEAN_LUMINANCE[is_colonoscopy(name)] * np.exp(EXPOSURE_SPREAD * rng.normal())
    gains = np.exp(WHITE_SPREAD * rng.normal(size=3))
    effects = effects_of(name, gains, number)
    radiance = np.nan_to_num(shot.frame.radiance)
    shade = effects.resolve("vignetting")
    reaching = (
        radiance if shade is None else radiance * shade.params(CameraSetup(shot.camera))[..., None]
    )
    exposure = even_exposure(reaching * gains, light) / shot.camera.exposure
    pipeline = CameraPipeline(shot.renderer, shot.camera, effects, fps=1.0, seed=number)
    planes = pipeline.allocate_planes()
    crop_margin(planes, *radiance.shape[:2])[...] = np.moveaxis(radiance, -1, 0)
    known = {name: array for name, array in vars(shot.frame).items() if array is not None}
    seen = SceneRadiance(Step(number, shot.state), known, planes)
    sent = pipeline.process(seen, exposure)
    assert sent.rgb is not None
    return sent.rgb


def effects_of(name: str, gains: np.ndarray, number: int) -> Effects:
    """Apply lens and sensor to one frame; the level of white is unchanged."""
    effects = EFFECTS[is_colonoscopy(name)].sample(number)
    red, green, blue = (gains / luminance(gains)).tolist()
    quality = JPEG_QUALITY.get(name.partition("_grade")[0])
    return replace(
        effects,
        auto_exposure=_LIT,
        white_balance=WhiteBalance((red, green, blue)),
        jpeg=effects.jpeg if quality is None else Jpeg(quality),
    )
