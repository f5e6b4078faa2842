"""Figure of the quality of a lens fit."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from vrcaps.core.errors import import_extra
from vrcaps.core.units import DEG
from vrcaps.tools.camera_calibration.circle import ImageCircle
from vrcaps.tools.camera_calibration.fit import Calibration
from vrcaps.tools.report import make_figure

if TYPE_CHECKING:
    from vrcaps.tools.photos import Photo

_ACROSS = 5
"""Photographs per row."""


def write_report(
    path: Path, fit: Calibration, photos: Sequence[Photo], circle: ImageCircle | None
) -> None:
    """Draw each photograph with its corners, the residuals, and the lens curve.

    Args:
        path: Image file to write; its suffix is the format.
        fit: The lens.
        photos: Include those that the lens was fitted to.
        circle: Image circle of the photographs.
    """
    rows = -(-len(fit.views) // _ACROSS)
    fig = make_figure(15, 3.1 * rows + 5.2)
    parts = fig.add_gridspec(2, 1, height_ratios=(3.1 * rows, 5.2))
    upper, lower = fig.add_subfigure(parts[0]), fig.add_subfigure(parts[1])
    by_name = {photo.name: photo for photo in photos}
    axes = upper.subplots(rows, _ACROSS, squeeze=False).ravel()
    for k, axis in enumerate(axes):
        axis.set_axis_off()
        if k < len(fit.views):
            _draw_view(axis, fit, k, by_name[fit.views[k].name])
    arrows, radial, curve = lower.subplots(1, 3)
    _draw_arrows(arrows, fit, circle)
    _draw_radial(radial, fit)
    _draw_curve(curve, fit, circle)
    fig.savefig(path, dpi=90)


def _draw_view(axis, fit: Calibration, k: int, photo: Photo) -> None:
    view = fit.views[k]
    projected = (view.pixels - fit.residuals[k]).reshape(*fit.board.grid[::-1], 2)
    axis.imshow(photo.rgb)
    axis.plot(*projected[0].T, color="cyan", lw=0.8)  # the board's x axis
    axis.plot(*view.pixels.T, "o", ms=3.5, mfc="none", color="lime", mew=0.7)
    axis.plot(*projected.reshape(-1, 2).T, "+", ms=3.5, color="red", mew=0.7)
    method = "" if view.method == "plain" else f" ({view.method})"
    name = view.name if len(view.name) <= 26 else f"…{view.name[-25:]}"
    axis.set_title(f"{name}{method}\nmean {fit.errors[k].mean():.2f} px", fontsize=8)


def _draw_arrows(axis, fit: Calibration, circle: ImageCircle | None) -> None:
    Circle = import_extra("matplotlib.patches", "calibrate", package="matplotlib").Circle

    width, height = fit.size
    gain = 0.03 * width / max(float(np.median(fit.errors)), 1e-9)
    positions = np.concatenate([view.pixels for view in fit.views])
    moves = gain * fit.residuals.reshape(-1, 2)
    axis.quiver(*positions.T, *moves.T, angles="xy", scale_units="xy", scale=1.0, width=0.002)
    axis.plot(fit.lens.cx, fit.lens.cy, "r+", label="optical axis")
    if circle is not None:
        outline = Circle((circle.cx, circle.cy), circle.radius, fill=False, color="tab:blue")
        axis.add_patch(outline)
        axis.plot([], color="tab:blue", label=f"image circle, {circle.radius:.1f} px")
    axis.set(xlim=(-0.5, width - 0.5), ylim=(height - 0.5, -0.5), aspect="equal")
    axis.set_title(f"detected − projected, × {gain:.0f}")
    axis.legend(loc="lower left", fontsize=8)


def _draw_radial(axis, fit: Calibration) -> None:
    positions = np.concatenate([view.pixels for view in fit.views])
    away = positions - (fit.lens.cx, fit.lens.cy)
    radius = np.linalg.norm(away, axis=1)
    outward = np.sum(away * fit.residuals.reshape(-1, 2), axis=1) / np.maximum(radius, 1e-9)
    axis.plot(radius, fit.errors.ravel(), ".", ms=3, color="0.6", label="distance")
    axis.plot(radius, outward, ".", ms=3, color="tab:orange", label="radial component")
    edges = np.quantile(radius, np.linspace(0.0, 1.0, 11))
    ring = np.clip(np.searchsorted(edges, radius, side="right") - 1, 0, 9)
    middle = [radius[ring == k].mean() for k in range(10) if np.any(ring == k)]
    bias = [np.median(outward[ring == k]) for k in range(10) if np.any(ring == k)]
    axis.plot(middle, bias, "-", color="tab:red", label="median of the radial component")
    axis.axhline(0.0, color="black", lw=0.5)
    axis.set(xlabel="distance from the optical axis [px]", ylabel="residual [px]")
    axis.set_title(f"mean {fit.errors.mean():.3f} px, root mean square {fit.rms_px:.3f} px")
    axis.legend(fontsize=8)


def _draw_curve(axis, fit: Calibration, circle: ImageCircle | None) -> None:
    angle = np.linspace(0.0, 100.0, 401) * DEG
    rays = np.stack([np.sin(angle), np.zeros_like(angle), np.cos(angle)], axis=-1)
    radius = fit.lens.project(rays)[:, 0] - fit.lens.cx
    inside = radius <= 1.2 * max(fit.size)
    axis.plot(angle[inside] / DEG, radius[inside], color="tab:blue", label=fit.lens.kind)
    low, high = (float(end(fit.angles)) / DEG for end in (np.min, np.max))
    axis.axvspan(low, high, color="tab:green", alpha=0.15, label="angles of the corners")
    if circle is not None:
        edge = circle.radius_about(fit.lens.cx, fit.lens.cy)
        axis.axhline(edge, color="black", ls=":", label="image circle")
    axis.set(xlabel="angle to the optical axis [°]", ylabel="image radius [px]")
    axis.set_title("fitted lens")
    axis.legend(fontsize=8, loc="upper left")
