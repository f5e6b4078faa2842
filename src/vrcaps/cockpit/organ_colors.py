"""Colorings of the organ in the page: by segment, by lesion, by what was seen."""

from __future__ import annotations

import colorsys
from typing import TYPE_CHECKING, ClassVar

import numpy as np

from vrcaps.organ.surface import OrganSurface, face_label

if TYPE_CHECKING:
    from jaxtyping import Int

    from vrcaps.cockpit.page_mesh import PageMesh
    from vrcaps.cockpit.seen_wall import SeenWall

_PLAIN = (225, 150, 140)
_GOLDEN = 0.618033988749895


class Coloring:
    """Colors the triangles of a coarse wall.

    Attributes:
        name: What the colors stand for.
        colors: sRGB of each class.
    """

    name: ClassVar[str]

    def __init__(self, organ: OrganSurface, mesh: PageMesh, seen: SeenWall | None) -> None:
        self.organ, self.mesh, self.seen = organ, mesh, seen
        self.colors: list[tuple[int, int, int]] = [_PLAIN]

    @property
    def version(self) -> int:
        """Rises whenever a triangle changes its color."""
        return 0

    @classmethod
    def fits(cls, organ: OrganSurface) -> bool:
        """Whether an organ has what is colored."""
        del organ
        return True

    def classes(self) -> Int[np.ndarray, " m"]:
        """Class of each triangle, a number into `colors`."""
        raise NotImplementedError

    def legend(self) -> str:
        """What the colors mean, as Markdown."""
        raise NotImplementedError

    def _faces(self, of_vertices: np.ndarray) -> np.ndarray:
        """Class of each triangle from those of the fine wall's vertices."""
        return face_label(of_vertices[self.mesh.vertices], self.mesh.faces).astype(int)


class SegmentColoring(Coloring):
    """Colors by segment or tissue class."""

    name = "segment"

    def __init__(self, organ: OrganSurface, mesh: PageMesh, seen: SeenWall | None) -> None:
        super().__init__(organ, mesh, seen)
        self.colors = [_hue(k) for k in range(len(organ.label_names))]

    def classes(self) -> np.ndarray:
        """Number of each triangle's label."""
        return self._faces(self.organ.label)

    def legend(self) -> str:
        """Names of the labels."""
        present = np.unique(self.classes())
        return _legend([(self.colors[k], self.organ.label_names[k]) for k in present])


class LesionColoring(Coloring):
    """Colors lesions."""

    name = "lesion"

    def __init__(self, organ: OrganSurface, mesh: PageMesh, seen: SeenWall | None) -> None:
        super().__init__(organ, mesh, seen)
        count = int(organ.instance.max(initial=0))
        self.colors = [_PLAIN, *(_hue(k) for k in range(1, count + 1))]

    @classmethod
    def fits(cls, organ: OrganSurface) -> bool:
        """Whether it has lesions."""
        return bool(organ.instance.any())

    def classes(self) -> np.ndarray:
        """Number of the lesion at any corner of each triangle."""
        return self.organ.instance[self.mesh.vertices][self.mesh.faces].max(axis=1).astype(int)

    def legend(self) -> str:
        """Numbers of the lesions."""
        return _legend([(color, f"lesion {k}") for k, color in enumerate(self.colors) if k])


class CoverageColoring(Coloring):
    """Colors what the camera has seen."""

    name = "coverage"

    def __init__(self, organ: OrganSurface, mesh: PageMesh, seen: SeenWall | None) -> None:
        super().__init__(organ, mesh, seen)
        self.colors = [(120, 120, 128), (90, 200, 110)]

    @property
    def version(self) -> int:
        """Rises whenever more was seen."""
        return 0 if self.seen is None else self.seen.version

    def classes(self) -> np.ndarray:
        """1 where most corners of a triangle were seen."""
        count = len(self.organ.vertices)
        seen = np.zeros(count, bool) if self.seen is None else self.seen.vertices
        return self._faces(seen.astype(np.uint8))

    def legend(self) -> str:
        """What was seen and what was not."""
        return _legend([(self.colors[1], "seen"), (self.colors[0], "not seen yet")])


COLORINGS: dict[str, type[Coloring]] = {
    each.name: each for each in (SegmentColoring, LesionColoring, CoverageColoring)
}
"""All colorings by name."""


def _hue(number: int) -> tuple[int, int, int]:
    """Distinct colors: hues a golden angle apart."""
    color = colorsys.hsv_to_rgb(number * _GOLDEN % 1.0, 0.45, 0.92)
    return tuple(round(255 * part) for part in color)  # type: ignore[return-value]


def _legend(entries: list[tuple[tuple[int, int, int], str]]) -> str:
    spots = (f'<span style="color:rgb{color}">&#9632;</span> {text}' for color, text in entries)
    return " · ".join(spots)
