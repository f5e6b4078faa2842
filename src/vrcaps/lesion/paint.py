"""Texture painting of lesions: large ones in place, focal ones on separate charts.

A chart is an additional texture region next to the wall's own, with enough resolution for a
lesion's pattern and without the stretch caused by its shape. It starts exactly at the border of the
footprint's faces, where it contains the same values as the original texture. The clean twin
has the same charts, filled from the clean texture.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
import scipy

from vrcaps.core.color import LINEAR, srgb_from_linear
from vrcaps.core.errors import InputError
from vrcaps.core.units import MM
from vrcaps.lesion.base import AppearanceSample, Form, WallSamples
from vrcaps.mesh.rasterize import Texels, covered_texels, sample
from vrcaps.mucosa.bake import MAX_SIDE
from vrcaps.organ.surface import Appearance, round_height

if TYPE_CHECKING:
    from jaxtyping import Bool, Float, Int

    from vrcaps.mesh.patch import Patch

_DENSITY = 14.0 / MM  # texels per meter on charts
_MAX_SIDE = 768  # texels on a chart's side
_MARGIN = 6  # texels around a chart, for filtering and its mip levels
_BLUR = 16  # texels over which vessels are smoothed away
_SPILL = 3.0  # texels painted beyond the borders of charts, for filtering and mip levels
_CHUNK = 16_384  # texels painted at once: their values stay in a processor's cache

_BYTES = np.arange(256) / 255.0


@dataclass(frozen=True)
class Textures:
    """Appearance, and a version with its vessels smoothed away.

    Attributes:
        appearance: The textures.
        plain: Linear color at 1/16 of the resolution.
    """

    appearance: Appearance
    plain: Float[np.ndarray, "k l 3"]

    def copy(self) -> Textures:
        """Independent copy for painting."""
        look = self.appearance
        images = {name: getattr(look, name).copy() for name in ("albedo", "roughness", "height")}
        return replace(self, appearance=replace(look, **images))

    def look(self, uv: Float[np.ndarray, "n 2"]) -> AppearanceSample:
        """Appearance at texture coordinates."""
        return AppearanceSample(
            color=sample(self.appearance.albedo, uv, LINEAR),
            roughness=sample(self.appearance.roughness, uv, _BYTES),
            height=sample(self.appearance.height, uv, None),
            plain=sample(self.plain, uv, None),
        )


@dataclass(frozen=True)
class FormSamples:
    """Form of a lesion at the vertices of a piece of wall.

    Attributes:
        form: Form of the lesion.
        wall: The vertices at rest.
        points: Positions with the lesion, relative to its center [m].
    """

    form: Form
    wall: WallSamples
    points: Float[np.ndarray, "n 3"]


@dataclass(frozen=True)
class Chart:
    """Texture region of one lesion, before it is packed into the atlas.

    Attributes:
        instance: Lesion ID.
        origin: Chart position [m] of the center of the top-left texel.
        density: Texels per meter.
        clean: Albedo, roughness and height without the lesion.
        lesioned: Albedo, roughness and height with the lesion.
    """

    instance: int
    origin: Float[np.ndarray, " 2"]
    density: float
    clean: tuple[np.ndarray, np.ndarray, np.ndarray]
    lesioned: tuple[np.ndarray, np.ndarray, np.ndarray]


def smoothed(appearance: Appearance) -> Textures:
    """Textures with their plain color: block means over texels that are not blank."""
    albedo = appearance.albedo
    height, width = (max(1, side // _BLUR) for side in albedo.shape[:2])
    rows = np.linspace(0, albedo.shape[0], height * 4, endpoint=False).astype(int)
    columns = np.linspace(0, albedo.shape[1], width * 4, endpoint=False).astype(int)
    color = LINEAR[albedo[rows][:, columns]].reshape(height, 4, width, 4, 3)
    weight = color.any(axis=-1, keepdims=True)
    total = np.maximum(weight.sum(axis=(1, 3)), 1)
    blocks = (color * weight).sum(axis=(1, 3)) / total
    overall = color.sum(axis=(0, 1, 2, 3)) / max(int(weight.sum()), 1)
    blank = weight.sum(axis=(1, 3))[..., 0] == 0
    blocks[blank] = overall
    return Textures(appearance, np.ascontiguousarray(blocks))


def paint_in_place(
    textures: Textures, patch: Patch, samples: FormSamples, faces: Int[np.ndarray, " k"]
) -> None:
    """Paint a lesion on the texels of some faces of the wall's own texture.

    Args:
        textures: Textures to paint on.
        patch: Wall around the lesion.
        samples: The lesion's form on it.
        faces: Faces of the patch to paint on.
    """
    look = textures.appearance
    images = (look.albedo, look.roughness, look.height)
    sides = np.array([look.albedo.shape[1], look.albedo.shape[0]])
    uv = patch.uv[faces, :, :2]
    texels = covered_texels(
        np.stack([uv[..., 0], 1.0 - uv[..., 1]], axis=-1) * sides - 0.5, margin=_SPILL
    )
    corners = _corner_values(patch, samples, faces)
    rows, columns = texels.row % sides[1], texels.column % sides[0]
    # Read before painting: where coordinates wrap, a texel may occur twice.
    albedo = look.albedo[rows, columns]
    roughness, height = look.roughness.copy(), look.height.copy()
    for first in range(0, len(texels), _CHUNK):
        chosen = slice(first, first + _CHUNK)
        part = texels.take(chosen)
        own = (np.stack([part.column, part.row], axis=1) + 0.5) / sides
        own[:, 1] = 1.0 - own[:, 1]
        before = AppearanceSample(
            color=LINEAR[albedo[chosen]],
            roughness=sample(roughness, own, _BYTES),
            height=sample(height, own, None),
            plain=sample(textures.plain, own, None),
        )
        _store(images, _painted(before, samples, corners, part), rows[chosen], columns[chosen])


def paint_chart(
    clean: Textures,
    lesioned: Textures,
    patch: Patch,
    samples: FormSamples,
    instance: int,
) -> Chart:
    """Separate chart of a lesion, from the textures of its surroundings.

    Args:
        clean: Textures without lesions.
        lesioned: Textures with the previous lesions.
        patch: Wall around the lesion.
        samples: The lesion's form on it.
        instance: Lesion ID.
    """
    faces = np.flatnonzero(patch.chart_id == instance)
    corners = patch.uv[faces, :, 2:]
    low, high = corners.min(axis=(0, 1)), corners.max(axis=(0, 1))
    density = min(_DENSITY, (_MAX_SIDE - 2 * _MARGIN) / float((high - low).max()))
    width, height = np.ceil((high - low) * density).astype(int) + 2 * _MARGIN + 1
    origin = np.array([low[0], high[1]]) + np.array([-_MARGIN, _MARGIN]) / density
    texels = covered_texels((corners - origin) * (density, -density))
    values = _corner_values(patch, samples, faces)
    images = []
    for textures, is_lesioned in ((clean, False), (lesioned, True)):
        image = _blank(height, width)
        before = textures.look(texels.blend_corners(patch.uv[faces, :, :2]))
        painted = _painted(before, samples, values, texels) if is_lesioned else before
        _store(image, painted, texels.row, texels.column)
        covered = np.zeros((height, width), bool)
        covered[texels.row, texels.column] = True
        rows, columns = _nearest(covered)
        images.append(tuple(part[rows, columns] for part in image))
    return Chart(instance, origin, density, images[0], images[1])


def _nearest(covered: Bool[np.ndarray, "h w"]) -> tuple[np.ndarray, np.ndarray]:
    """Row and column of the nearest covered texel to each texel."""
    nearest = scipy.ndimage.distance_transform_edt(
        ~covered, return_distances=False, return_indices=True
    )
    rows, columns = np.asarray(nearest)
    return rows, columns


def _blank(height: int, width: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    return (
        np.zeros((height, width, 3), np.uint8),
        np.zeros((height, width), np.uint8),
        np.zeros((height, width), np.float32),
    )


def _corner_values(
    patch: Patch, samples: FormSamples, faces: Int[np.ndarray, " k"]
) -> Float[np.ndarray, "k 3 c"]:
    """Wall data required by a form's painting, at the corners of faces."""
    wall = samples.wall
    columns = (wall.rest, wall.normal, wall.inward, samples.points, wall.xy)
    return np.concatenate(columns, axis=1)[patch.faces[faces]]


