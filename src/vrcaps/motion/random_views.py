"""Random views: each frame is an independent pose, as in a set of still images."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated, ClassVar

import numpy as np

from vrcaps.core.errors import InputError, require
from vrcaps.core.fields import Range, check_fields
from vrcaps.core.geometry import invert, look_along, rotation_from_vector, transform_from
from vrcaps.core.rng import stream
from vrcaps.core.units import DEG, MM
from vrcaps.motion.motion import MotionSettings
from vrcaps.motion.trajectory import Trajectory, fit_text
from vrcaps.world.model import Model
from vrcaps.world.wall_displacement import WallDisplacement

if TYPE_CHECKING:
    from jaxtyping import Float, Int

_MAX_DRAWS = 4000
_BATCH = 4096
"""Maximum number of poses drawn at once."""
_SLACK_DISTANCES = (4.0 * MM, 20.0 * MM)
"""Upper limits of `nearest` and `farthest` in a closed lumen, which is open around the capsule only
[m]."""
_HIT_SLACK = 0.5 * MM
"""Tolerated gap between line of sight and target: the wall is curved, triangles are flat."""


@dataclass(frozen=True)
class RandomViews(MotionSettings):
    """Views of the wall from random positions, independent in each frame.

    For still images with varied content: near surfaces fill the image, and lesions are seen from
    all sides, whereas a fly-through passes them at a distance. Nothing moves between frames, so
    velocities are zero and images have no motion blur.

    Example:
        >>> motion = vrcaps.RandomViews(lesion_fraction=0.5, farthest=0.03)
        >>> vrcaps.record(vrcaps.Scenario(motion=motion), "runs/stills")

    Attributes:
        lesion_fraction: Fraction of the frames that look at a lesion, each lesion with equal
            probability; the others look at any point of the wall, as do all frames without lesions.
        nearest: Minimum distance from the first camera to its target [m], at most 4 mm in a closed
            lumen.
        farthest: Maximum distance from the first camera to its target [m], at most 20 mm in a
            closed lumen; the distances are log-uniform.
        obliqueness: Maximum angle between the line of sight and the wall's normal [rad].
        tilt: Maximum angle between the camera's axis and the line of sight [rad].
        margin: Minimum distance of the cameras and the capsule's center from the wall [m], at most
            0.5 mm from the wall at rest in a closed lumen.
        rigid_wall: Whether the wall keeps its shape where the shell reaches into it. Otherwise the
            wall yields to the shell.
    """

    lesion_fraction: Annotated[float, Range(0.0, 1.0)] = 0.8
    nearest: Annotated[float, Range(above=0.0, unit="m")] = 8.0 * MM
    farthest: Annotated[float, Range(above=0.0, unit="m")] = 50.0 * MM
    obliqueness: Annotated[float, Range(min=0.0, below=math.pi / 2, unit="rad")] = 75.0 * DEG
    tilt: Annotated[float, Range(0.0, math.pi / 2, unit="rad")] = 30.0 * DEG
    margin: Annotated[float, Range(above=0.0, unit="m")] = 2.0 * MM
    rigid_wall: bool = False

    kind: ClassVar[str] = "random-views"

    def __post_init__(self) -> None:
        check_fields(self)
        allowed = f"nearest ({self.nearest:g} m) or more"
        require(self.farthest >= self.nearest, "farthest", self.farthest, allowed)

    def begin(
        self, model: Model, *, frames: int, fps: float, seed: int, shown: Model | None = None
    ) -> Trajectory:
        """Draw the views in a model, see `MotionSettings.begin`."""
        rng = stream(seed, "random-views")
        still = np.zeros((frames, 3))
        return Trajectory(
            np.arange(frames) / fps,
            random_views(model, self, frames=frames, rng=rng),
            still,
            still,
            wall_displacement=None if self.rigid_wall else WallDisplacement(model, shown or model),
        )


def random_views(
    model: Model, settings: RandomViews, *, frames: int, rng: np.random.Generator
) -> Float[np.ndarray, "frames 4 4"]:
    """Draw views ``Ts_world_capsule``, each until its line of sight is free.

    Args:
        model: The lumen and the capsule.
        settings: Distribution of targets and positions.
        frames: Number of views.
        rng: Random number generator.

    Raises:
        InputError: If no valid pose is found for a view.
    """
    poses = np.empty((frames, 4, 4))
    is_of_lesion = rng.random(frames) < settings.lesion_fraction
    instance = model.organ.instance
    lesions = [np.flatnonzero(instance == lesion) for lesion in np.unique(instance[instance > 0])]
    left, num_draws = np.arange(frames), 0
    while num_draws < _MAX_DRAWS:
        # The fewer views are left, the more draws each has at once.
        count = min(_BATCH // len(left), 1 + num_draws // 8)
        views = np.repeat(left, count)
        targets = _targets(lesions, len(instance), is_of_lesion[views], rng)
        drawn, is_seen = _drawn(model, settings, targets, rng)
        found, first = np.unique(views[is_seen], return_index=True)
        poses[found] = drawn[is_seen][first]
        left, num_draws = np.setdiff1d(left, found), num_draws + count
        if not len(left):
            return poses
    nearest, _ = _distances(model, settings)
    margin = model.wall_margin(settings.margin)
    raise InputError(
        f"{model.device.name} in {model.organ.name}: {len(left)} of {frames} views have no "
        f"free position in {_MAX_DRAWS} draws each, with nearest {nearest:g} m and "
        f"margin {margin:g} m: {fit_text(model)} Allow less of both, inflate the organ, "
        "or take a smaller capsule."
    )


def _targets(
    lesions: Sequence[Int[np.ndarray, " k"]],
    num_vertices: int,
    is_of_lesion: np.ndarray,
    rng: np.random.Generator,
) -> Int[np.ndarray, " n"]:
    """Draw a vertex of the wall for each view: on a random lesion, or anywhere.

    Args:
        lesions: Vertices of each lesion.
        num_vertices: Number of vertices of the wall.
        is_of_lesion: Whether a view looks at a lesion [n].
        rng: Random number generator.
    """
    targets = rng.integers(num_vertices, size=len(is_of_lesion))
    if lesions:
        for view in np.flatnonzero(is_of_lesion):
            members = lesions[int(rng.integers(len(lesions)))]
            targets[view] = members[rng.integers(len(members))]
    return targets


def _drawn(
    model: Model, settings: RandomViews, targets: Int[np.ndarray, " n"], rng: np.random.Generator
) -> tuple[Float[np.ndarray, "n 4 4"], np.ndarray]:
    """Draw a pose of the capsule for each target, and whether the target is visible from it."""
    count = len(targets)
    normals = model.organ.normals[targets] @ model.T_world_patient[:3, :3].T
    towards_camera = _cone(normals, settings.obliqueness, rng)
    nearest, farthest = _distances(model, settings)
    distance = np.exp(rng.uniform(math.log(nearest), math.log(farthest), count))
    centers = model.vertices_world[targets] + distance[:, None] * towards_camera
    forward = _cone(-towards_camera, settings.tilt, rng)
    upright = look_along(forward, _across(forward))
    roll = rotation_from_vector(rng.uniform(-math.pi, math.pi, (count, 1)) * np.eye(3)[2])
    cameras = transform_from(upright @ roll, centers)
    poses = cameras @ invert(model.device.cameras[0].T_capsule_camera)

    margin = model.wall_margin(settings.margin)
    is_seen = np.asarray(model.wall.signed_distance(centers)) >= margin
    some = np.flatnonzero(is_seen)
    hit, _ = model.wall.cast(centers[some], -towards_camera[some])
    some = some[np.abs(hit - distance[some]) <= _HIT_SLACK]
    some = some[model.vital_clearance(poses[some]) >= margin]
    # A body with free ends may pass through the wall in a bend.
    some = some[model.axis_clearance(poses[some]).min(axis=1) > 0.0]
    is_seen[:] = False
    is_seen[some] = True
    return poses, is_seen


def _distances(model: Model, settings: RandomViews) -> tuple[float, float]:
    """Minimum and maximum distance from the camera to its target [m]."""
    if model.closed_radius == 0.0:
        return settings.nearest, settings.farthest
    nearest, farthest = _SLACK_DISTANCES
    return min(settings.nearest, nearest), min(settings.farthest, farthest)


def _cone(
    axes: Float[np.ndarray, "n 3"], angle: float, rng: np.random.Generator
) -> Float[np.ndarray, "n 3"]:
    """Random directions within an angle [rad] of axes, uniform over the sphere."""
    cosine = rng.uniform(math.cos(angle), 1.0, len(axes))[:, None]
    around = rng.uniform(-math.pi, math.pi, len(axes))[:, None]
    x = _across(axes)
    y = np.cross(axes, x)
    sine = np.sqrt(1.0 - cosine**2)
    return cosine * axes + sine * (np.cos(around) * x + np.sin(around) * y)


def _across(axes: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "n 3"]:
    """A unit vector perpendicular to each unit vector."""
    least = np.eye(3)[np.abs(axes).argmin(axis=1)]
    across = np.cross(axes, least)
    return across / np.linalg.norm(across, axis=1, keepdims=True)
