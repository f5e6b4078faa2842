"""Settings of `Dynamics`, and its columns of `frames.parquet`."""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, ClassVar, Literal

import numpy as np

from vrcaps.actuation.coil_program import CoilSteering, coil_column_names, coil_row
from vrcaps.actuation.steering_program import MagnetSteering
from vrcaps.core.errors import InputError, UnknownNameError, require
from vrcaps.core.fields import FileRef, check_fields, file_ref
from vrcaps.core.geometry import quaternion_from_matrix
from vrcaps.motion.fly_through import FlyThrough
from vrcaps.motion.motion import MotionSettings
from vrcaps.tissue.fem.deformation import FemDeformation
from vrcaps.tissue.motility.migrating_complex import Front
from vrcaps.tissue.motility.motility import Motility, Propulsion
from vrcaps.tissue.tissue import Drag, SpringWall, Tissue, WinklerFoundation
from vrcaps.world.mechanics import DYNAMICS, SUBSTEP, DynamicsKind
from vrcaps.world.schedule import (
    Flush,
    Insufflation,
    PostureChange,
    Wrench,
    check_flushes,
    check_insufflation,
    check_posture_changes,
    check_wrenches,
    require_rising,
)

if TYPE_CHECKING:
    from vrcaps.actuation.magnet_controller import ControllerStatus
    from vrcaps.motion.motion import Command
    from vrcaps.sensors.pose_filter import PoseBelief
    from vrcaps.world.model import Contact, Coupling, State

_POSE = ("x_m", "y_m", "z_m", "qw", "qx", "qy", "qz")

SPEED_ALONG_GUT = "capsule_along_gut_m_per_s"
"""Column of every commanded frame."""

DYNAMICS_COLUMNS = (
    *(f"contact_force_{axis}_n" for axis in "xyz"),
    *(f"contact_torque_{axis}_nm" for axis in "xyz"),
    "normal_force_total_n",
    "friction_work_j",
    "contact_area_m2",
    "contact_depth_m",
    *(f"commanded_force_{axis}_n" for axis in "xyz"),
    *(f"commanded_torque_{axis}_nm" for axis in "xyz"),
    "insufflation",
    *(f"patient_{name}" for name in _POSE),
    "mmc_phase",
)
"""Columns of every dynamic motion."""

_COUPLING = (
    *(f"flux_density_{axis}_t" for axis in "xyz"),
    *(f"magnetic_force_{axis}_n" for axis in "xyz"),
    *(f"magnetic_torque_{axis}_nm" for axis in "xyz"),
)

MAGNET_COLUMNS = (
    *(f"magnet_{name}" for name in _POSE),
    *_COUPLING,
    *(f"required_force_{axis}_n" for axis in "xyz"),
    "coupling_angle_rad",
    "coupling_distance_m",
    "position_error_m",
    "heading_error_rad",
    "magnet_limit",
    "coupling_lost",
)
"""Further columns with a steering magnet; those of an arm's joints follow."""

COUPLING_COLUMNS = (*_COUPLING, "coupling_angle_rad")
"""Further columns with coils; currents and temperatures of the coils follow."""

ESTIMATE_COLUMNS = (
    *(f"estimated_{name}" for name in _POSE),
    *(f"estimated_velocity_{axis}_m_per_s" for axis in "xyz"),
    "estimated_position_sigma_m",
    "estimated_roll_sigma_rad",
)
"""Further columns if the controller uses an estimated pose."""

DEFORMATIONS = ("spring", "fem", "rigid")
MOTILITIES = ("none", "fasting", "phase-three", "steady")
WRENCH_FRAMES = ("world", "capsule", "gut")


