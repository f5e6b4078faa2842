"""`vrcaps calibrate`: geometric and photometric camera calibration."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Literal

from tyro.conf import Positional

from vrcaps.cli.arguments import require_existing, require_out
from vrcaps.cli.console import console, progress_bar
from vrcaps.core.errors import InputError, require_extra
from vrcaps.core.units import DEG, MM, parse_length

if TYPE_CHECKING:
    from vrcaps.tools.camera_calibration.circle import ImageCircle
    from vrcaps.tools.camera_calibration.fit import Calibration
    from vrcaps.tools.photometric_calibration.calibrate import PhotometricCalibration
    from vrcaps.tools.photos import Photo


@dataclass(frozen=True)
class CalibrateGeometric:
    """Fit a lens model to photographs of a chessboard, and write a capsule file.

    Take 8 or more photographs through the capsule's own dome: the board near, tilted to different
    sides by 20° to 45°, and in every part of the image up to its rim. The board must be flat and
    completely visible. Mirrored images of a board also work, since its corners form the same grid.

    For example:
      vrcaps calibrate geometric photos/ --board 7x8 --square 2mm --out my-capsule.toml
      vrcaps calibrate geometric photos/ --board 7x9 --square 2mm --lens scaramuzza
          --capsule pillcam-colon2 --out my-capsule.toml
      vrcaps record --organ colon --capsule my-capsule.toml --out runs/mine
    """

    photos: Positional[tuple[Path, ...]]
    """Images (JPEG, PNG, BMP, TIFF, WebP), videos, or folders of them; all of one size, as the
    capsule delivers them: not cropped, not resized."""

    board: str
    """Squares along the board's sides, such as 7x8; not inner corners."""

    square: str
    """Side of a square with its unit, such as 2mm. It affects only distances, not the lens."""

    out: Path
    """Capsule file to write, ending in .toml; a PNG of the residuals is written next to it."""

    lens: Literal["kannala-brandt", "pinhole", "scaramuzza"] = "kannala-brandt"
    """Lens model: kannala-brandt or scaramuzza for wide lenses, pinhole up to about 120°."""

    terms: int | None = None
    """Number of distortion coefficients to fit, from the lowest order; by default all."""

    capsule: str = "mirocam"
    """Capsule to take the body, LEDs and all other values from: a name of the catalog or a file."""

    camera: str | None = None
    """Camera of the capsule to replace; by default the first."""

    overwrite: bool = False
    """Replace the file if it exists."""

    video_frames: int = 20
    """Number of frames to use from each video."""

    def run(self) -> None:
        """Detect the board, fit, report and write."""
        require_existing(self.photos, "pictures or videos, or folders of them")
        require_extra("calibrate", "matplotlib")
        from vrcaps.capsule.device_file import read_device, write_device
        from vrcaps.tools.camera_calibration.board import find_views, parse_board
        from vrcaps.tools.camera_calibration.circle import image_circle
        from vrcaps.tools.camera_calibration.fit import (
            calibrate,
            calibrated_device,
            check_fit,
            find_camera,
        )
        from vrcaps.tools.camera_calibration.report import write_report
        from vrcaps.tools.photos import read_photos

        check_out(self.out, overwrite=self.overwrite)
        board = parse_board(self.board, parse_length(self.square))
        pattern = read_device(self.capsule)
        find_camera(pattern, self.camera)
        photos = read_photos(self.photos, num_frames=self.video_frames)
        with progress_bar("detecting the board") as advance:
            views, missed = find_views(photos, board, advance)
        circle = image_circle([photo.rgb for photo in photos])
        height, width = photos[0].rgb.shape[:2]
        reach = None if circle is None else circle.radius
        fit = calibrate(
            views, board, (width, height), self.lens, num_terms=self.terms, circle_px=reach
        )
        check_fit(fit)
        edge = None if circle is None else circle.radius_about(fit.lens.cx, fit.lens.cy)
        device = calibrated_device(pattern, fit, camera=self.camera, circle_px=edge)
        write_device(self.out, device)
        write_report(self.out.with_suffix(".png"), fit, photos, circle)
        self._report(fit, photos, missed, circle)

    def _report(
        self,
        fit: Calibration,
        photos: Sequence[Photo],
        missed: Sequence[str],
        circle: ImageCircle | None,
    ) -> None:
        console.print(f"Detected the board in {len(fit.views)} of {len(photos)} photographs.")
        if missed:
            console.print(f"Not detected in: {', '.join(missed)}.")
        if len(missed) >= len(fit.views):
            console.print(
                "Warning: half of the photographs or more are left out. If they show the board "
                "whole, --board is wrong: count the squares along both sides, not inner corners."
            )
        mirrored = [view.name for view in fit.views if view.method == "mirrored"]
        if mirrored:
            console.print(f"Detected only in the mirror image of: {', '.join(mirrored)}.")
        console.print(_view_table(fit))
        console.print(_lens_table(fit))
        for line in _facts(fit, circle):
            console.print(line)
        picture = self.out.with_suffix(".png")
        console.print(f"Wrote {self.out}. The residuals are plotted in {picture}: check them.")
        console.print(f"Use it with: vrcaps record --organ colon --capsule {self.out} --out RUN")


def check_out(path: Path, *, overwrite: bool) -> None:
    """Check that a capsule can be written to a file.

    Raises:
        InputError: If its name does not end in .toml, or it exists and may not be replaced.
    """
    require_out(path, ".toml")
    if path.exists() and not overwrite:
        raise InputError(f"{path} exists. Choose another --out, or pass --overwrite.")


