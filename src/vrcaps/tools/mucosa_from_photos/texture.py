"""Mucosa texture from endoscopic photographs: image quilting, relief, roughness and vessels."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Annotated, Any

import numpy as np
import scipy

from vrcaps.core.color import LUMINANCE, log_luminance, srgb_from_log_linear
from vrcaps.core.errors import InputError, import_extra, require
from vrcaps.core.fields import Range, check_fields
from vrcaps.core.processes import ProgressReport, no_report
from vrcaps.core.rng import MAX_SEED, stream
from vrcaps.core.units import MM
from vrcaps.mucosa.texture import HEIGHT_STEP, MucosaTexture
from vrcaps.tools.mucosa_from_photos.patches import (
    PhotoAnalysis,
    PhotoScale,
    analyze_photo,
    check_scale,
    choose,
    source_patches,
)
from vrcaps.tools.mucosa_from_photos.quilt import Quilt, quilt, texture_quality, variants
from vrcaps.tools.mucosa_from_photos.vessels import VesselPiece, VesselPlacement, place_vessels
from vrcaps.tools.report import make_figure

if TYPE_CHECKING:
    from pathlib import Path

    from jaxtyping import Float

    from vrcaps.tools.photos import Photo

RELIEF_SLOPE = 0.08
"""RMS slope of the relief; a single image lit from the lens does not determine it."""

ROUGHNESS = 0.65
"""Mean perceptual roughness of the wall under its mucus film."""

_ROUGHNESS_SPREAD = 0.04  # hollows hold more mucus and are smoother
_MAX_SCALE = 0.6e-3  # standard deviation of the low-pass above which color is not relief [m]


def relief(
    log_light: Float[np.ndarray, "n n 3"], texel: float
) -> tuple[Float[np.ndarray, "n n"], Float[np.ndarray, "n n"]]:
    """Estimate height [m] and roughness: darker parts lie deeper.

    With the lamp next to the lens, a pit is darker than its surroundings whichever way it faces, so
    band-passed log brightness approximates height (Glencross et al. 2008, A perceptually validated
    model for surface depth hallucination, ACM Trans. Graph. 27(3)). Its amplitude gives an RMS
    slope of `RELIEF_SLOPE`.

    Args:
        log_light: Logarithm of reflectance without vessels; tileable.
        texel: Side of a texel [m].
    """
    bright = log_luminance(log_light)
    fine = scipy.ndimage.gaussian_filter(bright, 0.8, mode="wrap")
    fine = fine - scipy.ndimage.gaussian_filter(bright, max(2.0, _MAX_SCALE / texel), mode="wrap")
    slope = np.hypot(*(np.roll(fine, -1, axis) - fine for axis in (0, 1))) / texel
    steepness = float(np.sqrt(np.mean(slope**2)))
    height = fine * (RELIEF_SLOPE / steepness if steepness > 0.0 else 0.0)
    depth = np.clip(fine / max(2.0 * float(fine.std()), 1e-9), -1.0, 1.0)
    return height.astype(np.float32), (ROUGHNESS + _ROUGHNESS_SPREAD * depth).astype(np.float32)


_TINTS = {"highlight": (0, 255, 255), "dark": (30, 30, 200), "vessel": (0, 255, 0)}
_CLOSE = 320  # texels of the close-up
_MAX_RED = 0.92  # 99th percentile of linear red light over the texels, at most


@dataclass(frozen=True)
class TextureOptions:
    """Settings of the texture.

    Attributes:
        size: Side of the texture [texels].
        luminance: Mean reflectance; photographs do not contain it, as cameras adapt exposure.
            0.30 is that of the built-in colon.
        max_sources: Maximum number of photographs whose regions are mixed.
        vessels: Whether to remove vessels from the ground and place them again on top.
        placement: Distribution of the placed vessels.
        is_flat: Whether the images are textures already, without border, highlights, shading.
        box: Left, top, width, height [px] of the region to use instead of the most uniform one.
    """

    size: Annotated[int, Range(128, 8192)] = 2048
    luminance: Annotated[float, Range(0.02, 0.8)] = 0.30
    max_sources: Annotated[int, Range(min=1)] = 4
    vessels: bool = True
    placement: VesselPlacement = field(default_factory=VesselPlacement)
    is_flat: bool = False
    box: tuple[int, int, int, int] | None = None

    def __post_init__(self) -> None:
        check_fields(self, of="TextureOptions")


@dataclass(frozen=True)
class TextureResult:
    """Texture and its sources.

    Attributes:
        texture: The result.
        sources: Photographs whose regions were used, best first.
        others: Names of the photographs that were not used.
        source_rgb: The regions as they were quilted, sRGB, in the texture's colors.
        vessel_density: Optical density of the placed vessels, in green.
    """

    texture: MucosaTexture
    sources: list[PhotoAnalysis]
    others: list[str]
    source_rgb: list[np.ndarray]
    vessel_density: Float[np.ndarray, "n n"]


def make_texture(
    photos: list[Photo],
    scale: PhotoScale,
    options: TextureOptions,
    *,
    seed: int,
    progress: ProgressReport = no_report,
) -> TextureResult:
    """Synthesize a tileable mucosa texture from endoscopic photographs.

    Args:
        photos: At least one.
        scale: Scale of their pixels; a texel has the size of a pixel of the best photograph.
        options: Settings of the texture.
        seed: The same seed gives the same bytes.
        progress: Called with the work done and the total.

    Raises:
        InputError: If the scale, the options or a photograph is invalid, or no photograph
            has a usable region.
    """
    check_scale(scale)
    _check(options, photos, seed)
    chosen, others = _chosen(photos, scale, options, progress)
    rng = stream(seed, "mucosa-from-photos")
    parts, doubtful = source_patches(chosen, keep_vessels=not options.vessels)
    layout = Quilt.of_side(len(parts[0]))
    if options.size < 2 * layout.patch:
        raise InputError(f"The size is {options.size}. Allowed: {2 * layout.patch} or more.")
    ground = quilt(
        variants(parts),
        variants(doubtful),
        options.size,
        layout,
        rng,
        progress=lambda done, total: progress(total // 2 + done, total // 2 + total),
    )
    return _finish(ground, parts, chosen, others, options, rng=rng, seed=seed)


def _chosen(
    photos: list[Photo],
    scale: PhotoScale,
    options: TextureOptions,
    report: ProgressReport,
) -> tuple[list[PhotoAnalysis], list[str]]:
    """Choose the photographs to use, analyzed, best first; also return the names of the others.

    Raises:
        InputError: If none has a usable region.
    """
    analyzed = []
    for index, photo in enumerate(photos):
        analyzed.append(analyze_photo(photo, scale, is_flat=options.is_flat, box=options.box))
        report(index + 1, 3 * len(photos))
    usable = [source for source in analyzed if source is not None]
    if not usable:
        raise InputError(
            f"No usable region in {_names(photos)}: too much border, highlight or darkness. "
            "Give other photographs, or --box LEFT TOP WIDTH HEIGHT."
        )
    chosen = choose(usable, options.max_sources)
    used = {id(source) for source in chosen}
    others = [
        photo.name
        for photo, source in zip(photos, analyzed, strict=True)
        if source is None or id(source) not in used
    ]
    return chosen, others


def _finish(ground, parts, chosen, others, options: TextureOptions, *, rng, seed) -> TextureResult:
    """Add color, relief and vessels to the quilted ground."""
    texel = chosen[0].mm_per_pixel * MM
    color = _color(ground, np.mean([source.color for source in chosen], axis=0), options.luminance)
    ground = ground - ground.mean(axis=(0, 1)) + color
    height, roughness = relief(ground, texel)
    density = np.zeros_like(ground)
    if options.vessels:
        pieces = [piece for source in chosen for piece in _scaled(source, chosen[0])]
        coverage = float(np.mean([source.vessels.coverage for source in chosen]))
        density = place_vessels(pieces, coverage, options.size, options.placement, rng)
    albedo = srgb_from_log_linear(ground - density)
    steps = np.clip(np.rint(height / HEIGHT_STEP) + 32768.0, 0.0, 65535.0).astype(np.uint16)
    source_rgb = [srgb_from_log_linear(part + color) for part in parts]
    metadata = {
        "seed": seed,
        "size": options.size,
        "luminance": options.luminance,
        "is_flat": options.is_flat,
        "vessels": options.vessels,
        "photographs": [_record(source) for source in chosen],
        "measures": texture_quality(srgb_from_log_linear(ground), source_rgb).record(),
    }
    texture = MucosaTexture(
        albedo=albedo,
        roughness=np.rint(255.0 * roughness).astype(np.uint8),
        height=steps,
        texel=texel,
        metadata=metadata,
    )
    return TextureResult(texture, chosen, others, source_rgb, density[..., 1])


def _color(ground, photographed, luminance: float) -> Float[np.ndarray, " 3"]:
    """Mean logarithm of reflectance: the photographs' color at the requested luminance.

    For very saturated colors, luminance is reduced so that red stays below 1.
    """
    deviation = ground - ground.mean(axis=(0, 1))
    light = np.exp(deviation[::4, ::4] + photographed)
    gain = luminance / float(np.mean(light @ LUMINANCE))
    gain = min(gain, _MAX_RED / float(np.percentile(light, 99.0, axis=(0, 1)).max()))
    return photographed + np.log(gain)


def _scaled(source: PhotoAnalysis, first: PhotoAnalysis) -> list[VesselPiece]:
    """Vessels of a photograph at the scale of the first photograph."""
    zoom = source.mm_per_pixel / first.mm_per_pixel
    if abs(zoom - 1.0) <= 0.02:
        return source.vessels.pieces
    return [
        VesselPiece(
            np.maximum(np.asarray(scipy.ndimage.zoom(piece.density, zoom, order=1)), 0.0),
            piece.color,
            max(1, round(piece.length * zoom)),
            piece.radius * zoom,
        )
        for piece in source.vessels.pieces
    ]


def _record(source: PhotoAnalysis) -> dict[str, Any]:
    region, shrink = source.region, source.shrink
    return {
        "name": source.photo.name,
        "sha256": source.photo.sha256,
        "region_px": [shrink * n for n in (region.column, region.row, region.side, region.side)],
        "unevenness": round(region.unevenness, 4),
        "mm_per_pixel": source.mm_per_pixel / shrink,
        "vessel_pieces": len(source.vessels.pieces),
        "vessel_coverage": round(source.vessels.coverage, 5),
    }


def _check(options: TextureOptions, photos: list[Photo], seed: int) -> None:
    require(0 <= seed <= MAX_SEED, "The seed", seed, f"0 to {MAX_SEED}")
    if options.box is not None and len(photos) != 1:
        raise InputError(f"A box goes with one photograph; {len(photos)} were given.")


def _names(photos: list[Photo]) -> str:
    return photos[0].name if len(photos) == 1 else f"{len(photos)} photographs"


def write_report(path: Path, work: TextureResult) -> None:
    """Draw photographs with masks and regions, and the texture in full and close up.

    Args:
        path: Image file to write; its suffix is the format.
        work: Result of `make_texture`.
    """
    rows = len(work.sources)
    fig = make_figure(13, 3.3 * rows + 7.0)
    parts = fig.add_gridspec(2, 1, height_ratios=(3.3 * rows, 7.0))
    upper, lower = fig.add_subfigure(parts[0]), fig.add_subfigure(parts[1])
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
    fig.savefig(path, dpi=90)


def _draw_source(axes, source: PhotoAnalysis) -> None:
    """Draw one photograph: original, masks, without shading, vessels."""
    Rectangle = import_extra("matplotlib.patches", "reports", package="matplotlib").Rectangle

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
