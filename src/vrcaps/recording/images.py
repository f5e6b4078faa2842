"""The images of a recording: rendered, then as its cameras' lens and sensor make them."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from vrcaps.camera_pipeline.camera_changes import half_side_px
from vrcaps.camera_pipeline.frame_rate import image_speed
from vrcaps.camera_pipeline.pipeline import CameraChain, Moment, Seen
from vrcaps.render.frame import Frame
from vrcaps.render.renderer import Renderer

if TYPE_CHECKING:
    from vrcaps.motion.step import Step
    from vrcaps.recording.table import FrameTable
    from vrcaps.scenario.scenario import Scenario
    from vrcaps.world.model import Model
    from vrcaps.world.moving_wall import MovingWall


class Images:
    """Images of the frames of a recording, in their order."""

    def __init__(
        self,
        model: Model,
        scenario: Scenario,
        before: FrameTable | None = None,
        wall: MovingWall | None = None,
    ) -> None:
        """Begins a recording, or goes on after the rows of an earlier one.

        Args:
            model: What is recorded.
            scenario: Resolved.
            before: Rows of the frames before; they hold the state of the automatic exposure.
            wall: The model's wall, shared with others who need it in the same states.
        """
        assert scenario.fps is not None
        self._model, self._channels, self._fps = model, scenario.channels, scenario.fps
        self._renderer = Renderer(model, scenario.render, wall)
        self._automatic = scenario.effects.figures("exposure")
        self._rate = scenario.effects.frame_rate
        self._chains: dict[str, CameraChain] = {}
        if self._rate is not None or ("rgb" in self._channels and not scenario.effects.is_ideal):
            self._chains = {
                camera.name: CameraChain(
                    scenario.effects, camera, number=k, fps=scenario.fps, seed=scenario.seed
                )
                for k, camera in enumerate(model.device.cameras)
            }
        self._exposures = dict.fromkeys(self._chains, 1.0)
        self._taken: int | None = None
        if before is not None and len(before):
            self._go_on(before)
        self._current = dict(self._exposures)
        self._seen: tuple[Step, dict[str, Seen]] | None = None

    def _go_on(self, before: FrameTable) -> None:
        """Takes over exposures, and the last frame taken, from the rows of earlier frames."""
        if self._automatic is not None:
            for name in self._chains:
                last = (float(before.columns[column][-1]) for column in exposure_columns(name))
                self._exposures[name] = self._automatic.following(*last, 1.0 / self._fps)
        if self._rate is not None:
            self._taken = int(np.flatnonzero(before.columns[TAKEN])[-1])

    def expose(self, step: Step) -> dict[str, float]:
        """Sets the exposure of a frame, to be called for each in turn; its columns in the table."""
        self._current, self._seen = dict(self._exposures), None
        columns: dict[str, float] = {}
        if self._automatic is not None:
            for name, seen in self._see(step).items():
                exposure = self._exposures[name]
                metered = self._chains[name].meter(seen)
                columns |= dict(zip(exposure_columns(name), (exposure, metered), strict=True))
                following = self._automatic.following(exposure, metered, 1.0 / self._fps)
                self._exposures[name] = following
        return columns | self._timing(step)

    def _timing(self, step: Step) -> dict[str, float]:
        """Columns of the adaptive frame rate: speed of the fastest image, and if it is taken."""
        if self._rate is None:
            return {}
        speeds = []
        for camera in self._model.device.cameras:
            seen = self._see(step)[camera.name]
            motion = self._chains[camera.name].motion(seen, self._renderer)
            speeds.append(image_speed(motion, half_side_px(camera), self._fps))
        speed, last = max(speeds), self._taken
        is_taken = last is None or self._rate.is_due(speed, step.index - last, self._fps)
        if is_taken:
            self._taken = step.index
        return {SPEED: speed, TAKEN: int(is_taken)}

    def render(self, step: Step) -> dict[str, Frame]:
        """Images of all cameras at the frame that was exposed last."""
        images = self._perfect(step) if not self._chains else {}
        for name, seen in self._see(step).items():
            if "rgb" in self._channels:
                images[name] = self._chains[name].apply(seen, self._renderer)
            else:
                images[name] = Frame(**seen.channels)
        ends = (step.previous is None, step.next is None)
        return {name: _without_neighbour(image, *ends) for name, image in images.items()}

    def _perfect(self, step: Step) -> dict[str, Frame]:
        """Images without lens and sensor."""
        return {
            camera.name: self._renderer.render(
                step.state,
                camera,
                channels=self._channels,
                state_next=step.next or step.state,
                state_previous=step.previous or step.state,
            )
            for camera in self._model.device.cameras
        }

    def _see(self, step: Step) -> dict[str, Seen]:
        """What reaches the lenses, rendered once for metering and for the image."""
        if self._seen is None or self._seen[0] is not step:
            seen = {
                name: chain.see(self._renderer, self._moment(step, name), self._channels)
                for name, chain in self._chains.items()
            }
            self._seen = (step, seen)
        return self._seen[1]

    def _moment(self, step: Step, camera: str) -> Moment:
        return Moment(
            step.index,
            step.state,
            state_next=step.next,
            state_previous=step.previous,
            exposure=self._current[camera],
        )


SPEED, TAKEN = "image_speed_half_sides_per_s", "taken"
"""Columns of the adaptive frame rate."""


def exposure_columns(camera: str) -> tuple[str, str]:
    """Columns of a frame's exposure, relative to the device's own, and its metered luminance."""
    return f"{camera}_exposure", f"{camera}_luminance"


def _without_neighbour(image: Frame, is_first: bool, is_last: bool) -> Frame:
    """The image with no flow to a frame that the run does not have, and nothing seen in it."""
    if is_first and image.flow_backward is not None:
        image = replace(image, flow_backward=np.full_like(image.flow_backward, np.nan))
    if is_last and image.flow_forward is not None:
        image = replace(image, flow_forward=np.full_like(image.flow_forward, np.nan))
    if is_last and image.occlusion is not None:
        image = replace(image, occlusion=np.ones_like(image.occlusion))
    return image
