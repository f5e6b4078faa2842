"""World: simulation of a capsule in a soft wall by the compiled core."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from vrcaps import _core
from vrcaps.capsule.device import Body, homogeneous_body
from vrcaps.core.errors import InputError, require
from vrcaps.core.rng import stream
from vrcaps.core.transforms import rotate_vectors
from vrcaps.magnet.sources import Source
from vrcaps.tissue.motility.layout import arc_length_samples
from vrcaps.tissue.motility.muscle import Muscle
from vrcaps.tissue.tissue import Tissue
from vrcaps.world.control import Control
from vrcaps.world.core_pose import core_pose
from vrcaps.world.dynamics import DynamicsKind, check_dynamics
from vrcaps.world.fem_coupling import coupling_state_of, make_fem_wall
from vrcaps.world.lumen_dynamics import LumenDynamics
from vrcaps.world.magnetic_coupling import MagneticCoupling
from vrcaps.world.model import Contact, Coupling, Model, State
from vrcaps.world.snapshot import Snapshot, check_snapshot
from vrcaps.world.stepping import step_together

if TYPE_CHECKING:
    from jaxtyping import Float

    from vrcaps.tissue.motility.migrating_complex import Front
    from vrcaps.tissue.motility.motility import Motility

SUBSTEP = 5e-5
"""Default maximum substep [s]."""

_WAKING = 1.0
"""Time over which contractions grow from the wall at rest at the start of a world [s]."""

_LONGEST_SUBSTEP = 1e-3

_SMALL_WALL = 50_000
"""Number of vertices up to which one thread moves a wall, within 1 ms."""


class World:
    """A capsule in a soft organ, with the wall's hierarchy and all variable state.

    The core works in the patient frame; states are in the world frame. The same initial state and
    steps give identical bytes with any number of threads.

    Example:
        >>> world = vrcaps.World(vrcaps.Model(organ, device))
        >>> world.step(vrcaps.Control(force_world=(0.0, 0.0, 0.02)), dt=0.01)
        >>> world.state.T_world_capsule
    """

    def __init__(
        self,
        model: Model,
        tissue: Tissue | None = None,
        start: State | None = None,
        *,
        body: Body | None = None,
        substep: float = SUBSTEP,
        seed: int = 0,
        sources: Sequence[Source] = (),
        dynamics: DynamicsKind = "physics",
    ) -> None:
        """Place the capsule in the organ.

        Args:
            model: Organ, device and posture.
            tissue: Mechanical behavior of the wall; None is the default `Tissue`.
            start: Initial pose and velocity; None is at rest at the middle of the centerline.
            body: Mass properties; by default the device's mass, uniformly distributed.
            substep: Maximum substep [s].
            seed: Seed of the patient's muscle, 0 or more.
            sources: External magnets that act on those of the device.
            dynamics: `physics`, with inertia, in substeps; or `quasi-static`, at the velocity at
                which all loads on the capsule are in balance, see `vrcaps.world.dynamics`.

        Raises:
            InputError: If the capsule is outside the lumen or does not fit, the substep is too
                long, the seed is negative, an elastic layer folds or is not held, the device has no
                magnet for the sources, or quasi-static motion is combined with an elastic layer or
                lumen contents.
            UnknownNameError: If the tissue has no muscle for a segment of the wall, or there are
                no such dynamics.
        """
        tissue, start = tissue or Tissue(), start or model.place()
        check_dynamics(dynamics, model, tissue)
        longest = min(_LONGEST_SUBSTEP, tissue.longest_substep)
        require(0.0 < substep <= longest, "substep", substep, f"above 0 to {longest:.3g} s")
        require(seed >= 0, "seed", seed, "0, 1, 2, …")
        self.model, self.tissue, self.substep, self.seed = model, tissue, substep, seed
        self.dynamics: DynamicsKind = dynamics
        self.body = body or homogeneous_body(model.device)
        organ, self._lumen = model.organ, None
        self._wall = model.wall_in_patient.copy()
        self._center = np.array(self._wall.center)
        self._start, self._time, self._began = start, start.time, start.time
        self._T_world_patient = model.T_world_patient
        pose = core_pose(start, self._T_world_patient, self._center)
        self.layer = make_fem_wall(organ, tissue)
        self._core = self._make_core(pose)
        self._magnetic = MagneticCoupling(self._core, model.device.magnets, sources)
        self._num_samples = len(arc_length_samples(organ.centerline))
        self._lumen_scale: Float[np.ndarray, " k"] = np.ones(self._num_samples)
        self.muscle: Muscle | None = None
        if tissue.motility is not None:
            self.muscle = self._make_muscle(tissue.motility)
        self._moves = tissue.deformation is not None or self.muscle is not None
        self._check_start()
        if model.lumen_contents is not None:
            self._lumen = LumenDynamics(model, self._wall, self.body, self._core.pose)
        self._state: State | None = None

    def __reduce__(self) -> tuple[Any, ...]:
        """Support copies that continue with identical bytes."""
        more = {name: getattr(self, name) for name in ("body", "substep", "seed", "dynamics")}
        more["sources"] = self.sources
        given = (self.model, self.tissue, self._start)
        return _restored, (given, more, self.muscle, self.snapshot())

    def _make_muscle(self, motility: Motility) -> Muscle:
        return Muscle(self.model.organ, motility, stream(self.seed, "tissue/muscle"))

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
            raise InputError("This world has no muscle in which a front could begin. Add it first.")
        self.muscle = self.muscle.with_fronts(fronts)

    def _make_core(self, pose: _core.Pose) -> _core.World:
        """Create the world of the core: body, wall and laws."""
        tissue, is_quasi_static = self.tissue, self.dynamics == "quasi-static"
        spring = tissue.deformation if self.layer is None else None
        laws = (tissue.foundation_in_series, tissue.drag, spring)
        core = _core.World(self._wall, self.body, *laws, pose, is_quasi_static)
        if self.layer is not None:
            self.layer.carry(core)
        core.set_lumen_drive(*self.model.lumen_drive)
        return core

    @property
    def time(self) -> float:
        """Current time [s]."""
        return self._time

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
    def sources(self) -> tuple[Source, ...]:
        """External magnets at their current poses, with their nominal strength."""
        return self._magnetic.sources

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
        failures = step_together([self], [control], dt)
        if failures:
            raise InputError(failures[0])

    def snapshot(self) -> Snapshot:
        """Complete variable state; a world restored from it continues with identical bytes."""
        position, wxyz, velocity, spin = self._core.pose
        layer, contact_faces = np.zeros((0, 15)), np.zeros((0, 5))
        if self.layer is not None and self._core.coupling_state is not None:
            nodes, contact_faces = self._core.coupling_state
            layer = np.hstack([self.layer.snapshot(), nodes])
        return Snapshot(
            seed=self.seed,
            time=self._time,
            began=self._began,
            T_world_patient=self._T_world_patient,
            capsule=np.concatenate([position, wxyz, velocity, spin]),
            lumen_scale=self._lumen_scale,
            active_wall=self._core.active_wall,
            wall_displacement=self._core.wall_displacement,
            layer=layer,
            contact_faces=contact_faces,
            contents=np.zeros(0) if self._lumen is None else self._lumen.to_array(),
            contact=np.concatenate([np.ravel(part) for part in self._core.contact()]),
            sources=self._magnetic.rows,
        )

    def restore(self, snapshot: Snapshot) -> None:
        """Restore a snapshot of a world with the same model.

        Raises:
            InputError: If the snapshot is of another wall or seed, or is not finite; the state is
                then unchanged.
        """
        check_snapshot(snapshot, self.snapshot())
        if self.layer is not None:
            motion, exchange = coupling_state_of(self.layer, snapshot)
            self.layer.restore(motion)
            self._core.coupling_state = exchange
        if self._lumen is not None:
            self._lumen.restore(snapshot.contents, snapshot.T_world_patient)
        p = snapshot.capsule
        self._core.active_wall, self._core.wall_displacement = (
            snapshot.active_wall,
            snapshot.wall_displacement,
        )
        self._core.pose = (tuple(p[:3]), tuple(p[3:7]), tuple(p[7:10]), tuple(p[10:]))
        self._time, self._began = snapshot.time, snapshot.began
        self._T_world_patient, self._lumen_scale = snapshot.T_world_patient, snapshot.lumen_scale
        self._core.set_contact(tuple(snapshot.contact))
        self._state = None
        self._magnetic.restore(snapshot.sources, snapshot.T_world_patient)

    def is_inside(self) -> bool:
        """Check that the capsule's axis is in the lumen."""
        return self._core.inside()

    def _lumen_scale_at(self, time: float, insufflation: float) -> Float[np.ndarray, " k"]:
        """Radius of the lumen at its samples, relative to that at rest."""
        if self.muscle is None:
            stays = (self._lumen_scale == insufflation).all()
            return self._lumen_scale if stays else np.full(self._num_samples, insufflation)
        awake = min(1.0, (time - self._began) / _WAKING)
        return insufflation * (1.0 - awake * (1.0 - self.muscle.lumen_scale(time)))

    def _check_start(self) -> None:
        if not self._core.inside():
            raise InputError(
                "T_world_capsule puts the capsule's axis outside the lumen. Allowed: inside it; "
                "start on the centerline."
            )
        depth, radius = self._core.penetration_depth(), self.body.radius
        if depth > 0.9 * radius:
            narrow = 2.0 * (radius - depth)
            raise InputError(
                f"The capsule, {2e3 * radius:.1f} mm thick, does not fit: the lumen is "
                f"{1e3 * narrow:.1f} mm wide where it starts. Start it elsewhere or inflate."
            )


def _restored(
    given: tuple[Any, ...], more: dict[str, Any], muscle: Muscle | None, snapshot: Snapshot
) -> World:
    """Recreate a world from the data of `World.__reduce__`."""
    world = World(*given, **more)
    if muscle is not None:
        world.muscle, world._moves = muscle, True
    world.restore(snapshot)
    return world
