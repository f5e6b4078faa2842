"""Colorings of the organ in the page: segment, lesion, coverage, contact pressure and stiffness.

The organ is drawn as a decimated mesh, `PageMesh`. The contact law is the same everywhere, so the
wall is plain except where the capsule presses; there, the fine wall is drawn in color bands.
"""

from __future__ import annotations

import colorsys
from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar

import numpy as np

from vrcaps.core.geometry import triangle_areas
from vrcaps.organ.surface import OrganSurface, face_label
from vrcaps.world.indentation import indentation

if TYPE_CHECKING:
    from jaxtyping import Float, Int

    from vrcaps.capsule.device import Body
    from vrcaps.cockpit.session.seen_wall import SeenWall
    from vrcaps.organ.surface import OrganSurface
    from vrcaps.tissue.tissue import WinklerFoundation

_MAX_FACES = 12_000


@dataclass(frozen=True)
class PageMesh:
    """Coarse wall that uses some vertices of the fine one, so that it moves with it.

    Attributes:
        vertices: Indices of the fine wall's vertices.
        faces: Triangles of indices into `vertices`.
    """

    vertices: Int[np.ndarray, " n"]
    faces: Int[np.ndarray, "m 3"]


def coarse_mesh(
    points: Float[np.ndarray, "n 3"], faces: Int[np.ndarray, "m 3"], most: int = _MAX_FACES
) -> PageMesh:
    """Decimate a wall to a triangle count by vertex clustering (Rossignac & Borrel, 1993).

    All vertices in a cell of a cubic grid are replaced by the one nearest to their mean; triangles
    with corners in fewer than three cells are removed. The grid is as fine as possible.

    Args:
        points: Vertices of the fine wall.
        faces: Its triangles.
        most: Maximum number of triangles.
    """
    if len(faces) <= most:
        return PageMesh(np.arange(len(points)), np.asarray(faces))
    cell = float(np.sqrt(2.0 * triangle_areas(points[faces]).sum() / most))
    while True:
        mesh = _clustered(points, faces, cell)
        if len(mesh.faces) <= most:
            return mesh
        cell *= 1.1


def _clustered(points: np.ndarray, faces: np.ndarray, cell: float) -> PageMesh:
    grid = np.floor((points - points.min(axis=0)) / cell).astype(np.int64)
    _, cluster = np.unique(grid, axis=0, return_inverse=True)
    cluster = cluster.reshape(-1)
    count = np.bincount(cluster)
    mean = np.stack([np.bincount(cluster, axis) for axis in points.T], axis=1) / count[:, None]
    distance = np.linalg.norm(points - mean[cluster], axis=1)
    order = np.lexsort((distance, cluster))
    chosen = order[np.concatenate([[0], np.cumsum(count)[:-1]])]
    coarse = cluster[faces]
    a, b, c = coarse.T
    coarse = coarse[(a != b) & (b != c) & (c != a)]
    _, first = np.unique(np.sort(coarse, axis=1), axis=0, return_index=True)
    return PageMesh(chosen, coarse[np.sort(first)])


Color = tuple[int, int, int]
Legend = list[tuple[Color, str]]
"""Colors and their labels."""

PLAIN = (225, 150, 140)
"""Color of a wall without classes."""
_GOLDEN = 0.618033988749895


@dataclass(frozen=True)
class LiveWall:
    """Data of a wall that only a running simulation has.

    Attributes:
        seen: Parts that were seen.
        foundation: Contact law of the wall.
        body: Shape of the capsule.
    """

    seen: SeenWall
    foundation: WinklerFoundation
    body: Body


@dataclass(frozen=True)
class Patch:
    """Triangles of one color, drawn in addition to the wall.

    Attributes:
        color: sRGB.
        corners: Corners in the world [m].
    """

    color: Color
    corners: Float[np.ndarray, "k 3 3"]


