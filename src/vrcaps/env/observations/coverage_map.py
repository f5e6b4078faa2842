"""Map observation: coverage so far in gut coordinates, and the capsule's position in it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated, Any, ClassVar

import numpy as np

from vrcaps.config.fields import Range, check_fields
from vrcaps.env.parts import EnvView, Observation

if TYPE_CHECKING:
    from jaxtyping import Float


@dataclass(frozen=True)
class MapObservation(Observation):
    """The unrolled wall: a row for each cell along the gut, a column for each around it.

    Two channels [2 rows columns]: the fraction of each cell's area that was visible so far, 1 for
    cells without wall; and 1 in the cell that contains the capsule, 0 elsewhere.

    `egocentric` gives crops around the capsule instead [2 scales, size, size]: for each scale the
    seen fraction of the wall in each pixel, then the fraction of the pixel that is within the gut.
    Both are 0 beyond its ends; around the gut the map is periodic. A pixel is a cell of the map at
    the first scale, and `factor` times as long and as wide at each further one (Jonnarth, Zhao,
    Felsberg, arXiv 2306.16978, multi-scale egocentric maps).

    Attributes:
        egocentric: Whether the map is centered at the capsule.
        scales: Number of crops.
        size: Side of each crop [px].
        factor: Ratio of the pixel sizes of consecutive scales.
    """

    egocentric: bool = False
    scales: Annotated[int, Range(min=1, max=8)] = 4
    size: Annotated[int, Range(min=2, max=256)] = 16
    factor: Annotated[float, Range(min=1.0, max=4.0)] = 2.0

    kind: ClassVar[str] = "map"

    def __post_init__(self) -> None:
        check_fields(self)

    def space(self, view: EnvView) -> Any:
        """Observation space: fractions."""
        from gymnasium import spaces

        shape = (2, *view.grid)
        if self.egocentric:
            shape = (2 * self.scales, self.size, self.size)
        return spaces.Box(0.0, 1.0, shape, np.float32)

    def names(self, view: EnvView) -> tuple[str, ...]:
        """Name of each channel of the map."""
        if not self.egocentric:
            return ("seen [1]", "capsule [1]")
        scales = range(self.scales)
        return tuple(f"{stem}_scale_{k} [1]" for k in scales for stem in ("seen", "inside"))

    def observe(self, view: EnvView) -> Float[np.ndarray, "n c h w"]:
        """Return the maps of all worlds."""
        made = self._crops(view) if self.egocentric else _whole(view)
        return made.clip(0.0, 1.0).astype(np.float32)

    def _crops(self, s: EnvView) -> Float[np.ndarray, "n c h w"]:
        """Maps around the capsules; a pixel's value is the mean over its area."""
        rows, columns = s.grid
        half = 0.5 * self.size * self.factor ** np.arange(self.scales)[:, None]
        edges = half * np.linspace(-1.0, 1.0, self.size + 1)
        row, column = (at[:, None, None] + edges for at in _map_position(s))
        along, around = _overlap(row, rows), _repeated_overlap(column, columns)
        around = np.swapaxes(around, -1, -2)
        seen, area = (
            s.coverage.cells.reshape(-1, 1, rows, columns),
            s.coverage.cell_area.reshape(-1, 1, rows, columns),
        )
        inside = along.sum(axis=-1) / np.diff(row, axis=-1)
        wall = along @ area @ around
        fraction = np.divide(along @ seen @ around, wall, out=np.zeros_like(wall), where=wall > 0.0)
        crops = np.stack([fraction, np.broadcast_to(inside[..., None], fraction.shape)], axis=2)
        return crops.reshape(s.num_worlds, 2 * self.scales, self.size, self.size)


def _whole(s: EnvView) -> Float[np.ndarray, "n 2 h w"]:
    rows, columns = s.grid
    made = np.zeros((s.num_worlds, 2, rows * columns))
    made[:, 0] = s.coverage.cell_fraction
    row, column = (index.astype(int) for index in _map_position(s))
    cell = np.minimum(row, rows - 1) * columns + column % columns
    made[np.arange(s.num_worlds), 1, cell] = 1.0
    return made.reshape(-1, 2, rows, columns)


def _map_position(s: EnvView) -> tuple[Float[np.ndarray, " n"], Float[np.ndarray, " n"]]:
    """Row and column of each capsule on the map, as fractional indices."""
    rows, columns = s.grid
    here = s.course.at(s.arc_length)
    offset = s.T_world_capsule[:, :3, 3] - here.point
    x, y, _ = np.einsum("nij,nj->in", here.axes, offset)
    turn = np.arctan2(y, x) / (2.0 * np.pi) + 0.5
    return (s.arc_length / s.course.length).clip(0.0, 1.0) * rows, turn * columns


def _overlap(edges: Float[np.ndarray, "*n k"], count: int) -> Float[np.ndarray, "*n k-1 c"]:
    """Length of each of `count` cells of length 1 that lies between neighboring edges."""
    return np.diff((edges[..., None] - np.arange(count)).clip(0.0, 1.0), axis=-2)


def _repeated_overlap(
    edges: Float[np.ndarray, "*n k"], count: int
) -> Float[np.ndarray, "*n k-1 c"]:
    """Overlap as in `_overlap`, with periodic cells."""
    rounds, rest = np.divmod(edges[..., None], count)
    return np.diff(rounds + (rest - np.arange(count)).clip(0.0, 1.0), axis=-2)