def _painted(
    before: AppearanceSample,
    samples: FormSamples,
    corners: Float[np.ndarray, "m 3 c"],
    texels: Texels,
) -> AppearanceSample:
    """Appearance of texels with a lesion.

    Args:
        before: Appearance without it.
        samples: The lesion's form.
        corners: Result of `_corner_values`.
        texels: Texels to paint.
    """
    rest, normal, inward, points, xy = np.split(
        texels.blend_corners(corners), (3, 6, 9, 12), axis=1
    )
    wall = WallSamples(xy=xy, rest=rest, normal=normal, inward=inward)
    return samples.form.paint(wall, points, before)


def _store(images, look: AppearanceSample, row: np.ndarray, column: np.ndarray) -> None:
    albedo, roughness, height = images
    albedo[row, column] = srgb_from_linear(look.color)
    roughness[row, column] = np.rint(255.0 * np.clip(look.roughness, 0.0, 1.0))
    height[row, column] = look.height


@dataclass(frozen=True)
class Atlas:
    """Layout of the enlarged textures.

    Attributes:
        extra: Columns and rows by which the wall's texture is extended, right and on top.
        size: Total width and height [texels].
        origins: Column and row of each chart's top-left texel.
    """

    extra: tuple[int, int]
    size: tuple[int, int]
    origins: list[tuple[int, int]]


