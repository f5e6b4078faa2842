"""Observations of state, images and the map of coverage."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Annotated, Any, ClassVar, Literal

import numpy as np

from vrcaps.core.errors import UnknownNameError, require
from vrcaps.core.fields import Range, check_fields
from vrcaps.core.units import CM, MM
from vrcaps.env.cameras import DISTANCES, View, distance_noise
from vrcaps.env.parts import EnvView, Observation
from vrcaps.render.channels import CHANNELS
from vrcaps.render.settings import RenderSettings
from vrcaps.sensors.tracking import CapsuleTracker, TrackingSensors, check_locatable

if TYPE_CHECKING:
    from jaxtyping import Float

_LIMIT = 10.0
_POSITION = 10.0 * CM
_VELOCITY = 20.0 * MM
_FORCE = 0.1
_LOCATED = "state/located"


@dataclass(frozen=True)
class StateObservation(Observation):
    """Measurements of a tracker and a force sensor, in the world frame, as 19 values.

    - position of the capsule relative to the organ's center [0.1 m] (3)
    - its rotation: the x and z axes of the capsule (6)
    - its velocity [20 mm/s] (3) and angular velocity [1 rad/s] (3)
    - mean contact force [0.1 N] (3)
    - elapsed fraction of the episode (1)

    With an external magnet, its position relative to the capsule [0.1 m] and the direction of its
    moment follow (6). Values are clipped to ±10.

    Attributes:
        pose: Source of pose, velocities and contact force: `true` values, or `located`, estimated
            from `sensors`.
        sensors: Sensors in the capsule and under the patient, for a located pose. They are read
            once per control period.
    """

    pose: Literal["true", "located"] = "true"
    sensors: TrackingSensors = field(default_factory=TrackingSensors)

    kind: ClassVar[str] = "state"

    def __post_init__(self) -> None:
        check_fields(self)

    def space(self, view: EnvView) -> Any:
        """Observation space: values from −10 to 10."""
        from gymnasium import spaces

        count = 19 + (6 if "magnet/T" in view.memory else 0)
        return spaces.Box(-_LIMIT, _LIMIT, (count,), np.float32)

    def names(self, view: EnvView) -> tuple[str, ...]:
        """Name of each value, with its unit in brackets."""
        stems = {"position": "0.1 m", "axis_x": "1", "axis_z": "1", "velocity": "20 mm/s"}
        stems |= {"angular_velocity": "rad/s", "contact_force": "0.1 N"}
        magnet = {"magnet_offset": "0.1 m", "magnet_moment": "1"}
        names = (*_with_axes(stems), "time [1/episode_time]")
        return names + (_with_axes(magnet) if "magnet/T" in view.memory else ())

    def allocate(self, view: EnvView) -> None:
        """Allocate the center of each organ, and the localization.

        Raises:
            InputError: If the pose is located, but the capsule has no magnet for localization.
        """
        view.memory.allocate("state/center", (3,))
        if self.pose == "located":
            located_capsules(view, self.sensors, self.kind)

    def begin(self, view: EnvView, index: int, rng: np.random.Generator) -> None:
        """Compute the center of the organ."""
        vertices = view.patient(index).model.vertices_world
        center = 0.5 * (vertices.min(axis=0) + vertices.max(axis=0))
        view.memory["state/center"][index] = center
        if self.pose == "located":
            view.objects[_LOCATED].begin(index, rng, self.kind)

    def observe(self, view: EnvView) -> Float[np.ndarray, "n k"]:
        """Return the values of all worlds."""
        s, memory = view, view.memory
        T, velocity, force = s.T_world_capsule, s.velocity_world, s.contact_force_world
        if self.pose == "located":
            located = view.objects[_LOCATED]
            located.read()
            T, velocity = located.Ts_world_capsule, located.velocity_world
            force = located.contact_force_world
        parts = [
            (T[:, :3, 3] - memory["state/center"]) / _POSITION,
            T[:, :3, 0],
            T[:, :3, 2],
            velocity[:, 0] / _VELOCITY,
            velocity[:, 1],
            force / _FORCE,
            s.time[:, None] / s.episode_time,
        ]
        if "magnet/T" in memory:
            T_magnet = memory["magnet/T"]
            parts += [(T_magnet[:, :3, 3] - T[:, :3, 3]) / _POSITION, T_magnet[:, :3, 2]]
        return np.concatenate(parts, axis=1).clip(-_LIMIT, _LIMIT).astype(np.float32)


def _with_axes(stems: dict[str, str]) -> tuple[str, ...]:
    """Names of the components of vectors with their units."""
    return tuple(f"{stem}_{axis} [{unit}]" for stem, unit in stems.items() for axis in "xyz")


class LocatedCapsules:
    """A filter for each world, which reads its IMU and Hall sensors once per control period.

    Its state is part of the environment's memory.

    Attributes:
        Ts_world_capsule: Estimated poses.
        velocity_world: Velocities [m/s], and angular velocities [rad/s] from the gyroscopes.
        contact_force_world: Forces of the wall on the capsules' sides [N].
    """

    def __init__(self, view: EnvView, sensors: TrackingSensors, owner: str) -> None:
        """Allocate buffers.

        Args:
            view: The worlds.
            sensors: Sensors of the capsules.
            owner: Kind of the observation that starts the localization.

        Raises:
            InputError: If the capsule does not contain exactly one magnet for localization.
        """
        check_locatable(view.device)
        self._view, self._sensors, self._owner = view, sensors, owner
        memory = view.memory
        self._seed = memory.allocate("located/seed", dtype=np.int64)
        self._saved = memory.allocate("located/filter", (CapsuleTracker.size,))
        self.Ts_world_capsule = memory.allocate("located/T", (4, 4))
        self.velocity_world = memory.allocate("located/velocity", (2, 3))
        self.contact_force_world = memory.allocate("located/force", (3,))
        self._trackers: dict[int, tuple[tuple[int, int], CapsuleTracker]] = {}

    def begin(self, index: int, rng: np.random.Generator, owner: str) -> None:
        """Start the localization of the capsule of one world, near its true pose."""
        if owner != self._owner:
            return
        self._seed[index] = rng.integers(2**31)
        self._trackers.pop(index, None)
        self._saved[index] = self._tracker(index).to_array()

    def read(self) -> None:
        """Read the sensors of all worlds that have advanced since the last reading."""
        for index, world in enumerate(self._view.batch.worlds):
            tracker, sources = self._tracker(index), world.sources
            tracker.restore(self._saved[index], sources)
            tracker.read(world, sources)
            self._saved[index] = tracker.to_array()
            self.Ts_world_capsule[index] = tracker.T_world_capsule
            self.velocity_world[index] = tracker.velocity_world
            self.contact_force_world[index] = tracker.contact_force_world

    def _tracker(self, index: int) -> CapsuleTracker:
        """Tracker of a world's patient and seed; its state is that of its last use."""
        view = self._view
        key = (int(self._seed[index]), view.patient_index(index))
        current = self._trackers.get(index)
        if current is None or current[0] != key:
            model, T = view.batch.worlds[index].model, view.T_world_capsule[index].copy()
            period = view.control_period
            tracker = CapsuleTracker(model, self._sensors, T, period=period, seed=key[0])
            current = self._trackers[index] = (key, tracker)
        return current[1]


