"""Lapped texturing: a mucosa texture applied to an organ without seams or repetition.

The wall is covered by overlapping round patches. Each lies flat in the tangent plane of its
center and shows a random part of the texture with a random rotation. Overlapping patches are
blended with preserved contrast (Praun et al. 2000, Lapped textures; blending after Heitz & Neyret
2018). The result does not depend on the organ's texture coordinates.
"""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from itertools import pairwise
from typing import TYPE_CHECKING

import numpy as np
import scipy

from vrcaps.core.geometry import triangle_areas
from vrcaps.core.rng import stream
from vrcaps.core.units import MM
from vrcaps.mesh.noise import fbm
from vrcaps.mesh.rasterize import covered_texels
from vrcaps.organ.surface import Appearance

if TYPE_CHECKING:
    from jaxtyping import Bool, Float, Int, UInt8

    from vrcaps.mucosa.texture import MucosaTexture
    from vrcaps.organ.surface import OrganSurface

_SPACING = 12.0 * MM  # between centers of patches
_NORMAL_WEIGHT = 14.0 * MM  # distance equivalent of a right angle between normals
_MAX_PATCHES = 4  # maximum number of patches at a vertex
_SHARPNESS = 3.0  # of the borders between patches
_MIN_WEIGHT = 0.06  # weight from which a patch is visible
_PATIENT = np.array([0.03, 0.10, 0.08], np.float32)  # density of slow variation, r g b
_GRAIN = 35.0 * MM  # of that variation
_FACES = 1_500  # processed at a time


