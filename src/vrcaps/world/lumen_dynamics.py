"""Dynamics of the lumen contents: particles move and push the capsule, liquid supports it."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from vrcaps import _core
from vrcaps.capsule.device import Body
from vrcaps.core.geometry import invert, matrix_from_quaternion, transform_points
from vrcaps.core.rng import stream
from vrcaps.core.units import CM
from vrcaps.lumen.lumen_contents import LumenContents
from vrcaps.lumen.pools import Pools, Sections, cut_sections, level_pools, submerged
from vrcaps.tissue.motility.layout import arc_length_samples
from vrcaps.world.model import Model

if TYPE_CHECKING:
    from jaxtyping import Float

LUMEN_SUBSTEP = 2.5e-3
"""Maximum time for which buoyancy and drag of the liquid are held constant [s]."""

SUBSTEPS_PER_SWEEP = 8
"""Maximum number of pieces of a step between updates of all spheres; spheres next to the capsule
move in each piece."""

_LEVEL_TOLERANCE = 0.01
"""Change of the lumen's radius, relative to that at rest, after which liquid is leveled again."""

FLUSH_REACH = 5.0 * CM
"""Distance from the capsule's center within which a flush removes bubbles and chyme [m]."""

_AWAY = 1e3
"""Distance outside the patient at which removed spheres are kept [m]. Their number is constant, so
that snapshots and the motion between images are unaffected."""

_DRAG = 0.5
"""Drag coefficient of a capsule in liquid relative to its frontal area (a long body with round
ends: Hoerner, Fluid-Dynamic Drag, 1965, 3-12, including tumbling)."""


@dataclass(frozen=True)
class _StepInputs:
    """Inputs of the core's swarm in a step; positions are relative to the wall's center."""

    up: tuple[float, float, float]
    gravity: float
    stretch: Float[np.ndarray, "p 2"]
    levels: Float[np.ndarray, " p"]
    axis: tuple[tuple[float, ...], ...]
    radius: float
    mass: float
    center: tuple[float, float, float]
    wxyz: tuple[float, float, float, float]
    velocity: tuple[float, float, float]
    spin: tuple[float, float, float]


@dataclass(frozen=True)
class LiquidLevel:
    """Liquid when it was last leveled, and the conditions then.

    Attributes:
        pools: The liquid, or None.
        section_volume: Liquid in each section before leveling [m³]; empty if not yet moved.
        T_world_patient: Posture then.
        lumen_scale: Radius of the lumen at its samples then, relative to that at rest.
    """

    pools: Pools | None
    section_volume: Float[np.ndarray, " k"]
    T_world_patient: Float[np.ndarray, "4 4"]
    lumen_scale: Float[np.ndarray, " m"]


@dataclass(frozen=True)
class _ParticleLaws:
    """Parameters of the core's swarm."""

    liquid_density: float
    viscosity: float
    chyme_density: float
    burst_rate: float
    landing_rate: float
    release_rate: float
    drift: float
    reach: float
    seed: int