def pack(base: Appearance, uv: Float[np.ndarray, "m 3 2"], charts: list[Chart]) -> Atlas:
    """Pack all charts next to the wall's texture: right of a tall, above a wide one.

    Where the wall's coordinates exceed 1, its texture is repeated as far as needed, because it can
    no longer wrap.

    Args:
        base: Original textures of the wall.
        uv: Texture coordinates of the wall.
        charts: Charts of the lesions.

    Raises:
        InputError: If they do not fit.
    """
    sides = np.array(base.albedo.shape[1::-1])
    over = np.ceil((uv.max(axis=(0, 1)) - 1.0).clip(0.0) * sides).astype(int)
    extra = over + 4 * (over > 0)
    across = int(sides[0] > sides[1])  # 0: charts in columns to the right
    along = 1 - across
    shapes = np.array([chart.clean[1].shape[::-1] for chart in charts]).reshape(-1, 2)
    longest = int(max([(sides + extra)[along], *shapes[:, along]]))
    start = int((sides + extra)[across]) if across == 0 else 0
    strip, end, filled = start, start, 0
    origins = np.zeros((len(charts), 2), int)
    for index in np.argsort(-shapes[:, across], kind="stable"):
        if filled + shapes[index, along] > longest:
            strip, filled = end, 0
        origins[index, across], origins[index, along] = strip, filled
        end, filled = max(end, strip + int(shapes[index, across])), filled + shapes[index, along]
    size = np.zeros(2, int)
    size[along], size[across] = longest, end if across == 0 else end + (sides + extra)[1]
    size = -(-size // 16) * 16
    if size.max() > MAX_SIDE:
        raise InputError(
            f"{len(charts)} lesions need a texture of {size[0]} × {size[1]} texels; allowed: sides "
            f"up to {MAX_SIDE}. Make fewer or smaller lesions, or bake with fewer texels_per_mm."
        )
    return Atlas(_pair(extra), _pair(size), [_pair(origin) for origin in origins])


def _pair(values: Int[np.ndarray, " 2"]) -> tuple[int, int]:
    return int(values[0]), int(values[1])


def assemble(base: Appearance, charts: list[Chart], atlas: Atlas, *, lesioned: bool) -> Appearance:
    """Assemble the enlarged textures.

    Args:
        base: Original textures of the wall.
        charts: Charts of the lesions.
        atlas: Layout of the charts.
        lesioned: Whether to include the lesions.
    """
    height, width = base.albedo.shape[:2]
    top, (columns, rows) = atlas.extra[1], atlas.size
    parts = []
    for k, image in enumerate((base.albedo, base.roughness, base.height)):
        fill = image[:: max(1, height // 64)].mean(axis=(0, 1))
        whole = np.empty((rows, columns, *image.shape[2:]), image.dtype)
        whole[...] = np.rint(fill) if image.dtype == np.uint8 else fill
        below = rows - height  # v counts from the bottom
        whole[below:, :width] = image
        whole[below - top : below, :width] = image[height - top :]
        whole[below - top :, width : width + atlas.extra[0]] = whole[
            below - top :, : atlas.extra[0]
        ]
        for chart, (x, y) in zip(charts, atlas.origins, strict=True):
            piece = (chart.lesioned if lesioned else chart.clean)[k]
            whole[y : y + piece.shape[0], x : x + piece.shape[1]] = piece
        parts.append(whole)
    return replace(base, albedo=parts[0], roughness=parts[1], height=round_height(parts[2]))


def final_uv(
    wall: Patch, base: Appearance, charts: list[Chart], atlas: Atlas
) -> Float[np.ndarray, "m 3 2"]:
    """Texture coordinates in the enlarged textures.

    Args:
        wall: Wall.
        base: Its original textures.
        charts: Charts of the lesions.
        atlas: Layout of the charts.
    """
    columns, rows = atlas.size
    height, width = base.albedo.shape[:2]
    uv = wall.uv[..., :2] * (width / columns, height / rows)
    for chart, (x, y) in zip(charts, atlas.origins, strict=True):
        faces = wall.chart_id == chart.instance
        texel = (wall.uv[faces, :, 2:] - chart.origin) * (chart.density, -chart.density)
        position = (texel + 0.5 + (x, y)) / (columns, rows)
        uv[faces] = np.stack([position[..., 0], 1.0 - position[..., 1]], axis=-1)
    return uv
