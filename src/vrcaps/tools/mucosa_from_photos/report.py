"""Quality metrics of a texture, and a figure of the steps from photographs to texture."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import TYPE_CHECKING

import numpy as np

from vrcaps.core.color import lab_from_srgb, srgb_from_log_linear
from vrcaps.core.units import MM
from vrcaps.tools.photos import highlights
from vrcaps.tools.report import make_figure

if TYPE_CHECKING:
    from pathlib import Path

    from jaxtyping import Float, UInt8

    from vrcaps.tools.mucosa_from_photos.patches import PhotoAnalysis
    from vrcaps.tools.mucosa_from_photos.texture import TextureResult

_BINS = np.linspace(0.0, 30.0, 61)  # bins of gradients in L* per texel


@dataclass(frozen=True)
class TextureQuality:
    """Comparison of a texture with its source regions.

    Attributes:
        seam_ratio: Mean step across the wrapped edges over that inside.
        lab_mean_source: Mean L*, a*, b* of the regions.
        lab_mean_texture: Mean L*, a*, b* of the texture.
        lab_std_source: Standard deviation of L*, a*, b* of the regions.
        lab_std_texture: Standard deviation of L*, a*, b* of the texture.
        gradient_distance: Difference of the histograms of steps in L* between neighbors: half
            the sum of absolute differences, 0 (same) to 1.
        repetition: Highest autocorrelation of L* beyond the reach of a patch, 0 to 1; a repeated
            texture has 1.
        highlight_fraction: Fraction of the texels detected as highlights.
    """

    seam_ratio: float
    lab_mean_source: tuple[float, ...]
    lab_mean_texture: tuple[float, ...]
    lab_std_source: tuple[float, ...]
    lab_std_texture: tuple[float, ...]
    gradient_distance: float
    repetition: float
    highlight_fraction: float

    def record(self) -> dict:
        """Convert to plain values, rounded."""
        return {
            name: [round(v, 2) for v in value] if isinstance(value, tuple) else round(value, 5)
            for name, value in asdict(self).items()
        }


def texture_quality(
    texture: UInt8[np.ndarray, "n n 3"], sources: list[UInt8[np.ndarray, "s s 3"]]
) -> TextureQuality:
    """Compare a texture, before vessels are placed, with its sources."""
    colors = lab_from_srgb(texture)
    regions = [lab_from_srgb(source) for source in sources]
    pixels = np.concatenate([region.reshape(-1, 3) for region in regions])
    flat = colors.reshape(-1, 3)
    everywhere = np.ones(texture.shape[:2], bool)
    return TextureQuality(
        seam_ratio=seam_ratio(colors),
        lab_mean_source=_plain(pixels.mean(axis=0)),
        lab_mean_texture=_plain(flat.mean(axis=0)),
        lab_std_source=_plain(pixels.std(axis=0)),
        lab_std_texture=_plain(flat.std(axis=0)),
        gradient_distance=_gradient_distance(colors, regions),
        repetition=repetition(colors[..., 0], reach=len(sources[0])),
        highlight_fraction=float(highlights(texture, everywhere, len(texture)).mean()),
    )


def seam_ratio(image: Float[np.ndarray, "n m c"]) -> float:
    """Mean absolute step across the two wrapped edges over that between inner neighbors."""
    seams, inner = [], []
    for axis in (0, 1):
        step = np.diff(image, axis=axis, append=np.take(image, [0], axis=axis))
        seams.append(np.take(step, [-1], axis=axis).ravel())
        inner.append(np.delete(step, -1, axis=axis).ravel())
    seam, inside = (float(np.abs(np.concatenate(part)).mean()) for part in (seams, inner))
    return seam / inside if inside > 0.0 else 1.0


def repetition(image: Float[np.ndarray, "n n"], *, reach: int) -> float:
    """Highest autocorrelation at shifts longer than `reach` [px], without slow variation.

    Computed by the Wiener-Khinchin theorem with periodic boundaries.
    """
    power = np.abs(np.fft.rfft2(image - image.mean())) ** 2
    rows, columns = np.fft.fftfreq(len(image)), np.fft.rfftfreq(len(image))
    power[np.hypot(rows[:, None], columns[None]) < 0.5 / reach] = 0.0
    correlation = np.fft.irfft2(power, image.shape)
    shift = np.abs(np.fft.fftfreq(len(image), 1.0 / len(image)))
    far = np.hypot(shift[:, None], shift[None]) > reach
    if not far.any() or correlation[0, 0] <= 0.0:
        return 0.0
    return float(correlation[far].max() / correlation[0, 0])


def _gradient_distance(texture, regions) -> float:
    def histogram(images) -> np.ndarray:
        steps = [
            np.abs(np.diff(image[..., 0], axis=axis)).ravel() for image in images for axis in (0, 1)
        ]
        counts, _ = np.histogram(np.concatenate(steps), _BINS)
        return counts / counts.sum()

    return float(0.5 * np.abs(histogram([texture]) - histogram(regions)).sum())


def _plain(values: np.ndarray) -> tuple[float, ...]:
    return tuple(float(value) for value in values)


_TINTS = {"highlight": (0, 255, 255), "dark": (30, 30, 200), "vessel": (0, 255, 0)}
_CLOSE = 320  # texels of the close-up


def write_report(path: Path, work: TextureResult) -> None:
    """Draw photographs with masks and regions, and the texture in full and close up.

    Args:
        path: Image file to write; its suffix is the format.
        work: Result of `make_texture`.
    """
    rows = len(work.sources)
    figure = make_figure(13, 3.3 * rows + 7.0)
    parts = figure.add_gridspec(2, 1, height_ratios=(3.3 * rows, 7.0))
    upper, lower = figure.add_subfigure(parts[0]), figure.add_subfigure(parts[1])
    grid = upper.subplots(rows, 4, squeeze=False)
    for axes, source in zip(grid, work.sources, strict=True):
        _draw_source(axes, source)
    far, near, vessels = lower.subplots(1, 3, width_ratios=(2, 2, 1))
    side = 2.0 * work.texture.side / MM
    far.imshow(np.tile(work.texture.albedo[::4, ::4], (2, 2, 1)), extent=(0, side, side, 0))
    far.set(title="texture, tiled 2 × 2", xlabel="mm")
    close = min(_CLOSE, len(work.texture.albedo))
    side = close * work.texture.texel / MM
    near.imshow(work.texture.albedo[:close, :close], extent=(0, side, side, 0))
    near.set(title="texture, close-up", xlabel="mm")
    vessels.imshow(-work.vessel_density[::4, ::4], cmap="gray", vmax=0.0)
    vessels.set(title="vessels placed", xticks=[], yticks=[])
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
        "shading removed",
        f"{len(source.vessels.pieces)} vessel pieces",
    )
    for axis, image, title in zip(axes, (rgb, masked, even, veined), titles, strict=True):
        axis.imshow(image)
        axis.set(xticks=[], yticks=[])
        axis.set_title(title, fontsize=9)
        corner = (region.column - 0.5, region.row - 0.5)
        axis.add_patch(Rectangle(corner, region.side, region.side, fill=False, color="lime"))