class LumenDynamics:
    """Spheres and pools of a `World`, in the frame of its core: patient frame, wall-centered."""

    def __init__(self, model: Model, wall: _core.Wall, body: Body, pose: _core.Pose) -> None:
        assert model.lumen_contents is not None
        self._model, self._body, self._rest = model, body, model.lumen_contents
        self._center = np.array(wall.center)
        self._wall = wall
        bubbles, chyme, self._liquid = model.contents.resolved
        self._sections: Sections | None = None
        arc_length = arc_length_samples(model.organ.centerline)
        self._posture, none = model.T_world_patient, np.zeros(0)
        self.liquid = LiquidLevel(self._rest.pools, none, self._posture, np.ones(len(arc_length)))
        centers = transform_points(invert(model.T_world_patient), self._rest.spheres.centers)
        curve = model.organ.centerline
        tangents = np.stack(
            [np.interp(arc_length, curve.arc_length, curve.frames[:, k, 2]) for k in range(3)],
            axis=1,
        )
        laws = _ParticleLaws(
            liquid_density=self._liquid.density,
            viscosity=self._liquid.viscosity,
            chyme_density=chyme.density,
            burst_rate=bubbles.burst_rate,
            landing_rate=bubbles.landing_rate,
            release_rate=bubbles.release_rate,
            drift=model.contents.drift,
            reach=model.contents.reach,
            seed=model.contents.seed,
        )
        at_rest = self._rest.spheres.at(centers)
        self._particles = _core.Particles(wall, at_rest, laws, tangents, float(arc_length[1]))
        self._push = np.zeros(6)
        lots = stream(model.contents.seed, "lumen/flush")
        self._lots = lots.random(len(self._rest.spheres))
        self._place_dome_bubbles(pose)

    def lumen_contents(self, T_world_patient: Float[np.ndarray, "4 4"]) -> LumenContents:
        """Current contents of the lumen, in the world frame."""
        states = self._particles.states
        centers = transform_points(T_world_patient, states[:, :3] + self._center)
        spheres = replace(self._rest.spheres, centers=centers, arc_length=states[:, 6])
        return LumenContents(self._rest.contents, spheres, self.liquid.pools)

    def _place_dome_bubbles(self, pose: _core.Pose) -> None:
        """Place the bubbles that are initially on the capsule."""
        dome_sites = self._rest.dome_sites + self._body.center
        states = self._particles.states
        first = len(states) - len(dome_sites)
        center, rotation = center_of_mass_and_rotation(pose)
        states[first:, :3] = center + dome_sites @ rotation.T
        states[first:, 7:] = dome_sites
        self._particles.states = states

    def wash_off(self, pose: _core.Pose, fraction: float) -> None:
        """Remove bubbles and chyme around the capsule from the lumen; liquid stays.

        Args:
            pose: Pose of the capsule in the core's frame.
            fraction: Fraction of all spheres that is removed if near; the same spheres each time.
        """
        states = self._particles.states
        center, _ = center_of_mass_and_rotation(pose)
        is_near = np.linalg.norm(states[:, :3] - center, axis=1) < FLUSH_REACH
        goes = is_near & (self._lots < fraction)
        if goes.any():
            states[goes, :3] += [0.0, 0.0, _AWAY]
            states[goes, 3:6] = states[goes, 7:] = 0.0  # at rest, and off the capsule
            self._particles.states = states

    def level_liquid(
        self, T_world_patient: Float[np.ndarray, "4 4"], lumen_scale: Float[np.ndarray, " m"]
    ) -> None:
        """Level the liquid instantly in another posture or with a moved wall.

        Args:
            T_world_patient: Posture of the patient.
            lumen_scale: Radius of the lumen at its samples, relative to that at rest.
        """
        now, self._posture = self.liquid, T_world_patient
        if now.pools is None:
            return
        moved = float(np.abs(lumen_scale - now.lumen_scale).max())
        if moved > _LEVEL_TOLERANCE or not np.array_equal(T_world_patient, now.T_world_patient):
            self._settle(now.pools.section_volume, T_world_patient, lumen_scale)

    def set_liquid(self, liquid: LiquidLevel, T_world_patient: Float[np.ndarray, "4 4"]) -> None:
        """Restore the liquid and posture before a failed step."""
        self.liquid, self._posture = liquid, T_world_patient

    def _settle(
        self,
        section_volume: Float[np.ndarray, " k"],
        T_world_patient: Float[np.ndarray, "4 4"],
        lumen_scale: Float[np.ndarray, " m"],
    ) -> None:
        organ = self._model.organ
        self._sections = self._sections or cut_sections(organ)
        arc_length = arc_length_samples(organ.centerline)
        scale = np.interp(self._sections.arc_length, arc_length, lumen_scale)
        pools = level_pools(organ, self._sections, section_volume, T_world_patient, scale)
        self.liquid = LiquidLevel(pools, section_volume, T_world_patient, lumen_scale.copy())

    def buoyancy_wrench(
        self, pose: _core.Pose, dt: float, gravity: float
    ) -> tuple[Float[np.ndarray, " 3"], Float[np.ndarray, " 3"]]:
        """Force [N] and torque [N·m] on the capsule over the next `dt`, in the core's frame.

        Sum of buoyancy and drag at the position after half the time, and the last push of spheres.
        """
        center, axis = self._capsule(pose, 0.5 * dt)
        force, torque = self._push[:3] / dt, self._push[3:] / dt
        level = self._level(center)
        if level is None:
            return force, torque
        ends = transform_points(self._posture, np.array(axis) + self._center)
        volume, centroid = submerged((ends[0], ends[1]), self._body.radius, level)
        if volume == 0.0:
            return force, torque
        up = self._up()
        lift = self._liquid.density * gravity * volume * up
        middle = transform_points(invert(self._posture), centroid[None])[0] - self._center
        velocity = np.array(pose[2])
        whole = submerged((ends[0], ends[1]), self._body.radius, np.inf)[0]
        area = np.pi * self._body.radius**2 * volume / whole
        drag = -0.5 * _DRAG * self._liquid.density * area * np.linalg.norm(velocity) * velocity
        return force + lift + drag, torque + np.cross(middle - center, lift)

    def step(self, pose: _core.Pose, dt: float, gravity: float, sweep: float) -> None:
        """Advance the spheres by `dt` next to the capsule, which has arrived at `pose`.

        Args:
            pose: Pose of the capsule in the core's frame.
            dt: Length of this piece of a sweep [s].
            gravity: Gravity [m/s²].
            sweep: Total duration of the sweep [s] if this piece ends it, else 0: spheres away from
                the capsule move once per sweep.
        """
        center, axis = self._capsule(pose, 0.0)
        pools = self.liquid.pools
        up = self._up()
        offset = self._posture[2, 3] + self._posture[2, :3] @ self._center
        around = _StepInputs(
            up=tuple(up),
            gravity=gravity,
            stretch=np.zeros((0, 2)) if pools is None else pools.stretch,
            levels=np.zeros(0) if pools is None else pools.levels - offset,
            axis=tuple(tuple(end) for end in axis),
            radius=self._body.radius,
            mass=self._body.mass,
            center=tuple(center),
            wxyz=pose[1],
            velocity=pose[2],
            spin=pose[3],
        )
        impulse, moment = self._particles.step(self._wall, around, dt, sweep)
        self._push = np.array([*impulse, *moment])

    def to_array(self) -> Float[np.ndarray, " q"]:
        """Complete variable state: spheres, their counter, the pending impulse, the liquid."""
        liquid, pools = self.liquid, self._rest.pools
        section_volume = np.zeros(0 if pools is None else len(pools.section_volume))
        section_volume[: len(liquid.section_volume)] = liquid.section_volume
        own = [self._particles.count, *self._push, len(liquid.section_volume) > 0]
        return np.concatenate(
            [self._particles.states.ravel(), own, section_volume, liquid.lumen_scale]
        )

    def restore(self, array: Float[np.ndarray, " q"], T_world_patient: np.ndarray) -> None:
        """Restore the state given by `to_array`."""
        count = 10 * len(self._rest.spheres)
        self._particles.states = array[:count].reshape(-1, 10)
        self._particles.count, self._push = int(array[count]), array[count + 1 : count + 7].copy()
        lumen_scale = array[len(array) - len(self.liquid.lumen_scale) :].copy()
        section_volume = array[count + 8 : len(array) - len(lumen_scale)].copy()
        self._posture = T_world_patient
        if array[count + 7]:
            self._settle(section_volume, T_world_patient, lumen_scale)
        else:
            home = self._model.T_world_patient
            self.liquid = LiquidLevel(self._rest.pools, np.zeros(0), home, lumen_scale)

    def _up(self) -> Float[np.ndarray, " 3"]:
        return self._posture[2, :3]

    def _capsule(
        self, pose: _core.Pose, ahead: float
    ) -> tuple[Float[np.ndarray, " 3"], Float[np.ndarray, "2 3"]]:
        """Center of mass and ends of the axis after a time [m], relative to the wall's center."""
        center, rotation = center_of_mass_and_rotation(pose)
        center = center + ahead * np.array(pose[2])
        middle = center + rotation @ self._body.center
        half = self._body.half_axis * rotation[:, 2]
        return center, np.array([middle - half, middle + half])

    def _level(self, center: Float[np.ndarray, " 3"]) -> float | None:
        """Level of the pool whose arc-length interval contains a point [m], in the world frame."""
        pools = self.liquid.pools
        if pools is None:
            return None
        _, face = self._wall.closest_point((center + self._center)[None])
        pool = pools.of_vertex[self._model.organ.faces[face[0]]].max()
        return None if pool == 0 else float(pools.levels[pool - 1])


def center_of_mass_and_rotation(
    pose: _core.Pose,
) -> tuple[Float[np.ndarray, " 3"], Float[np.ndarray, "3 3"]]:
    """Position relative to the wall's center [m], and rotation from the body frame."""
    return np.array(pose[0]), matrix_from_quaternion(np.array(pose[1]))