class Coloring:
    """Coloring of the triangles of a coarse wall.

    Attributes:
        name: Name in the page.
        hides_capsule: Whether the capsule has to be transparent.
        colors: sRGB of each class.
    """

    name: ClassVar[str]
    hides_capsule: ClassVar[bool] = False

    def __init__(self, organ: OrganSurface, mesh: PageMesh) -> None:
        self.organ, self.mesh = organ, mesh
        self.colors: list[Color] = [PLAIN]

    @property
    def version(self) -> int:
        """Counter that increases whenever a triangle changes its color."""
        return 0

    @classmethod
    def fits(cls, organ: OrganSurface) -> bool:
        """Check whether an organ has the colored property."""
        del organ
        return True

    def classes(self) -> Int[np.ndarray, " m"]:
        """Class of each triangle, an index into `colors`."""
        return np.zeros(len(self.mesh.faces), int)

    def patches(
        self, points: Float[np.ndarray, "n 3"], T_world_capsule: Float[np.ndarray, "4 4"]
    ) -> tuple[Patch, ...]:
        """Triangles drawn in addition to the wall now.

        Args:
            points: Vertices of the fine wall in the world [m].
            T_world_capsule: Pose of the capsule.
        """
        del points, T_world_capsule
        return ()

    def legend(self) -> Legend:
        """Legend of the colors."""
        raise NotImplementedError

    def _faces(self, of_vertices: np.ndarray) -> np.ndarray:
        """Class of each triangle from those of the fine wall's vertices."""
        return face_label(of_vertices[self.mesh.vertices], self.mesh.faces).astype(int)


class SegmentColoring(Coloring):
    """Coloring by segment or tissue class."""

    name = "segment"

    def __init__(self, organ: OrganSurface, mesh: PageMesh) -> None:
        super().__init__(organ, mesh)
        self.colors = [_distinct(k) for k in range(len(organ.label_names))]

    def classes(self) -> np.ndarray:
        """Label index of each triangle."""
        return self._faces(self.organ.label)

    def legend(self) -> Legend:
        """Names of the labels."""
        present = np.unique(self.classes())
        return [(self.colors[k], self.organ.label_names[k].replace("_", " ")) for k in present]


class LesionColoring(Coloring):
    """Coloring of lesions."""

    name = "lesion"

    def __init__(self, organ: OrganSurface, mesh: PageMesh) -> None:
        super().__init__(organ, mesh)
        count = int(organ.instance.max(initial=0))
        self.colors = [PLAIN, *(_distinct(k) for k in range(1, count + 1))]

    @classmethod
    def fits(cls, organ: OrganSurface) -> bool:
        """Check whether the organ has lesions."""
        return bool(organ.instance.any())

    def classes(self) -> np.ndarray:
        """Instance of the lesion at any corner of each triangle."""
        return self.organ.instance[self.mesh.vertices][self.mesh.faces].max(axis=1).astype(int)

    def legend(self) -> Legend:
        """Instances of the lesions."""
        return [(color, f"lesion {k}") for k, color in enumerate(self.colors) if k]


class CoverageColoring(Coloring):
    """Coloring by the coverage of the camera."""

    name = "coverage"

    def __init__(self, organ: OrganSurface, mesh: PageMesh, live: LiveWall) -> None:
        super().__init__(organ, mesh)
        self._seen = live.seen
        self.colors = [(110, 112, 122), (86, 180, 233)]

    @property
    def version(self) -> int:
        """Counter that increases whenever more was seen."""
        return self._seen.version

    def classes(self) -> np.ndarray:
        """1 where most corners of a triangle were seen."""
        return self._faces(self._seen.vertices.astype(np.uint8))

    def legend(self) -> Legend:
        """Legend of seen and unseen."""
        return [(self.colors[1], "seen"), (self.colors[0], "not seen")]


_LIGHT: tuple[Color, ...] = (
    *((119, 170, 221), (238, 136, 102), (238, 221, 136), (255, 170, 187), (153, 221, 255)),
    *((68, 187, 153), (187, 204, 51), (170, 170, 0), (221, 221, 221)),
)
"""Colors that color-blind viewers distinguish: scheme light of P. Tol, Colour Schemes (2021)."""


def _distinct(label: int) -> Color:
    """Distinct color of a label; beyond the scheme, hues a golden angle apart."""
    if label < len(_LIGHT):
        return _LIGHT[label]
    color = colorsys.hsv_to_rgb(label * _GOLDEN % 1.0, 0.45, 0.92)
    return tuple(round(255 * part) for part in color)  # type: ignore[return-value]


