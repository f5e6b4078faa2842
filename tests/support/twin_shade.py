"""Readable twin of the compiled renderer: every channel of an image, in double precision."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from tests.support import twin
from tests.support.twin import dot, unit
from vrcaps.camera.camera import Camera, Led, camera_rays
from vrcaps.core.geometry import invert, rotate_vectors, transform_points
from vrcaps.organ.surface import Appearance, clearcoat_alpha, face_label
from vrcaps.world.model import Model, State

_TILE = 8


@dataclass
class _Points:
    """Surface points of the pixels that see the wall, in the world frame."""

    position: np.ndarray
    view: np.ndarray
    normal: np.ndarray
    least_facing: np.ndarray
    uv: np.ndarray
    gradients: np.ndarray
    pull: np.ndarray
    footprint: np.ndarray


def render(
    model: Model, camera: Camera, state: State, *, shadows: bool = False
) -> dict[str, np.ndarray]:
    """All channels of one image but flow and `rgb`."""
    organ, faces = model.organ, model.organ.faces
    vertices = model.vertices_world if state.vertices_world is None else state.vertices_world
    T_world_camera = state.T_world_capsule @ camera.T_capsule_camera
    rays_camera = camera_rays(camera).astype(float)
    rays = rotate_vectors(T_world_camera, rays_camera).reshape(-1, 3)
    origin = T_world_camera[:3, 3]
    used = np.flatnonzero(np.isfinite(rays[:, 0]))
    hit, distance, face, weights = _trace(vertices[faces], origin, rays, used)

    normals = _vertex_normals(vertices, faces)[faces[face]]
    smooth = unit(np.einsum("nc,ncx->nx", weights, normals))
    view = -rays[hit]
    geometric = twin.face_normals(vertices[faces[face]])
    smooth = np.where(dot(geometric, view)[:, None] < 0.0, -smooth, smooth)
    smooth = unit(smooth - np.minimum(dot(smooth, view), 0.0)[:, None] * view)
    position = origin + distance[:, None] * rays[hit]
    pixel_angle = _pixel_angles(rays_camera).reshape(-1)[hit]
    gradients = _uv_gradients(vertices[faces[face]], organ.uv[face])
    rest = _uv_gradients(model.vertices_world[faces[face]], organ.uv[face])
    along, across = (np.linalg.norm(gradients, axis=2) / np.linalg.norm(rest, axis=2)).T
    size = distance * pixel_angle / np.sqrt(np.maximum(dot(smooth, view), 0.05))
    turn = np.einsum("ncx,nx->n", normals, geometric) / 3.0
    points = _Points(
        position,
        view,
        smooth,
        0.25 * np.sqrt(np.maximum(1.0 - turn**2, 0.0)),
        np.einsum("nc,nck->nk", weights, organ.uv[face]),
        gradients,
        np.maximum(along / across, across / along),
        size[:, None] * np.linalg.norm(gradients, axis=2),
    )
    lit = [
        np.ones(len(hit), bool)
        if not shadows
        else twin.is_visible(vertices[faces], _place(led, T_world_camera), position)
        for led in camera.leds
    ]
    albedo, radiance = _shade(organ.appearance, camera, T_world_camera, points, lit)
    image = _Image(camera, hit)
    return {
        "radiance": image.of(radiance, 0.0),
        "depth": image.of(distance * rays_camera.reshape(-1, 3)[hit, 2], np.nan),
        "ray_distance": image.of(distance, np.nan),
        "normal": image.of(rotate_vectors(invert(T_world_camera), smooth), np.nan),
        "label": image.of(face_label(organ.label, faces)[face], 0),
        "instance": image.of(face_label(organ.instance, faces)[face], 0),
        "albedo": image.of(albedo, np.nan),
        "arc_length": image.of(dot(weights, organ.arc_length[faces[face]]), np.nan),
        "position": image.of(position, np.nan),
        "face": image.of(face, -1),
    }


@dataclass
class _Image:
    camera: Camera
    hit: np.ndarray

    def of(self, values: np.ndarray, missing: float) -> np.ndarray:
        height, width = self.camera.height, self.camera.width
        flat = np.full((height * width, *values.shape[1:]), missing, values.dtype)
        flat[self.hit] = values
        return flat.reshape(height, width, *values.shape[1:])


def _trace(
    corners: np.ndarray, origin: np.ndarray, rays: np.ndarray, used: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    origins = np.broadcast_to(origin, (len(used), 3))
    distance, face, weights = twin.nearest_hits(corners, origins, rays[used])
    found = face >= 0
    return used[found], distance[found], face[found], weights[found]


def _vertex_normals(vertices: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """Mean of the surrounding faces' normals, weighted by area."""
    normals = np.zeros_like(vertices)
    area_normals = twin.area_normals(vertices[faces])
    for corner in range(3):
        np.add.at(normals, faces[:, corner], area_normals)
    return unit(normals)


