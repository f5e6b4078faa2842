"""Surface of a stitched image, its registration to the true wall, and the output files.

Shape from shading gives the distance up to a factor, with a light at the camera. A matte wall of
uniform albedo has the brightness I = cos θ / r² at distance r and angle θ to its normal. With
L = ln r over directions, cos θ = 1 / √(1 + |∇L|²), so that ::

    L + ¼ ln(1 + |∇L|²) + ½ ln I = 0

which has a unique viscosity solution (Prados and Faugeras, CVPR 2005). It is computed by
integrating L_t = −(…) on a grid to a steady state with the Lax-Friedrichs scheme.

The registration is iterative closest point (Besl and McKay, IEEE TPAMI 14(2), 1992) with the
point-to-plane distances of Chen and Medioni, Image and Vision Computing 10(3), 1992: points may
slide along the surface, so few steps suffice.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from vrcaps.camera.camera import Camera, pixel_grid
from vrcaps.core.color import linear_from_srgb, luminance
from vrcaps.core.errors import InputError, import_extra, require
from vrcaps.core.files import write_csv
from vrcaps.core.geometry import (
    rotation_from_vector,
    transform_points,
    triangle_normals,
    unit,
    wall_of,
)
from vrcaps.core.units import MM
from vrcaps.mesh.mesh import Mesh
from vrcaps.metrics.trajectory import Similarity
from vrcaps.recording.frame_files import write_images
from vrcaps.recording.frame_sequence import CAMERA_POSE
from vrcaps.render.channels import CHANNELS
from vrcaps.tools.photos import fill
from vrcaps.tools.reconstruction.estimates import network_depth
from vrcaps.tools.reconstruction.matching import Pair, highlights, opencv, without_highlights
from vrcaps.tools.reconstruction.stitching.mosaic import Mosaic
from vrcaps.tools.reconstruction.stitching.stitch import Stitched

if TYPE_CHECKING:
    from jaxtyping import Float, UInt8

    from vrcaps.learn.checkpoint import TrainedNetwork

_MAX_STEPS = 60
_CONVERGED = 1e-4
"""Relative change of the error below which registration stops."""
_EXACT = 1e-8
"""Error at which registration also stops [m]: nearest points have 32-bit precision."""
_MAX_POINTS = 20_000
_USED = 0.9
"""Fraction of the points, the nearest, used in a step; the others may be off the surface."""
_SOFT = 1e-2
"""Directions that distances constrain less than this, relative to the best, are not updated: in a
tube points can slide and roll."""


@dataclass(frozen=True)
class Registration:
    """Result of point-to-plane ICP.

    Attributes:
        similarity: Maps the given points to the surface.
        rmse: Root mean square distance from the surface before each step and after the last [m].
    """

    similarity: Similarity
    rmse: tuple[float, ...]


def register(points: Float[np.ndarray, "n 3"], surface: Mesh, *, scale: bool) -> Registration:
    """Register points to a surface, starting from their current position.

    Args:
        points: Points near their solution [m].
        surface: Target surface [m].
        scale: Whether to fit a scale as well.

    Raises:
        InputError: If there are fewer than 10 points.
    """
    require(len(points) >= 10, "number of points to register", len(points), "10 or more")
    wall = wall_of(surface.vertices, surface.faces)
    normals = unit(triangle_normals(surface.vertices[surface.faces]))
    result, errors = Similarity(np.eye(3), np.zeros(3), 1.0), []
    best, least = result, np.inf
    for _ in range(_MAX_STEPS):
        moved = apply(result, points)
        nearest, face = wall.closest_point(np.ascontiguousarray(moved))
        distance = np.linalg.norm(nearest - moved, axis=1)
        errors.append(float(np.sqrt(np.mean(distance**2))))
        if errors[-1] < least:
            best, least = result, errors[-1]
        if _has_converged(errors):
            break
        near = distance <= np.quantile(distance, _USED)
        step = _step(moved[near], nearest[near], normals[face[near]], scale=scale)
        result = after(step, result)
    return Registration(best, tuple(errors))


def _has_converged(errors: list[float]) -> bool:
    is_steady = len(errors) > 1 and abs(errors[-2] - errors[-1]) <= _CONVERGED * errors[-2]
    return is_steady or errors[-1] <= _EXACT


def registered(mesh: Mesh, surface: Mesh, *, scale: bool) -> tuple[Mesh, Registration]:
    """Register a mesh to a surface.

    Args:
        mesh: Mesh near its solution [m].
        surface: Target surface [m].
        scale: Whether to fit a scale as well.

    Raises:
        InputError: If it has fewer than 10 vertices.
    """
    step = 1 + len(mesh.vertices) // _MAX_POINTS
    result = register(mesh.vertices[::step], surface, scale=scale)
    return replace(mesh, vertices=apply(result.similarity, mesh.vertices)), result


def apply(similarity: Similarity, points: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "n 3"]:
    """Transform points by a similarity."""
    return similarity.scale * points @ similarity.rotation.T + similarity.translation


def after(second: Similarity, first: Similarity) -> Similarity:
    """Compose two similarities."""
    return Similarity(
        second.rotation @ first.rotation,
        apply(second, first.translation[None])[0],
        second.scale * first.scale,
    )


def _step(
    points: np.ndarray, nearest: np.ndarray, normals: np.ndarray, *, scale: bool
) -> Similarity:
    """Small motion that minimizes the distances of points to the planes of their nearest points."""
    center = points.mean(axis=0)
    arm = points - center
    size = float(np.sqrt(np.mean(np.sum(arm**2, axis=1))))
    columns = [np.cross(arm, normals) / size, normals]
    if scale:
        columns.append(np.sum(arm * normals, axis=1, keepdims=True) / size)
    gap = np.sum((nearest - points) * normals, axis=1)
    solved = np.linalg.lstsq(np.concatenate(columns, axis=1), gap, rcond=_SOFT)[0]
    rotation = rotation_from_vector(solved[:3] / size)
    factor = float(np.exp(solved[6] / size)) if scale else 1.0
    return Similarity(rotation, center + solved[3:6] - factor * rotation @ center, factor)


_SIDE = 128
"""Longest side of the solver's grid."""
_DURATION = 8.0
"""Pseudo-time until steady state; deviations decay as e⁻ᵗ."""
_DARK = 1e-3
"""Linear brightness below which there is only noise."""


