"""Fly-through along the centerline: smooth, seeded, and always inside the lumen.

The capsule follows the centerline plus a lateral drift (see `centerline_follower`). All noise
(drift, tilt, roll, speed) is a function of the distance traveled, so the path does not depend on
the frame rate. The noise is reduced where a camera would come too close to the wall. If even the
centerline brings it too close, in an acute bend, the capsule is pushed aside.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Annotated, ClassVar

import numpy as np

from vrcaps.core.errors import InputError, require
from vrcaps.core.fields import Range, check_fields
from vrcaps.core.geometry import transform_points, velocities_between
from vrcaps.core.rng import stream
from vrcaps.core.units import MM
from vrcaps.motion.centerline_follower import (
    BandLimitedNoise,
    CenterlineFollower,
    follower_offsets,
    make_noise,
    push_inside,
)
from vrcaps.motion.motion import MotionSettings
from vrcaps.motion.trajectory import Trajectory, fit_text
from vrcaps.world.model import Model
from vrcaps.world.wall_displacement import WallDisplacement

if TYPE_CHECKING:
    from jaxtyping import Bool, Float

DEFAULT_SPEED = 0.01
"""Default mean speed of a fly-through [m/s], similar to transport by peristalsis."""

_TILT, _SLACK_TILT = 0.15, 1.1
"""Default tilt in an open and in a closed lumen [rad]."""

_SLACK_DEPTH = 1.0 * MM
"""Maximum distance of a camera beyond the wall at rest of a closed lumen, whose folds give way to
the shell and thus to the cameras in it [m]."""

_KNOT_SPACING = 1.0 * MM  # of the positions where the path is checked against the wall
_PUSH_BLURS = (3.0 * MM, 1.5 * MM, 0.75 * MM)
"""Blurs of the push off the wall [m], tried in turn: a narrow bend requires a less smooth path."""


@dataclass(frozen=True)
class FlyThrough(MotionSettings):
    """Fly-through along the centerline, at a steady speed or over a whole stretch.

    Example:
        >>> motion = vrcaps.FlyThrough(start=0.2, end=0.6, speed=0.005)
        >>> vrcaps.record(vrcaps.Scenario(motion=motion), "runs/flight")

    Attributes:
        start: Position of the first frame, as a fraction of the centerline from the oral end.
        end: Farthest position that the capsule reaches; less than `start` to travel towards the
            oral end. Both are moved inwards to where the capsule fits.
        speed: Mean speed along the centerline [m/s]; None is 0.01 m/s, or less if the frames last
            longer than the stretch from start to end.
        whole: Whether the frames cover the whole stretch from start to end, at the speed that this
            requires. Many frames or a high frame rate keep the distance between frames small.
        speed_variation: Maximum deviation of the speed from its mean, as a fraction, below 1.
        drift: Maximum distance from the centerline, as a fraction of the local radius, below 1.
        tilt: Maximum angle between the capsule's axis and its direction of travel [rad]; None is
            0.15 rad, or 1.1 rad in a closed lumen, whose slack wall does not guide the capsule. The
            wall at rest limits it further.
        roll: Maximum angle about the capsule's axis [rad].
        smoothness: Minimum wavelength of all these along the path [m].
        margin: Distance that cameras and body axis keep from the wall if the lumen is wide enough
            [m]; otherwise half of their distance on the centerline.
        rigid_wall: Whether the wall keeps its shape where the lumen is narrower than the capsule,
            so that the shell reaches into it; its center and its cameras never do. Otherwise the
            wall yields to the shell.
    """

    start: Annotated[float, Range(0.0, 1.0)] = 0.03
    end: Annotated[float, Range(0.0, 1.0)] = 0.97
    speed: Annotated[float | None, Range(above=0.0, unit="m/s")] = None
    whole: bool = False
    speed_variation: Annotated[float, Range(min=0.0, below=1.0)] = 0.3
    drift: Annotated[float, Range(min=0.0, below=1.0)] = 0.3
    tilt: Annotated[float | None, Range(0.0, math.pi / 2, unit="rad")] = None
    roll: Annotated[float, Range(min=0.0, unit="rad")] = 0.6
    smoothness: Annotated[float, Range(above=0.0, unit="m")] = 0.06
    margin: Annotated[float, Range(above=0.0, unit="m")] = 2.0 * MM
    rigid_wall: bool = False

    kind: ClassVar[str] = "fly-through"

    def __post_init__(self) -> None:
        check_fields(self)
        require(self.end != self.start, "end", self.end, "0 to 1, not start")
        if self.whole and self.speed is not None:
            raise InputError(
                f"whole is true and speed is {self.speed:g} m/s. Allowed: one of them, because the "
                "frames and the frame rate give the speed at which the whole stretch is covered."
            )

    def begin(
        self, model: Model, *, frames: int, fps: float, seed: int, shown: Model | None = None
    ) -> Trajectory:
        """Create the fly-through in a model, see `MotionSettings.begin`."""
        rng = stream(seed, "fly-through")
        return fly_through(model, self, frames=frames, fps=fps, rng=rng, shown=shown)


def fly_through(
    model: Model,
    settings: FlyThrough,
    *,
    frames: int,
    fps: float,
    rng: np.random.Generator,
    shown: Model | None = None,
) -> Trajectory:
    """Trajectory of the capsule along the centerline, facing the direction of travel.

    Args:
        model: The lumen and the capsule.
        settings: Start, end, speed and noise.
        frames: Number of frames, at least 1.
        fps: Frames per second.
        rng: Random number generator of the noise.
        shown: Model whose wall yields to the shell, with the same triangles; None for `model`.

    Raises:
        InputError: If a setting is out of range, the frames at `speed` need more than the
            stretch, or the capsule does not fit through a bend.
    """
    duration = (frames - 1) / fps
    follower, low, high, notes = _fitted(
        model, settings, _make_follower(model, settings, rng), duration
    )
    distance = _distance(settings, high - low, frames, fps)
    follower = _eased(model, settings, follower, low, high)
    rate = distance / duration if frames > 1 else 0.0
    noise = make_noise(settings.smoothness, rng, count=1)
    first = low if follower.sign > 0.0 else high

    def pose_at(times: Float[np.ndarray, " k"]) -> Float[np.ndarray, "k 4 4"]:
        traveled = _traveled(rate * times, distance, noise, settings.speed_variation)
        return follower.poses(first + follower.sign * traveled)

    times = np.arange(frames) / fps
    step = 1e-3 / fps
    velocities = velocities_between(pose_at(times - step), pose_at(times + step), 2.0 * step)
    wall_displacement = None if settings.rigid_wall else WallDisplacement(model, shown or model)
    trajectory = Trajectory(times, pose_at(times), *velocities, notes, wall_displacement)
    if not _gives_way(model, settings):
        model.require_inside(trajectory.Ts_world_capsule)
    return trajectory


def _nominal_speed(settings: FlyThrough) -> float:
    """Requested or default mean speed [m/s]."""
    return DEFAULT_SPEED if settings.speed is None else settings.speed


def _distance(settings: FlyThrough, stretch: float, frames: int, fps: float) -> float:
    """Distance along the centerline from the first frame to the last [m].

    Raises:
        InputError: If the frames at the requested speed need more than the stretch.
    """
    if settings.whole:
        return stretch
    distance = _nominal_speed(settings) * (frames - 1) / fps
    if settings.speed is None:
        return min(distance, stretch)
    if distance > stretch * (1.0 + 1e-9):
        raise InputError(
            f"{frames} frames at {fps:g} per second and {settings.speed:g} m/s travel "
            f"{distance:.3g} m, but the stretch is {stretch:.3g} m. Allowed: up to "
            f"{int(stretch / settings.speed * fps) + 1} frames, or a lower speed."
        )
    return distance


def _traveled(
    nominal: Float[np.ndarray, " n"], distance: float, noise: BandLimitedNoise, variation: float
) -> Float[np.ndarray, " n"]:
    """Distance traveled for nominal distances at steady speed; both end at `distance` [m]."""
    if distance <= 0.0:
        return np.zeros_like(nominal)
    ends = np.array([distance])
    whole = distance + variation * noise.integral(ends)[0, 0]
    return (nominal + variation * noise.integral(nominal)[:, 0]) * distance / whole


def _make_follower(
    model: Model, settings: FlyThrough, rng: np.random.Generator
) -> CenterlineFollower:
    """Follower of the organ's centerline for the model's capsule, without noise."""
    line = model.organ.centerline
    front, rear = follower_offsets(model.device)
    noise = make_noise(settings.smoothness, rng, count=5)
    return CenterlineFollower(
        centerline=replace(
            line,
            points=transform_points(model.T_world_patient, line.points),
            frames=model.T_world_patient[:3, :3] @ line.frames,
        ),
        noise=noise.swinging(slice(2, 4)) if model.closed_radius > 0.0 else noise,
        front=front,
        rear=rear,
        sign=1.0 if settings.end > settings.start else -1.0,
        drift=settings.drift,
        tilt=_tilt(model, settings),
        roll=settings.roll,
        amplitude=np.zeros_like,
    )


def _fitted(
    model: Model, settings: FlyThrough, follower: CenterlineFollower, duration: float
) -> tuple[CenterlineFollower, float, float, tuple[str, ...]]:
    """Return the follower with its poses pushed into the lumen, and the stretch where it fits [m].

    Raises:
        InputError: If the capsule does not fit in, or leaves the lumen in between.
    """
    knots, clearance, notes = _stretch(model, settings, follower)
    need = _least_clearance(model, settings)
    if (clearance >= need).all() and (clearance > 0.0).all():  # there is nothing to push
        still = replace(follower, correction=_linear(knots, np.zeros((len(knots), 6))))
        return still, float(knots[0]), float(knots[-1]), notes
    poses, fitted = follower.poses(knots), follower
    for blur in _PUSH_BLURS:
        push = push_inside(model, poses, need=need, blur=blur / _KNOT_SPACING)
        fitted = replace(follower, correction=_linear(knots, push))
        clearance = model.vital_clearance(fitted.poses(knots))
        if (clearance > 0.0).all():
            return fitted, float(knots[0]), float(knots[-1]), notes
    is_free = np.asarray(clearance > 0.0)
    part = None if settings.whole else _free_part(settings, knots, is_free, duration)
    if part is None and _gives_way(model, settings) and (clearance > -_SLACK_DEPTH).all():
        return fitted, float(knots[0]), float(knots[-1]), notes
    if part is None:
        blocked = int(np.flatnonzero(~is_free)[0])
        raise InputError(
            f"{model.device.name} in {model.organ.name}: a camera leaves the lumen "
            f"{knots[blocked] / model.organ.centerline.length:.3f} of the way along (by "
            f"{max(-clearance[blocked] / MM, 0.01):.2f} mm). Choose start and end on one side of "
            "it, a smaller capsule or a wider organ."
        )
    note = (
        f"Moved the stretch to {part[0] / MM:.0f} to {part[1] / MM:.0f} mm along the centerline, "
        "because the capsule does not fit through a bend outside it."
    )
    return fitted, *part, (*notes, note)


def _free_part(
    settings: FlyThrough,
    knots: Float[np.ndarray, " k"],
    is_free: Bool[np.ndarray, " k"],
    duration: float,
) -> tuple[float, float] | None:
    """First part of a stretch [m] in which the capsule fits for the whole duration, if any."""
    least = _nominal_speed(settings) * duration
    ends = np.flatnonzero(np.diff(np.concatenate([[False], is_free, [False]]).astype(int)))
    parts = [(float(knots[a]), float(knots[b - 1])) for a, b in ends.reshape(-1, 2)]
    long_enough = [part for part in parts if part[1] - part[0] >= least]
    if not long_enough:
        return None
    return long_enough[0] if settings.end > settings.start else long_enough[-1]


def _stretch(
    model: Model, settings: FlyThrough, follower: CenterlineFollower
) -> tuple[Float[np.ndarray, " k"], Float[np.ndarray, " k"], tuple[str, ...]]:
    """Knots of the requested stretch, its ends moved inwards to where the capsule fits.

    Returns:
        Distances along the centerline [m], clearance at each [m], and notes on the ends.

    Raises:
        InputError: If it does not fit anywhere.
    """
    asked = np.sort(np.array([settings.start, settings.end])) * model.organ.centerline.length
    knots = _knots(*asked)
    clearance = model.vital_clearance(follower.poses(knots))
    inside = np.flatnonzero(clearance > model.wall_margin(settings.margin))
    if len(inside) < 2:
        inside = np.flatnonzero(clearance > _least_clearance(model, settings))
    if len(inside) < 2:
        raise InputError(
            f"{model.device.name} in {model.organ.name}: the capsule fits nowhere between start "
            f"{settings.start:g} and end {settings.end:g}: {fit_text(model)} Choose another "
            "stretch, inflate the gut, or take a smaller capsule."
        )
    part = slice(inside[0], inside[-1] + 1)
    knots, clearance = knots[part], clearance[part]
    notes = tuple(
        f"Moved the {end} end of the stretch inwards by {shift / MM:.1f} mm, to where the "
        "capsule fits."
        for end, shift in (("oral", knots[0] - asked[0]), ("anal", asked[1] - knots[-1]))
        if shift > 0.0
    )
    return knots, clearance, notes


def _gives_way(model: Model, settings: FlyThrough) -> bool:
    """Whether the wall is slack and yields to the shell."""
    return not settings.rigid_wall and model.closed_radius > 0.0


def _tilt(model: Model, settings: FlyThrough) -> float:
    """Requested or default maximum tilt [rad]."""
    if settings.tilt is not None:
        return settings.tilt
    return _TILT if model.closed_radius == 0.0 else _SLACK_TILT


def _least_clearance(model: Model, settings: FlyThrough) -> float:
    """Clearance [m] up to which the capsule is pushed off the wall."""
    return 0.25 * min(model.wall_margin(settings.margin), model.device.radius)


def _eased(
    model: Model, settings: FlyThrough, follower: CenterlineFollower, low: float, high: float
) -> CenterlineFollower:
    """Return the follower with full noise, reduced wherever it would come too close to the wall."""
    from scipy.interpolate import PchipInterpolator  # slow to load

    knots = _knots(low, high)
    bare = model.clearance(follower.poses(knots))
    # A point that is outside even without noise (an end of the shell) is ignored.
    margin = model.wall_margin(settings.margin)
    need = np.where(bare > 0.0, np.minimum(margin, 0.5 * bare), -np.inf)
    amplitude = np.ones_like(knots)
    slope = knots / settings.smoothness
    for attempt in range(16):
        wandering = replace(follower, amplitude=_linear(knots, amplitude))
        near = (model.clearance(wandering.poses(knots)) < need).any(axis=1)
        if not near.any():
            break
        amplitude[near] *= 0.7 if attempt < 12 else 0.0
        amplitude = np.minimum.accumulate(amplitude - slope) + slope
        amplitude = np.minimum.accumulate((amplitude + slope)[::-1])[::-1] - slope
    interpolator = PchipInterpolator(knots, amplitude)
    return replace(follower, amplitude=lambda s: interpolator(np.clip(s, low, high)))


def _knots(low: float, high: float) -> Float[np.ndarray, " n"]:
    return np.linspace(low, high, max(int(np.ceil((high - low) / _KNOT_SPACING)), 2) + 1)


def _linear(
    knots: Float[np.ndarray, " k"], values: Float[np.ndarray, " k *d"]
) -> Callable[[np.ndarray], np.ndarray]:
    """Linear interpolation between knots, constant beyond the end knots."""

    def at(s: np.ndarray) -> np.ndarray:
        columns = [np.interp(s, knots, column) for column in values.reshape(len(knots), -1).T]
        return np.stack(columns, axis=-1).reshape(len(s), *values.shape[1:])

    return at