def _view_table(fit: Calibration):
    import numpy as np
    from rich.table import Column, Table

    name = Column("photograph", overflow="fold")
    table = Table(name, "found", "mean [px]", "max [px]", "tilt [°]", "distance [mm]")
    for view, error, pose in zip(fit.views, fit.errors, fit.Ts_camera_board, strict=True):
        tilt = np.arccos(np.clip(abs(pose[2, 2]), 0.0, 1.0)) / DEG
        middle = pose @ [*fit.board.points.mean(axis=0), 1.0]
        away = np.linalg.norm(middle[:3]) / MM
        mean, most = f"{error.mean():.3f}", f"{error.max():.2f}"
        table.add_row(view.name, view.method, mean, most, f"{tilt:.0f}", f"{away:.1f}")
    return table


def _lens_table(fit: Calibration):
    from rich.table import Table

    table = Table("parameter", "value", "standard deviation", title=f"{fit.lens.kind} lens")
    for name, spread in zip(fit.names, fit.deviations, strict=True):
        table.add_row(name, f"{getattr(fit.lens, name):.6g}", f"{spread:.2g}")
    return table


def _facts(fit: Calibration, circle: ImageCircle | None) -> list[str]:
    """Explain the values, and suggest improvements where they are poor."""
    import numpy as np

    from vrcaps.tools.camera_calibration.fit import sees_image

    lines = [f"Mean error {fit.errors.mean():.3f} px, root mean square {fit.rms_px:.3f} px."]
    edge = None if circle is None else circle.radius_about(fit.lens.cx, fit.lens.cy)
    reach = f"Corners reach {fit.angles.max() / DEG:.0f}° from the axis"
    if edge is None:
        lines.append(f"{reach}. No dark rim: the image circle cannot be detected.")
    else:
        on_edge = fit.lens.unproject(np.array([fit.lens.cx + edge, fit.lens.cy]))
        angle = np.arctan2(np.hypot(*on_edge[:2]), on_edge[2]) / DEG
        lines.append(f"{reach}; the image circle has {edge:.1f} px, {angle:.0f}° from the axis.")
    if not sees_image(fit.lens, fit.size, edge):
        lines.append(
            "The lens has no ray for part of the image, which stays black. Give fewer --terms, "
            "another --lens, or photographs with the board at the rim."
        )
    focal = fit.deviations[0] / getattr(fit.lens, fit.names[0])
    if focal > 0.03:
        lines.append(
            f"The focal length is accurate to {focal:.1%} only. Tilt the board more, and "
            "reduce its distance."
        )
    return lines


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
      vrcaps record --organ small-bowel --capsule mirocam --frames 60 --effects none
          --out runs/plain
      vrcaps calibrate photometric frames/ --capsule mirocam --reference runs/plain/front/rgb
          --out my-capsule.toml
      vrcaps record my-capsule-effects.toml --out runs/matched
    """

    frames: Positional[tuple[Path, ...]]
    """Images (JPEG, PNG, BMP, TIFF, WebP), videos, or folders of them; of one camera, one size,
    not cropped."""

    out: Path
    """Capsule file to write, ending in .toml. NAME-effects.toml, a scenario, and NAME.png, a plot
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
        require_extra("calibrate", "matplotlib")
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
        with progress_bar("reading the frames") as advance:
            photos = read_photos(self.frames, num_frames=self.video_frames)
            frames = make_frames(photos, advance)
        reference = None
        if self.reference:
            with progress_bar("reading the reference frames") as advance:
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
        console.print(_photometric_table(calibration, has_reference=bool(self.reference)))
        if not self.reference:
            console.print(
                "Without --reference the wall's own shading counts as vignetting, and color and "
                "brightness are not matched."
            )
        picture = self.out.with_suffix(".png")
        console.print(f"Wrote {self.out} and {effects}. The results are plotted in {picture}.")
        console.print(f"Use them with: vrcaps record {effects} --out RUN")


def _photometric_table(calibration: PhotometricCalibration, *, has_reference: bool):
    from rich.table import Table

    table = Table("parameter", "estimate", show_lines=False)
    circle = "not detected: no circular dark rim"
    if calibration.circle is not None:
        c = calibration.circle
        circle = f"radius {c.radius:.1f} px, center {c.cx:.1f}, {c.cy:.1f}"
    table.add_row("image circle", circle)
    fall = calibration.vignetting
    profile = f"1 {fall.k1:+.3f} ρ² {fall.k2:+.3f} ρ⁴, ρ in halves of the shorter side"
    rim = f"{fall.rim:.2f} ± {fall.deviation:.2f} of the light at the rim"
    table.add_row("vignetting", f"{profile}; {rim}" if fall.is_clear else f"not significant; {rim}")
    color = calibration.color
    words = "not estimated: no bright, well-exposed pixels"
    if color is not None:
        words = f"R/G {color.red:.3f}, B/G {color.blue:.3f}, linear, of bright mucosa"
    table.add_row("color", words)
    if has_reference:
        red, _, blue = calibration.gains
        table.add_row("red and blue against the reference", f"× {red:.3f}, × {blue:.3f}")
        table.add_row("brightness against the reference", f"× {calibration.brightness:.3f}")
    noise = "hidden by coding, or too few even regions"
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