def depth_from_shading(rgb: UInt8[np.ndarray, "h w 3"], camera: Camera) -> Float[np.ndarray, "h w"]:
    """Depth z of a wall of uniform albedo, up to a factor; NaN where the image is black.

    Args:
        rgb: Image lit by lights next to the lens, without highlights.
        camera: Pinhole camera of the image.
    """
    resize = import_extra("skimage.transform", "reconstruct", package="scikit-image").resize
    is_seen = rgb.max(axis=2) > 0
    light = luminance(linear_from_srgb(rgb))
    light = fill(np.maximum(light, _DARK)[..., None], is_seen)[..., 0] if is_seen.any() else light
    height, width = light.shape
    scale = min(1.0, _SIDE / max(height, width))
    size = (max(2, round(scale * height)), max(2, round(scale * width)))
    small = np.asarray(resize(light, size, order=1, anti_aliasing=True))
    rays = camera.lens.unproject(pixel_grid(width, height))
    plane = rays[..., :2] / rays[..., 2:]
    axes = (
        np.linspace(plane[0, 0, 0], plane[0, -1, 0], size[1]),
        np.linspace(plane[0, 0, 1], plane[-1, 0, 1], size[0]),
    )
    solved = _solved(np.maximum(small, _DARK), *axes)
    log_distance = np.asarray(resize(solved, (height, width), order=1))
    return np.where(is_seen, np.exp(log_distance) * rays[..., 2], np.nan)