def _pixel_angles(rays_camera: np.ndarray) -> np.ndarray:
    """Mean step between horizontal neighbors of each tile of 8 by 8 pixels [rad]."""
    height, width = rays_camera.shape[:2]
    steps = np.linalg.norm(np.diff(rays_camera, axis=1), axis=-1)
    result = np.zeros((height, width))
    for row in range(0, height, _TILE):
        for column in range(0, width, _TILE):
            tile = steps[row : row + _TILE, column : column + _TILE - 1]
            some = tile[np.isfinite(tile)]
            mean = some.mean() if some.size else 0.0
            result[row : row + _TILE, column : column + _TILE] = mean
    return result


def _uv_gradients(corners: np.ndarray, uv: np.ndarray) -> np.ndarray:
    """Gradients [n 2 3] of u and v over their triangles [1/m]."""
    edges = corners[:, 1:] - corners[:, :1]
    return np.swapaxes(np.linalg.pinv(edges) @ (uv[:, 1:] - uv[:, :1]), 1, 2)


def _place(led: Led, T_world_camera: np.ndarray) -> np.ndarray:
    return transform_points(T_world_camera, np.array([led.position_camera]))[0]


def _shade(
    look: Appearance | None,
    camera: Camera,
    T_world_camera: np.ndarray,
    points: _Points,
    lit: list[np.ndarray],
) -> tuple[np.ndarray, np.ndarray]:
    """Base color and radiance of the points."""
    assert look is not None
    widths = points.footprint * look.roughness.shape[::-1]
    # A wall that is gathered or pulled along one direction shows a coarser level.
    level = np.log2(np.maximum(widths.max(1), 1.0) * np.maximum(points.pull / 1.7, 1.0))
    texels = _textures(look)
    albedo, roughness, slope = (_fetch(texels, points.uv, np.rint(level), k) for k in range(3))
    normal = unit(points.normal - np.einsum("nk,nkx->nx", slope, points.gradients))
    lacking = np.maximum(points.least_facing - dot(normal, points.view), 0.0)
    normal = unit(normal + lacking[:, None] * points.view)
    radiance = np.zeros_like(albedo)
    for led, free in zip(camera.leds, lit, strict=True):
        offset = _place(led, T_world_camera) - points.position
        light = unit(offset)
        axis = rotate_vectors(T_world_camera, np.array([led.direction_camera]))[0]
        lobe = np.maximum(-light @ axis, 0.0) ** led.lobe_exponent
        reflected = principled(look, albedo, roughness[:, 0], normal, points.view, light)
        falloff = free * lobe / dot(offset, offset)
        radiance += np.array(led.intensity) * reflected * falloff[:, None]
    return albedo, radiance


def principled(
    look: Appearance,
    albedo: np.ndarray,
    roughness: np.ndarray,
    normal: np.ndarray,
    view: np.ndarray,
    light: np.ndarray,
) -> np.ndarray:
    """Reflected share times the cosine at the light [1/sr] (Burley 2012)."""
    half = unit(view + light)
    cos_view = np.maximum(dot(normal, view), 1e-4)
    cos_light, cos_half, cos_d = dot(normal, light), dot(normal, half), dot(view, half)
    at_light, at_view = _schlick(cos_light), _schlick(cos_view)
    retro = 2.0 * roughness * cos_d**2
    base = (1.0 - 0.5 * at_light) * (1.0 - 0.5 * at_view)
    base += retro * (at_light + at_view + at_light * at_view * (retro - 1.0))
    diffuse = albedo * (base * cos_light / np.pi)[:, None]

    alpha = np.maximum(roughness**2, 1e-3)
    facets = alpha**2 / (np.pi * (cos_half**2 * (alpha**2 - 1.0) + 1.0) ** 2)
    masking = _smith(cos_view, alpha) * _smith(cos_light, alpha)
    gloss = _fresnel(cos_d, look.ior) * facets * masking / (4.0 * cos_view)

    film_alpha = clearcoat_alpha(look.clearcoat_gloss)
    square = film_alpha**2
    facets = (square - 1.0) / (np.pi * np.log(square) * (1.0 + (square - 1.0) * cos_half**2))
    masking = _smith(cos_view, 0.25) * _smith(cos_light, 0.25)
    film = 0.25 * look.clearcoat * (0.04 + 0.96 * _schlick(cos_d)) * facets * masking * cos_light
    return np.where(cos_light[:, None] > 0.0, diffuse + (gloss + film)[:, None], 0.0)


