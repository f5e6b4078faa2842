"""`vrcaps calibrate photometric`: estimate vignetting, color and noise of a camera."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from tyro.conf import Positional

from vrcaps.cli.calibrate_geometric import check_out
from vrcaps.cli.console import console, progress_bar
from vrcaps.cli.paths import require_existing

if TYPE_CHECKING:
    from vrcaps.tools.photometric_calibration.calibrate import PhotometricCalibration


@dataclass(frozen=True)
class CalibratePhotometric:
    """Estimate the photometric properties of a real camera from a folder of its frames.

    Estimates the image circle, vignetting, color, brightness, noise and JPEG quality. Circle, color
    of the LEDs and exposure are written to a capsule file; vignetting, noise and JPEG to a scenario
    next to it. Use twenty or more frames of different positions for good results.

    Frames alone do not separate the camera from the scene. Record a run with the same capsule, no
    effects, in a similar organ, and pass its frames as --reference: color, brightness and
    vignetting are then estimated from the differences. Without a reference, vignetting includes the
    wall's own shading, and color and brightness do not change.

    For example:
      vrcaps calibrate photometric frames/ --capsule mirocam --out my-capsule.toml
      vrcaps record --organ small-bowel --capsule mirocam --frames 60 --out runs/plain
      vrcaps calibrate photometric frames/ --capsule mirocam --reference runs/plain/front/rgb
          --out my-capsule.toml
      vrcaps record my-capsule-effects.toml --out runs/matched
    """

    frames: Positional[tuple[Path, ...]]
    """Images (JPEG, PNG, BMP, TIFF, WebP), videos, or folders of them; of one camera, one size,
    not cropped."""

    out: Path
    """Capsule file to write, ending in .toml. NAME-effects.toml, a scenario, and NAME.png, a figure
    of the results, are written next to it."""

    capsule: str = "mirocam"
    """Capsule to change: a name of the catalog or a file, such as the output of vrcaps calibrate
    geometric."""

    camera: str | None = None
    """Camera of the capsule that took the frames; by default the first."""

    reference: tuple[Path, ...] = ()
    """Frames recorded with this capsule in a similar organ."""

    overwrite: bool = False
    """Replace the files if they exist."""

    video_frames: int = 20
    """Number of frames to use from each video."""

    def run(self) -> None:
        """Estimate, report and write."""
        require_existing(self.frames, "pictures or videos, or folders of them")
        from vrcaps.capsule.device_file import read_device, write_device
        from vrcaps.tools.camera_calibration.fit import find_camera, sees_image
        from vrcaps.tools.photometric_calibration.calibrate import (
            calibrate_photometric,
            photometric_device,
            write_report,
            write_scenario,
        )
        from vrcaps.tools.photometric_calibration.frames import jpeg_quality, make_frames
        from vrcaps.tools.photos import read_photos

        effects = self.out.with_name(f"{self.out.stem}-effects.toml")
        for path in (self.out, effects):
            check_out(path, overwrite=self.overwrite)
        pattern = read_device(self.capsule)
        camera = find_camera(pattern, self.camera)
        with progress_bar("looking at the frames") as advance:
            photos = read_photos(self.frames, num_frames=self.video_frames)
            frames = make_frames(photos, advance)
        reference = None
        if self.reference:
            with progress_bar("looking at the reference") as advance:
                reference = make_frames(read_photos(self.reference), advance)
        quality = jpeg_quality(self.frames)
        calibration = calibrate_photometric(
            frames, camera, reference=reference, jpeg_quality=quality
        )
        device = photometric_device(pattern, calibration, camera=self.camera)
        write_device(self.out, device)
        write_scenario(effects, calibration, self.out)
        write_report(self.out.with_suffix(".png"), calibration, frames)
        self._report(calibration, len(photos), effects)
        circle = find_camera(device, self.camera).image_circle_px
        if not sees_image(camera.lens, (camera.width, camera.height), circle):
            console.print(
                f"The lens of {self.capsule} has no ray for the rim of this circle: the image will "
                "end before. Calibrate the lens, or choose another --capsule."
            )

    def _report(self, calibration: PhotometricCalibration, num_frames: int, effects: Path) -> None:
        width, height = calibration.size
        console.print(f"{num_frames} frames of {width} × {height} px.")
        console.print(_table(calibration, has_reference=bool(self.reference)))
        if not self.reference:
            console.print(
                "Without --reference the wall's own shading counts as vignetting, and color and "
                "brightness are not matched."
            )
        picture = self.out.with_suffix(".png")
        console.print(f"Wrote {self.out} and {effects}. What was found is drawn in {picture}.")
        console.print(f"Use them with: vrcaps record {effects} --out RUN")


def _table(calibration: PhotometricCalibration, *, has_reference: bool):
    from rich.table import Table

    table = Table("figure", "found", show_lines=False)
    circle = "no dark rim that is a circle"
    if calibration.circle is not None:
        found = calibration.circle
        circle = f"radius {found.radius:.1f} px, center {found.cx:.1f}, {found.cy:.1f}"
    table.add_row("image circle", circle)
    fall = calibration.vignetting
    profile = f"1 {fall.k1:+.3f} ρ² {fall.k2:+.3f} ρ⁴, ρ in halves of the shorter side"
    rim = f"{fall.rim:.2f} ± {fall.deviation:.2f} of the light at the rim"
    table.add_row(
        "vignetting", f"{profile}; {rim}" if fall.is_clear else f"none that is clear; {rim}"
    )
    color = calibration.color
    words = "nothing is bright and well exposed"
    if color is not None:
        words = f"R/G {color.red:.3f}, B/G {color.blue:.3f}, linear, of bright mucosa"
    table.add_row("color", words)
    if has_reference:
        red, _, blue = calibration.gains
        table.add_row("red and blue against the reference", f"× {red:.3f}, × {blue:.3f}")
        table.add_row("brightness against the reference", f"× {calibration.brightness:.3f}")
    noise = "hidden by coding, or too few even places"
    if calibration.noise is not None:
        well, read = calibration.noise.full_well, calibration.noise.read_noise
        noise = f"full well {well:.0f} electrons, read noise {read:.1f} electrons"
    table.add_row("noise", noise)
    quality = (
        "no JPEG files"
        if calibration.jpeg_quality is None
        else f"quality {calibration.jpeg_quality}"
    )
    table.add_row(
        "compression", f"{quality}; step over 8-px borders × {calibration.blockiness:.2f}"
    )
    return table
