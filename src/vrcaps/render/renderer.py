"""Renderer: images of a world, with all requested channels in one pass of the compiled core."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np

from vrcaps import _core
from vrcaps.camera.camera import Camera, camera_rays
from vrcaps.lumen.lumen_contents import LumenContents
from vrcaps.render.channels import (
    CHANNELS,
    RADIANCE_PLANAR,
    Frame,
    check_channels,
    fill_empty,
    is_light,
    layout,
    needs,
    write_light,
)
from vrcaps.render.flow import (
    REFLECTED,
    RefractedPaths,
    SurfacePoints,
    flow,
    refract_paths,
    surface_heights,
    visibility,
)
from vrcaps.render.imaging import make_imaging
from vrcaps.render.immersion import Immersion
from vrcaps.render.sampling import (
    PathSampling,
    crop_margin,
    load_denoiser,
    path_sampling,
    supersampled_radiance,
)
from vrcaps.render.scene import make_scene, make_villi
from vrcaps.render.settings import RenderSettings
from vrcaps.world.model import Model, MovingWall, State

if TYPE_CHECKING:
    from jaxtyping import Float
    from numpy.typing import NDArray

DEFAULT_CHANNELS = ("rgb", "depth", "ray_distance", "normal", "label", "instance", "arc_length")
"""The channels of a complete labeled frame."""

_MOTION_INPUTS = ("position", "face", "weights", "refraction_label")


class Renderer:
    """Renderer of one organ; holds its hierarchy, textures and the ray tables of cameras.

    Example:
        >>> renderer = vrcaps.Renderer(model)
        >>> frame = renderer.render(model.place(), "front", channels=("rgb", "depth"))
    """

    def __init__(
        self,
        model: Model,
        settings: RenderSettings | None = None,
        wall: MovingWall | None = None,
    ) -> None:
        """Prepare rendering.

        Args:
            model: Model to render.
            settings: Render settings; None for the defaults, which recordings also use.
            wall: Wall of the model, shared with others that need it in the same states.
        """
        self.model = model
        self.settings = settings or RenderSettings()
        if self.settings.denoise:
            load_denoiser()  # fail before expensive work
        self._imaging = make_imaging(model.device, self.settings.imaging)
        self._scene = make_scene(model.organ, self.settings, self._imaging)
        is_slack = model.closed_radius > 0.0
        self._villi = make_villi(model.organ, self.settings, is_slack=is_slack)
        self._immersion = Immersion(model, self._imaging)
        self._radiosity: _core.Radiosity | None = None
        self._wall = wall or MovingWall(model)
        self._neighbors = {"previous": MovingWall(model), "next": MovingWall(model)}
        self._poses: deque[tuple[State, Camera, Float[np.ndarray, "4 4"]]] = deque(maxlen=16)
        self._known_contents: deque[tuple[State, LumenContents]] = deque(maxlen=3)
        self._contents: dict[str, tuple[LumenContents, _core.Wall, _core.Contents]] = {}
        self._tables: dict[tuple[int, int], tuple[Camera, _core.RayTable]] = {}
        self._led_rows: dict[int, tuple[Camera, Float[np.ndarray, "k 11"]]] = {}

    def __reduce__(self) -> tuple[Any, ...]:
        """Copy the model and the settings; the copy has its own wall."""
        return Renderer, (self.model, self.settings)

    def render(
        self,
        state: State,
        camera: Camera | str,
        *,
        channels: Sequence[str] = DEFAULT_CHANNELS,
        state_next: State | None = None,
        state_previous: State | None = None,
        out: Frame | None = None,
    ) -> Frame:
        """Render a camera's image.

        Args:
            state: State of the world now.
            camera: Camera of the device, or its name.
            channels: Names of channels of `Frame`.
            state_next: State one frame later, for `flow_forward` and `occlusion`.
            state_previous: State one frame earlier, for `flow_backward`.
            out: Earlier frame of the same camera whose arrays may be overwritten.

        Raises:
            UnknownNameError: If there is no such camera or channel.
            InputError: If a channel needs a state that was not given.
        """
        if isinstance(camera, str):
            camera = self.model.device.camera(camera)
        states = state_previous, state, state_next
        return Frame(**self.arrays(states, camera, tuple(channels), out))

    def arrays(
        self,
        states: tuple[State | None, State, State | None],
        camera: Camera,
        channels: Sequence[str],
        out: Frame | None = None,
        points: SurfacePoints | None = None,
        planes: Float[np.ndarray, "3 h+2m w+2m"] | None = None,
    ) -> dict[str, NDArray[Any]]:
        """Channels of `render` by name, given the states before, now and after.

        `points` receives the surface points of the `subsample` pixels; `planes` receives float32
        radiance by color, with a margin that is left unchanged.
        """
        state_previous, state, state_next = states
        check_channels(channels, state_next, state_previous)
        arrays = self._allocate(channels, camera, out)
        arrays |= {} if planes is None else {RADIANCE_PLANAR: planes}
        if points is not None:
            arrays |= {f"sparse_{name}": array for name, array in vars(points).items()}
        wall, lumen_contents = self._wall.at(state), self.lumen_contents(state)
        contents = lumen_contents and self._core_contents(lumen_contents, wall, "now")
        self._render_into(wall, camera, state, arrays, contents)
        motion = self._motion(camera, arrays, channels, states)
        return {name: arrays[name] for name in channels if name in arrays} | motion

    def _render_into(
        self,
        wall: _core.Wall,
        camera: Camera,
        state: State,
        arrays: dict[str, NDArray[Any]],
        contents: _core.Contents | None,
    ) -> None:
        light = {name for name in arrays if is_light(name)}
        amounts, villi = (self._immersion.amounts(state), self._villi) if light else (None, None)
        if amounts is None and villi is None:
            self._render_clear(wall, camera, state, arrays, contents)
            return
        size = camera.height, camera.width
        inputs = ("ray_distance",) if villi is None else villi.channels
        needed = {name: np.empty(*layout(name, camera)) for name in inputs}
        needed |= {name: array for name, array in arrays.items() if name not in light}
        needed[RADIANCE_PLANAR] = arrays.get(RADIANCE_PLANAR, np.empty((3, *size), np.float32))
        self._render_clear(wall, camera, state, needed, contents)
        planes = crop_margin(needed[RADIANCE_PLANAR], *size)
        if villi is not None:
            villi.apply(camera, planes, needed)
        if amounts is not None:
            pose, leds = self.pose(state, camera), self._leds(camera)
            self._immersion.apply(amounts, camera, pose, leds, planes, needed["ray_distance"])
        if light != {RADIANCE_PLANAR}:
            radiance = np.ascontiguousarray(np.moveaxis(planes, 0, -1))
            write_light(radiance, camera.exposure, arrays)

    def _render_clear(
        self,
        wall: _core.Wall,
        camera: Camera,
        state: State,
        arrays: dict[str, NDArray[Any]],
        contents: _core.Contents | None,
    ) -> None:
        """Render as if there was neither turbid fluid nor a film on the dome."""
        if contents is None:
            fill_empty(arrays)
        T_world_camera, leds = self.pose(state, camera), self._leds(camera)
        paths = path_sampling(self.settings, state.time, T_world_camera)

        def draw(
            into: dict[str, NDArray[Any]], supersampling: int, paths: PathSampling | None = paths
        ) -> None:
            _core.render(
                wall,
                self._scene,
                self._table(camera, supersampling),
                T_world_camera,
                leds,
                into,
                exposure=camera.exposure,
                shadows=self.settings.shadows or paths is not None,
                contents=contents,
                paths=paths,
                radiosity=self._radiosity_for(into),
            )

        light = {name for name in arrays if is_light(name)}
        if not (self.settings.is_supersampled and light):
            draw(arrays, 1)
            return
        draw({name: array for name, array in arrays.items() if name not in light}, 1)
        radiance = supersampled_radiance(draw, camera, self.settings, paths)
        write_light(radiance, camera.exposure, arrays)
        if RADIANCE_PLANAR in arrays:
            planes = crop_margin(arrays[RADIANCE_PLANAR], camera.height, camera.width)
            planes[...] = np.moveaxis(radiance, -1, 0)

    def _radiosity_for(self, arrays: Iterable[str]) -> _core.Radiosity | None:
        """Return the solver of indirect light, created on first use."""
        if self.settings.light != "radiosity" or not any(is_light(name) for name in arrays):
            return None
        if self._radiosity is None:
            self._radiosity = _core.Radiosity(self.model.wall, self._scene)
        return self._radiosity

    def _motion(
        self,
        camera: Camera,
        arrays: dict[str, NDArray[Any]],
        channels: Sequence[str],
        states: tuple[State | None, State, State | None],
    ) -> dict[str, NDArray[Any]]:
        """Channels that compare this frame with its neighbors; states are before, now, after."""
        state_previous, state, state_next = states
        motion: dict[str, NDArray[Any]] = {}
        needed = needs(channels)
        if not needed:
            return motion
        points = SurfacePoints(*(arrays[name] for name in _MOTION_INPUTS))
        faces, now = self.model.organ.faces, self.lumen_contents(state)
        if state_next is not None and "next" in needed:
            moved = points.moved(faces, state_next, now, self.lumen_contents(state_next))
            paths = self.refracted_paths(camera, points, moved, state_next, "next")
            forward = flow(camera, paths.apparent, state_next)
            if "flow_forward" in channels:
                motion["flow_forward"] = forward
            if "occlusion" in channels:
                wall, contents = self._neighbors["next"].at(state_next), None
                if (then := self.lumen_contents(state_next)) is not None:
                    contents = self._core_contents(then, wall, "next")
                seen = visibility(camera, paths, moved, forward, state_next, wall, contents)
                motion["occlusion"] = ~seen
        if state_previous is not None and "previous" in needed:
            back = self.points_in_neighbor(camera, points, state, state_previous, "previous")
            motion["flow_backward"] = flow(camera, back[0], state_previous)
        return motion

    def points_in_neighbor(
        self,
        camera: Camera,
        points: SurfacePoints,
        state: State,
        neighbor: State,
        slot: str,
    ) -> tuple[Float[np.ndarray, "h w 3"], Float[np.ndarray, "4 4"]]:
        """Apparent surface points in a neighboring frame [m], and its `T_world_camera`.

        Args:
            camera: Camera that sees the points.
            points: Surface points of the pixels now.
            state: State now.
            neighbor: State one frame later or earlier.
            slot: `next` or `previous`, the neighbor's side.
        """
        contents = self.lumen_contents(state), self.lumen_contents(neighbor)
        moved = points.moved(self.model.organ.faces, neighbor, *contents)
        paths = self.refracted_paths(camera, points, moved, neighbor, slot)
        return paths.apparent, self.pose(neighbor, camera)

    def refracted_paths(
        self,
        camera: Camera,
        points: SurfacePoints,
        moved: Float[np.ndarray, "h w 3"],
        state: State,
        slot: str,
    ) -> RefractedPaths:
        """Light paths through liquid to surface points that have `moved` to another state.

        The slot is `next` or `previous`, the neighbor's side.
        """
        lumen_contents = self.lumen_contents(state)
        if lumen_contents is None or lumen_contents.pools is None:
            return RefractedPaths(moved, None)
        eye = self.pose(state, camera)[:3, 3]
        wall, faces = self._neighbors[slot].at(state), self.model.organ.faces
        heights = surface_heights(lumen_contents, eye, wall, faces, points.face)
        ior = lumen_contents.contents.resolved[2].ior
        moved = moved.astype(float, copy=False)
        return refract_paths(eye, moved, heights, points.refraction == REFLECTED, ior)

    def _allocate(
        self, channels: Sequence[str], camera: Camera, out: Frame | None
    ) -> dict[str, NDArray[Any]]:
        names = [name for name in channels if CHANNELS[name].stage != "motion"]
        if needs(channels):
            names += _MOTION_INPUTS
        arrays = {}
        for name in names:
            shape, dtype = layout(name, camera)
            given = getattr(out, name, None)
            given = np.empty(0) if given is None or not given.flags.carray else given  # writable
            fits = given.shape == shape and given.dtype == dtype
            arrays[name] = given if fits else np.empty(shape, dtype)
            if name in CHANNELS and CHANNELS[name].stage == "dome":
                arrays[name].fill(0)  # set by the camera pipeline
        return arrays

    def pose(self, state: State, camera: Camera) -> Float[np.ndarray, "4 4"]:
        """`T_world_camera` in a state, cached for frames that have it as their neighbor."""
        for known, seeing, pose in self._poses:
            if known is state and seeing is camera:
                return pose
        pose = state.T_world_capsule @ camera.T_capsule_camera
        self._poses.append((state, camera, pose))
        return pose

    def lumen_contents(self, state: State) -> LumenContents | None:
        """Contents of the lumen in a state."""
        if state.lumen_contents is not None or self.model.lumen_contents is None:
            return state.lumen_contents
        for known, lumen_contents in self._known_contents:
            if known is state:
                return lumen_contents
        lumen_contents = self.model.resting_contents(state)
        assert lumen_contents is not None
        self._known_contents.append((state, lumen_contents))
        return lumen_contents

    def _core_contents(
        self, lumen_contents: LumenContents, wall: _core.Wall, slot: str
    ) -> _core.Contents:
        """Contents ready for tracing; their tree is kept if only spheres have moved."""
        kept = self._contents.get(slot)
        if kept is not None and kept[1] is wall and _differ_in_place(kept[0], lumen_contents):
            if kept[0] is not lumen_contents:
                kept[2].move_to(wall, np.ascontiguousarray(lumen_contents.spheres.centers))
        else:
            light = self._imaging
            bubbles, _, liquid = lumen_contents.contents.resolved
            color = light.reflectance(lumen_contents.spheres.color)
            pools = (
                None
                if lumen_contents.pools is None
                else (lumen_contents.pools, light.liquid(liquid))
            )
            label = len(self.model.organ.label_names)
            spheres = replace(lumen_contents.spheres, color=color)
            core = _core.Contents(wall, spheres, light.bubbles(bubbles), pools, label)
            kept = (lumen_contents, wall, core)
        self._contents[slot] = (lumen_contents, *kept[1:])
        return kept[2]

    def _table(self, camera: Camera, supersampling: int) -> _core.RayTable:
        key = (id(camera), supersampling)
        if key not in self._tables:
            table = _core.RayTable(camera_rays(camera, supersampling))
            self._tables[key] = (camera, table)  # a reference to the camera keeps its id unique
        return self._tables[key][1]

    def _leds(self, camera: Camera) -> Float[np.ndarray, "k 11"]:
        """Rows of position [m], direction, intensity [W/sr], lobe exponent and radius [m]."""
        if id(camera) not in self._led_rows:
            gains = self._imaging.led_gains
            rows = [
                (
                    *led.position_camera,
                    *led.direction_camera,
                    *np.multiply(led.intensity, gains),
                    led.lobe_exponent,
                    led.emitter_radius,
                )
                for led in camera.leds
            ]
            self._led_rows[id(camera)] = (camera, np.array(rows, float).reshape(-1, 11))
        return self._led_rows[id(camera)][1]


def _differ_in_place(one: LumenContents, other: LumenContents) -> bool:
    """Check whether two contents have the same spheres and pools."""
    return one.spheres.radius is other.spheres.radius and one.pools is other.pools
