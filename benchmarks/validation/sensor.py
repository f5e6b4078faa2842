"""Claim: lens and sensor follow their formulas.

Measured on images alone, as in a laboratory: flat fields for the photon-transfer
curve, points and lines for the optics. Claimed: gain and read noise within 3 %.

    python -m benchmarks.validation.sensor
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np

from benchmarks.common.scripts import options, table, write_section
from vrcaps._core import testing
from vrcaps.camera.camera import Camera
from vrcaps.camera.derive import focal_length_px
from vrcaps.camera_pipeline.effect.base import CameraSetup
from vrcaps.camera_pipeline.effect.exposure import AutoExposure
from vrcaps.camera_pipeline.effect.optics import (
    Bloom,
    DepthOfField,
    LateralChromaticAberration,
    Vignetting,
)
from vrcaps.camera_pipeline.effects import SEVERITIES
from vrcaps.capsule.device_file import read_device
from vrcaps.core.units import MM
from vrcaps.render.flow import SUBSAMPLE

HEAD = ("quantity", "as set", "formula", "measured", "error")
BLACK = 3000
"""Far above the noise, so that no number is cut off."""
Row = tuple[str, str, str, str, str]


def row(what: str, given: str, expected: float, measured: float, unit: str = "") -> Row:
    """A line of the table, with the relative error."""
    error = f"{100.0 * (measured / expected - 1.0):+.2f} %"
    return what, given, f"{expected:.4g}{unit}", f"{measured:.4g}{unit}", error


def photon_transfer(camera: Camera, size: int) -> list[Row]:
    """Gain and read noise from pairs of flat fields (EMVA 1288, release 4.0, 2.4 and 6.6)."""
    rows = []
    for severity, gain in ((1, 1.0), (2, 1.0), (2, 4.0), (3, 1.0), (4, 1.0)):
        noise = replace(SEVERITIES["sensor_noise"][severity], bits=14, black_level=BLACK)
        pattern = noise.fixed_pattern((3 * size, size), 0)
        readout = noise.params(CameraSetup(camera))
        readout |= {"light": 1.0, "gain": gain, "response": (1.0, 1.0, 1.0)}
        mean, variance = [], []
        for k, value in enumerate(np.linspace(0.0, 0.7, 15) / gain):
            planes = np.full((3, size, size), value, np.float32)
            pair = [
                (2**14 - 1 - BLACK)
                * testing.read_sensor(planes, pattern, readout, None, (3, 2 * k + j)).astype(float)
                for j in (0, 1)
            ]
            mean.append((pair[0] + pair[1]).mean() / 2.0)
            variance.append((pair[0] - pair[1]).var() / 2.0)
        slope = np.polyfit(mean[1:], np.array(variance[1:]) - variance[0], 1)[0]
        read = np.sqrt(variance[0] - 1.0 / 12.0) / slope
        given = f"severity {severity}, gain {gain:g}"
        rows.append(row("system gain", given, noise.system_gain(gain), slope))
        rows.append(row("read noise", given, noise.read_noise, read, " e⁻"))
    return rows


def spread(plane: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Center and variance of an image along its columns and rows."""
    grid = np.stack(np.meshgrid(*(np.arange(n) for n in plane.shape[::-1])), axis=-1)
    weight = (plane / plane.sum())[..., None].astype(float)
    mean = (weight * grid).sum(axis=(0, 1))
    return mean, (weight * (grid - mean) ** 2).sum(axis=(0, 1))