def located_capsules(view: EnvView, sensors: TrackingSensors, owner: str) -> LocatedCapsules:
    """Return the localization that observations share; the first one to request it creates it."""
    if _LOCATED not in view.objects:
        view.objects[_LOCATED] = LocatedCapsules(view, sensors, owner)
    return view.objects[_LOCATED]


LIMITS: dict[str, tuple[float, float]] = {
    "rgb": (0, 255),
    "depth": (0.0, 1.0),
    "ray_distance": (0.0, 1.0),
    "normal": (-1.0, 1.0),
    "albedo": (0.0, 1.0),
    "label": (0, 255),
    "instance": (0, 65535),
    "arc_length": (0.0, 20.0),
}
"""Channels that can be observed, with the limits of their values."""


_Side = Annotated[int, Range(8, 4096, unit="px")]


@dataclass(frozen=True)
class ImageObservation(Observation):
    """One channel of a camera's image [h w c].

    Colors are uint8, as learning libraries expect images to be; other channels keep their units and
    are 0 where no wall is visible. Several channels are several observations, which are rendered
    together if camera, size and settings are the same.

    Example:
        >>> color = ImageObservation("rgb", size=(48, 48))
        >>> depth = ImageObservation("depth", size=(48, 48))
        >>> settings = EnvSettings(observations=(color, depth))

    Attributes:
        channel: One of `LIMITS`, see `Frame` for their contents.
        camera: Name of the camera; None for the capsule's first.
        size: Height and width [px]. The camera's image is scaled to cover this size, then cropped.
        render: Render settings.
        key: Name of the observation; None for the channel's.
        noise: Error of a depth or distance, similar to that of an estimate from color: logarithm of
            a factor of the whole image, and of a factor of each pixel, each normal with this
            standard deviation.
    """

    channel: str = "rgb"
    camera: str | None = None
    size: tuple[_Side, _Side] = (64, 64)
    render: RenderSettings = field(default_factory=lambda: RenderSettings(light="direct"))
    key: str | None = None
    noise: Annotated[float, Range(min=0.0, max=1.0)] = 0.0

    kind: ClassVar[str] = "image"

    def __post_init__(self) -> None:
        check_fields(self)
        if self.channel not in LIMITS:
            raise UnknownNameError("channel to observe", self.channel, LIMITS)
        is_distance = self.channel in DISTANCES or not self.noise
        require(is_distance, "noise", f"{self.noise:g} of {self.channel}", f"0, or {DISTANCES}")

    @property
    def needs_textures(self) -> bool:
        """Whether the wall needs its appearance: for all channels but distances."""
        return self.channel not in DISTANCES

    @property
    def name(self) -> str:
        """Key of the observation."""
        return self.channel if self.key is None else self.key

    @property
    def view(self) -> View:
        """View that is rendered."""
        return View(self.camera, self.size, self.render)

    def space(self, view: EnvView) -> Any:
        """Observation space: images between the channel's limits."""
        from gymnasium import spaces

        shape = (*CHANNELS[self.channel].shape(*self.size), 1)[:3]
        return spaces.Box(*LIMITS[self.channel], shape, np.dtype(CHANNELS[self.channel].dtype))

    def names(self, view: EnvView) -> tuple[str, ...]:
        """Name of each channel of the image, with its unit in brackets."""
        count, unit = self.space(view).shape[-1], CHANNELS[self.channel].unit
        parts = "rgb" if self.channel in ("rgb", "albedo") else "xyz"
        stems = [f"{self.name}_{part}" for part in parts] if count == 3 else [self.name]
        return tuple(f"{stem} [{unit}]" for stem in stems)

    def allocate(self, view: EnvView) -> None:
        """Allocate the images, and the seed of the noise."""
        view.cameras.request(self.view, self.channel)
        if self.noise:
            view.memory.allocate(f"image/{self.name}/seed", dtype=np.int64)

    def begin(self, view: EnvView, index: int, rng: np.random.Generator) -> None:
        """Draw the seed of the noise."""
        if self.noise:
            view.memory[f"image/{self.name}/seed"][index] = rng.integers(2**31)

    def observe(self, view: EnvView) -> np.ndarray:
        """Return the images of all worlds [n h w c]."""
        images = view.cameras.images(self.view, self.channel)
        images = images.copy() if images.ndim == 4 else images[..., None].copy()
        for index in range(view.num_worlds if self.noise else 0):
            seed = int(view.memory[f"image/{self.name}/seed"][index])
            time = float(view.time[index])
            images[index] = distance_noise(images[index], self.noise, seed, time)
        if images.dtype.kind == "f":
            np.clip(np.nan_to_num(images, copy=False), *LIMITS[self.channel], out=images)
        return images