def apply_texture(
    organ: OrganSurface, texture: MucosaTexture, shape: tuple[int, int], *, seed: int
) -> Appearance:
    """Bake a texture onto an organ's texture coordinates.

    Args:
        organ: The wall; its appearance is ignored.
        texture: The texture to apply.
        shape: Rows and columns of the baked textures.
        seed: Seed of patches and slow variation; the same seed gives the same bytes.
    """
    rng = stream(seed, "mucosa/texture")
    texel = _texel_size(organ, shape)
    channels = _Channels.of(texture, texel)
    layout = _PatchLayout.of(organ, texture.side, rng)
    variation = fbm(_GRAIN, rng)(organ.vertices).astype(np.float32)
    height, width = shape
    corners = organ.uv * [width, -height] + [-0.5, height - 0.5]

    def paint(faces: Int[np.ndarray, " k"]) -> _Painted:
        texels = covered_texels(corners[faces])
        inside = texels.weights.astype(np.float32)
        seen = channels.blend(*layout.at(faces[texels.face], inside))
        slow = np.einsum("kc,kc->k", inside, variation[organ.faces[faces[texels.face]]])
        # sRGB is approximately the power 1 / 2.2, so density acts on the code with that factor.
        color = seen[:, :3] * np.exp(-slow[:, None] * (_PATIENT / 2.2))
        code = np.clip(np.rint(np.column_stack([color, seen[:, 3]])), 0.0, 255.0).astype(np.uint8)
        position = texels.row % height, texels.column % width
        return _Painted(position, inside.min(axis=1) > 0.0, code, seen[:, 4])

    canvas = _Canvas(shape, channels.mean)
    order = np.argsort(corners[:, 0, 1] // 64, kind="stable")
    groups = [order[first : first + _FACES] for first in range(0, len(order), _FACES)]
    with ThreadPoolExecutor() as pool:  # results are in order for any number of threads
        for painted in pool.map(paint, groups):
            canvas.paint(painted)
    return Appearance(
        albedo=canvas.albedo,
        roughness=canvas.roughness,
        height=canvas.relief,
        clearcoat_gloss=texture.clearcoat_gloss,
    )


@dataclass(frozen=True)
class _Painted:
    """Texels covered by some faces.

    Attributes:
        position: Rows and columns.
        is_inside: Whether each lies inside its face, not just next to it.
        code: sRGB color and roughness.
        raised: Relief [m].
    """

    position: tuple[Int[np.ndarray, " n"], Int[np.ndarray, " n"]]
    is_inside: Bool[np.ndarray, " n"]
    code: UInt8[np.ndarray, "n 4"]
    raised: Float[np.ndarray, " n"]


class _Canvas:
    """Baked textures being filled; the texture's mean where there is no face."""

    def __init__(self, shape: tuple[int, int], mean: Float[np.ndarray, " 5"]) -> None:
        self.albedo = np.empty((*shape, 3), np.uint8)
        self.albedo[:] = np.rint(mean[:3])
        self.roughness = np.full(shape, np.rint(mean[3]), np.uint8)
        self.relief = np.zeros(shape, np.float32)
        self.settled = np.zeros(shape, bool)

    def paint(self, painted: _Painted) -> None:
        """Draw texels; those just outside a face only fill gaps around charts."""
        (row, column), is_inside = painted.position, painted.is_inside
        for chosen in (~is_inside & ~self.settled[row, column], is_inside):
            position = row[chosen], column[chosen]
            self.albedo[position] = painted.code[chosen, :3]
            self.roughness[position] = painted.code[chosen, 3]
            self.relief[position] = painted.raised[chosen]
        self.settled[row[is_inside], column[is_inside]] = True


def _texel_size(organ: OrganSurface, shape: tuple[int, int]) -> float:
    """Mean side length of a baked texel on the wall [m]."""
    corners = organ.vertices[organ.faces]
    area = 2.0 * triangle_areas(corners)
    first, second = (organ.uv[:, k] - organ.uv[:, 0] for k in (1, 2))
    covered = np.abs(first[:, 0] * second[:, 1] - first[:, 1] * second[:, 0])
    return float(np.sqrt(area.sum() / max(covered.sum(), 1e-12) / (shape[0] * shape[1])))


@dataclass(frozen=True)
class _Channels:
    """Channels of a texture in one array, as deviations from their mean.

    Attributes:
        values: Red, green, blue and roughness [of 255] and relief [m], in row-major order.
        mean: Mean of the channels.
        side: Texels per side.
    """

    values: Float[np.ndarray, "nn 5"]
    mean: Float[np.ndarray, " 5"]
    side: int

    @classmethod
    def of(cls, texture: MucosaTexture, texel: float) -> _Channels:
        """Channels of a texture, reduced to the resolution of texels of a size [m]."""
        stack = np.dstack([texture.albedo, texture.roughness, texture.relief]).astype(np.float32)
        factor = 1
        while factor * 2 * texture.texel <= 1.2 * texel and len(stack) % 2 == 0:
            pairs = stack[::2] + stack[1::2]
            stack = 0.25 * (pairs[:, ::2] + pairs[:, 1::2])
            factor *= 2
        mean = stack.mean(axis=(0, 1), dtype=np.float64).astype(np.float32)
        return cls(np.ascontiguousarray(stack - mean).reshape(-1, 5), mean, len(stack))

    def blend(
        self, point: Int[np.ndarray, " n"], weight: Float[np.ndarray, " n"], position, count: int
    ) -> Float[np.ndarray, "count 5"]:
        """Blend patches: mean + Σ w (x − mean) / √Σ w² (Heitz & Neyret 2018, eq. 3).

        Args:
            point: Index of the wall's texel that each entry belongs to.
            weight: Weight of the patch at that texel.
            position: Position of that texel in the texture, in side lengths (n, 2).
            count: Number of texels of the wall.
        """
        total = np.zeros((count, 5), np.float32)
        squares = np.bincount(point, weight.astype(np.float64) ** 2, count)
        grid = position * np.float32(self.side)
        low = np.floor(grid).astype(np.int32)
        fraction = grid - low
        for dy in (0, 1):
            for dx in (0, 1):
                near = np.abs(1 - dy - fraction[:, 0]) * np.abs(1 - dx - fraction[:, 1]) * weight
                row, column = (low[:, 0] + dy) % self.side, (low[:, 1] + dx) % self.side
                value = self.values[row * self.side + column] * near[:, None]
                for start, stop in _runs(point):
                    total[point[start:stop]] += value[start:stop]
        return total / np.sqrt(np.maximum(squares, 1e-12))[:, None].astype(np.float32) + self.mean


def _runs(point: Int[np.ndarray, " n"]) -> list[tuple[int, int]]:
    """Stretches in which no texel occurs twice: entries are sorted by slot."""
    breaks = np.flatnonzero(np.diff(point) <= 0) + 1
    bounds = [0, *breaks.tolist(), len(point)]
    return list(pairwise(bounds))


@dataclass(frozen=True)
class _PatchLayout:
    """Patches that cover each face, and the texture positions of its corners in them.

    Attributes:
        slots: Number of patches of each face.
        weight: Weight of each patch of each face at the face's corners, largest first.
        position: Position in the texture of each patch at the same corners, in side lengths.
    """

    slots: Int[np.ndarray, " m"]
    weight: Float[np.ndarray, "m k 3"]
    position: Float[np.ndarray, "m k 3 2"]

    @classmethod
    def of(cls, organ: OrganSurface, side: float, rng: np.random.Generator) -> _PatchLayout:
        centers = _centers(organ, rng)
        space = np.hstack([organ.vertices, organ.normals * (_NORMAL_WEIGHT / 2.0**0.5)])
        count = min(_MAX_PATCHES + 1, len(centers))
        distance, nearest = scipy.spatial.KDTree(space[centers]).query(space, count)
        distance, nearest = distance.reshape(len(space), -1), nearest.reshape(len(space), -1)
        if count > 1:
            closeness = 1.0 - distance / np.maximum(distance[:, -1:], 1e-12)
        else:
            closeness = np.ones_like(distance)
        weight = closeness**_SHARPNESS
        weight /= np.maximum(weight.sum(axis=1, keepdims=True), 1e-12)
        weight = np.maximum(weight - _MIN_WEIGHT, 0.0).astype(np.float32)
        patch, corner_weight = _by_face(organ.faces, nearest, weight)
        frames = _frames(organ.normals[centers], rng)
        shift = rng.random((len(centers), 2))
        offset = (
            organ.vertices[organ.faces][:, None]
            - organ.vertices[centers][np.maximum(patch, 0)][:, :, None]
        )
        flat = np.einsum("mkcx,mkxd->mkcd", offset, frames[np.maximum(patch, 0)])
        # As long in the plane as in space, so that a patch on a curved wall is not compressed.
        stretch = np.linalg.norm(offset, axis=3) / np.maximum(np.linalg.norm(flat, axis=3), 1e-9)
        position = flat * np.minimum(stretch, 1.5)[..., None] / side
        position += shift[np.maximum(patch, 0)][:, :, None]
        return cls((patch >= 0).sum(axis=1), corner_weight, position.astype(np.float32))

    def at(self, face: Int[np.ndarray, " n"], inside: Float[np.ndarray, "n 3"]):
        """Arguments of `_Channels.blend` for points given by face and barycentric coordinates."""
        points, weights, positions = [], [], []
        for slot in range(self.weight.shape[1]):
            point = np.flatnonzero(self.slots[face] > slot)
            if not len(point):
                break
            own, bary = face[point], inside[point]
            weights.append(np.einsum("nc,nc->n", self.weight[own, slot], bary))
            positions.append(np.einsum("ncd,nc->nd", self.position[own, slot], bary))
            points.append(point)
        return np.concatenate(points), np.concatenate(weights), np.concatenate(positions), len(face)


def _centers(organ: OrganSurface, rng: np.random.Generator) -> Int[np.ndarray, " c"]:
    """Vertices about `_SPACING` apart, by position and normal: random sequential addition."""
    space = np.hstack([organ.vertices, organ.normals * (_NORMAL_WEIGHT / 2.0**0.5)])
    tree = scipy.spatial.KDTree(space)
    is_free = np.ones(len(space), bool)
    centers = []
    for vertex in rng.permutation(len(space)):
        if is_free[vertex]:
            centers.append(int(vertex))
            is_free[tree.query_ball_point(space[vertex], _SPACING)] = False
    return np.array(centers)


def _frames(normals: Float[np.ndarray, "c 3"], rng: np.random.Generator) -> np.ndarray:
    """Two axes perpendicular to each normal, randomly rotated, as columns (c, 3, 2)."""
    first = np.cross(normals, np.eye(3)[np.argmin(np.abs(normals), axis=1)])
    first /= np.linalg.norm(first, axis=1, keepdims=True)
    second = np.cross(normals, first)
    angle = rng.uniform(0.0, 2.0 * np.pi, (len(normals), 1))
    direction = np.cos(angle) * first + np.sin(angle) * second
    return np.stack([direction, np.cross(normals, direction)], axis=2)


def _by_face(faces, nearest, weight) -> tuple[np.ndarray, np.ndarray]:
    """Patches of each face, −1 for none, and their weights at its corners.

    A patch has a weight at a corner if it is among that vertex's nearest, so the weights of two
    faces agree along their common edge.
    """
    candidates = nearest[faces].reshape(len(faces), -1)
    own = weight[faces]
    at_corner = np.stack(
        [
            np.einsum(
                "mjk,mk->mj",
                candidates[:, :, None] == nearest[faces[:, corner]][:, None],
                own[:, corner],
            )
            for corner in range(3)
        ],
        axis=2,
    ).astype(np.float32)
    strength = at_corner.max(axis=2)
    earlier = np.tril(np.ones((candidates.shape[1],) * 2, bool), -1)
    is_double = ((candidates[:, :, None] == candidates[:, None]) & earlier).any(axis=2)
    strength[is_double] = 0.0
    order = np.argsort(-strength, axis=1, kind="stable")
    width = max(1, int((strength > 0.0).sum(axis=1).max()))
    order = order[:, :width]
    patch = np.take_along_axis(candidates, order, axis=1)
    patch = np.where(np.take_along_axis(strength, order, axis=1) > 0.0, patch, -1)
    return patch, np.take_along_axis(at_corner, order[..., None], axis=1)