def _schlick(cosine: np.ndarray) -> np.ndarray:
    return np.clip(1.0 - cosine, 0.0, 1.0) ** 5


def _smith(cosine: np.ndarray, alpha: np.ndarray | float) -> np.ndarray:
    tangent_square = 1.0 / np.maximum(cosine, 1e-4) ** 2 - 1.0
    return 2.0 / (1.0 + np.sqrt(1.0 + alpha**2 * tangent_square))


def _fresnel(cosine: np.ndarray, ior: float) -> np.ndarray:
    """Unpolarized reflectance by Snell's law and Fresnel's equations."""
    inside = np.sqrt(1.0 - (1.0 - cosine**2) / ior**2)
    across = (cosine - ior * inside) / (cosine + ior * inside)
    along = (inside - ior * cosine) / (inside + ior * cosine)
    return 0.5 * (across**2 + along**2)


def _textures(look: Appearance) -> list[tuple[np.ndarray, np.ndarray, np.ndarray]]:
    """Linear color, roughness and relief slope [m per unit of u, v] of each mip level."""
    color = look.albedo / 255.0
    color = np.where(color <= 0.04045, color / 12.92, ((color + 0.055) / 1.055) ** 2.4)
    rows, columns = look.height.shape
    along_u = 0.5 * columns * (np.roll(look.height, -1, 1) - np.roll(look.height, 1, 1))
    along_v = 0.5 * rows * (np.roll(look.height, 1, 0) - np.roll(look.height, -1, 0))
    maps = (color, look.roughness[..., None] / 255.0, np.stack([along_u, along_v], -1))
    levels = [maps]
    while max(levels[-1][0].shape[:2]) > 1:
        levels.append(tuple(_halve(m) for m in levels[-1]))  # type: ignore[arg-type]
    return levels


def _halve(texture: np.ndarray) -> np.ndarray:
    rows, columns = (max(1, size // 2) for size in texture.shape[:2])
    row, column = 2 * np.arange(rows)[:, None], 2 * np.arange(columns)
    row1 = np.minimum(row + 1, texture.shape[0] - 1)
    column1 = np.minimum(column + 1, texture.shape[1] - 1)
    corners = (texture[r, c] for r in (row, row1) for c in (column, column1))
    return sum(corners) / 4.0  # type: ignore[return-value]


def _fetch(levels: list, uv: np.ndarray, level: np.ndarray, which: int) -> np.ndarray:
    """Bilinear values of one of the textures in each point's mip level."""
    level = np.minimum(level, len(levels) - 1).astype(int)
    out = np.empty((len(uv), levels[0][which].shape[2]))
    for number in np.unique(level):
        some = level == number
        out[some] = bilinear(levels[number][which], uv[some])
    return out


def bilinear(texture: np.ndarray, uv: np.ndarray) -> np.ndarray:
    """Bilinear values [n c] of a wrapping texture [h w c] whose row 0 is v = 1."""
    rows, columns = texture.shape[:2]
    x, y = uv[:, 0] * columns - 0.5, (1.0 - uv[:, 1]) * rows - 0.5
    left, top = np.floor(x).astype(int), np.floor(y).astype(int)
    wx, wy = (x - left)[:, None], (y - top)[:, None]

    def texel(dy: int, dx: int) -> np.ndarray:
        return texture[(top + dy) % rows, (left + dx) % columns]

    upper = texel(0, 0) * (1.0 - wx) + texel(0, 1) * wx
    lower = texel(1, 0) * (1.0 - wx) + texel(1, 1) * wx
    return upper * (1.0 - wy) + lower * wy
