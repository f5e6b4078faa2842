"""Constants of a run (`Model`), its state in each frame (`State`), and the wall in a state."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, fields, replace
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np

from vrcaps._core import Wall
from vrcaps.capsule.device import Device
from vrcaps.core.errors import InputError, UnknownNameError, require
from vrcaps.core.geometry import (
    invert,
    rotation_from_vector,
    transform_from,
    transform_points,
    wall_of,
)
from vrcaps.core.units import MM
from vrcaps.lumen.contents import Contents
from vrcaps.lumen.lumen_contents import CHYME, LumenContents, populate, wall_anchors
from vrcaps.organ.surface import CLOSED_RADIUS, OrganSurface
from vrcaps.tissue.motility.layout import sample_coordinates

if TYPE_CHECKING:
    from jaxtyping import Float

# Rows are the world axes (z up) in the patient frame (LPS: x left, y posterior, z superior).
_POSTURES = {
    "supine": ((1, 0, 0), (0, 0, 1), (0, -1, 0)),
    "prone": ((-1, 0, 0), (0, 0, 1), (0, 1, 0)),
    "left-lateral": ((0, -1, 0), (0, 0, 1), (-1, 0, 0)),
    "right-lateral": ((0, 1, 0), (0, 0, 1), (1, 0, 0)),
    "standing": ((1, 0, 0), (0, 1, 0), (0, 0, 1)),
}

MAX_CLOSED_RADIUS = 5 * MM
_SLACK_MARGIN = 0.5 * MM
"""Distance that cameras and body axis keep from the wall at rest of a closed lumen [m]."""
_NUM_AXIS_POINTS = 17

POSTURES = tuple(_POSTURES)
"""Names of postures, for `posture_transform`."""


def posture_transform(posture: str) -> Float[np.ndarray, "4 4"]:
    """``T_world_patient`` of a named posture; gravity is world −z.

    Args:
        posture: `supine`, `prone`, `left-lateral` (lying on the left side), `right-lateral`
            or `standing`.

    Raises:
        UnknownNameError: If there is no such posture.
    """
    if posture not in _POSTURES:
        raise UnknownNameError("posture", posture, _POSTURES)
    return transform_from(np.array(_POSTURES[posture], float), np.zeros(3))


@dataclass(frozen=True)
class Model:
    """An organ in a posture and the capsule in it: all constants of a run.

    Example:
        >>> model = vrcaps.Model(vrcaps.generate_organ("colon"), vrcaps.read_device("mirocam"))
        >>> state = model.place(0.3)  # the capsule 30 cm from the oral end

    Attributes:
        organ: The gut wall at rest, in the patient frame.
        device: The capsule.
        T_world_patient: Pose of the patient in the world, see `posture_transform`.
        contents: Lumen contents.
    """

    organ: OrganSurface
    device: Device
    T_world_patient: Float[np.ndarray, "4 4"] = field(
        default_factory=lambda: posture_transform("supine")
    )
    contents: Contents = field(default_factory=Contents)

    def __getstate__(self) -> dict[str, Any]:
        """Only the fields: hierarchies are rebuilt where they are needed."""
        return {f.name: getattr(self, f.name) for f in fields(self)}

    def __deepcopy__(self, memo: object) -> Model:
        """Return itself, as it is immutable."""
        return self

    @property
    def closed_radius(self) -> float:
        """Median radius of the lumen away from the capsule [m], 0 if it stays open.

        Raises:
            InputError: If the metadata of the organ, which state it, are invalid.
        """
        radius = self.organ.metadata.get(CLOSED_RADIUS, 0.0)
        is_valid = isinstance(radius, int | float) and 0.0 <= radius <= MAX_CLOSED_RADIUS
        name = f"{CLOSED_RADIUS} in the metadata of {self.organ.name}"
        require(is_valid, name, radius, f"0 (open) to {MAX_CLOSED_RADIUS:g} m")
        return float(radius)

    def wall_margin(self, margin: float) -> float:
        """Distance that cameras keep from the wall at rest [m]: less than `margin` if it is slack.

        A slack wall gives way to the shell.
        """
        return min(margin, _SLACK_MARGIN) if self.closed_radius > 0.0 else margin

    def clearance(self, poses: Float[np.ndarray, "n 4 4"]) -> Float[np.ndarray, "n p"]:
        """Distance to the wall [m] of the origin, each camera, and both ends of the body's axis.

        Args:
            poses: Poses of the capsule in the world frame.
        """
        axis = self.device.length / 2.0 - self.device.radius
        ends = np.array([[0.0, 0.0, axis], [0.0, 0.0, -axis]])
        return self._distances(poses, np.concatenate([self._vital_points, ends]))

    def vital_clearance(self, poses: Float[np.ndarray, "n 4 4"]) -> Float[np.ndarray, " n"]:
        """Minimum distance to the wall [m] of origin and cameras, which must be positive."""
        return self._distances(poses, self._vital_points).min(axis=1)

    def axis_clearance(self, poses: Float[np.ndarray, "n 4 4"]) -> Float[np.ndarray, "n k"]:
        """Distance to the wall [m] at `axis_coordinates`, for poses ``Ts_world_capsule``."""
        return self._distances(poses, np.outer(self.axis_coordinates, np.eye(3)[2]))

    @property
    def axis_coordinates(self) -> Float[np.ndarray, " k"]:
        """Evenly spaced points of the body's axis, from one dome's center to the other's [m]."""
        half = self.device.length / 2.0 - self.device.radius
        return np.linspace(-half, half, _NUM_AXIS_POINTS)

    @property
    def _vital_points(self) -> Float[np.ndarray, "p 3"]:
        """Origin and position of each camera in the capsule frame [m]."""
        return np.array([np.zeros(3), *(camera.position for camera in self.device.cameras)])

    def _distances(
        self, poses: Float[np.ndarray, "n 4 4"], points: Float[np.ndarray, "p 3"]
    ) -> Float[np.ndarray, "n p"]:
        """Signed distance to the wall [m] of points in the capsule frame, at each pose."""
        points_world = transform_points(poses, points[None])
        distance = self.wall.signed_distance(points_world.reshape(-1, 3))
        return np.asarray(distance, float).reshape(points_world.shape[:2])

    def require_inside(self, poses: Float[np.ndarray, "n 4 4"]) -> None:
        """Check that every camera stays inside the lumen at all poses ``Ts_world_capsule``.

        Raises:
            InputError: If a camera is outside in any frame; states the first and their number.
        """
        clearance = self.clearance(poses)[:, 1 : 1 + len(self.device.cameras)]
        outside = np.argwhere(~(clearance > 0.0))
        if len(outside) == 0:
            return
        frame, camera = outside[0]
        raise InputError(
            f"Camera {self.device.cameras[camera].name!r} is {-clearance[frame, camera] / MM:.1f} "
            f"mm outside the lumen of {self.organ.name!r} at frame {frame} "
            f"({len(np.unique(outside[:, 0]))} of {len(poses)} frames are outside). Check the "
            "path's unit, handedness and placement, or accept them: allow_outside, on the command "
            "line motion.allow_outside=true."
        )

    def with_device(self, device: Device) -> Model:
        """The same model with another capsule; data of the organ alone is shared."""
        model = replace(self, device=device)
        made = ("vertices_world", "wall", "wall_in_patient", "lumen_drive")
        vars(model).update({name: getattr(self, name) for name in made})
        return model

    @cached_property
    def vertices_world(self) -> Float[np.ndarray, "n 3"]:
        """Vertices of the wall at rest in the world frame [m]."""
        return transform_points(self.T_world_patient, self.organ.vertices)

    @cached_property
    def wall(self) -> Wall:
        """Wall at rest for distance and ray queries in the world frame."""
        return wall_of(self.vertices_world, self.organ.faces)

    @cached_property
    def wall_in_patient(self) -> Wall:
        """Wall at rest in the patient frame, of which each `World` steps a copy."""
        return wall_of(self.organ.vertices, self.organ.faces)

    @cached_property
    def lumen_drive(self) -> tuple[Float[np.ndarray, "n 3"], Float[np.ndarray, " n"]]:
        """Motion of each vertex under muscle and gas, see `sample_coordinates`."""
        return sample_coordinates(self.organ)

    @cached_property
    def lumen_contents(self) -> LumenContents | None:
        """Contents at rest, or None."""
        if self.contents.is_empty:
            return None
        lumen_contents = populate(self.organ, self.contents, self.T_world_patient)
        return lumen_contents.with_capsule(self.device.length, self.device.radius)

    @cached_property
    def _anchors(self) -> tuple[np.ndarray, np.ndarray]:
        """Wall location of each sphere of the contents at rest."""
        assert self.lumen_contents is not None
        spheres, faces = self.lumen_contents.spheres, self.organ.faces
        return wall_anchors(spheres, self.wall, self.vertices_world, faces)

    def resting_contents(self, state: State) -> LumenContents | None:
        """Contents at rest on the wall of a state, displaced by the capsule; None without any."""
        rest = self.lumen_contents
        if rest is None:
            return None
        if state.vertices_world is not None and len(rest.spheres):
            rest = rest.on_wall(self._anchors, state.vertices_world, self.vertices_world)
        size = self.device.length, self.device.radius
        rest = rest.on_dome(self.arc_length_at(state.T_world_capsule), *size)
        return rest.around_capsule(state.T_world_capsule, *size)

    def arc_length_at(self, T_world_capsule: Float[np.ndarray, "4 4"]) -> float:
        """Arc length of the point of the centerline nearest to a capsule's origin [m]."""
        line = self.organ.centerline
        center = invert(self.T_world_patient) @ T_world_capsule[:, 3]
        nearest = np.square(line.points - center[:3]).sum(axis=1).argmin()
        return float(line.arc_length[nearest])

    def place(self, arc_length: float | None = None, *, angle: float = 0.0) -> State:
        """State of the capsule at rest on the centerline.

        Args:
            arc_length: Position along the centerline from the oral end [m]; None is its middle.
            angle: Angle between the capsule's front and the direction towards the anal end [rad]; π
                faces backwards.

        Raises:
            InputError: If the arc length is not on the centerline.
        """
        line = self.organ.centerline
        s = 0.5 * line.length if arc_length is None else arc_length
        require(0.0 <= s <= line.length, "arc_length", s, f"0 to {line.length:g} m")
        return State(0.0, self.centerline_poses(np.array([s]), angle=angle)[0])

    def centerline_poses(
        self, arc_length: Float[np.ndarray, " n"], *, angle: float = 0.0
    ) -> Float[np.ndarray, "n 4 4"]:
        """Poses ``Ts_world_capsule`` on the centerline at arc lengths [m], at rest.

        Args:
            arc_length: Positions along the centerline [m].
            angle: Angle between the capsule's front and the direction towards the anal end, about
                the x axis of the centerline's frame [rad].
        """
        line = self.organ.centerline
        nearest = np.abs(line.arc_length[:, None] - arc_length).argmin(axis=0)
        columns = [np.interp(arc_length, line.arc_length, axis) for axis in line.points.T]
        tilt = rotation_from_vector(np.array([angle, 0.0, 0.0]))
        poses = transform_from(line.frames[nearest] @ tilt, np.stack(columns, -1))
        return self.T_world_patient @ poses

    @property
    def label_names(self) -> tuple[str, ...]:
        """Names of all classes that images of this model may contain."""
        names = self.organ.label_names
        return names if self.contents.is_empty else (*names, CHYME)