def _solved(
    light: Float[np.ndarray, "h w"], x: Float[np.ndarray, " w"], y: Float[np.ndarray, " h"]
) -> Float[np.ndarray, "h w"]:
    """Solve for L over the plane z = 1.

    There |∇L|² = q² (Lx² + Ly² + (x Lx + y Ly)²) with q² = 1 + x² + y².
    """
    column, row = np.meshgrid(x, y)
    square = 1.0 + column**2 + row**2
    steps = (float(x[1] - x[0]), float(y[1] - y[0]))
    # Derivative of ¼ ln(1 + |∇L|²) by Lx or Ly: at most q² / 4, less than the scheme's viscosity.
    viscosity = 0.25 * square
    dt = min(steps) / (4.0 * float(viscosity.max()))
    base = -0.5 * np.log(light)
    result = base.copy()
    for _ in range(int(np.ceil(_DURATION / dt))):
        padded = np.pad(result, 1, mode="edge")
        left, right = padded[1:-1, :-2], padded[1:-1, 2:]
        above, below = padded[:-2, 1:-1], padded[2:, 1:-1]
        across, down = (right - left) / (2.0 * steps[0]), (below - above) / (2.0 * steps[1])
        slope = square * (across**2 + down**2 + (column * across + row * down) ** 2)
        smooth = (left + right - 2.0 * result) / steps[0]
        smooth += (above + below - 2.0 * result) / steps[1]
        rest = base - 0.25 * np.log1p(slope) - result
        result = result + dt * (rest + 0.5 * viscosity * smooth)
    return result


_JUMP = 1.15
"""Ratio of neighboring depths above which they belong to two surfaces."""


@dataclass(frozen=True)
class DepthSource:
    """Source of a stitched image's depth; by default, its frames.

    Attributes:
        weights: File or published name of weights of the task `depth` or `sfm`; empty for none.
        shading: Whether to use shape from shading.
    """

    weights: str = ""
    shading: bool = False


@dataclass(frozen=True)
class WallSurface:
    """Surface in the world frame, or in the reference camera's frame without known poses.

    Attributes:
        mesh: Vertices in [m].
        color: Color of each vertex.
        registration: Registration to the true wall; None if the wall is unknown.
    """

    mesh: Mesh
    color: UInt8[np.ndarray, "n 3"]
    registration: Registration | None


def wall_surface(stitched: Stitched, source: DepthSource) -> tuple[Stitched, WallSurface]:
    """Build the surface of a stitched image; return it with the image and the depth used.

    Registration starts from the reference's true pose, not the paper's hand-labeled polygon.
    A free scale is set by the median of the frames' own depth, or fitted without it.

    Args:
        stitched: Result of stitching.
        source: Source of the depth.

    Raises:
        InputError: If there is no depth, or the weights are unsuitable.
        MissingExtraError: If a package is not installed.
    """
    mosaic, sequence = stitched.mosaic, stitched.sequence
    depth, has_scale = _depth(mosaic, source)
    if not has_scale and np.isfinite(mosaic.depth).any():
        # A scale fitted to nearest points would shrink a wrong surface onto a part of the wall.
        depth, has_scale = depth * np.nanmedian(mosaic.depth / depth), True
    mesh, color = surface_of(depth, mosaic.rgb, mosaic.camera)
    if CAMERA_POSE in sequence.values:
        pose = sequence.Ts_world_camera[mosaic.reference]
        mesh = replace(mesh, vertices=transform_points(pose, mesh.vertices))
    registration = None
    if sequence.episode is not None:
        mesh, registration = registered(mesh, sequence.episode.organ, scale=not has_scale)
    moved = replace(stitched, mosaic=replace(mosaic, depth=depth.astype(np.float32)))
    return moved, WallSurface(mesh, color, registration)


def _depth(mosaic: Mosaic, source: DepthSource) -> tuple[Float[np.ndarray, "h w"], bool]:
    """Depth z of the image, and whether it is in meters."""
    if source.shading:
        return depth_from_shading(mosaic.rgb, mosaic.camera), False
    if source.weights:
        from vrcaps.learn.checkpoint import read_weights
        from vrcaps.learn.hub import find_weights

        return estimated_depth(read_weights(find_weights(source.weights)), mosaic)
    if not np.isfinite(mosaic.depth).any():
        raise InputError("The frames have no depth. Give --depth, --weights or --shading.")
    return mosaic.depth.astype(float), True


