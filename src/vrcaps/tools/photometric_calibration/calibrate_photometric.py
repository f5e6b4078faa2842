"""A camera's figures from a folder of its frames, and a device that has them."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

from vrcaps.camera.camera import Camera, Led
from vrcaps.capsule.device import Device
from vrcaps.capsule.device_file import write_lines
from vrcaps.errors import InputError
from vrcaps.toml_table import toml_text
from vrcaps.tools.camera_calibration.circle import ImageCircle, image_circle
from vrcaps.tools.camera_calibration.device import find_camera, with_camera
from vrcaps.tools.photometric_calibration.frames import Frames
from vrcaps.tools.photometric_calibration.jpeg import blockiness
from vrcaps.tools.photometric_calibration.noise_model import NoiseLine, fit_noise
from vrcaps.tools.photometric_calibration.vignetting_profile import (
    Falloff,
    RadialProfile,
    WallColor,
    find_falloff,
    mean_share,
    radial_profile,
    wall_color,
)

_SAME_SHAPE = 0.02
"""Largest difference of the ratios of width and height of frames and camera."""


@dataclass(frozen=True)
class CameraMatch:
    """What frames say of the camera that took them.

    Attributes:
        size: Width and height of the frames [px].
        circle: Image circle in the frames, or None where no dark rim is seen.
        falloff: How the light falls towards the edge.
        profile: Radial brightness of the frames.
        reference_profile: That of reference frames, if any.
        color: Of the wall, or None where nothing is well exposed.
        gains: Red, green and blue relative to the reference's; 1 without one.
        brightness: Green light on the axis relative to the reference's; 1 without one.
        noise: Gain and read noise, or None where coding hides them.
        jpeg_quality: Of JPEG files, or None.
        blockiness: Step over the borders of 8 px over the step elsewhere.
    """

    size: tuple[int, int]
    circle: ImageCircle | None
    falloff: Falloff
    profile: RadialProfile
    reference_profile: RadialProfile | None
    color: WallColor | None
    gains: tuple[float, float, float]
    brightness: float
    noise: NoiseLine | None
    jpeg_quality: int | None
    blockiness: float


def match_camera(
    frames: Frames,
    camera: Camera,
    *,
    reference: Frames | None = None,
    jpeg_quality: int | None = None,
) -> CameraMatch:
    """Figures of the camera that took frames.

    Args:
        frames: Real ones.
        camera: Gives its size and its lens's centre.
        reference: Frames rendered with `camera` without effects, that all is compared with.
        jpeg_quality: Of the files.

    Raises:
        InputError: If frames have another shape than the camera's images.
    """
    centre = _centre(frames, camera)
    profile = radial_profile(frames, centre)
    aim_frames = None if reference is None else (reference, _centre(reference, camera))
    shaded = None if aim_frames is None else radial_profile(*aim_frames)
    falloff = find_falloff(frames, centre, aim_frames)
    color = wall_color(frames)
    aim = None if reference is None else wall_color(reference)
    gains, brightness = (1.0, 1.0, 1.0), 1.0
    if color is not None and aim is not None:
        gains = (color.red / aim.red, 1.0, color.blue / aim.blue)
        brightness = color.green / aim.green / mean_share(falloff, frames, centre)
    return CameraMatch(
        size=frames.size,
        circle=image_circle(list(frames.rgb)),
        falloff=falloff,
        profile=profile,
        reference_profile=shaded,
        color=color,
        gains=gains,
        brightness=brightness,
        noise=fit_noise(frames),
        jpeg_quality=jpeg_quality,
        blockiness=blockiness(frames.luminance, frames.field),
    )


def matched_device(pattern: Device, match: CameraMatch, *, camera: str | None = None) -> Device:
    """A device whose camera has the frames' image circle, colour and brightness.

    The circle is scaled to the camera's size; colour goes into the LEDs' intensities, brightness
    into the exposure.

    Raises:
        UnknownNameError: If the pattern has no such camera.
    """
    old = find_camera(pattern, camera)
    circle = old.image_circle_px
    if match.circle is not None:
        circle = match.circle.radius * old.width / match.size[0]
    leds = tuple(_tinted(led, match.gains) for led in old.leds)
    new = replace(old, image_circle_px=circle, leds=leds, exposure=old.exposure * match.brightness)
    source = (
        f"Image circle, colour of the LEDs and exposure of camera {old.name}: matched to frames. "
        f"All else as in {pattern.name}: {pattern.source.strip()}"
    )
    title = f"{pattern.title}, matched to frames"
    return replace(with_camera(pattern, old, new), title=title, source=source)


def write_effects(path: Path, match: CameraMatch, capsule: Path) -> None:
    """Write a scenario with the capsule and what its device cannot hold, as exact effects.

    Vignetting, noise and JPEG are left out where the frames show none.

    Args:
        path: TOML file to write.
        match: The figures.
        capsule: File of the matched device.

    Raises:
        InputError: If the file cannot be written.
    """
    lines = [f"capsule = {toml_text(str(capsule))}"]
    if match.falloff.is_clear:
        coefficients = [float(f"{k:.5g}") for k in (match.falloff.k1, match.falloff.k2, 0.0)]
        lines += ["", "[effects.vignette]", f"coefficients = {toml_text(coefficients)}"]
    if match.noise is not None:
        lines += ["", "[effects.noise]", f"full_well = {match.noise.full_well:.5g}"]
        lines += [f"read_noise = {match.noise.read_noise:.5g}"]
    if match.jpeg_quality is not None:
        lines += ["", "[effects.jpeg]", f"quality = {match.jpeg_quality}"]
    write_lines(path, lines)


def _centre(frames: Frames, camera: Camera) -> tuple[float, float]:
    """The lens's centre in frames that may be larger or smaller than the camera's images [px].

    Raises:
        InputError: If frames have another shape than the camera's images.
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
