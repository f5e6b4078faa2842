"""Patient of an environment: an organ, the capsule, and the wall points for coverage."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np

from vrcaps.metrics.point_coverage import WallPoints, wall_points
from vrcaps.organ.surface import OrganSurface
from vrcaps.scenario.build import resolve
from vrcaps.scenario.scenario import Scenario
from vrcaps.world.model import Model, posture_transform

if TYPE_CHECKING:
    from jaxtyping import Float

    from vrcaps.capsule.device import Device
    from vrcaps.env.settings import EnvSettings


@dataclass(frozen=True)
class Patient:
    """An organ with everything that is constant over episodes.

    Attributes:
        model: Organ, capsule and posture.
        points: Sample points of the wall, weighted by area.
        num_cells: Number of cells of the map of the wall.
    """

    model: Model
    points: WallPoints
    num_cells: int

    @cached_property
    def cell_area(self) -> Float[np.ndarray, " c"]:
        """Fraction of the wall's area in each cell of the map."""
        weights = self.points.fractions[:, 1]
        return np.bincount(self.points.cell, weights, minlength=self.num_cells)

    @cached_property
    def cell_center(self) -> Float[np.ndarray, "c 3"]:
        """Centroid of the wall in each cell in the world frame [m]; 0 for empty cells."""
        face, weights = self.points.face, self.points.weights
        weights = np.column_stack([weights, 1.0 - weights.sum(axis=1)])
        corners = self.model.vertices_world[self.model.organ.faces[face]]
        places = np.einsum("kc,kcx->kx", weights, corners) * self.points.fractions[:, 1:]
        sums = [np.bincount(self.points.cell, x, minlength=self.num_cells) for x in places.T]
        return np.stack(sums, axis=-1) / np.maximum(self.cell_area, 1e-12)[:, None]


class Patients:
    """Patients of an environment, created on first use."""

    def __init__(self, settings: EnvSettings, device: Device, *, with_textures: bool) -> None:
        """Initialize without creating any patient.

        Args:
            settings: Settings, which name the organs.
            device: The capsule.
            with_textures: Whether the wall will be rendered.
        """
        self._settings, self._device, self._with_textures = settings, device, with_textures
        self._made: dict[int, Patient] = {}

    def __len__(self) -> int:
        return len(self._settings.organs)

    def __getitem__(self, number: int) -> Patient:
        if number not in self._made:
            self._made[number] = self._make(number)
        return self._made[number]

    def _make(self, number: int) -> Patient:
        settings = self._settings
        organ = self._organ(number)
        model = Model(organ, self._device, posture_transform(settings.posture))
        rows, columns = settings.grid
        return Patient(
            model, wall_points(organ, settings.num_points, settings.grid), rows * columns
        )

    def _organ(self, number: int) -> OrganSurface:
        settings = self._settings
        given = settings.organs[number]
        needs_look = self._with_textures or bool(settings.lesions)
        if isinstance(given, OrganSurface) and not needs_look:
            return replace(given, appearance=None)
        scenario = Scenario(
            organ=given,
            capsule=self._device,
            posture=settings.posture,
            lesions=settings.lesions,
        )
        organ = resolve(scenario).organ.load()
        return organ if self._with_textures else replace(organ, appearance=None)