@dataclass(frozen=True)
class DynamicsSettings(MotionSettings):
    """Settings of a capsule motion simulated from gravity, wall contact, muscle and commands.

    Attributes:
        start: Start position of the capsule, as a fraction of the centerline from the oral end;
            moved on to the next position where the capsule fits.
        angle: Angle between the capsule's front and the direction to the anal end, about the x axis
            of the centerline's frame [rad]; π faces backwards.
        deformation: Deformation of the wall: `spring` (springs and dampers at the vertices near the
            contact), `fem` (an elastic layer) or `rigid` (none except the softness of
            `foundation`).
        spring: Parameters of `spring`.
        fem: Parameters of `fem`; None for the defaults.
        foundation: Pressure of the wall on a capsule that indents it.
        drag: Resistance of the wall to a sliding capsule.
        motility: Motility of the muscle: `none`; `fasting`, the migrating motor complex at random;
            `phase-three`, its strongest phase, whose front has passed the capsule by 5 cm in the
            first frame; `steady`, even contractions of every segment.
        fallback_segment: Segment whose muscle is used where the wall's own segment name is unknown,
            such as `jejunum`; None makes that an error.
        propulsion: Force β (v_p − u) of peristalsis in addition to contact; None for no such force.
        wrenches: Commanded force and torque: linear in time between entries, constant before and
            after them.
        wrench_file: CSV file with these entries, in place of `wrenches`; see `read_wrenches`.
        wrench_frame: Axes of commanded forces and torques: `world`, the `capsule`'s own, or the
            `gut`'s at the capsule: z along the centerline towards the anal end.
        posture_changes: Changes of the patient's posture over time.
        insufflation: Insufflation over time; empty: as modeled.
        flushes: Times at which bubbles and chyme around the capsule are flushed off.
        phase_three: Fronts of phase III, each at a given position and time, replacing the next one
            due; if `motility` is none, the muscle rests until the first.
        magnet: External magnet that steers the capsule; None for no magnet.
        coils: Electromagnets that act on the capsule instead; None for none.
        settle: Time before the first frame, without commands [s]. The gut reaches its first
            insufflation, and muscle activity starts within 1 s.
        step: Maximum time between updates of muscle and commands [s].
        substep: Maximum substep of the dynamics [s]. Gentle forces permit four times the default.
        dynamics: `physics`, with inertia; or `quasi-static`, in equilibrium without inertia and
            many times as fast, see `vrcaps.world.mechanics`.
    """

    start: float = FlyThrough.start
    angle: float = 0.0
    deformation: Literal["spring", "fem", "rigid"] = "spring"
    spring: SpringWall = field(default_factory=SpringWall)
    fem: FemDeformation | None = None
    foundation: WinklerFoundation = field(default_factory=WinklerFoundation)
    drag: Drag = field(default_factory=Drag)
    motility: Literal["none", "fasting", "phase-three", "steady"] = "none"
    fallback_segment: str | None = None
    propulsion: Propulsion | None = None
    wrenches: tuple[Wrench, ...] = ()
    wrench_file: FileRef | str | None = None
    wrench_frame: Literal["world", "capsule", "gut"] = "world"
    posture_changes: tuple[PostureChange, ...] = ()
    insufflation: tuple[Insufflation, ...] = ()
    flushes: tuple[Flush, ...] = ()
    phase_three: tuple[Front, ...] = ()
    magnet: MagnetSteering | None = None
    coils: CoilSteering | None = None
    settle: float = 1.0
    step: float = 0.05
    substep: float = SUBSTEP
    dynamics: DynamicsKind = "physics"

    kind: ClassVar[str] = "dynamics"

    @property
    def column_names(self) -> tuple[str, ...]:
        """Columns of contact and commands, and of the magnet if there is one."""
        magnet = () if self.magnet is None else MAGNET_COLUMNS
        if self.magnet is not None and self.magnet.pose == "located":
            magnet += ESTIMATE_COLUMNS
        if self.coils is not None:
            magnet = (*COUPLING_COLUMNS, *coil_column_names(len(self.coils.array.coils)))
        return (SPEED_ALONG_GUT, *DYNAMICS_COLUMNS, *magnet)

    def make_tissue(self, front: float) -> Tissue:
        """Tissue, with the front of `phase-three` at an arc length in the first frame [m]."""
        motility = None
        if self.motility != "none" or self.phase_three:
            motility = Motility(
                fallback_segment=self.fallback_segment,
                propulsion=self.propulsion,
                fronts=self.phase_three,
                is_asleep=self.motility == "none",
            )
        if self.motility == "phase-three" and motility is not None:
            motility = replace(motility, front=front)
        elif self.motility == "steady" and motility is not None:
            motility = replace(motility, complex=None)
        deformations: dict[str, SpringWall | FemDeformation | None] = {
            "spring": self.spring,
            "fem": self.fem or FemDeformation(),
            "rigid": None,
        }
        return Tissue(
            foundation=self.foundation,
            drag=self.drag,
            deformation=deformations[self.deformation],
            motility=motility,
        )

    def __post_init__(self) -> None:
        check_fields(self, of="Dynamics")
        if self.wrench_file is not None:
            object.__setattr__(self, "wrench_file", file_ref(self.wrench_file))
        for name, valid, allowed in (
            ("start", 0.0 <= self.start <= 1.0, "0 to 1"),
            ("angle", math.isfinite(self.angle), "finite [rad]"),
            ("settle", 0.0 <= self.settle <= 3600.0, "0 to 3600 s"),
            ("step", 0.0 < self.step <= 0.5, "above 0 to 0.5 s"),
        ):
            require(valid, f"Dynamics' {name}", getattr(self, name), allowed)
        for noun, name, known in (
            ("deformation", self.deformation, DEFORMATIONS),
            ("motility", self.motility, MOTILITIES),
            ("wrench frame", self.wrench_frame, WRENCH_FRAMES),
            ("dynamics", self.dynamics, DYNAMICS),
        ):
            if name not in known:
                raise UnknownNameError(noun, name, known)
        if self.propulsion is not None and self.motility == "none":
            raise InputError(
                "Propulsion requires motility, but motility is none. Allowed: "
                f"{', '.join(MOTILITIES[1:])}."
            )
        if self.magnet is not None and self.coils is not None:
            raise InputError("magnet and coils are both given. Give one of them.")
        if self.wrenches and self.wrench_file:
            raise InputError("wrenches and wrench_file are both given. Give one of them.")
        check_wrenches(self.wrenches, "wrenches")
        check_posture_changes(self.posture_changes, "posture_changes")
        check_insufflation(self.insufflation, "insufflation")
        check_flushes(self.flushes, "flushes")
        if self.phase_three and self.motility == "steady":
            raise InputError(
                "phase_three starts fronts, but steady motility has none. Allowed motility: none, "
                "fasting or phase-three."
            )
        require_rising([front.time for front in self.phase_three], "phase_three")