@dataclass(frozen=True)
class MapObservation(Observation):
    """The unrolled wall: a row for each cell along the gut, a column for each around it.

    Two channels [2 rows columns]: the fraction of each cell's area that was visible so far, 1 for
    cells without wall; and 1 in the cell that contains the capsule, 0 elsewhere.

    `egocentric` gives crops around the capsule instead [2 scales, size, size]: for each scale the
    seen fraction of the wall in each pixel, then the fraction of the pixel that is within the gut.
    Both are 0 beyond its ends; around the gut the map is periodic. A pixel is a cell of the map at
    the first scale, and `factor` times as long and as wide at each further one (Jonnarth, Zhao,
    Felsberg, arXiv 2306.16978, multi-scale egocentric maps).

    Attributes:
        egocentric: Whether the map is centered at the capsule.
        scales: Number of crops.
        size: Side of each crop [px].
        factor: Ratio of the pixel sizes of consecutive scales.
    """

    egocentric: bool = False
    scales: Annotated[int, Range(min=1, max=8)] = 4
    size: Annotated[int, Range(min=2, max=256)] = 16
    factor: Annotated[float, Range(min=1.0, max=4.0)] = 2.0

    kind: ClassVar[str] = "map"

    def __post_init__(self) -> None:
        check_fields(self)

    def space(self, view: EnvView) -> Any:
        """Observation space: fractions."""
        from gymnasium import spaces

        shape = (2, *view.grid)
        if self.egocentric:
            shape = (2 * self.scales, self.size, self.size)
        return spaces.Box(0.0, 1.0, shape, np.float32)

    def names(self, view: EnvView) -> tuple[str, ...]:
        """Name of each channel of the map."""
        if not self.egocentric:
            return ("seen [1]", "capsule [1]")
        scales = range(self.scales)
        return tuple(f"{stem}_scale_{k} [1]" for k in scales for stem in ("seen", "inside"))

    def observe(self, view: EnvView) -> Float[np.ndarray, "n c h w"]:
        """Return the maps of all worlds."""
        made = self._crops(view) if self.egocentric else _whole(view)
        return made.clip(0.0, 1.0).astype(np.float32)

    def _crops(self, s: EnvView) -> Float[np.ndarray, "n c h w"]:
        """Maps around the capsules; a pixel's value is the mean over its area."""
        rows, columns = s.grid
        half = 0.5 * self.size * self.factor ** np.arange(self.scales)[:, None]
        edges = half * np.linspace(-1.0, 1.0, self.size + 1)
        row, column = (at[:, None, None] + edges for at in _map_position(s))
        along, around = _overlap(row, rows), _repeated_overlap(column, columns)
        around = np.swapaxes(around, -1, -2)
        seen, area = (
            s.coverage.cells.reshape(-1, 1, rows, columns),
            s.coverage.cell_area.reshape(-1, 1, rows, columns),
        )
        inside = along.sum(axis=-1) / np.diff(row, axis=-1)
        wall = along @ area @ around
        fraction = np.divide(along @ seen @ around, wall, out=np.zeros_like(wall), where=wall > 0.0)
        crops = np.stack([fraction, np.broadcast_to(inside[..., None], fraction.shape)], axis=2)
        return crops.reshape(s.num_worlds, 2 * self.scales, self.size, self.size)


