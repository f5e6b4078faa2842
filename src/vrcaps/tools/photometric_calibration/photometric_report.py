"""Figure of a photometric calibration."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from vrcaps.tools.photometric_calibration.calibrate_photometric import PhotometricCalibration
from vrcaps.tools.photometric_calibration.frames import Frames


def write_report(path: Path, calibration: PhotometricCalibration, frames: Frames) -> None:
    """Draw the mean frame with its circle, frames with masks, vignetting, color and noise.

    Args:
        path: Image file to write; its suffix is the format.
        calibration: The result.
        frames: Frames that it was estimated from.
    """
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(15, 9), layout="constrained")
    FigureCanvasAgg(figure)
    (circle, first, last), (vignette, color, noise) = figure.subplots(2, 3)
    _draw_circle(circle, calibration, frames)
    for axis, k in ((first, 0), (last, len(frames.rgb) // 2)):
        shown = frames.rgb[k].copy()
        shown[~frames.field[k]] //= 3
        shown[frames.field[k] & ~frames.exposed[k]] = (0, 255, 255)
        axis.imshow(shown)
        axis.set(xticks=[], yticks=[], title="dim: not looked at; cyan: over- or underexposed")
    _draw_vignetting(vignette, calibration)
    _draw_color(color, calibration, frames)
    _draw_noise(noise, calibration)
    figure.savefig(path, dpi=90)


def _draw_circle(axis, calibration: PhotometricCalibration, frames: Frames) -> None:
    from matplotlib.patches import Circle

    axis.imshow(frames.rgb.mean(axis=0).astype(np.uint8))
    axis.set(xticks=[], yticks=[], title="mean frame: no dark rim that is a circle")
    if calibration.circle is not None:
        found = calibration.circle
        axis.plot(*found.edge.T, ".", ms=2, color="lime")
        axis.set(xlim=axis.get_xlim(), ylim=axis.get_ylim())
        outline = Circle((found.cx, found.cy), found.radius, fill=False, color="cyan")
        axis.add_patch(outline)
        axis.set_title(f"mean frame: circle of {found.radius:.1f} px at {found.cx:.1f}, "
                       f"{found.cy:.1f}")  # fmt: skip


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
    axis.set_title("noise: hidden by coding")
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