def surface_of(
    depth: Float[np.ndarray, "h w"], rgb: UInt8[np.ndarray, "h w 3"], camera: Camera
) -> tuple[Mesh, UInt8[np.ndarray, "n 3"]]:
    """Triangulate a depth image in the camera frame, with vertex colors.

    Args:
        depth: Depth z [m]; NaN where it is unknown. The surface is cut at discontinuities.
        rgb: Colors.
        camera: Camera of both.

    Raises:
        InputError: If there is no surface.
    """
    height, width = depth.shape
    rays = camera.lens.unproject(pixel_grid(width, height))
    points = rays / rays[..., 2:] * depth[..., None]
    index = np.arange(height * width).reshape(height, width)
    a, b, c, d = index[:-1, :-1], index[:-1, 1:], index[1:, 1:], index[1:, :-1]
    faces = np.concatenate([np.stack(t, axis=-1).reshape(-1, 3) for t in ((a, d, b), (b, d, c))])
    corners = depth.ravel()[faces]
    low, high = corners.min(axis=1), corners.max(axis=1)
    faces = faces[np.isfinite(low) & (low > 0.0) & (high <= _JUMP * low)]
    if not len(faces):
        raise InputError("The stitched image has no surface: its depth is unknown everywhere.")
    used, faces = np.unique(faces, return_inverse=True)
    return Mesh(points.reshape(-1, 3)[used], faces.reshape(-1, 3)), rgb.reshape(-1, 3)[used]


def estimated_depth(
    trained: TrainedNetwork, mosaic: Mosaic
) -> tuple[Float[np.ndarray, "h w"], bool]:
    """Estimate depth z of a stitched image by a network; also return whether it is in meters.

    Args:
        trained: Weights of the task `depth` or, up to scale, `sfm`.
        mosaic: The image.

    Raises:
        InputError: If the weights are of another task.
    """
    depth = network_depth(trained, mosaic.rgb, mosaic.camera)
    return np.where(mosaic.rgb.any(axis=2), depth, np.nan), trained.task.kind == "depth"


_MARK = np.array([40, 255, 80], np.uint8)
_LINES = 60


def write_stitched(folder: Path, result: Stitched) -> None:
    """Write `highlights.png`, `matches.png`, `matches.csv`, `mosaic.png` and `depth.png`.

    Raises:
        MissingExtraError: If OpenCV is not installed.
    """
    images = {
        "highlights.png": highlights_picture(result.sequence.image("rgb", result.mosaic.reference)),
        "matches.png": matches_picture(result),
        "mosaic.png": result.mosaic.rgb,
        "depth.png": CHANNELS["depth"].encoding.encode(result.mosaic.depth),
    }
    write_images([(folder / name, image) for name, image in images.items()])
    used = set(result.mosaic.images)
    rows = [
        {
            "first_frame": int(result.frames[pair.first]),
            "second_frame": int(result.frames[pair.second]),
            "matches": pair.num_matches,
            "inliers": len(pair.points_first),
            "is_stitched": {pair.first, pair.second} <= used,
        }
        for pair in result.pairs
    ]
    write_csv(folder / "matches.csv", rows)


def write_registration(folder: Path, surface: WallSurface) -> None:
    """Write `registration.csv`, the error at each step, if there was a registration."""
    if surface.registration is not None:
        errors = enumerate(surface.registration.rmse)
        rows = [{"step": k, "rmse_mm": round(error / MM, 6)} for k, error in errors]
        write_csv(folder / "registration.csv", rows)


def highlights_picture(rgb: UInt8[np.ndarray, "h w 3"]) -> UInt8[np.ndarray, "h k 3"]:
    """Draw an image, its marked highlights, and the inpainted image."""
    marked = np.where(highlights(rgb)[..., None], _MARK, rgb)
    return np.concatenate([rgb, marked, without_highlights(rgb)], axis=1)


def matches_picture(result: Stitched) -> UInt8[np.ndarray, "h k 3"]:
    """Draw the pair of images with the most inliers, connected by lines."""
    cv2 = opencv()
    pair: Pair = max(result.pairs, key=lambda one: len(one.points_first))
    images = [result.sequence.image("rgb", k) for k in (pair.first, pair.second)]
    picture = np.concatenate(images, axis=1)
    shift = (images[0].shape[1], 0.0)
    chosen = np.unique(np.linspace(0, len(pair.points_first) - 1, _LINES).astype(int))
    for one, other in zip(pair.points_first[chosen], pair.points_second[chosen], strict=True):
        ends = [tuple(np.rint(p).astype(int).tolist()) for p in (one, other + shift)]
        cv2.line(picture, ends[0], ends[1], _MARK.tolist(), 1, cv2.LINE_AA)
    return picture
