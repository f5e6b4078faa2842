"""Texture coordinates and appearance of a full tract: those of its parts, side by side."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from vrcaps.core.units import MM
from vrcaps.mesh.mesh import Mesh, face_areas
from vrcaps.mucosa.bake import bake_appearance
from vrcaps.organ.segments import COLON, SMALL_BOWEL, STOMACH
from vrcaps.organ.surface import OrganSurface
from vrcaps.organ.uv_charts import TubeChart, chart_coordinates

if TYPE_CHECKING:
    from collections.abc import Iterator

    from jaxtyping import Bool, Float, Int

    from vrcaps.anatomy.tube_mesh.surface_to_organ import TubeMesh


@dataclass(frozen=True)
class JoinedFaces:
    """Faces of a tract in order: kept faces of the upper mesh and of the colon, and a band.

    Attributes:
        upper: Stomach and small bowel.
        in_stomach: Mask of its faces that belong to the stomach; all of them are kept.
        in_bowel: Mask of its faces that belong to the small bowel and are kept.
        band: Faces between the small bowel and the colon.
        colon_uv: Texture coordinates of the kept corners of the colon, in the unit square.
        colon_area: Area of the colon's wall [m²].
    """

    upper: TubeMesh
    in_stomach: Bool[np.ndarray, " m"]
    in_bowel: Bool[np.ndarray, " m"]
    band: Int[np.ndarray, "k 3"]
    colon_uv: Float[np.ndarray, "l 3 2"]
    colon_area: float


def tract_coordinates(
    joined: JoinedFaces, vertices: Float[np.ndarray, "n 3"]
) -> tuple[Float[np.ndarray, "m 3 2"], list[float]]:
    """Side-by-side texture coordinates of stomach, small bowel and colon, and their boundaries.

    Args:
        joined: The faces; the band belongs to the small bowel.
        vertices: Vertices of the joint wall [m].
    """
    tubes = [_stomach_chart(joined, vertices), _bowel_chart(joined, vertices)]
    charts = [*(chart_coordinates(tube) for tube in tubes), joined.colon_uv]
    areas = [face_areas(Mesh(vertices, tube.faces)).sum() for tube in tubes]
    width = np.sqrt([*areas, joined.colon_area])
    parts = np.concatenate([[0.0], np.cumsum(width)]) / width.sum()
    stomach, bowel, colon = (
        np.stack([low + span * uv[..., 0], height * uv[..., 1]], axis=-1)
        for uv, low, span, height in zip(
            charts, parts[:-1], np.diff(parts), width / width.max(), strict=True
        )
    )
    upper = np.empty((*joined.in_stomach.shape, 3, 2))
    num_bowel = len(bowel) - len(joined.band)
    upper[joined.in_stomach], upper[joined.in_bowel] = stomach, bowel[:num_bowel]
    is_kept = joined.in_stomach | joined.in_bowel
    return np.concatenate([upper[is_kept], colon, bowel[num_bowel:]]), parts.tolist()


def _stomach_chart(joined: JoinedFaces, vertices: np.ndarray) -> TubeChart:
    upper, is_in = joined.upper, joined.in_stomach
    faces = upper.faces[is_in]
    return TubeChart(faces, vertices[faces], upper.turn[is_in], upper.along[is_in])


def _bowel_chart(joined: JoinedFaces, vertices: np.ndarray) -> TubeChart:
    """Chart of the small bowel including the band at its end."""
    upper, is_in = joined.upper, joined.in_bowel
    turn, beyond = _on_band(joined)
    start, end = upper.along[is_in].min(), upper.along[is_in].max()
    faces = np.concatenate([upper.faces[is_in], joined.band])
    along = np.concatenate([upper.along[is_in], end + beyond]) - start
    return TubeChart(faces, vertices[faces], np.concatenate([upper.turn[is_in], turn]), along)


def _on_band(joined: JoinedFaces) -> tuple[Float[np.ndarray, "k 3"], Float[np.ndarray, "k 3"]]:
    """Circumferential fraction of the band's corners, and distance beyond the bowel's end [m].

    Corners on the rim of the colon lie just beyond it, at the angle of the face's other corners.
    """
    is_own = joined.band < len(joined.upper.vertices)
    own = np.where(is_own, joined.band, 0)
    turn = 0.5 - joined.upper.theta[own] / (2.0 * np.pi)
    first = np.take_along_axis(turn, is_own.argmax(axis=1)[:, None], axis=1)
    turn = np.where(is_own, turn - np.rint(turn - first), first)
    return np.clip(turn, 0.0, 1.0), np.where(is_own, -0.3 * MM, 1.0 * MM)


_MUCOSAE = (STOMACH.mucosa, SMALL_BOWEL.mucosa, COLON.mucosa)
_MAX_TEXELS = 90_000_000


@dataclass(frozen=True)
class _Part:
    """Organ of a tract.

    Attributes:
        is_in: Mask of the organ's faces in the tract.
        uv: Texture coordinates of their corners in the organ's own unit square.
        fraction: Fraction of all texels.
        mucosa: Name of the organ's mucosa.
    """

    is_in: Bool[np.ndarray, " m"]
    uv: Float[np.ndarray, "k 3 2"]
    fraction: float
    mucosa: str


def with_appearance(
    organ: OrganSurface, *, seed: int, max_texels: int = _MAX_TEXELS
) -> OrganSurface:
    """Add textures and matching texture coordinates to a tract of `generate_full_tract`.

    Args:
        organ: The tract; `metadata["texture_parts"]` states the side-by-side layout of its parts.
        seed: Seed of the patient.
        max_texels: Approximate maximum number of texels of all textures.
    """
    parts = list(_parts(organ))
    baked = [
        bake_appearance(
            replace(organ, faces=organ.faces[part.is_in], uv=part.uv),
            seed=seed,
            mucosa=part.mucosa,
            max_texels=int(part.fraction * max_texels),
        )
        for part in parts
    ]
    sizes = np.array([own.roughness.shape for own in baked])
    height, total = sizes[:, 0].max(), sizes[:, 1].sum()
    left = np.cumsum(sizes[:, 1]) - sizes[:, 1]
    uv = np.empty_like(organ.uv)
    for part, size, start in zip(parts, sizes, left, strict=True):
        uv[part.is_in] = part.uv * (size / np.array([height, total]))[::-1] + [start / total, 0.0]
    names = ("albedo", "roughness", "height")
    appearance = replace(
        baked[1],
        clearcoat=float(np.average([own.clearcoat for own in baked], weights=sizes.prod(axis=1))),
        **{name: _side_by_side([getattr(own, name) for own in baked]) for name in names},
    )
    return replace(organ, uv=uv, appearance=appearance)


def _parts(organ: OrganSurface) -> Iterator[_Part]:
    """Stomach, small bowel and colon of a tract."""
    borders = np.array(organ.metadata["texture_parts"])
    width = np.diff(borders)
    heights = width / width.max()
    part_index = np.searchsorted(borders[1:-1], organ.uv[..., 0].mean(axis=1))
    for k, mucosa in enumerate(_MUCOSAE):
        uv = (organ.uv[part_index == k] - [borders[k], 0.0]) / [width[k], heights[k]]
        fraction = width[k] * heights[k] / np.sum(width * heights)
        yield _Part(part_index == k, uv, float(fraction), mucosa)


def _side_by_side(images: list[np.ndarray]) -> np.ndarray:
    """Concatenate images horizontally; row 0 is v = 1, so shorter images are padded at the top."""
    height, width = max(len(image) for image in images), sum(image.shape[1] for image in images)
    joint = np.empty((height, width, *images[0].shape[2:]), images[0].dtype)
    left = 0
    for image in images:
        column = joint[:, left : left + image.shape[1]]
        above = height - len(image)
        column[:above], column[above:] = image[0], image
        left += image.shape[1]
    return joint
