"""Scene and extent of the benchmarks: a colon, a capsule in it, views along the centerline."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from vrcaps.camera.camera import Camera
from vrcaps.camera.lens import LensEquidistant
from vrcaps.capsule.device import Device
from vrcaps.capsule.device_file import read_device
from vrcaps.core.geometry import invert, transform_from
from vrcaps.core.units import MM
from vrcaps.mesh.mesh import vertex_normals
from vrcaps.organ.surface import OrganSurface
from vrcaps.world.model import Model, State

if TYPE_CHECKING:
    from jaxtyping import Float

DEVICE = "mirocam"
"""A camera of 320 × 320 pixels with six LEDs."""


@dataclass(frozen=True)
class Extent:
    """Extent of a measurement.

    Attributes:
        num_triangles: Approximate number of triangles of the wall.
        coarsest: Approximate number of triangles of the smallest wall in their comparison.
        num_subdivisions: Number of subdivisions of that wall, by four each.
        sizes: Side lengths of square images [px], ascending.
        num_views: Number of views along the organ.
        num_rounds: Number of rounds.
    """

    num_triangles: int = 100_000
    coarsest: int = 25_000
    num_subdivisions: int = 3
    sizes: tuple[int, ...] = (160, 320, 640, 1280)
    num_views: int = 8
    num_rounds: int = 21


FULL = Extent()
QUICK = Extent(num_triangles=30_000, coarsest=20_000, num_subdivisions=1, num_views=2, num_rounds=3)
"""Quick check; the values are meaningless."""


@dataclass(frozen=True)
class Stage:
    """Model and views of its capsule.

    Attributes:
        model: Organ and device.
        states: Capsule on the centerline, its axis along it, evenly spread over the organ.
    """

    model: Model
    states: tuple[State, ...]

    @property
    def camera(self) -> Camera:
        """The device's first camera."""
        return self.model.device.cameras[0]

    @property
    def num_triangles(self) -> int:
        """Number of triangles of the wall."""
        return len(self.model.organ.faces)

    def Ts_world_camera(self) -> Float[np.ndarray, "views 4 4"]:
        """Pose of the first camera in each view."""
        return np.stack([s.T_world_capsule @ self.camera.T_capsule_camera for s in self.states])


def make_organ(num_triangles: int, *, seed: int) -> OrganSurface:
    """Generate a colon of about a number of triangles, with its mucosa."""
    from vrcaps.anatomy.colon import ColonParameters, generate_colon
    from vrcaps.mucosa.bake import bake_appearance

    organ = generate_colon(ColonParameters(triangles=num_triangles), seed=seed)
    return replace(organ, appearance=bake_appearance(organ, seed=seed))


def make_stage(organ: OrganSurface, device: Device | str = DEVICE, *, num_views: int) -> Stage:
    """Views from 5 % to 95 % of the centerline; the first camera's pupil is on it."""
    model = Model(organ, read_device(device) if isinstance(device, str) else device)
    line = organ.centerline
    fraction = np.linspace(0.05, 0.95, num_views)
    samples = np.searchsorted(line.arc_length, fraction * line.length)
    T_camera_capsule = invert(model.device.cameras[0].T_capsule_camera)
    states = tuple(
        State(
            time=0.0,
            T_world_capsule=model.T_world_patient
            @ transform_from(line.frames[i], line.points[i])
            @ T_camera_capsule,
        )
        for i in samples
    )
    return Stage(model, states)


def with_moving_wall(stage: Stage) -> Stage:
    """Copy of a stage whose wall differs in each view: waves of 0.5 mm across it."""
    rest, organ = stage.model.vertices_world, stage.model.organ
    normals = vertex_normals(rest, organ.faces)
    phase = 2.0 * np.pi * organ.arc_length / (20 * MM)
    moved = (
        rest + 0.5 * MM * np.sin(phase + i)[:, None] * normals for i in range(len(stage.states))
    )
    states = zip(stage.states, moved, strict=True)
    return replace(stage, states=tuple(replace(s, vertices_world=v) for s, v in states))


def resized_camera(camera: Camera, size: int) -> Camera:
    """Copy of a camera with an ideal fisheye of 170° across a square image of any size [px]."""
    middle, half_field = 0.5 * (size - 1), np.deg2rad(85.0)
    lens = LensEquidistant(
        focal=0.5 * size / half_field, cx=middle, cy=middle, max_angle=float(half_field)
    )
    return replace(camera, lens=lens, width=size, height=size, image_circle_px=None)


def subdivide(organ: OrganSurface) -> OrganSurface:
    """Subdivide each triangle of a wall into four at the midpoints of its edges."""
    faces = np.asarray(organ.faces, np.int64)
    ends = faces[:, [[0, 1], [1, 2], [2, 0]]]
    edges, index = np.unique(np.sort(ends.reshape(-1, 2), axis=1), axis=0, return_inverse=True)
    middle = len(organ.vertices) + index.reshape(-1, 3)
    (a, b, c), (ab, bc, ca) = faces.T, middle.T
    quarters = np.stack([[a, ab, ca], [ab, b, bc], [ca, bc, c], [ab, bc, ca]])
    corner, side = organ.uv, 0.5 * (organ.uv + np.roll(organ.uv, -1, axis=1))
    (ua, ub, uc), (uab, ubc, uca) = corner.swapaxes(0, 1), side.swapaxes(0, 1)
    uv = np.stack([[ua, uab, uca], [uab, ub, ubc], [uca, ubc, uc], [uab, ubc, uca]])

    def mean(values: np.ndarray) -> np.ndarray:
        return np.concatenate([values, 0.5 * (values[edges[:, 0]] + values[edges[:, 1]])])

    def first(values: np.ndarray) -> np.ndarray:
        return np.concatenate([values, values[edges[:, 0]]])

    vertices, faces = mean(organ.vertices), quarters.transpose(0, 2, 1).reshape(-1, 3)
    return replace(
        organ,
        vertices=vertices,
        faces=faces,
        normals=vertex_normals(vertices, faces),
        uv=uv.transpose(0, 2, 1, 3).reshape(-1, 3, 2),
        label=first(organ.label),
        instance=first(organ.instance),
        arc_length=mean(organ.arc_length),
        theta=first(organ.theta),
        radius=mean(organ.radius),
    )