def motion_row(state: State, command: Command) -> dict[str, float | str]:
    """Row of contact, commands and, with a steering magnet or coils, their coupling."""
    assert state.contact is not None
    row: dict[str, float | str] = {**dynamics_row(state.contact, command)}
    if command.controller is not None and state.coupling is not None:
        row |= magnet_row(state.coupling, command.controller)
    if command.estimate is not None:
        row |= estimate_row(command.estimate)
    if command.coils is not None and state.coupling is not None:
        row |= coupling_row(state.coupling) | coil_row(command.coils)
    return row


def dynamics_row(contact: Contact, command: Command) -> dict[str, float]:
    """Row of `DYNAMICS_COLUMNS`."""
    pose = command.T_world_patient
    values = (
        *contact.force_world,
        *contact.torque_world,
        contact.normal_force_total,
        contact.friction_work,
        contact.area,
        contact.depth,
        *command.force_world,
        *command.torque_world,
        command.insufflation,
        *pose[:3, 3],
        *quaternion_from_matrix(pose[:3, :3]),
        command.phase,
    )
    return dict(zip(DYNAMICS_COLUMNS, values, strict=True))


def magnet_row(coupling: Coupling, status: ControllerStatus) -> dict[str, float | str]:
    """Row of `MAGNET_COLUMNS`, and the joint angles of an arm."""
    actuator = status.actuator
    values = (
        *actuator.T_world_magnet[:3, 3],
        *quaternion_from_matrix(actuator.T_world_magnet[:3, :3]),
        *coupling.flux_density_world,
        *coupling.force_world,
        *coupling.torque_world,
        *status.required_force,
        coupling.angle,
        coupling.distance,
        float(np.linalg.norm(status.position_error)),
        status.heading_error,
        actuator.limit,
        status.lost,
    )
    row = dict(zip(MAGNET_COLUMNS, values, strict=True))
    return row | {f"joint_{k}_rad": angle for k, angle in enumerate(actuator.joint_angles, start=1)}


def coupling_row(coupling: Coupling) -> dict[str, float | str]:
    """Row of `COUPLING_COLUMNS`."""
    values = (*coupling.flux_density_world, *coupling.force_world, *coupling.torque_world)
    return dict(zip(COUPLING_COLUMNS, (*values, coupling.angle), strict=True))


def estimate_row(belief: PoseBelief) -> dict[str, float]:
    """Row of `ESTIMATE_COLUMNS`."""
    pose = belief.T_world_capsule
    values = (
        *pose[:3, 3],
        *quaternion_from_matrix(pose[:3, :3]),
        *belief.velocity_world,
        belief.position_sigma,
        belief.roll_sigma,
    )
    return dict(zip(ESTIMATE_COLUMNS, values, strict=True))
