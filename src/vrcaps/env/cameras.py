"""Images of the cameras of all worlds, rendered once for all consumers."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from functools import lru_cache
from typing import TYPE_CHECKING, Any

import numpy as np

from vrcaps.camera.camera import Camera
from vrcaps.camera.derive import scaled_lens
from vrcaps.camera_pipeline.effect.base import CameraEffect
from vrcaps.camera_pipeline.effects import Effects
from vrcaps.camera_pipeline.pipeline import CameraPipeline, PipelineState
from vrcaps.core.rng import stream
from vrcaps.env.randomization import Randomization
from vrcaps.env.worlds import EnvWorlds, Memory
from vrcaps.motion.motion import Step
from vrcaps.render.batch import BATCH_CHANNELS, render_batch, renders_batches
from vrcaps.render.channels import CHANNELS, Frame
from vrcaps.render.renderer import Renderer
from vrcaps.render.settings import RenderSettings
from vrcaps.world.model import State

if TYPE_CHECKING:
    from vrcaps import _core

DISTANCES = ("depth", "ray_distance")
"""Channels that are distances: they need no appearance and may have noise."""


@dataclass(frozen=True)
class View:
    """One camera of the capsule and its render settings.

    Attributes:
        camera: Name of the camera; None for the capsule's first.
        size: Height and width of the image [px]; None for the camera's own.
        render: Render settings.
    """

    camera: str | None = None
    size: tuple[int, int] | None = None
    render: RenderSettings = field(default_factory=RenderSettings)


class _WorldWall:
    """Current wall of the rendered world, in the patient frame, in place of a `MovingWall`."""

    def __init__(self) -> None:
        self.wall: _core.Wall | None = None

    def at(self, state: State) -> Any:
        """Return the current wall, independent of the state."""
        return self.wall


class CameraImages:
    """Current images of all worlds.

    All channels of a view are rendered together, and each world at most once per step.
    """

    def __init__(
        self, worlds: EnvWorlds, randomization: Randomization, control_period: float
    ) -> None:
        """Initialize without rendering."""
        self._worlds, self._randomization = worlds, randomization
        self._fps = 1.0 / control_period
        self._renderers: dict[tuple[int, RenderSettings], tuple[Renderer, _WorldWall]] = {}
        self._requested: dict[View, tuple[str, ...]] = {}
        self._images: dict[tuple[View, str], np.ndarray] = {}
        self._is_stale: dict[View, np.ndarray] = {}
        self._exposure: dict[View, np.ndarray] = {}
        self._pipelines: dict[tuple[int, View], tuple[object, CameraPipeline]] = {}

    def request(self, view: View, channel: str) -> None:
        """Allocate a channel of a view in the worlds' memory.

        Raises:
            UnknownNameError: If the capsule has no such camera.
        """
        if channel not in self._requested.get(view, ()):
            self._add(view, channel, self._worlds.memory)

    def _add(self, view: View, channel: str, memory: Memory) -> None:
        """Allocate a channel of a view in a memory."""
        camera, kind = self.camera(view), CHANNELS[channel]
        shape, name = kind.shape(camera.height, camera.width), f"views/{len(self._images)}"
        self._images[view, channel] = memory.allocate(f"{name}/{channel}", shape, kind.dtype)
        if view not in self._is_stale:
            self._is_stale[view] = memory.allocate(f"{name}/is_stale", (), bool)
            self._exposure[view] = memory.allocate(f"{name}/exposure", fill=np.nan)
        self._is_stale[view][:] = True
        self._requested[view] = (*self._requested.get(view, ()), channel)

    def begin(self, index: int) -> None:
        """Start an episode in one world; its cameras settle their exposure in the first image."""
        for exposure in self._exposure.values():
            exposure[index] = np.nan

    def expire(self, indices: np.ndarray) -> None:
        """Mark the images of some worlds as outdated."""
        for is_stale in self._is_stale.values():
            is_stale[indices] = True

    def images(self, view: View, channel: str) -> np.ndarray:
        """Return a channel of all worlds [n h w …]; the next step overwrites it."""
        if channel not in self._requested.get(view, ()):
            self._add(view, channel, Memory(self._worlds.memory.num_worlds))
        self._render(np.flatnonzero(self._is_stale[view]).tolist(), view)
        self._is_stale[view][:] = False
        return self._images[view, channel]

    def camera(self, view: View, index: int | None = None) -> Camera:
        """Return the camera of a view at its size, of the nominal capsule or of one world.

        Raises:
            UnknownNameError: If the capsule has no such camera.
        """
        s = self._worlds
        device = s.device if index is None else s.devices[index]
        camera = device.cameras[0] if view.camera is None else device.camera(view.camera)
        if index is not None and self._is_captured(view):
            for effect in self._effects(index).of_kind(CameraEffect):
                camera = effect.on(camera)
        return camera if view.size is None else resized_camera(camera, *view.size)

    def _is_captured(self, view: View) -> bool:
        """Return whether camera effects apply to a view: to those of agents, not for display."""
        return self._randomization.has_effects and view.size is not None

    def _effects(self, index: int) -> Effects:
        """Camera effects of a world on the images of agents."""
        return self._randomization.sample_effects(int(self._worlds.effects_seed[index]))

    def _render(self, indices: list[int], view: View) -> None:
        """Render worlds; those that share a camera and use direct light in one call."""
        s = self._worlds
        together: dict[Camera, list[int]] = {}
        for index in indices:
            renderer, _ = self._renderer(index, view.render)
            is_bare = renders_batches(renderer) and not self._is_captured(view)
            if is_bare and set(self._requested[view]) <= set(BATCH_CHANNELS):
                together.setdefault(self.camera(view, index), []).append(index)
            else:
                self._render_alone(index, view)
        for camera, some in together.items():
            images = render_batch(
                [self._renderer(index, view.render)[0] for index in some],
                np.array([s.T_patient_capsule(k) @ camera.T_capsule_camera for k in some]),
                camera,
                self._requested[view],
                walls=s.batch.walls(some),
            )
            for channel, image in images.items():
                self._images[view, channel][some] = image

    def _render_alone(self, index: int, view: View) -> None:
        """Render one world in the patient frame, in which its wall is stored."""
        s = self._worlds
        renderer, wall = self._renderer(index, view.render)
        wall.wall = s.batch.worlds[index].wall
        wall.wall.vertex_normals()  # a step does not compute them, the renderer needs them
        state = State(float(s.time[index]), s.T_patient_capsule(index))
        channels = self._requested[view]
        if self._is_captured(view):
            frame = self._captured(index, view, state, renderer)
        else:
            frame = renderer.render(state, self.camera(view, index), channels=channels)
        for channel in channels:
            self._images[view, channel][index] = getattr(frame, channel)

    def _captured(self, index: int, view: View, state: State, renderer: Renderer) -> Frame:
        """Render a frame through the camera pipeline of a world."""
        s = self._worlds
        seed, fps = int(s.effects_seed[index]), self._fps
        key = (seed, renderer, s.devices[index].cameras, self._requested[view])
        known, pipeline = self._pipelines.get((index, view), (None, None))
        if pipeline is None or known != key:
            pipeline = CameraPipeline(
                renderer,
                self.camera(view, index),
                self._effects(index),
                fps=fps,
                seed=seed,
                channels=self._requested[view],
            )
            self._pipelines[index, view] = (key, pipeline)
        before = float(self._exposure[view][index])
        pipeline.state = PipelineState(None if np.isnan(before) else before)
        frame = pipeline.capture(Step(round(s.time[index] * fps), state))
        after = pipeline.state.exposure
        self._exposure[view][index] = np.nan if after is None else after
        return frame

    def _renderer(self, index: int, render: RenderSettings) -> tuple[Renderer, _WorldWall]:
        """Renderer of a world's patient."""
        s = self._worlds
        key = (s.patient_index(index), render)
        if key not in self._renderers:
            wall = _WorldWall()
            model = replace(s.patient(index).model, T_world_patient=np.eye(4))
            self._renderers[key] = (Renderer(model, render, wall), wall)  # type: ignore[arg-type]
        return self._renderers[key]


