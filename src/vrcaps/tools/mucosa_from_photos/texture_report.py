"""Figure of the steps from photographs to a texture."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from vrcaps.core.color import srgb_from_log_linear
from vrcaps.core.units import MM

if TYPE_CHECKING:
    from pathlib import Path

    from vrcaps.tools.mucosa_from_photos.make_texture import TextureResult
    from vrcaps.tools.mucosa_from_photos.patches import PhotoAnalysis

_TINTS = {"highlight": (0, 255, 255), "dark": (30, 30, 200), "vessel": (0, 255, 0)}
_CLOSE = 320  # texels of the close-up


def write_report(path: Path, work: TextureResult) -> None:
    """Draw photographs with masks and regions, and the texture in full and close up.

    Args:
        path: Image file to write; its suffix is the format.
        work: Result of `make_texture`.
    """
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    rows = len(work.sources)
    figure = Figure(figsize=(13, 3.3 * rows + 7.0), layout="constrained")
    FigureCanvasAgg(figure)
    parts = figure.add_gridspec(2, 1, height_ratios=(3.3 * rows, 7.0))
    upper, lower = figure.add_subfigure(parts[0]), figure.add_subfigure(parts[1])
    grid = upper.subplots(rows, 4, squeeze=False)
    for axes, source in zip(grid, work.sources, strict=True):
        _draw_source(axes, source)
    far, near, vessels = lower.subplots(1, 3, width_ratios=(2, 2, 1))
    side = 2.0 * work.texture.side / MM
    far.imshow(np.tile(work.texture.albedo[::4, ::4], (2, 2, 1)), extent=(0, side, side, 0))
    far.set(title="texture, laid 2 × 2", xlabel="mm")
    close = min(_CLOSE, len(work.texture.albedo))
    side = close * work.texture.texel / MM
    near.imshow(work.texture.albedo[:close, :close], extent=(0, side, side, 0))
    near.set(title="texture, near", xlabel="mm")
    vessels.imshow(-work.vessel_density[::4, ::4], cmap="gray", vmax=0.0)
    vessels.set(title="vessels laid on", xticks=[], yticks=[])
    figure.savefig(path, dpi=90)


def _draw_source(axes, source: PhotoAnalysis) -> None:
    """Draw one photograph: original, masks, without shading, vessels."""
    from matplotlib.patches import Rectangle

    rgb, view, region = source.photo.rgb, source.view, source.region
    masked = rgb.copy()
    masked[~view.field] //= 3
    masked[view.highlight] = _TINTS["highlight"]
    masked[view.dark] = _TINTS["dark"]
    even = srgb_from_log_linear(source.flat + source.color)
    even[~view.field] = 0
    veined = even.copy()
    veined[source.vessels.mask] = _TINTS["vessel"]
    titles = (
        source.photo.name if len(source.photo.name) <= 28 else f"{source.photo.name[:25]}…",
        "highlights, darkness, region",
        "under even light",
        f"{len(source.vessels.pieces)} pieces of vessels",
    )
    for axis, image, title in zip(axes, (rgb, masked, even, veined), titles, strict=True):
        axis.imshow(image)
        axis.set(xticks=[], yticks=[])
        axis.set_title(title, fontsize=9)
        corner = (region.column - 0.5, region.row - 0.5)
        axis.add_patch(Rectangle(corner, region.side, region.side, fill=False, color="lime"))
