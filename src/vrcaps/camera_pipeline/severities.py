"""Grades 0 (none) to 4 (strong) of every effect, in figures: the one table of them."""

from __future__ import annotations

from typing import Any

from vrcaps.camera_pipeline.camera_changes import Distortion, FieldOfView, Film, Resolution
from vrcaps.camera_pipeline.dome import Droplets, Smears
from vrcaps.camera_pipeline.exposure import AutoExposure
from vrcaps.camera_pipeline.optics import (
    Bloom,
    Defocus,
    LateralColor,
    MotionBlur,
    RollingShutter,
    Vignetting,
)
from vrcaps.camera_pipeline.sensor import Jpeg, Noise, WhiteBalance
from vrcaps.units import MM

GRADES: dict[str, tuple[Any, ...]] = {
    "specular": (
        Film(0.0, ior=1.0),
        Film(0.05, ior=1.15),
        Film(0.2, ior=1.3),
        Film(0.5, ior=1.45),
        Film(1.0, ior=1.7),
    ),
    "bubbles": (0, 1, 2, 4, 9),
    "field_of_view": (None, *(FieldOfView(m) for m in (1.2, 1.45, 1.75, 2.1))),
    "distortion": (None, *(Distortion(d) for d in (0.1, 0.2, 0.3, 0.4))),
    "resolution": (None, *(Resolution(s) for s in (0.75, 0.5, 0.375, 0.25))),
    "motion_blur": (None, *(MotionBlur(1e-3 * t) for t in (10.0, 25.0, 50.0, 100.0))),
    "rolling_shutter": (None, *(RollingShutter(1e-3 * t) for t in (30.0, 80.0, 160.0, 300.0))),
    "depth_of_field": (None, *(Defocus(a * MM) for a in (0.2, 0.5, 1.0, 2.0))),
    "droplets": (
        None,
        Droplets(3, radius=0.4 * MM),
        Droplets(6, radius=0.45 * MM),
        Droplets(11, radius=0.5 * MM),
        Droplets(18, radius=0.6 * MM),
    ),
    "smears": (
        None,
        Smears(0.015 * MM, cover=0.25),
        Smears(0.03 * MM, cover=0.4),
        Smears(0.06 * MM, cover=0.55),
        Smears(0.12 * MM, cover=0.7),
    ),
    "chromatic": (None, *(LateralColor(s, -s) for s in (0.002, 0.005, 0.01, 0.02))),
    "vignette": (
        None,
        Vignetting((-0.2, 0.02, 0.0)),
        Vignetting((-0.4, 0.05, 0.0)),
        Vignetting((-0.6, 0.1, 0.0)),
        Vignetting((-0.8, 0.16, 0.0)),
    ),
    "bloom": (None, *(Bloom(s) for s in (0.03, 0.08, 0.16, 0.3))),
    "exposure": (None, *(AutoExposure(t) for t in (0.3, 1.0, 2.0, 5.0))),
    "noise": (
        None,
        Noise(12000.0, 4.0, prnu=0.005, dsnu=1.0),
        Noise(5000.0, 8.0, prnu=0.01, dsnu=3.0),
        Noise(2000.0, 12.0, prnu=0.02, dsnu=6.0),
        Noise(700.0, 16.0, prnu=0.03, dsnu=10.0),
    ),
    "white_balance": (
        None,
        WhiteBalance((1.04, 1.0, 0.96)),
        WhiteBalance((1.08, 1.0, 0.9)),
        WhiteBalance((1.15, 1.0, 0.8)),
        WhiteBalance((1.25, 1.0, 0.65)),
    ),
    "jpeg": (None, *(Jpeg(q) for q in (90, 75, 50, 25))),
}
"""Figures of each effect by grade; None is an ideal camera. `bubbles` are those on each round end
of the capsule."""

HIGHEST = 4
