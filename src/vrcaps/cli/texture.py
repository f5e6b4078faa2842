"""`vrcaps organ texture`: mucosa textures from photographs."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING

from tyro.conf import OmitArgPrefixes, Positional

from vrcaps.cli.arguments import require_existing
from vrcaps.cli.console import console, progress_bar
from vrcaps.core.errors import require_extra
from vrcaps.core.units import CM
from vrcaps.tools.mucosa_from_photos.vessels import VesselPlacement

if TYPE_CHECKING:
    from vrcaps.tools.mucosa_from_photos.texture import TextureResult


@dataclass(frozen=True)
class Texture:
    """Make a mucosa texture for organs from endoscopic photographs or videos.

    Border, highlights and darkness are masked, shading is removed, the most uniform region of each
    photograph is selected, and the best regions are quilted into a large tileable texture. Vessels
    are removed and placed again on top. The scale cannot be estimated from photographs: give
    --mm-per-pixel or --field-width-mm.

    For example:
      vrcaps organ texture frames/ --field-width-mm 30 --out my-mucosa
      vrcaps organ texture frame.jpg --mm-per-pixel 0.08 --box 90 60 120 120 --out my-mucosa
      vrcaps organ texture scan.png --flat --mm-per-pixel 0.083 --out my-mucosa
      vrcaps record --out runs/photo --organ colon --mucosa my-mucosa
    """

    photos: Positional[tuple[Path, ...]]
    """Images (JPEG, PNG, BMP, TIFF, WebP), videos, or folders of them."""

    out: Path
    """Output folder: albedo, roughness and height as PNG, mucosa.json, report.png."""

    mm_per_pixel: float | None = None
    """Size of a photograph's pixel on the wall [mm]."""

    field_width_mm: float | None = None
    """Alternative scale: width of wall in the visible field [mm]; about 30 near the wall."""

    size: int = 2048
    """Side of the texture [texels]; a texel has the size of a pixel of the best photograph."""

    flat: bool = False
    """The images are already textures: no border, highlights or shading to remove."""

    box: tuple[int, int, int, int] | None = None
    """Region to use: left, top, width, height [px]. For a single photograph."""

    max_photos: int = 4
    """Maximum number of photographs whose regions are mixed; the most uniform ones are used."""

    video_frames: int = 8
    """Number of frames to use from each video."""

    no_vessels: bool = False
    """Keep vessels as they are in the photographs, and place none."""

    vessels: OmitArgPrefixes[VesselPlacement] = field(default_factory=VesselPlacement)
    """Position, rotation and size of vessels."""

    luminance: float = 0.30
    """Mean reflectance of the mucosa; it cannot be measured because of automatic exposure."""

    seed: int = 0
    """Random seed; the same seed gives the same files."""

    def run(self) -> None:
        """Make, write and report."""
        require_existing(self.photos, "photographs or videos, or folders of them")
        require_extra("organs", "skimage")
        require_extra("reports", "matplotlib")
        from vrcaps.mucosa.texture import check_free, write_texture
        from vrcaps.tools.mucosa_from_photos.patches import PhotoScale, check_scale
        from vrcaps.tools.mucosa_from_photos.texture import (
            TextureOptions,
            make_texture,
            write_report,
        )
        from vrcaps.tools.photos import read_photos

        scale = PhotoScale(self.mm_per_pixel, self.field_width_mm)
        check_scale(scale)
        check_free(self.out)
        options = TextureOptions(
            size=self.size,
            luminance=self.luminance,
            max_sources=self.max_photos,
            vessels=not self.no_vessels,
            placement=self.vessels,
            is_flat=self.flat,
            box=self.box,
        )
        photos = read_photos(self.photos, num_frames=self.video_frames)
        with progress_bar("generating the texture") as advance:
            result = make_texture(photos, scale, options, seed=self.seed, progress=advance)
        write_texture(self.out, result.texture)
        write_report(self.out / "report.png", result)
        self._report(result)

    def _report(self, result: TextureResult) -> None:
        texture, measures = result.texture, result.texture.metadata["measures"]
        console.print(
            f"Wrote {self.out}: {self.size} × {self.size} texels, {texture.side / CM:.1f} cm wide."
        )
        for source in result.texture.metadata["photographs"]:
            left, top, side, _ = source["region_px"]
            console.print(
                f"From {source['name']}: {side} × {side} px at {left}, {top}; "
                f"{source['vessel_pieces']} vessel pieces."
            )
        if result.others:
            console.print(
                f"Not used, less uniform or without a usable region: {len(result.others)}."
            )
        console.print(
            f"Step over the edge {measures['seam_ratio']:.2f} of that inside; highest "
            f"autocorrelation {measures['repetition']:.2f}; mean Lab {measures['lab_mean_texture']}"
            f", of the photographs' regions {measures['lab_mean_source']}."
        )
        console.print(f"Report: {self.out / 'report.png'}.")
        console.print(f"Record it: vrcaps record --organ colon --mucosa {self.out} --out RUN")
