"""Photometric calibration of a camera from its frames: device and figure."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from vrcaps.camera.camera import Camera, Led
from vrcaps.capsule.device import Device
from vrcaps.capsule.image_chain import EQUAL_UNITS
from vrcaps.config.plain_files import write_toml
from vrcaps.core.errors import InputError, import_extra
from vrcaps.tools.camera_calibration.circle import ImageCircle, image_circle
from vrcaps.tools.camera_calibration.fit import find_camera, with_camera
from vrcaps.tools.photometric_calibration.frames import Frames, blockiness
from vrcaps.tools.photometric_calibration.models import (
    NoiseModel,
    RadialProfile,
    VignettingProfile,
    WallColor,
    fit_noise,
    fit_vignetting,
    mean_transmission,
    radial_profile,
    wall_color,
)
from vrcaps.tools.report import make_figure

_SAME_SHAPE = 0.02
"""Maximum difference of the aspect ratios of frames and camera."""


@dataclass(frozen=True)
class PhotometricCalibration:
    """Photometric parameters of a camera, estimated from its frames.

    Attributes:
        size: Width and height of the frames [px].
        circle: Image circle in the frames, or None if there is no dark rim.
        vignetting: Decrease of the light towards the edge.
        profile: Radial brightness of the frames.
        reference_profile: Radial brightness of the reference frames, if any.
        color: Color of the wall, or None if nothing is well exposed.
        gains: Red, green and blue relative to the reference; 1 without one.
        brightness: Green light on the axis relative to the reference; 1 without one.
        noise: Gain and read noise, or None if coding hides them.
        jpeg_quality: Of JPEG files, or None.
        blockiness: Step across the borders of 8 px blocks over the step elsewhere.
    """

    size: tuple[int, int]
    circle: ImageCircle | None
    vignetting: VignettingProfile
    profile: RadialProfile
    reference_profile: RadialProfile | None
    color: WallColor | None
    gains: tuple[float, float, float]
    brightness: float
    noise: NoiseModel | None
    jpeg_quality: int | None
    blockiness: float


def calibrate_photometric(
    frames: Frames,
    camera: Camera,
    *,
    reference: Frames | None = None,
    jpeg_quality: int | None = None,
) -> PhotometricCalibration:
    """Estimate the photometric parameters of a camera from its frames.

    Args:
        frames: Real frames.
        camera: Provides the size and the lens's center.
        reference: Frames rendered with `camera` without effects, for comparison.
        jpeg_quality: JPEG quality of the files.

    Raises:
        InputError: If the aspect ratio of the frames differs from the camera's.
    """
    center = _center(frames, camera)
    profile = radial_profile(frames, center)
    aim_frames = None if reference is None else (reference, _center(reference, camera))
    shaded = None if aim_frames is None else radial_profile(*aim_frames)
    vignetting = fit_vignetting(frames, center, aim_frames)
    color = wall_color(frames)
    aim = None if reference is None else wall_color(reference)
    gains, brightness = (1.0, 1.0, 1.0), 1.0
    if color is not None and aim is not None:
        gains = (color.red / aim.red, 1.0, color.blue / aim.blue)
        brightness = color.green / aim.green / mean_transmission(vignetting, frames, center)
    return PhotometricCalibration(
        size=frames.size,
        circle=image_circle(list(frames.rgb)),
        vignetting=vignetting,
        profile=profile,
        reference_profile=shaded,
        color=color,
        gains=gains,
        brightness=brightness,
        noise=fit_noise(frames),
        jpeg_quality=jpeg_quality,
        blockiness=blockiness(frames.luminance, frames.field),
    )


def photometric_device(
    pattern: Device, calibration: PhotometricCalibration, *, camera: str | None = None
) -> Device:
    """Copy of a device whose camera has the image circle, color and brightness of the frames.

    The circle is scaled to the camera's size; color is applied to the LEDs' intensities, brightness
    to the exposure. The device is one unit, so its image chain does not vary.

    Raises:
        UnknownNameError: If the pattern has no such camera.
    """
    old = find_camera(pattern, camera)
    circle = old.image_circle_px
    if calibration.circle is not None:
        circle = calibration.circle.radius * old.width / calibration.size[0]
    leds = tuple(_tinted(led, calibration.gains) for led in old.leds)
    new = replace(
        old, image_circle_px=circle, leds=leds, exposure=old.exposure * calibration.brightness
    )
    source = (
        f"Image circle, color of the LEDs and exposure of camera {old.name}: matched to frames. "
        f"All else as in {pattern.name}: {pattern.source.strip()}"
    )
    title = f"{pattern.title}, matched to frames"
    chain = pattern.image_chain
    chain = None if chain is None else replace(chain, variation=EQUAL_UNITS)
    device = with_camera(pattern, old, new)
    return replace(device, title=title, source=source, image_chain=chain)


def write_scenario(path: Path, calibration: PhotometricCalibration, capsule: Path) -> None:
    """Write a scenario with the capsule, and the effects that a device does not include.

    Vignetting, noise and JPEG are omitted if the frames show none.

    Args:
        path: TOML file to write.
        calibration: The result.
        capsule: File of the calibrated device.

    Raises:
        InputError: If the file cannot be written.
    """
    effects: dict[str, Any] = {}
    if calibration.vignetting.is_clear:
        k1, k2 = calibration.vignetting.k1, calibration.vignetting.k2
        effects["vignetting"] = {"coefficients": [float(f"{k:.5g}") for k in (k1, k2, 0.0)]}
    if calibration.noise is not None:
        noise = calibration.noise
        effects["sensor_noise"] = {
            "full_well": float(f"{noise.full_well:.5g}"),
            "read_noise": float(f"{noise.read_noise:.5g}"),
        }
    if calibration.jpeg_quality is not None:
        effects["jpeg"] = {"quality": calibration.jpeg_quality}
    plain = {"capsule": str(capsule)} | ({"effects": effects} if effects else {})
    write_toml(path, plain, "scenario")


def _center(frames: Frames, camera: Camera) -> tuple[float, float]:
    """Lens center in frames that may be larger or smaller than the camera's images [px].

    Raises:
        InputError: If the aspect ratio of the frames differs from the camera's.
    """
    width, height = frames.size
    across, down = width / camera.width, height / camera.height
    if abs(across / down - 1.0) > _SAME_SHAPE:
        raise InputError(
            f"The frames have {width} × {height} px, camera {camera.name} {camera.width} × "
            f"{camera.height}. Allowed: frames of the same shape, not cropped."
        )
    return (camera.lens.cx + 0.5) * across - 0.5, (camera.lens.cy + 0.5) * down - 0.5


def _tinted(led: Led, gains: tuple[float, float, float]) -> Led:
    red, green, blue = (i * g for i, g in zip(led.intensity, gains, strict=True))
    return replace(led, intensity=(red, green, blue))


def write_report(path: Path, calibration: PhotometricCalibration, frames: Frames) -> None:
    """Draw the mean frame with its circle, frames with masks, vignetting, color and noise.

    Args:
        path: Image file to write; its suffix is the format.
        calibration: The result.
        frames: Frames that it was estimated from.
    """
    fig = make_figure(15, 9)
    (circle, first, last), (vignette, color, noise) = fig.subplots(2, 3)
    _draw_circle(circle, calibration, frames)
    for axis, k in ((first, 0), (last, len(frames.rgb) // 2)):
        displayed = frames.rgb[k].copy()
        displayed[~frames.field[k]] //= 3
        displayed[frames.field[k] & ~frames.exposed[k]] = (0, 255, 255)
        axis.imshow(displayed)
        axis.set(xticks=[], yticks=[], title="dim: masked; cyan: over- or underexposed")
    _draw_vignetting(vignette, calibration)
    _draw_color(color, calibration, frames)
    _draw_noise(noise, calibration)
    fig.savefig(path, dpi=90)


def _draw_circle(axis, calibration: PhotometricCalibration, frames: Frames) -> None:
    Circle = import_extra("matplotlib.patches", "calibrate", package="matplotlib").Circle

    axis.imshow(frames.rgb.mean(axis=0).astype(np.uint8))
    axis.set(xticks=[], yticks=[], title="mean frame: no circular dark rim detected")
    if calibration.circle is not None:
        circle_fit = calibration.circle
        axis.plot(*circle_fit.edge.T, ".", ms=2, color="lime")
        axis.set(xlim=axis.get_xlim(), ylim=axis.get_ylim())
        outline = Circle(
            (circle_fit.cx, circle_fit.cy), circle_fit.radius, fill=False, color="cyan"
        )
        axis.add_patch(outline)
        axis.set_title(f"mean frame: circle of {circle_fit.radius:.1f} px at {circle_fit.cx:.1f}, "
                       f"{circle_fit.cy:.1f}")  # fmt: skip


def _draw_vignetting(axis, calibration: PhotometricCalibration) -> None:
    axis.plot(
        calibration.profile.radius, calibration.profile.brightness, "o-", ms=3, label="frames"
    )
    if calibration.reference_profile is not None:
        reference = calibration.reference_profile
        axis.plot(reference.radius, reference.brightness, "s-", ms=3, label="reference")
    radius = np.linspace(0.0, calibration.profile.radius[-1], 100)
    k1, k2 = calibration.vignetting.k1, calibration.vignetting.k2
    vignetting = 1.0 + k1 * radius**2 + k2 * radius**4
    axis.plot(radius, vignetting, "k-", label=f"1 {k1:+.3f} ρ² {k2:+.3f} ρ⁴")
    axis.set(xlabel="distance from the axis, halves of the shorter side", ylim=(0.0, None))
    axis.set_title("brightness by radius, and vignetting")
    axis.legend(fontsize=8)


def _draw_color(axis, calibration: PhotometricCalibration, frames: Frames) -> None:
    for channel, name in enumerate(("red", "green", "blue")):
        values = frames.rgb[..., channel][frames.field]
        counts = np.bincount(values, minlength=256) / max(values.size, 1)
        axis.plot(counts, color=f"tab:{name}", label=name)
    axis.set(xlabel="code value", ylabel="fraction of pixels", ylim=(0.0, None))
    color = calibration.color
    words = "" if color is None else f": R/G {color.red:.2f}, B/G {color.blue:.2f} linear"
    axis.set_title(f"color{words}")
    axis.legend(fontsize=8)


def _draw_noise(axis, calibration: PhotometricCalibration) -> None:
    axis.set(xlabel="linear brightness, 1 = white", ylabel="variance of the noise")
    axis.set_title("noise: hidden by compression")
    if calibration.noise is not None:
        noise = calibration.noise
        level = np.linspace(0.0, noise.brightness.max(), 50)
        line = level / noise.full_well + (noise.read_noise / noise.full_well) ** 2
        axis.plot(noise.brightness, noise.variance, "o", ms=4)
        axis.plot(level, line, "k-")
        axis.set(ylim=(0.0, None))
        axis.set_title(
            f"noise: full well {noise.full_well:.0f} e, read noise {noise.read_noise:.1f} e"
        )
