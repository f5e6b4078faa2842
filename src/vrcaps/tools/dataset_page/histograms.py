"""Histograms of a data set by split: depth, brightness, speed of the capsule."""

from __future__ import annotations

import io
from collections.abc import Mapping
from typing import TYPE_CHECKING

import numpy as np

from vrcaps.core.units import MM
from vrcaps.recording.frame_sequence import SPLITS
from vrcaps.tools.dataset_page.sample import Sample

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from numpy.typing import NDArray

SPLIT_COLORS = {"train": "#3b6fb6", "val": "#e0982f", "test": "#1a8a4a"}

_SIZE_INCH, _DPI = (12.8, 3.4), 110
_BINS = 48
_HIGHEST = 99.5
"""Percentile at which an open axis ends; larger values count in the last bin."""


def histogram_picture(sample: Sample) -> bytes:
    """Draw the three histograms side by side, as a PNG."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=_SIZE_INCH, layout="constrained")
    FigureCanvasAgg(figure)
    views = figure.subplots(1, 3)
    _draw(views[0], _pixels(sample, "depth", MM), "depth [mm]", "share of pixels [%]")
    _draw(views[1], _pixels(sample, "brightness", 1.0), "gray level", "share of pixels [%]", 255.0)
    _draw(views[2], _speeds(sample), "speed of the capsule [mm/s]", "share of frames [%]")
    handles = views[2].get_legend_handles_labels()
    figure.legend(*handles, loc="outside upper center", ncols=len(SPLITS), frameon=False)
    picture = io.BytesIO()
    figure.savefig(picture, dpi=_DPI)
    return picture.getvalue()


def _pixels(sample: Sample, name: str, unit: float) -> dict[str, NDArray]:
    """Values of sampled pixels of each split, in the given unit."""
    found = {split: [np.zeros(0)] for split in SPLITS}
    for shot in sample.shots:
        found[shot.member.split].append(getattr(shot, name) / unit)
    return {split: np.concatenate(values) for split, values in found.items()}


def _speeds(sample: Sample) -> dict[str, NDArray]:
    """Speeds of each split [mm/s]."""
    none, speeds = np.zeros(0), sample.speeds
    return {
        split: np.concatenate([none, *(speed / MM for name, speed in speeds if name == split)])
        for split in SPLITS
    }


def _draw(
    view: Axes,
    values: Mapping[str, NDArray],
    label: str,
    share: str,
    highest: float | None = None,
) -> None:
    """Draw an outline for each split that has values."""
    together = np.concatenate([*values.values()])
    view.set(xlabel=label, ylabel=share)
    if not together.size:
        view.text(0.5, 0.5, "not recorded", ha="center", transform=view.transAxes, color="#777777")
        view.set(xticks=(), yticks=())
        return
    end = highest or float(np.percentile(together, _HIGHEST)) * 1.05 or 1.0
    edges = np.linspace(0.0, end, _BINS + 1)
    for split, own in values.items():
        if own.size:
            counts, _ = np.histogram(np.minimum(own, end), edges)
            color = SPLIT_COLORS[split]
            view.stairs(100.0 * counts / own.size, edges, color=color, lw=1.6, label=split)
            view.stairs(100.0 * counts / own.size, edges, color=color, alpha=0.12, fill=True)
    view.set(xlim=(0.0, end), ylim=(0.0, None))
    view.grid(alpha=0.3)