@lru_cache(maxsize=64)
def resized_camera(camera: Camera, height: int, width: int) -> Camera:
    """Resize a camera's image: scale it to cover the new size, then crop it symmetrically.

    Args:
        camera: The camera.
        height: Height of the image [px].
        width: Width of the image [px].

    Raises:
        InputError: If the camera cannot be so small.
    """
    scale = max(height / camera.height, width / camera.width)
    lens, circle = camera.lens, camera.image_circle_px
    # The center of the image remains its center.
    cx = (lens.cx - 0.5 * (camera.width - 1)) * scale + 0.5 * (width - 1)
    cy = (lens.cy - 0.5 * (camera.height - 1)) * scale + 0.5 * (height - 1)
    return replace(
        camera,
        lens=scaled_lens(lens, scale, (cx, cy)),
        width=width,
        height=height,
        image_circle_px=None if circle is None else circle * scale,
    )


def distance_noise(distances: np.ndarray, noise: float, seed: int, time: float) -> np.ndarray:
    """Distances with the noise of `ImageObservation`, which depends on seed and time [s] alone."""
    draw = stream(seed, "observation/noise", round(time * 1e6))
    scale, pixels = draw.normal(), draw.normal(size=distances.shape)
    return distances * np.exp(noise * (scale + pixels))
