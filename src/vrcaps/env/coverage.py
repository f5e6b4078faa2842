"""Coverage of the wall in each world of an environment: total, gain of a step, and its map."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from vrcaps.metrics.coverage import CoverageCriteria, CoverageLevel
from vrcaps.metrics.point_coverage import POINT_LEVELS, mark_points

if TYPE_CHECKING:
    from jaxtyping import Float

    from vrcaps.env.worlds import EnvWorlds


class Coverage:
    """Coverage so far; arrays have a row for each world.

    Attributes:
        fraction: Fraction of the whole seen so far at each of `POINT_LEVELS`.
        gain: Fraction that was seen for the first time in the last step.
        cells: Visible fraction of the whole so far in each cell of the map.
        cell_area: Fraction of the whole that lies in each cell.
        cell_center: Centroid of each cell's part of the wall at rest [m]; 0 for empty cells.
        flags: Levels at which each point of the wall was seen, as bits.
    """

    def __init__(
        self, worlds: EnvWorlds, grid: tuple[int, int], criteria: CoverageCriteria
    ) -> None:
        """Allocate arrays."""
        memory, num_cells = worlds.memory, grid[0] * grid[1]
        self._worlds, self._criteria = worlds, criteria
        self.fraction = memory.allocate("fraction", (len(POINT_LEVELS),))
        self.gain = memory.allocate("gain", (len(POINT_LEVELS),))
        self.cells = memory.allocate("cells", (num_cells,))
        self.cell_area = memory.allocate("cell_area", (num_cells,))
        self.cell_center = memory.allocate("cell_center", (num_cells, 3))
        self.flags: list[np.ndarray] = [np.zeros(0, np.uint8)] * memory.num_worlds

    def seen(self, level: CoverageLevel) -> Float[np.ndarray, " n"]:
        """Return the fraction of the whole seen so far at one level."""
        return self.fraction[:, POINT_LEVELS.index(level)]

    @property
    def cell_fraction(self) -> Float[np.ndarray, "n c"]:
        """Fraction of each cell's area that was visible so far; 1 for cells without wall."""
        ones = np.ones_like(self.cells)
        fraction = np.divide(self.cells, self.cell_area, out=ones, where=self.cell_area > 0.0)
        return fraction.clip(0.0, 1.0)

    @property
    def unseen_cells(self) -> Float[np.ndarray, "n c"]:
        """Fraction of the whole in each cell of the map that was not visible yet."""
        return np.maximum(self.cell_area - self.cells, 0.0)

    def begin(self, index: int) -> None:
        """Start an episode in one world, with an unseen wall."""
        patient = self._worlds.patient(index)
        self.cell_area[index], self.cell_center[index] = patient.cell_area, patient.cell_center
        self.flags[index] = np.zeros(len(patient.points), np.uint8)
        for array in (self.fraction, self.gain, self.cells):
            array[index] = 0.0

    def update(self, indices: np.ndarray) -> None:
        """Mark the wall points that the cameras of some worlds see."""
        self.gain[indices] = 0.0
        lenses = np.array([id(self._worlds.devices[k].cameras) for k in indices])
        for lens in set(lenses.tolist()):
            self._update_alike(indices[lenses == lens])
        self.fraction[indices] += self.gain[indices]

    def _update_alike(self, indices: np.ndarray) -> None:
        """Mark the wall points seen in worlds with identical cameras."""
        worlds, cells = self._worlds, self.cells[indices]
        walls, poses = worlds.batch.walls(indices), worlds.T_patient_capsule(indices)
        for camera in worlds.devices[indices[0]].cameras:
            self.gain[indices] += mark_points(
                walls,
                [worlds.patient(k).points for k in indices],
                camera,
                poses @ camera.T_capsule_camera,
                [self.flags[k] for k in indices],
                cells,
                self._criteria,
            )
        self.cells[indices] = cells
