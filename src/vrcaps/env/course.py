"""Course of the gut in each world, resampled so that the arrays of all guts have one shape."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from vrcaps.core.transforms import rotate_vectors, transform_points
from vrcaps.organ.surface import interpolate

if TYPE_CHECKING:
    from jaxtyping import Float, Int

    from vrcaps.env.memory import Memory
    from vrcaps.world.model import Model

_SAMPLES = 512


@dataclass(frozen=True)
class CoursePoint:
    """A position on the centerline in each world, in the world frame.

    Attributes:
        point: The position [m].
        axes: Transverse axes and tangent there, as rows.
        radius: Distance from there to the nearest wall at rest [m].
    """

    point: Float[np.ndarray, "n 3"]
    axes: Float[np.ndarray, "n 3 3"]
    radius: Float[np.ndarray, " n"]


class Course:
    """Centerlines of the organs of all worlds.

    Attributes:
        length: Length of each centerline [m].
    """

    def __init__(self, memory: Memory) -> None:
        """Allocate the arrays in the memory."""
        self._samples = memory.allocate("course/samples", (_SAMPLES, 13))
        self.length = memory.allocate("course/length")

    def begin(self, index: int, model: Model) -> None:
        """Set the organ of one world."""
        line = model.organ.centerline
        points, frames, radius = interpolate(line, np.linspace(0.0, line.length, _SAMPLES))
        axes = rotate_vectors(model.T_world_patient, np.swapaxes(frames, 1, 2))
        self._samples[index, :, :3] = transform_points(model.T_world_patient, points)
        self._samples[index, :, 3:12] = axes.reshape(-1, 9)
        self._samples[index, :, 12] = radius
        self.length[index] = line.length

    def at(self, arc_length: Float[np.ndarray, " n"]) -> CoursePoint:
        """Evaluate the centerline at arc lengths [m], one per world, clamped to its ends.

        Points and radii are interpolated linearly; axes are those of the nearest sample.
        """
        position = (arc_length / self.length).clip(0.0, 1.0) * (_SAMPLES - 1)
        below = np.minimum(position.astype(int), _SAMPLES - 2)
        worlds, fraction = np.arange(len(below)), (position - below)[:, None]
        start, end = self._samples[worlds, below], self._samples[worlds, below + 1]
        point = start + fraction * (end - start)
        axes = np.where(fraction < 0.5, start, end)[:, 3:12]
        return CoursePoint(point[:, :3], axes.reshape(-1, 3, 3), point[:, 12])

    def nearest(
        self,
        indices: Int[np.ndarray, " m"],
        positions: Float[np.ndarray, "m 3"],
        arc_length: Float[np.ndarray, " m"],
        reach: float,
    ) -> Float[np.ndarray, " m"]:
        """Arc lengths [m] of the points on centerlines that are nearest to positions in the world.

        Args:
            indices: Indices of the worlds.
            positions: Position in each world [m].
            arc_length: Center of the search [m], since a neighboring loop of gut may be nearer.
            reach: Search distance along the gut [m].
        """
        points, length = self._samples[indices, :, :3], self.length[indices]
        step, worlds = length / (_SAMPLES - 1), np.arange(len(indices))
        offsets = positions[:, None] - points
        squares = np.einsum("nki,nki->nk", offsets, offsets)
        away = np.abs(step[:, None] * np.arange(_SAMPLES) - arc_length[:, None])
        best = np.where(away <= np.maximum(reach, step)[:, None], squares, np.inf).argmin(axis=1)
        chord = points[worlds, np.minimum(best + 1, _SAMPLES - 1)]
        chord = chord - points[worlds, np.maximum(best - 1, 0)]
        along = np.einsum("ni,ni->n", offsets[worlds, best], chord)
        along /= np.maximum(np.linalg.norm(chord, axis=1), 1e-12)
        return (best * step + along.clip(-step, step)).clip(0.0, length)
