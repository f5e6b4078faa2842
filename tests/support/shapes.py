"""Organs with a closed form, and cameras to look at them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from vrcaps.camera.camera import Camera, Led
from vrcaps.camera.lens import (
    Lens,
    LensEquidistant,
    LensEquirectangular,
    LensKannalaBrandt,
    LensPinhole,
    LensScaramuzza,
)
from vrcaps.capsule.device import Device
from vrcaps.core.geometry import look_along, transform_from
from vrcaps.mesh.mesh import vertex_normals
from vrcaps.organ.surface import Appearance, Centerline, OrganSurface
from vrcaps.render.settings import RenderSettings
from vrcaps.world.model import Model, State

DIRECT = RenderSettings(light="direct", shadows=False)
"""For tests of what a frame shows by direct light, or of geometry alone."""

RADIUS = 0.02


def make_organ(
    vertices: np.ndarray,
    faces: np.ndarray,
    *,
    uv: np.ndarray | None = None,
    arc_length: np.ndarray | None = None,
    appearance: Appearance | None = None,
) -> OrganSurface:
    """An organ of a bare mesh: labels by octant, lesions by height, no real centerline."""
    count = len(vertices)
    middle = vertices.mean(axis=0)
    octant = (vertices > middle) @ np.array([1, 2, 4]) + 1
    line = Centerline(
        middle + np.outer([0.0, 0.01], [0.0, 0.0, 1.0]),
        np.array([0.0, 0.01]),
        np.full(2, 0.01),
        np.stack([np.eye(3)] * 2),
    )
    return OrganSurface(
        name="shape",
        vertices=vertices,
        faces=faces,
        normals=vertex_normals(vertices, faces),
        uv=np.zeros((len(faces), 3, 2)) if uv is None else uv,
        label=octant.astype(np.uint8),
        label_names=("background", *(f"octant {k}" for k in range(1, 9))),
        instance=np.where(vertices[:, 0] > middle[0], 700, 0).astype(np.uint16),
        arc_length=vertices[:, 2].copy() if arc_length is None else arc_length,
        theta=np.zeros(count),
        radius=np.zeros(count),
        centerline=line,
        appearance=appearance,
    )


def sphere(
    subdivisions: int, *, radius: float = RADIUS, appearance: Appearance | None = None
) -> OrganSurface:
    """A sphere about the origin seen from inside; texture coordinates have no seam or pole."""
    import trimesh

    mesh = trimesh.creation.icosphere(subdivisions=subdivisions, radius=radius)
    vertices, faces = np.array(mesh.vertices), np.array(mesh.faces)[:, ::-1]
    x, y, z = np.moveaxis(vertices[faces], -1, 0) / radius
    uv = np.stack([0.3 * x + 0.1 * z, 0.3 * y - 0.2 * z], axis=-1)
    return make_organ(vertices, faces, uv=uv, appearance=appearance)


def tube(
    around: int,
    along: int,
    *,
    length: float = 0.2,
    folds: float = 0.0,
    capped: bool = False,
    appearance: Appearance | None = None,
) -> OrganSurface:
    """A cylinder about z from z = 0 seen from inside; arc length is z.

    Args:
        around: Corners of its cross-section.
        along: Rows of vertices.
        length: Its length [m].
        folds: Height of its ring folds, as a share of the radius; one fold every radius.
        capped: Whether both ends are closed.
        appearance: Its looks; u goes once around, v once every two radii.
    """
    angle = 2.0 * np.pi * np.arange(around) / around
    z = np.linspace(0.0, length, along)
    radius = RADIUS * (1.0 - folds * np.sin(np.pi * z / RADIUS) ** 6)
    ring = np.stack([np.cos(angle), np.sin(angle)], axis=-1)
    vertices = np.concatenate(
        [radius[:, None, None] * ring, np.broadcast_to(z[:, None, None], (along, around, 1))], -1
    ).reshape(-1, 3)
    row, column = (a.ravel() for a in np.mgrid[: along - 1, :around])
    grid = np.stack([row, column, row + 1, column + 1], axis=-1)

    def corner(r: int, c: int) -> np.ndarray:
        return grid[:, r] * around + grid[:, c] % around

    a, b, c, d = corner(0, 1), corner(0, 3), corner(2, 1), corner(2, 3)
    faces = np.concatenate([np.stack([a, c, b], 1), np.stack([b, c, d], 1)])
    place = np.stack(np.broadcast_arrays(grid[:, [1, 3, 1, 3]], grid[:, [0, 0, 2, 2]]), -1)
    uv4 = np.stack([place[..., 0] / around, z[place[..., 1]] / (2.0 * RADIUS)], axis=-1)
    uv = np.concatenate([uv4[:, [0, 2, 1]], uv4[:, [1, 2, 3]]])
    if capped:
        first, last, rim = len(vertices), len(vertices) + 1, np.arange(around)
        following = (rim + 1) % around
        end = around * (along - 1)
        vertices = np.concatenate([vertices, [[0.0, 0.0, 0.0], [0.0, 0.0, length]]])
        lids = [
            np.stack([np.full(around, first), rim, following], 1),
            np.stack([np.full(around, last), end + following, end + rim], 1),
        ]
        faces = np.concatenate([faces, *lids])
        flat = vertices[np.concatenate(lids)][..., :2] / (6.0 * RADIUS)
        uv = np.concatenate([uv, flat])
    return make_organ(vertices, faces, uv=uv, appearance=appearance)


def with_ball(organ: OrganSurface, center: np.ndarray, radius: float) -> OrganSurface:
    """An organ with a closed ball in its lumen, instance 1, its normals outward."""
    import trimesh

    ball = trimesh.creation.icosphere(3, radius)
    sizes = (len(organ.vertices), len(ball.vertices))
    names = ("label", "arc_length", "theta", "radius")
    return replace(
        organ,
        vertices=np.vstack([organ.vertices, ball.vertices + center]),
        faces=np.vstack([organ.faces, ball.faces + sizes[0]]),
        normals=np.vstack([organ.normals, ball.vertex_normals]),
        uv=np.concatenate([organ.uv, np.zeros((len(ball.faces), 3, 2))]),
        instance=np.repeat([0, 1], sizes).astype(np.uint16),
        **{name: np.pad(getattr(organ, name), (0, sizes[1])) for name in names},
    )


def patterned(
    rng: np.random.Generator, *, size: tuple[int, int] = (12, 16), relief: float = 0.0
) -> Appearance:
    """Random coarse textures: every texel another color, roughness and height [m]."""
    return Appearance(
        albedo=rng.integers(20, 236, (*size, 3), dtype=np.uint8),
        roughness=rng.integers(60, 230, size, dtype=np.uint8),
        height=relief * rng.random(size),
        ior=1.4,
        clearcoat=0.7,
        clearcoat_gloss=0.4,
    )


LENSES: dict[str, tuple[Lens, int, int]] = {
    "pinhole": (LensPinhole(55.0, 54.0, 40.5, 31.0, 0.3, -0.02, 0.001, 0.001, -0.001), 83, 61),
    "kannala-brandt": (LensKannalaBrandt(40.0, 41.0, 40.0, 36.0, 0.01, -0.002), 81, 73),
    "scaramuzza": (
        LensScaramuzza(35.0, -0.008, 1e-5, -1e-7, 40.0, 38.0, 1.001, 0.002, -0.001),
        80,
        77,
    ),
    "equidistant": (LensEquidistant(24.0, 39.5, 39.5, 1.6), 80, 80),
    "equirectangular": (LensEquirectangular(96 / 2 / np.pi, 96 / 2 / np.pi, 47.5, 23.5), 96, 48),
}
"""One small camera of each lens kind: lens, width, height."""


def make_camera(
    lens: str | tuple[Lens, int, int] = "pinhole",
    *,
    leds: tuple[Led, ...] = (Led((0.003, 0.001, -0.001)),),
    exposure: float = 0.1,
    image_circle_px: float | None = None,
) -> Camera:
    """A camera at the capsule's origin."""
    optics, width, height = LENSES[lens] if isinstance(lens, str) else lens
    return Camera(
        "eye",
        optics,
        width,
        height,
        leds=leds,
        exposure=exposure,
        image_circle_px=image_circle_px,
    )


def pinhole(size: int, field: float = 1.4) -> tuple[Lens, int, int]:
    """A square pinhole camera with a full field of view [rad]."""
    focal = 0.5 * size / np.tan(0.5 * field)
    return LensPinhole(focal, focal, (size - 1) / 2, (size - 1) / 2), size, size


def make_model(organ: OrganSurface, *cameras: Camera) -> Model:
    """A model whose world frame is the organ's own; without cameras it has one of its own."""
    device = Device(
        name="test",
        title="Test",
        length=0.02,
        radius=0.005,
        mass=0.003,
        frame_rate=10.0,
        cameras=cameras or (make_camera("pinhole"),),
    )
    return Model(organ, device, np.eye(4))


def looking(
    position: tuple[float, float, float],
    forward: tuple[float, float, float] = (0.2, -0.3, 1.0),
    *,
    vertices_world: np.ndarray | None = None,
) -> State:
    """A state with the capsule at a place, looking along a direction."""
    pose = transform_from(look_along(np.array(forward), np.array([0.3, 1.0, 0.1])), position)
    return State(0.0, pose, vertices_world=vertices_world)