@dataclass(frozen=True)
class Contact:
    """Effect of the wall on the capsule: means over the last step, and values at its end.

    Attributes:
        force_world: Mean force of the wall on the capsule [N].
        torque_world: Mean torque of the wall about the capsule's center of mass [N·m].
        normal_force_total: Mean sum of the magnitudes of all normal forces [N].
        friction_work: Energy lost to friction and drag in the step [J].
        energy: Energy stored in the indented wall [J].
        area: Contact area [m²].
        depth: Maximum indentation [m].
    """

    force_world: Float[np.ndarray, " 3"]
    torque_world: Float[np.ndarray, " 3"]
    normal_force_total: float
    friction_work: float
    energy: float
    area: float
    depth: float


@dataclass(frozen=True)
class Coupling:
    """Effect of external sources on the capsule's magnets: means over the last step, and its end.

    Attributes:
        force_world: Mean force on the capsule [N].
        torque_world: Mean torque about the capsule's center of mass [N·m].
        flux_density_world: Flux density at the center of the capsule's magnets [T].
        flux_gradient_world: ∂B_i/∂x_j there [T/m].
        angle: Angle between the capsule's moment and the flux density [rad]; beyond π/2 it repels.
        distance: Distance from the magnets to the nearest source's center [m]; infinite if no
            source has a position.
        Ts_world_magnet: Poses of the sources.
        strengths: Factor on the field of each source.
        is_exact: False if a magnet was outside a sampled field, whose value at the edge was used.
    """

    force_world: Float[np.ndarray, " 3"]
    torque_world: Float[np.ndarray, " 3"]
    flux_density_world: Float[np.ndarray, " 3"]
    flux_gradient_world: Float[np.ndarray, "3 3"]
    angle: float
    distance: float
    Ts_world_magnet: Float[np.ndarray, "k 4 4"]
    strengths: Float[np.ndarray, " k"]
    is_exact: bool


