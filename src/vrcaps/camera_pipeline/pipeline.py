"""A recording's lens and sensor: the stages in their order, and what they need to know."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from vrcaps import _core
from vrcaps.camera.rays import camera_rays
from vrcaps.camera_pipeline.dome import Dome
from vrcaps.camera_pipeline.effects import Effects
from vrcaps.camera_pipeline.sensor import Noise, WhiteBalance, mosaic_colors
from vrcaps.color import LUMINANCE
from vrcaps.render.flow import SUBSAMPLE, SurfacePoints
from vrcaps.render.frame import Frame, inside

if TYPE_CHECKING:
    from jaxtyping import Bool, Float

    from vrcaps.camera.camera import Camera
    from vrcaps.render.renderer import Renderer
    from vrcaps.world.model import State

_SHARES: list[float] = LUMINANCE.tolist()
_NEUTRAL = WhiteBalance(response=(1.0, 1.0, 1.0))
_QUIET = Noise(1e6, 0.0, bits=16, black=0)
"""Of a sensor that has a mosaic and nothing else: one step of its numbers is 1/65535."""


@dataclass(frozen=True)
class Moment:
    """What a stage may know of the instant of a frame.

    Attributes:
        index: Number of the frame; with the seed it fixes the noise.
        state: The world.
        state_next: One frame later; None at the end, where motion goes on as it came.
        state_previous: One frame earlier; None at the beginning.
        exposure: Relative to the camera's own, as the automatic exposure has it.
    """

    index: int
    state: State
    state_next: State | None = None
    state_previous: State | None = None
    exposure: float = 1.0


@dataclass(frozen=True)
class Seen:
    """What reaches the lens.

    Attributes:
        channels: Those asked for, and those that the stages need; `rgb` if they are none.
        planes: Radiance by colours [W/(sr·m²)] with a margin, if stages are to change it.
        points: What `subsample` pixels see, if motion is to be known.
        moment: When.
    """

    channels: dict[str, Any]
    planes: Float[np.ndarray, "3 h+2m w+2m"] | None
    points: SurfacePoints | None
    moment: Moment


class CameraChain:
    """Lens and sensor of one camera; holds what does not change from frame to frame."""

    def __init__(
        self, effects: Effects, camera: Camera, *, number: int, fps: float, seed: int
    ) -> None:
        """Begins a recording.

        Args:
            effects: With no grade left to draw.
            camera: As `Effects.device` has changed it.
            number: Which of the capsule's cameras.
            fps: Frames per second.
            seed: Of the noise.
        """
        self.camera, self._is_ideal = camera, effects.is_ideal
        self._stages = {name: effects.figures(name) for name in _STAGES}
        self._interval, self._seed, self._number = 1.0 / fps, seed, number
        self._colors = mosaic_colors(effects.mosaic)
        self._rays = camera_rays(camera)
        self._lit = _lit(self._rays)
        self._table = _core.RayTable(self._rays)
        drops, smears = self._stages["droplets"], self._stages["smears"]
        self._dome = None
        if drops is not None or smears is not None:
            lens = self._stages["depth_of_field"]
            self._dome = Dome(camera, drops, smears, lens=lens, seed=(seed, number))
        self._shutter = self._times()
        self._last_points: tuple[Seen, tuple[Any, ...] | None] | None = None
        self._needs_motion = self._shutter is not None or effects.frame_rate is not None
        self._core = _core.CameraStages(self._fixed())

    def _fixed(self) -> dict[str, object]:
        """What the stages need that no frame changes."""
        camera, stages = self.camera, self._stages
        defocus, colors, bloom = stages["depth_of_field"], stages["chromatic"], stages["bloom"]
        vignette, jpeg = stages["vignette"], stages["jpeg"]
        sites = (camera.height * (1 if self._colors else 3), camera.width)
        return {
            "rays": self._table,
            "lit": self._lit,
            "cosine": np.ascontiguousarray(self._rays[..., 2]),
            "shutter": self._shutter,
            "defocus": defocus and defocus.figures(camera),
            "film": self._dome and self._dome.film,
            "scales": colors and colors.figures(camera),
            "shade": vignette and vignette.profile(camera),
            "bloom": bloom and bloom.figures(camera),
            "pattern": (stages["noise"] or _QUIET).fixed_pattern(sites, self._number),
            "mosaic": self._colors,
            "jpeg": jpeg and (jpeg.quality, jpeg.most_bytes),
        }

    def _times(self) -> tuple[float, float, float] | None:
        """How long rows are open, are read after one another, and are lit, in frames."""
        blur, rolling = self._stages["motion_blur"], self._stages["rolling_shutter"]
        if blur is None and rolling is None:
            return None
        opened = 0.0 if blur is None else min(blur.exposure_time / self._interval, 1.0)
        readout = 0.0 if rolling is None else min(rolling.readout_time / self._interval, 1.0)
        lit = None if blur is None else blur.led_pulse
        return opened, readout, np.inf if lit is None else lit / self._interval

    def see(self, renderer: Renderer, moment: Moment, asked: Sequence[str]) -> Seen:
        """Renders what the camera sees; colour is made of it by `apply`.

        Args:
            renderer: Of the world.
            moment: When it is taken.
            asked: Channels of the frame. A neighbour that there is none of is as now.
        """
        points = SurfacePoints.allocate(self.camera) if self._needs_motion else None
        planes = None if self._is_ideal else self.room()
        now = moment.state
        states = moment.state_previous or now, now, moment.state_next or now
        needed = self._needed(asked)
        channels = renderer.arrays(states, self.camera, needed, points=points, planes=planes)
        if planes is not None and renderer.settings.is_supersampled:
            # Rays beside that of a pixel that sees nothing may see something.
            inside(planes, *self._lit.shape)[:, ~self._lit] = 0.0
        return Seen(channels, planes, points, moment)

    def room(self) -> Float[np.ndarray, "3 h+2m w+2m"]:
        """Room for the radiance by colours that `apply` takes, with a margin."""
        return np.empty(self._core.room, np.float32)

    def _needed(self, asked: Sequence[str]) -> tuple[str, ...]:
        needed = set(asked)
        if not self._is_ideal:
            needed = needed - {"rgb"}
        lens = self._stages["depth_of_field"]
        if self._needs_motion or lens is not None:
            needed |= {"foreground_label", "foreground_depth"}
        if lens is not None:
            needed |= {"ray_distance"}
        return tuple(sorted(needed))

    def apply(self, seen: Seen, renderer: Renderer) -> Frame:
        """The frame with the colour image as this camera sends it; all else stays as it is.

        Args:
            seen: What `see` returned.
            renderer: That rendered it.
        """
        if seen.planes is None:
            return Frame(**seen.channels)
        made = {"rgb": self._core.apply(seen.planes, self._shot(seen, renderer))}
        if "dome_label" in seen.channels and self._dome is not None:
            made["dome_label"] = self._dome.labels(seen.moment.state.time)
        return Frame(**seen.channels | made)

    def meter(self, seen: Seen) -> float:
        """Mean linear luminance of the lit image at its exposure, each pixel cut at white."""
        assert seen.planes is not None
        factor = self.camera.exposure * seen.moment.exposure
        red, green, blue = _SHARES
        return self._core.meter(seen.planes, (factor * red, factor * green, factor * blue))

    def _shot(self, seen: Seen, renderer: Renderer) -> dict[str, object]:
        """What the stages need to know of a frame."""
        channels, moment, distance = seen.channels, seen.moment, None
        if self._stages["depth_of_field"] is not None:
            names = ("ray_distance", "foreground_label", "foreground_depth")
            distance = tuple(channels[name] for name in names)
        automatic, noise = self._stages["exposure"], self._stages["noise"]
        light, gain = (1.0, 1.0) if automatic is None else automatic.split(moment.exposure)
        balance, readout = self._stages["white_balance"] or _NEUTRAL, None
        final = light * gain
        if noise is not None or self._colors is not None:
            readout = (noise or _QUIET).readout(gain, balance.response, light)
            final = 1.0
        return {
            "factor": self.camera.exposure,
            "points": self._shutter and self._points(seen, renderer),
            "is_backward": moment.state_next is None,
            "distance": distance,
            "drops": self._dome and self._dome.drops(moment.state.time),
            "readout": readout,
            "gains": tuple(final * gain for gain in balance.gains),
            "key": (self._seed, 64 * moment.index + self._number),
        }

    def motion(self, seen: Seen, renderer: Renderer) -> Float[np.ndarray, "hc wc 2"] | None:
        """Motion of the image in a frame's time [px] at `subsample` pixels.

        None where there is no neighbouring frame.
        """
        points = self._points(seen, renderer)
        if points is None:
            return None
        flow = _core.flow_by_rays(self._table, points, SUBSAMPLE)
        return -flow if seen.moment.state_next is None else flow

    def _points(self, seen: Seen, renderer: Renderer) -> tuple[Any, ...] | None:
        """Where what is seen appears in a neighbouring frame, its camera, and what is in front.

        Kept for the frame rate and the image alike.
        """
        if self._last_points is None or self._last_points[0] is not seen:
            self._last_points = (seen, self._new_points(seen, renderer))
        return self._last_points[1]

    def _new_points(self, seen: Seen, renderer: Renderer) -> tuple[Any, ...] | None:
        moment = seen.moment
        neighbour = moment.state_next or moment.state_previous
        if neighbour is None:
            return None
        assert seen.points is not None
        slot = "previous" if moment.state_next is None else "next"
        fillings = renderer.lumen_contents(moment.state), renderer.lumen_contents(neighbour)
        moved = seen.points.moved(renderer.model.organ.faces, neighbour, *fillings)
        apparent = renderer.refracted_paths(
            self.camera, seen.points, moved, neighbour, slot
        ).apparent
        device, label = renderer.model.device, seen.channels["foreground_label"]
        capsule = (0.5 * device.length - device.radius, device.radius)
        depth = seen.channels["foreground_depth"]
        front = (label, depth, self.camera.T_capsule_camera, capsule)
        pose = renderer.pose(neighbour, self.camera)
        return np.ascontiguousarray(apparent, np.float32), pose, front


_STAGES = (
    *("motion_blur", "rolling_shutter", "depth_of_field", "droplets", "smears", "chromatic"),
    *("vignette", "bloom", "exposure", "noise", "white_balance", "jpeg"),
)


def _lit(rays: Float[np.ndarray, "h w 3"]) -> Bool[np.ndarray, "h w"]:
    """Pixels that see anything."""
    return np.asarray(np.isfinite(rays).all(axis=-1))
