"""Views of an organ: from outside in parallel projection, and from inside through a capsule."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from vrcaps import _core
from vrcaps._core import Wall
from vrcaps.capsule.device_file import read_device
from vrcaps.core.geometry import barycentric, invert, transform_from, unit
from vrcaps.core.units import MM
from vrcaps.organ.surface import OrganSurface, face_label, interpolate
from vrcaps.render.renderer import Renderer
from vrcaps.render.settings import RenderSettings
from vrcaps.world.model import Model, State

if TYPE_CHECKING:
    from jaxtyping import Float, UInt8

    from vrcaps._core import Wall
    from vrcaps.camera.camera import Camera

VIEWS = {
    "From the front": np.array([[1.0, 0, 0], [0, 0, 1], [0, 1, 0]]),
    "From the patient's left": np.array([[0, 1.0, 0], [0, 0, 1], [-1, 0, 0]]),
}
"""Rows are the image's right and up and the viewing direction, in the patient frame (LPS)."""

_AMBIENT = 0.35
_LIGHT = (-0.35, 0.45, -0.82)  # towards the light: right, up, forward


def outside_view(
    organ: OrganSurface,
    wall: Wall,
    axes: Float[np.ndarray, "3 3"],
    center: Float[np.ndarray, " 3"],
    half: float,
    *,
    colors: Float[np.ndarray, "k 3"],
    size_px: int = 520,
) -> Float[np.ndarray, "h w 3"]:
    """Parallel projection of an organ, colored by label, lit from next to the viewer.

    Args:
        organ: The organ.
        wall: Its surface, in the organ's frame.
        axes: Rows are the image's right and up and the viewing direction, unit vectors.
        center: Point in the middle of the image [m].
        half: Half the side of the visible square [m]; the view starts twice as far from `center`.
        colors: sRGB color of each label.
        size_px: Side of the image; each pixel averages 2×2 rays.

    Returns:
        sRGB image, 0 to 1, white where there is no wall.
    """
    origins, directions = view_rays(axes, center, half, 2 * size_px)
    distance, face = wall.cast(origins, directions)
    hit = np.flatnonzero(face >= 0)
    points = origins[hit] + distance[hit, None] * axes[2]
    corners = organ.faces[face[hit]]
    weights = barycentric(points, organ.vertices[corners])
    normals = -np.einsum("nc,ncx->nx", weights, organ.normals[corners])  # out of the lumen
    normals = unit(normals)
    light = np.array(_LIGHT) @ axes / np.linalg.norm(_LIGHT)
    shade = _AMBIENT + (1.0 - _AMBIENT) * np.clip(normals @ light, 0.0, 1.0)
    near = (distance[hit] - distance[hit].min()) / max(float(np.ptp(distance[hit])), 1e-12)
    color = colors[face_label(organ.label, organ.faces)[face[hit]]]
    image = np.ones((len(origins), 3))
    image[hit] = np.clip(color * (shade * (1.12 - 0.30 * near))[:, None], 0.0, 1.0)
    return image.reshape(size_px, 2, size_px, 2, 3).mean(axis=(1, 3))


def view_rays(
    axes: Float[np.ndarray, "3 3"], center: Float[np.ndarray, " 3"], half: float, size_px: int
) -> tuple[Float[np.ndarray, "n 3"], Float[np.ndarray, "n 3"]]:
    """Origins and directions of the rays of a view, row by row.

    Args:
        axes: Rows are the image's right and up and the viewing direction, unit vectors.
        center: Point in the middle of the image [m].
        half: Half the side of the square seen [m].
        size_px: Rays along a side.
    """
    right, up, forward = axes
    steps = half * (2.0 * (np.arange(size_px) + 0.5) / size_px - 1.0)
    origins = steps[None, :, None] * right - steps[:, None, None] * up
    origins = (origins + center - 2.0 * half * forward).reshape(-1, 3)
    return origins, np.broadcast_to(forward, origins.shape).copy()


def project(
    point: Float[np.ndarray, " 3"], axes: Float[np.ndarray, "3 3"], center: Float[np.ndarray, " 3"]
) -> Float[np.ndarray, " 2"]:
    """Position of a point in a view: to the right of and above the center [m]."""
    return axes[:2] @ (point - center)


_BRIGHT = 0.6  # linear value that the 90th percentile of an image is scaled to
_ASIDE = 30.0 * MM  # maximum distance of a view from the requested position
_CONE = 0.45  # tangent of the half angle of the cone ahead that must be free
_GAIN = (0.25, 12.0)  # of the capsule's own exposure; capsules regulate theirs likewise


def inside_views(
    organ: OrganSurface, arc_length: Sequence[float], *, capsule: str = "mirocam"
) -> list[UInt8[np.ndarray, "h w 3"]]:
    """Render the view of a capsule on the centerline that looks towards the anal end.

    Args:
        organ: The organ.
        arc_length: Position [m]; moved by up to `_ASIDE` if a lesion is in the way.
        capsule: Its front camera is used; the exposure is regulated in each view.
    """
    device = read_device(capsule)
    camera = device.cameras[0]
    renderer = Renderer(
        Model(organ, device, np.eye(4)),
        RenderSettings(light="direct", supersampling=2, shadows=True),
    )
    wall = renderer.model.wall
    positions = np.array([clear_place(organ, wall, float(at)) for at in arc_length])
    points, frames, _ = interpolate(organ.centerline, positions)
    T_camera_capsule = invert(camera.T_capsule_camera)
    images = []
    for point, frame in zip(points, frames, strict=True):
        state = State(0.0, transform_from(frame, point) @ T_camera_capsule)
        images.append(exposed_image(renderer, state, camera))
    return images


def exposed_image(renderer: Renderer, state: State, camera: Camera) -> UInt8[np.ndarray, "h w 3"]:
    """Render a camera image with its exposure regulated as capsules do."""
    radiance = renderer.render(state, camera, channels=("radiance",)).radiance
    assert radiance is not None
    lit = np.append(radiance[..., 0][radiance[..., 0] > 0.0], 1e-9)
    gain = _BRIGHT / (np.percentile(lit, 90) * camera.exposure)
    return _core.encode_srgb(radiance, camera.exposure * float(np.clip(gain, *_GAIN)))


def clear_place(organ: OrganSurface, wall: Wall, arc_length: float) -> float:
    """Arc length [m] nearest to the given one with a mostly free view ahead for one diameter.

    If there is none, the given arc length.
    """
    angle = np.linspace(0.0, 2.0 * np.pi, 12, endpoint=False)
    across = _CONE * np.stack([np.cos(angle), np.sin(angle)], axis=1)
    cone = np.column_stack([np.vstack([across, 0.5 * across]), np.ones(2 * len(angle))])
    for offset in sorted(np.linspace(-_ASIDE, _ASIDE, 13), key=abs):
        position = float(np.clip(arc_length + offset, 0.0, organ.centerline.length))
        point, frame, radius = interpolate(organ.centerline, np.array([position]))
        if wall.signed_distance(point)[0] < 0.25 * radius[0]:
            continue
        ahead, face = wall.cast(np.tile(point, (len(cone), 1)), cone @ frame[0].T)
        if np.mean((face < 0) | (ahead > 2.0 * radius[0])) > 0.5:
            return position
    return arc_length