@dataclass(frozen=True)
class State:
    """State of the world at one instant.

    Example:
        >>> state = vrcaps.Model(organ, device).place(0.1)
        >>> state.T_world_capsule[:3, 3]

    Attributes:
        time: Time since the start of the run [s].
        T_world_capsule: Pose of the capsule.
        linear_velocity_world: Velocity of the capsule's origin [m/s].
        angular_velocity_world: Angular velocity of the capsule [rad/s].
        vertices_world: Wall vertices [m]; None for a wall at rest.
        contact: Effect of the wall on the capsule; None without simulation.
        lumen_contents: Lumen contents; None means the model's contents at rest, displaced by the
            capsule.
        coupling: Effect of external sources on the capsule; None without sources.
    """

    time: float
    T_world_capsule: Float[np.ndarray, "4 4"]
    linear_velocity_world: Float[np.ndarray, " 3"] = field(default_factory=lambda: np.zeros(3))
    angular_velocity_world: Float[np.ndarray, " 3"] = field(default_factory=lambda: np.zeros(3))
    vertices_world: Float[np.ndarray, "n 3"] | None = None
    contact: Contact | None = None
    lumen_contents: LumenContents | None = None
    coupling: Coupling | None = None


class MovingWall:
    """One wall that is refitted to a state, once for all queries of that state."""

    def __init__(self, model: Model) -> None:
        self.model = model
        self._wall: Wall | None = None
        self._vertices: np.ndarray | None = None

    def at(self, state: State) -> Wall:
        """Wall in a state, valid for queries and images until another state is requested.

        The arrays of a state are assumed not to change.
        """
        if state.vertices_world is None:
            return self.model.wall
        if self._wall is None:
            # Built at rest: the hierarchy, and so the choice among equally near triangles, must not
            # depend on the first requested frame.
            self._wall = wall_of(self.model.vertices_world, self.model.organ.faces)
        if self._vertices is not state.vertices_world:
            self._wall.refit(np.ascontiguousarray(state.vertices_world, np.float64))
            self._vertices = state.vertices_world
        return self._wall


def mean_contact(contacts: Sequence[Contact]) -> Contact:
    """Mean force and torque, total work, and the contact patch of the last step."""
    return replace(
        contacts[-1],
        force_world=np.mean([contact.force_world for contact in contacts], axis=0),
        torque_world=np.mean([contact.torque_world for contact in contacts], axis=0),
        normal_force_total=float(np.mean([contact.normal_force_total for contact in contacts])),
        friction_work=float(np.sum([contact.friction_work for contact in contacts])),
    )


def mean_coupling(couplings: Sequence[Coupling | None]) -> Coupling | None:
    """Mean force and torque, the rest from the last step; None if the last step has none."""
    last, known = couplings[-1], [coupling for coupling in couplings if coupling is not None]
    if last is None:
        return None
    return replace(
        last,
        force_world=np.mean([coupling.force_world for coupling in known], axis=0),
        torque_world=np.mean([coupling.torque_world for coupling in known], axis=0),
        is_exact=all(coupling.is_exact for coupling in known),
    )
