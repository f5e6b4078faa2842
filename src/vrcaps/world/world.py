"""World: simulation of a capsule in a soft wall by the compiled core."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from vrcaps import _core
from vrcaps.core.errors import InputError
from vrcaps.core.geometry import rotate_vectors
from vrcaps.world.batch import advance
from vrcaps.world.control import Control
from vrcaps.world.mechanics import Mechanics, core_pose
from vrcaps.world.model import Contact, Coupling, State

if TYPE_CHECKING:
    from jaxtyping import Float

    from vrcaps.tissue.motility.migrating_complex import Front
    from vrcaps.tissue.motility.motility import Motility

_SMALL_WALL = 50_000
"""Number of vertices up to which one thread moves a wall, within 1 ms."""


class World(Mechanics):
    """A capsule in a soft organ, with the wall's hierarchy and all variable state.

    The core works in the patient frame; states are in the world frame. The same initial state and
    steps give identical bytes with any number of threads.

    Example:
        >>> world = vrcaps.World(vrcaps.Model(organ, device))
        >>> world.step(vrcaps.Control(force_world=(0.0, 0.0, 0.02)), dt=0.01)
        >>> world.state.T_world_capsule
    """

    def add_muscle(self, motility: Motility) -> None:
        """Add a muscle, at rest until fronts are started, to a world without one.

        Args:
            motility: Settings of a muscle that is asleep.

        Raises:
            UnknownNameError: If it has no muscle for a segment of the wall.
        """
        if self.muscle is None:
            self.muscle, self._moves = self._make_muscle(motility), True

    def begin_fronts(self, fronts: tuple[Front, ...]) -> None:
        """Set the fronts of phase III to start, see `Motility.fronts`.

        Args:
            fronts: All fronts; those before the current time must be unchanged.

        Raises:
            InputError: If there is no muscle, or no front passes a position at which one starts.
        """
        if self.muscle is None:
            raise InputError("This world has no muscle to start a front in. Add muscle first.")
        self.muscle = self.muscle.with_fronts(fronts)

    @property
    def T_world_capsule(self) -> Float[np.ndarray, "4 4"]:
        """Current pose of the capsule."""
        return self._core.pose_in(np.asarray(self._T_world_patient, float))

    @property
    def velocity_world(self) -> Float[np.ndarray, "2 3"]:
        """Current velocity of the capsule's origin [m/s] and angular velocity [rad/s]."""
        return rotate_vectors(self._T_world_patient, np.array(self._core.pose[2:]))

    @property
    def contact(self) -> Contact:
        """Effect of the wall on the capsule in the last step."""
        force, torque, *rest = self._core.contact()
        force, torque = rotate_vectors(self._T_world_patient, np.array([force, torque]))
        return Contact(force, torque, *rest)

    @property
    def contact_force_world(self) -> Float[np.ndarray, " 3"]:
        """Mean force of the wall on the capsule in the last step [N], as in `contact`."""
        return self._T_world_patient[:3, :3] @ np.array(self._core.contact()[0])

    def field_angle(self, T_world_capsule: Float[np.ndarray, "4 4"]) -> float:
        """Angle between the moment of a capsule at a pose and the sources' field there [rad]."""
        return self._magnetic.angle(T_world_capsule)

    @property
    def coupling(self) -> Coupling | None:
        """Effect of the sources on the capsule in the last step; None without sources."""
        return self._magnetic.coupling(self.T_world_capsule)

    @property
    def state(self) -> State:
        """Current state, with all vertices of a moving wall; computed once per step."""
        if self._state is None:
            self._state = self._make_state()
        return self._state

    def _make_state(self) -> State:
        T = self._T_world_patient
        linear, angular = self.velocity_world
        moved = (
            self._moves or T is not self.model.T_world_patient or (self._lumen_scale != 1.0).any()
        )
        return State(
            time=self.time,
            T_world_capsule=self.T_world_capsule,
            linear_velocity_world=linear,
            angular_velocity_world=angular,
            vertices_world=self._vertices_world() if moved else None,
            contact=self.contact,
            lumen_contents=None if self._lumen is None else self._lumen.lumen_contents(T),
            coupling=self.coupling,
        )

    def _vertices_world(self) -> Float[np.ndarray, "n 3"]:
        """Current vertices of the wall [m].

        A small wall is moved on this thread with the same sums as in the core: its threads may be
        busy with an image, which must not delay the control of a magnet.
        """
        T = np.asarray(self._T_world_patient, float)
        if len(self.model.organ.vertices) > _SMALL_WALL:
            return self._core.vertices(T)
        given_way = self._core.wall_displacement[:, :3]
        x, y, z = (self._core.active_wall + given_way + self._center).T[..., None]
        return x * T[:3, 0] + y * T[:3, 1] + z * T[:3, 2] + T[:3, 3]

    @property
    def wall(self) -> _core.Wall:
        """Current wall in the patient frame; the next step moves it."""
        self._core.settle()
        return self._wall

    def place(self, *, arc_length: float) -> None:
        """Place the capsule at rest on the centerline, facing the anal end.

        Args:
            arc_length: Arc length from the oral end [m].

        Raises:
            InputError: If the capsule does not fit there; it is then unchanged.
        """
        before = self._core.pose
        self._core.pose = core_pose(
            self.model.place(arc_length), self.model.T_world_patient, self._center
        )
        self._core.settle()
        try:
            self._check_start()
        except InputError:
            self._core.pose = before
            raise
        self._state = None

    def step(self, control: Control, dt: float) -> None:
        """Advance by a time `dt` [s].

        Raises:
            InputError: If the step is too large, the control out of bounds, or the capsule would
                be in a source; the state is then unchanged.
        """
        failures = advance([self], [control], dt)
        if failures:
            raise InputError(failures[0])

    def is_inside(self) -> bool:
        """Check that the capsule's axis is in the lumen."""
        return self._core.inside()