def _whole(s: EnvView) -> Float[np.ndarray, "n 2 h w"]:
    rows, columns = s.grid
    made = np.zeros((s.num_worlds, 2, rows * columns))
    made[:, 0] = s.coverage.cell_fraction
    row, column = (index.astype(int) for index in _map_position(s))
    cell = np.minimum(row, rows - 1) * columns + column % columns
    made[np.arange(s.num_worlds), 1, cell] = 1.0
    return made.reshape(-1, 2, rows, columns)


def _map_position(s: EnvView) -> tuple[Float[np.ndarray, " n"], Float[np.ndarray, " n"]]:
    """Row and column of each capsule on the map, as fractional indices."""
    rows, columns = s.grid
    here = s.course.at(s.arc_length)
    offset = s.T_world_capsule[:, :3, 3] - here.point
    x, y, _ = np.einsum("nij,nj->in", here.axes, offset)
    turn = np.arctan2(y, x) / (2.0 * np.pi) + 0.5
    return (s.arc_length / s.course.length).clip(0.0, 1.0) * rows, turn * columns


def _overlap(edges: Float[np.ndarray, "*n k"], count: int) -> Float[np.ndarray, "*n k-1 c"]:
    """Length of each of `count` cells of length 1 that lies between neighboring edges."""
    return np.diff((edges[..., None] - np.arange(count)).clip(0.0, 1.0), axis=-2)


def _repeated_overlap(
    edges: Float[np.ndarray, "*n k"], count: int
) -> Float[np.ndarray, "*n k-1 c"]:
    """Overlap as in `_overlap`, with periodic cells."""
    rounds, rest = np.divmod(edges[..., None], count)
    return np.diff(rounds + (rest - np.arange(count)).clip(0.0, 1.0), axis=-2)