def optics(camera: Camera) -> list[Row]:
    """Each lens stage on a point of light, or on an even field."""
    height, width = camera.height, camera.width
    setup, point = CameraSetup(camera), np.zeros((3, height, width), np.float32)
    point[:, 60, 220] = 1.0
    rows = []
    for distance in (5.0 * MM, 8.0 * MM, 60.0 * MM):
        stage = DepthOfField(2.0 * MM)
        far = np.full((height, width), distance, np.float32)
        seen = testing.depth_of_field(point, far, *stage.params(setup))[1]
        expected = 2.0 * float(stage.radius_px(camera, np.array(distance)))
        # A disk of diameter c has a variance of c²/16 along each axis, a pixel's edge 1/12.
        measured = 4.0 * np.sqrt(spread(seen)[1].mean() - 1.0 / 12.0)
        given = f"aperture 2 mm, focus 12 mm, at {distance / MM:g} mm"
        rows.append(row("circle of confusion", given, expected, measured, " px"))
    soft = np.exp(-0.5 * (((np.arange(320) - 60) / 2.0) ** 2))
    across = np.exp(-0.5 * (((np.arange(320) - 220) / 2.0) ** 2))
    spot = np.stack([np.outer(soft, across)] * 3).astype(np.float32)
    params = LateralChromaticAberration(0.01, -0.01).params(setup)
    colors = testing.chromatic_aberration(spot, *params)
    center = np.array([camera.lens.cx, camera.lens.cy])
    reach = float(np.linalg.norm(spread(spot[1])[0] - center))
    for name, plane, share in (("red", 0, 0.01), ("blue", 2, -0.01)):
        moved = float(np.linalg.norm(spread(colors[plane])[0] - center)) - reach
        given = f"{share:+g} at {reach:.1f} px"
        rows.append(row(f"lateral shift, {name}", given, share * reach, moved, " px"))
    even = np.ones((3, height, width), np.float32)
    shade = testing.vignetting(even, Vignetting((-0.4, 0.05, 0.0)).params(setup))[1]
    rho = np.hypot(*(np.array([300.0, 160.0]) - center)) / 160.0
    expected = 1.0 - 0.4 * rho**2 + 0.05 * rho**4
    rows.append(row("vignetting", f"severity 2, ρ = {rho:.3f}", expected, float(shade[160, 300])))
    middle = np.zeros((3, height, width), np.float32)
    middle[:, 160, 160] = 1.0
    stage = Bloom(0.2, 0.02)
    halo = testing.bloom(middle, *stage.params(setup))[1].astype(float)
    halo[160, 160] -= 0.8
    sigma = stage.angle * focal_length_px(camera.lens)
    rows.append(row("bloom, fraction", "0.2", 0.2, float(halo.sum())))
    wide = float(np.sqrt(spread(halo)[1].mean()))
    rows.append(row("bloom, width √8.5 σ", "σ 0.02 rad", sigma * np.sqrt(8.5), wide, " px"))
    return rows


def motion(camera: Camera) -> list[Row]:
    """Length of a streak, and tilt of a line under a rolling shutter."""
    height, width = camera.height, camera.width
    image = np.zeros((height, width, 3), np.float32)
    image[160, 160] = 1.0
    lit = np.ones((height, width), bool)
    cells = (height // SUBSAMPLE, width // SUBSAMPLE, 2)
    rows = []
    for speed, shutter in ((60.0, 0.1), (60.0, 0.3), (120.0, 0.3)):
        field = np.broadcast_to(np.float32([speed, 0.0]), cells).copy()
        seen = testing.motion_blur(image, lit, field, (shutter, 0.0, np.inf), 1.0)[0]
        length = np.sqrt(12.0 * spread(seen)[1][0])
        given = f"{speed:g} px a frame, open for {shutter:g} of it"
        rows.append(row("blur length √(12 var)", given, speed * shutter, float(length), " px"))
    line = np.zeros((height, width, 3), np.float32)
    line[:, 160] = 1.0
    field = np.broadcast_to(np.float32([30.0, 0.0]), cells).copy()
    seen = testing.motion_blur(line, lit, field, (0.0, 0.8, np.inf), 1.0)[1]
    middle = (seen * np.arange(width)).sum(axis=1) / seen.sum(axis=1)
    lean = np.polyfit(np.arange(height), middle, 1)[0] * height
    rows.append(row("lean, rolling shutter", "30 px a frame, 0.8 of it", 24.0, float(lean), " px"))
    return rows


def exposure() -> list[Row]:
    """Times after which the exposure of a static scene is within 1/e and 1 % of its target."""
    rows = []
    for constant in (0.3, 1.0, 5.0):
        automatic, exposures = AutoExposure(constant, min_light=1e-4), [1.0]
        while len(exposures) < 2000:
            exposures.append(
                automatic.next_exposure(exposures[-1], 0.9 * exposures[-1], 1.0 / 30.0)
            )
        left = np.abs(np.log(np.array(exposures) * 0.9 / automatic.target))
        settled = np.interp(-np.log(0.01), -np.log(left[:1000] / left[0]), np.arange(1000)) / 30.0
        given = f"τ {constant:g} s, 30 frames per second"
        rows.append(row("settled to 1 %", given, constant * np.log(100.0), float(settled), " s"))
    return rows


def main() -> None:
    """Measure, and write the section."""
    arguments = options(__doc__ or "", 320)
    camera = read_device("mirocam").cameras[0]
    measured = [
        *photon_transfer(camera, arguments.size),
        *optics(camera),
        *motion(camera),
        *exposure(),
    ]
    text = (
        "## Lens and sensor\n\n"
        "`python -m benchmarks.validation.sensor`: [stages of lens and sensor]"
        "(../concepts/effects.md) "
        f"against their formulas, from images of {arguments.size} x {arguments.size} sites (photon "
        "transfer, 14 bits) and of the MiroCam's camera.\n\n"
        f"{table(HEAD, measured)}\n"
    )
    write_section(arguments.out, Path(__file__), text)


if __name__ == "__main__":
    main()
