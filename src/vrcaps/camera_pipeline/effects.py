"""All effects of a camera in one place: by grade, by a range of grades, or in exact figures."""

from __future__ import annotations

from dataclasses import dataclass, fields, replace
from typing import TYPE_CHECKING, Any, get_args

import vrcaps.rng
from vrcaps.camera_pipeline.camera_changes import Distortion, FieldOfView, Film, Resolution
from vrcaps.camera_pipeline.dome import Droplets, Smears
from vrcaps.camera_pipeline.exposure import AutoExposure
from vrcaps.camera_pipeline.frame_rate import AdaptiveRate
from vrcaps.camera_pipeline.optics import (
    Bloom,
    Defocus,
    LateralColor,
    MotionBlur,
    RollingShutter,
    Vignetting,
)
from vrcaps.camera_pipeline.sensor import Jpeg, Mosaic, Noise, WhiteBalance
from vrcaps.camera_pipeline.severities import GRADES, HIGHEST
from vrcaps.errors import InputError
from vrcaps.lumen.bubbles import Bubbles

if TYPE_CHECKING:
    from vrcaps.capsule.device import Device
    from vrcaps.lumen.contents import Contents
    from vrcaps.organ.surface import OrganSurface

Grade = int | tuple[int, int]
"""A grade, or the first and last of those that one is drawn from."""


@dataclass(frozen=True)
class Effects:
    """What lens and sensor do to the images, in this order.

    Each is a grade from 0 (none) to 4, a range of grades that a recording draws one of, or exact
    figures. `docs/effects.md` has the figures of every grade.

    Attributes:
        specular: How the wall mirrors the LEDs; None leaves the organ's own film.
        bubbles: Bubbles on each round end of the capsule; None leaves those of the contents.
        field_of_view: A longer lens.
        distortion: Barrel distortion beyond the lens's own.
        resolution: Fewer pixels.
        motion_blur: Motion while the shutter is open.
        rolling_shutter: Rows exposed one after another.
        depth_of_field: Blur by the circle of confusion.
        droplets: Drops on the dome, each a small lens.
        smears: A film of mucus, bile or blood on the dome.
        chromatic: Lateral chromatic aberration.
        vignette: The image darkens towards its edge.
        bloom: Halo and veil around what is bright.
        exposure: Automatic exposure that lags; 0 is the device's fixed exposure.
        noise: Shot noise, read noise, fixed pattern, quantisation.
        mosaic: Colour filter of the sensor, demosaiced; `none` is a sensor of three colours.
        white_balance: Response of the colours, and a cast that is left.
        jpeg: Compression.
        frame_rate: Says of each frame whether the capsule takes it; None takes all.
    """

    specular: Grade | Film | None = None
    bubbles: Grade | None = None
    field_of_view: Grade | FieldOfView = 0
    distortion: Grade | Distortion = 0
    resolution: Grade | Resolution = 0
    motion_blur: Grade | MotionBlur = 0
    rolling_shutter: Grade | RollingShutter = 0
    depth_of_field: Grade | Defocus = 0
    droplets: Grade | Droplets = 0
    smears: Grade | Smears = 0
    chromatic: Grade | LateralColor = 0
    vignette: Grade | Vignetting = 0
    bloom: Grade | Bloom = 0
    exposure: Grade | AutoExposure = 0
    noise: Grade | Noise = 0
    mosaic: Mosaic = "none"
    white_balance: Grade | WhiteBalance = 0
    jpeg: Grade | Jpeg = 0
    frame_rate: AdaptiveRate | None = None

    def __post_init__(self) -> None:
        for name in GRADES:
            value = getattr(self, name)
            ends = value if isinstance(value, tuple) else (value,)
            if not all(isinstance(end, int) for end in ends):
                continue
            is_range = isinstance(value, int) or (len(ends) == 2 and ends[0] <= ends[1])
            if not (is_range and all(0 <= end <= HIGHEST for end in ends)):
                given = "..".join(map(str, ends))
                raise InputError(
                    f"Effect {name} has the grade {given}. Allowed: 0 to {HIGHEST}, or a rising "
                    "range of these."
                )
        if self.mosaic not in get_args(Mosaic):
            allowed = ", ".join(get_args(Mosaic))
            raise InputError(f"The effect mosaic is {self.mosaic!r}. Allowed: {allowed}.")

    def drawn(self, seed: int) -> Effects:
        """The effects with a grade drawn from each range, the same for the same seed.

        A grade does not depend on which other effects are drawn.
        """
        share = vrcaps.rng.stream(seed, "camera/severities").random(len(GRADES))
        chosen: dict[str, int] = {}
        for name, at in zip(sorted(GRADES), share, strict=True):
            value = getattr(self, name)
            if isinstance(value, tuple):
                chosen[name] = value[0] + int(at * (value[1] - value[0] + 1))
        return replace(self, **chosen)  # type: ignore[arg-type]

    def figures(self, name: str) -> Any:
        """Exact figures of one effect; None where the camera is ideal.

        Raises:
            InputError: If it is still a range of grades.
        """
        value = getattr(self, name)
        if isinstance(value, tuple):
            raise InputError(f"Effect {name} is a range of grades. Draw one first: drawn(seed).")
        return GRADES[name][value] if isinstance(value, int) else value

    @property
    def is_ideal(self) -> bool:
        """Whether the image is as a perfect camera takes it; its geometry may still differ."""
        stages = {f.name for f in fields(self)} - _IN_SCENE
        return all(getattr(self, name) in (0, "none") for name in stages)

    def device(self, device: Device) -> Device:
        """The capsule with cameras of this field of view, distortion and resolution."""
        cameras = device.cameras
        for name in ("field_of_view", "distortion", "resolution"):
            change = self.figures(name)
            if change is not None:
                cameras = tuple(change.on(camera) for camera in cameras)
        return replace(device, cameras=cameras)

    def organ(self, organ: OrganSurface) -> OrganSurface:
        """The organ with this specular reflection."""
        film = self.figures("specular")
        return organ if film is None else film.on(organ)

    def contents(self, contents: Contents) -> Contents:
        """The contents of the lumen with these bubbles on the capsule."""
        count = self.figures("bubbles")
        if count is None:
            return contents
        bubbles = contents.resolved[0] if contents.bubbles else Bubbles(per_area=0.0)
        return replace(contents, bubbles=replace(bubbles, on_dome=count))


_IN_SCENE = {
    *("specular", "bubbles", "field_of_view", "distortion", "resolution", "frame_rate"),
}
"""Effects on what is seen and when; the others are stages of the image."""