_COLORS: tuple[Color, ...] = (
    *((255, 236, 130), (254, 178, 76), (253, 106, 50), (227, 26, 28), (128, 0, 60)),
)
"""Colors of the bands, from the lowest."""
_KILO_MM = 1e6
"""Pascal per meter in a kilopascal per millimeter."""


class ContactColoring(Coloring):
    """Coloring of the touched part of the wall, in bands.

    Attributes:
        limits: Lower limit of each band.
    """

    limits: ClassVar[tuple[float, ...]]
    hides_capsule = True

    def __init__(self, organ: OrganSurface, mesh: PageMesh, live: LiveWall) -> None:
        super().__init__(organ, mesh)
        self._live = live

    def values(self, depth: Float[np.ndarray, " k"]) -> Float[np.ndarray, " k"]:
        """Values in the unit of `limits` at indentations [m]."""
        raise NotImplementedError

    def patches(
        self, points: Float[np.ndarray, "n 3"], T_world_capsule: Float[np.ndarray, "4 4"]
    ) -> tuple[Patch, ...]:
        """Touched part of the wall, one patch per band."""
        indents = indentation(points, self.organ.faces, self._live.body, T_world_capsule)
        band = np.searchsorted(self.limits, self.values(indents.depth), side="right") - 1
        return tuple(
            Patch(_COLORS[k], indents.corners[band == k]) for k in np.unique(band[band >= 0])
        )


class PressureColoring(ContactColoring):
    """Coloring by the pressure of the wall on the capsule, for quasi-static indentation."""

    name = "contact pressure"
    limits = (0.0, 0.5, 1.0, 2.0, 4.0)

    def values(self, depth: np.ndarray) -> np.ndarray:
        """Pressure [kPa]."""
        return 1e-3 * self._live.foundation.static_pressure(depth)

    def legend(self) -> Legend:
        """Lower pressure limits of the bands."""
        entries = [
            (color, f"{low:g} kPa") for color, low in zip(_COLORS[1:], self.limits[1:], strict=True)
        ]
        entries[-1] = (entries[-1][0], f"{entries[-1][1]} or more")
        return [(_COLORS[0], f"below {self.limits[1]:g} kPa"), *entries]


class StiffnessColoring(ContactColoring):
    """Coloring by the stiffening of the wall under the capsule."""

    name = "stiffness"
    limits = (1.02, 1.1, 1.25, 1.5, 2.0)

    def values(self, depth: np.ndarray) -> np.ndarray:
        """Stiffness relative to that without indentation."""
        foundation = self._live.foundation
        return foundation.stiffness_at(depth) / foundation.stiffness

    def legend(self) -> Legend:
        """Lower stiffness limits of the bands."""
        at_rest = self._live.foundation.stiffness / _KILO_MM
        entries = [
            (color, f"{factor * at_rest:.3g} kPa/mm")
            for color, factor in zip(_COLORS, self.limits, strict=True)
        ]
        return [(PLAIN, f"{at_rest:.3g} kPa/mm"), *entries]


_STATIC: dict[str, type[Coloring]] = {each.name: each for each in (SegmentColoring, LesionColoring)}
_LIVE = {each.name: each for each in (CoverageColoring, PressureColoring, StiffnessColoring)}


def coloring_names(organ: OrganSurface, *, is_live: bool) -> tuple[str, ...]:
    """Names of the colorings of an organ; those of a running simulation only if it is live."""
    fitting = tuple(name for name, kind in _STATIC.items() if kind.fits(organ))
    return (*fitting, *_LIVE) if is_live else fitting


def make_coloring(
    name: str, organ: OrganSurface, mesh: PageMesh, live: LiveWall | None = None
) -> Coloring:
    """Create a coloring by name.

    Args:
        name: One of `coloring_names`.
        organ: Organ to color.
        mesh: Its mesh in the page.
        live: Live data of the wall, for the colorings that need it.
    """
    if name in _STATIC:
        return _STATIC[name](organ, mesh)
    assert live is not None
    return _LIVE[name](organ, mesh, live)
