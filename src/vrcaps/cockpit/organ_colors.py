"""Colorings of the organ in the page: base class, by segment, by lesion, by coverage."""

from __future__ import annotations

import colorsys
from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar

import numpy as np

from vrcaps.organ.surface import OrganSurface, face_label

if TYPE_CHECKING:
    from jaxtyping import Float, Int

    from vrcaps.capsule.body import Body
    from vrcaps.cockpit.page_mesh import PageMesh
    from vrcaps.cockpit.seen_wall import SeenWall
    from vrcaps.tissue.winkler_foundation import WinklerFoundation

Color = tuple[int, int, int]

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

    def legend(self) -> str:
        """Legend of the colors, as Markdown."""
        raise NotImplementedError

    def _faces(self, of_vertices: np.ndarray) -> np.ndarray:
        """Class of each triangle from those of the fine wall's vertices."""
        return face_label(of_vertices[self.mesh.vertices], self.mesh.faces).astype(int)


class SegmentColoring(Coloring):
    """Coloring by segment or tissue class."""

    name = "segment"

    def __init__(self, organ: OrganSurface, mesh: PageMesh) -> None:
        super().__init__(organ, mesh)
        self.colors = [_hue(k) for k in range(len(organ.label_names))]

    def classes(self) -> np.ndarray:
        """Label index of each triangle."""
        return self._faces(self.organ.label)

    def legend(self) -> str:
        """Names of the labels."""
        present = np.unique(self.classes())
        return legend_of([(self.colors[k], self.organ.label_names[k]) for k in present])


class LesionColoring(Coloring):
    """Coloring of lesions."""

    name = "lesion"

    def __init__(self, organ: OrganSurface, mesh: PageMesh) -> None:
        super().__init__(organ, mesh)
        count = int(organ.instance.max(initial=0))
        self.colors = [PLAIN, *(_hue(k) for k in range(1, count + 1))]

    @classmethod
    def fits(cls, organ: OrganSurface) -> bool:
        """Check whether the organ has lesions."""
        return bool(organ.instance.any())

    def classes(self) -> np.ndarray:
        """Instance of the lesion at any corner of each triangle."""
        return self.organ.instance[self.mesh.vertices][self.mesh.faces].max(axis=1).astype(int)

    def legend(self) -> str:
        """Instances of the lesions."""
        return legend_of([(color, f"lesion {k}") for k, color in enumerate(self.colors) if k])


class CoverageColoring(Coloring):
    """Coloring by what the camera has seen."""

    name = "coverage"

    def __init__(self, organ: OrganSurface, mesh: PageMesh, live: LiveWall) -> None:
        super().__init__(organ, mesh)
        self._seen = live.seen
        self.colors = [(120, 120, 128), (90, 200, 110)]

    @property
    def version(self) -> int:
        """Counter that increases whenever more was seen."""
        return self._seen.version

    def classes(self) -> np.ndarray:
        """1 where most corners of a triangle were seen."""
        return self._faces(self._seen.vertices.astype(np.uint8))

    def legend(self) -> str:
        """Legend of seen and unseen."""
        return legend_of([(self.colors[1], "seen"), (self.colors[0], "not seen yet")])


def _hue(number: int) -> Color:
    """Distinct color: hues a golden angle apart."""
    color = colorsys.hsv_to_rgb(number * _GOLDEN % 1.0, 0.45, 0.92)
    return tuple(round(255 * part) for part in color)  # type: ignore[return-value]


def legend_of(entries: list[tuple[Color, str]]) -> str:
    """Legend of colors, as Markdown."""
    spots = (f'<span style="color:rgb{color}">&#9632;</span> {text}' for color, text in entries)
    return " · ".join(spots)
