"""Mechanics of a world, with inertia or quasi-static, and their complete variable state.

`physics` integrates the Newton-Euler equations in substeps of 50 µs. `quasi-static` neglects
inertia: the capsule moves at the twist ξ (velocity and angular velocity) for which

    M ξ/τ + contact(pose, ξ) + friction(ξ) = F(pose) + gravity + commands

with the mass matrix M, the wall's pressure and friction, and the wrench F of sources. A step is
divided into parts of at most 1/60 s in which no point of the capsule moves more than 0.5 mm. Each
is solved implicitly (backward Euler), with the stiffness of the sources' wrench, together with the
spring wall under the capsule, which also has no inertia: m μ ẋ + k x = F_v. A capsule that would
need more than 1500 parts per second, at 0.75 m/s next to a wall, is slowed down.

M ξ/τ is the drag of the lumen contents, by which momentum decays with the relaxation time τ of
`Drag`, by default 0.1 s. `physics` has the same drag, by default none. With the default a capsule
sinks freely at g τ = 0.98 m/s, and a force 1 mN above friction moves a capsule of 3 g at 33 mm/s.
Effects of momentum are absent: a capsule does not coast, bounce or swing. Where it does in
`physics`, pushed by a wrench or in a fall, the two differ; led by a magnet they agree, see
docs/results/validation.md.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, Literal, get_args

import numpy as np

from vrcaps import _core
from vrcaps.capsule.device import Body, homogeneous_body
from vrcaps.core.errors import InputError, UnknownNameError, require
from vrcaps.core.geometry import invert, quaternion_from_matrix, rotate_vectors
from vrcaps.core.rng import MAX_SEED, stream
from vrcaps.magnet.sources import Source
from vrcaps.tissue.fem.deformation import FemDeformation
from vrcaps.tissue.motility.layout import arc_length_samples
from vrcaps.tissue.motility.muscle import Muscle
from vrcaps.tissue.tissue import Tissue
from vrcaps.world.lumen_dynamics import LumenDynamics
from vrcaps.world.magnetic_coupling import MagneticCoupling
from vrcaps.world.model import Model, State
from vrcaps.world.snapshot import Snapshot, check_snapshot, coupling_state_of

if TYPE_CHECKING:
    from jaxtyping import Float

    from vrcaps.organ.surface import OrganSurface
    from vrcaps.tissue.fem.wall import FemWall
    from vrcaps.tissue.motility.motility import Motility

_WAKING = 1.0
"""Time over which contractions grow from the wall at rest at the start of a world [s]."""

SUBSTEP = 5e-5
"""Default maximum substep [s]."""

_LONGEST_SUBSTEP = 1e-3

RELAXATION_TIME = 0.1
"""Default relaxation time τ of quasi-static motion [s], where `Drag` has none; as in the core."""

DynamicsKind = Literal["physics", "quasi-static"]
"""Names of dynamics."""

DYNAMICS: tuple[DynamicsKind, ...] = get_args(DynamicsKind)


def check_dynamics(name: str, model: Model, tissue: Tissue) -> None:
    """Check that the dynamics exist and support a model and a tissue.

    Raises:
        InputError: If quasi-static motion is combined with an elastic layer, lumen contents or no
            drag.
        UnknownNameError: If no dynamics have that name.
    """
    if name not in DYNAMICS:
        raise UnknownNameError("dynamics", name, DYNAMICS)
    if name != "quasi-static":
        return
    tau = tissue.drag.relaxation_time
    require(
        tau is None or tau <= 1e3, "relaxation_time of quasi-static motion", tau, "up to 1000 s"
    )
    refused = "Dynamics are quasi-static, but {} moves with inertia. {}, or choose physics."
    if isinstance(tissue.deformation, FemDeformation):
        raise InputError(refused.format("a layer of finite elements", "Give a spring wall or none"))
    if not model.contents.is_empty:
        raise InputError(refused.format("matter in the lumen", "Omit the contents"))


def core_pose(
    state: State, T_world_patient: Float[np.ndarray, "4 4"], center: Float[np.ndarray, " 3"]
) -> _core.Pose:
    """Convert the capsule of a state to the core's pose.

    Args:
        state: State in the world frame.
        T_world_patient: Pose of the patient.
        center: Center of the wall in the patient frame [m].

    Raises:
        InputError: If the state is not finite.
    """
    for name in ("T_world_capsule", "linear_velocity_world", "angular_velocity_world"):
        if not np.isfinite(getattr(state, name)).all():
            raise InputError(f"The start's {name} is not finite. Allowed: finite numbers.")
    to_patient = invert(T_world_patient)
    pose = to_patient @ state.T_world_capsule
    velocity = np.array([state.linear_velocity_world, state.angular_velocity_world])
    linear, angular = rotate_vectors(to_patient, velocity)
    wxyz = quaternion_from_matrix(pose[:3, :3])
    return tuple(pose[:3, 3] - center), tuple(wxyz), tuple(linear), tuple(angular)


def make_fem_wall(organ: OrganSurface, tissue: Tissue) -> FemWall | None:
    """Create the elastic layer under an organ's surface, if the tissue has one."""
    if not isinstance(tissue.deformation, FemDeformation):
        return None
    from vrcaps.tissue.fem.wall import FemWall

    return FemWall(organ, tissue.deformation)


class Mechanics:
    """Mechanical state of one world: the compiled core with its wall, layer, contents and sources.

    It is stepped by `vrcaps.world.batch` and read as a `World`.
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
                which all loads on the capsule are in balance, see `vrcaps.world.mechanics`.

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
        require(0 <= seed <= MAX_SEED, "seed", seed, f"0 to {MAX_SEED}")
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
        return _restored, (type(self), given, more, self.muscle, self.snapshot())

    def _make_muscle(self, motility: Motility) -> Muscle:
        return Muscle(self.model.organ, motility, stream(self.seed, "tissue/muscle"))

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
    def sources(self) -> tuple[Source, ...]:
        """External magnets at their current poses, with their nominal strength."""
        return self._magnetic.sources

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
    cls: type[Mechanics],
    given: tuple[Any, ...],
    more: dict[str, Any],
    muscle: Muscle | None,
    snapshot: Snapshot,
) -> Mechanics:
    """Recreate a world from the data of `Mechanics.__reduce__`."""
    world = cls(*given, **more)
    if muscle is not None:
        world.muscle, world._moves = muscle, True
    world.restore(snapshot)
    return world
