"""Patients of an environment: parsed organ names, and everything that is constant over episodes."""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np

from vrcaps.core.errors import InputError, UnknownNameError, require
from vrcaps.metrics.point_coverage import WallPoints, wall_points
from vrcaps.organ.segments import ORGANS
from vrcaps.organ.surface import OrganSurface
from vrcaps.scenario.build import resolve
from vrcaps.scenario.scenario import OrganFile, OrganGenerated, Scenario, organ_named
from vrcaps.world.model import Model, posture_transform

if TYPE_CHECKING:
    from jaxtyping import Float

    from vrcaps.capsule.device import Device
    from vrcaps.lesion import Lesion

Organ = OrganGenerated | OrganFile | OrganSurface | str
"""An organ, or a string in the syntax of `parse_organs`."""

_SEEDS = re.compile(r"(\d{1,9})(?:-(\d{1,9}))?")
_MAX_SEEDS = 100_000


def organs_of(given: Iterable[Organ]) -> Iterator[OrganGenerated | OrganFile | OrganSurface]:
    """Yield the given organs; a string may name several.

    Raises:
        InputError: If a string cannot be parsed.
    """
    for organ in given:
        if isinstance(organ, str):
            yield from parse_organs(organ)
        else:
            yield organ


def parse_organs(text: str) -> list[OrganGenerated | OrganFile]:
    """Parse a string such as ``stomach``, ``stomach:3``, ``stomach:0-15`` or ``mine.ply:mm``.

    Raises:
        InputError: If the part after the colon is neither a seed or seeds, nor a unit of a mesh.
    """
    name, _, rest = text.rpartition(":") if ":" in text else (text, "", "")
    organ = organ_named(name)
    if not rest:
        return [organ]
    if isinstance(organ, OrganFile):
        return [replace(organ, unit=rest)]
    seeds = _SEEDS.fullmatch(rest)
    if seeds is None:
        raise InputError(f"The organ is {text!r}. Allowed: NAME:SEED, NAME:FIRST-LAST, FILE:UNIT.")
    first, last = int(seeds[1]), int(seeds[2] or seeds[1])
    if first > last:
        raise InputError(
            f"The organ is {text!r}. Allowed: ascending seeds, such as {name}:{last}-{first}."
        )
    require(last - first < _MAX_SEEDS, "The number of seeds", last - first + 1, "up to 100,000")
    return [OrganGenerated(name, seed=seed) for seed in range(first, last + 1)]


def check_names(organs: Sequence[Organ], capsule: str | Device) -> None:
    """Check that organs and a capsule exist; nothing is created.

    Raises:
        InputError: If an organ's file or unit is missing, or a device file.
        UnknownNameError: If an organ or the capsule is unknown.
    """
    checked: list[OrganGenerated] = []
    for organ in organs_of(organs):
        if isinstance(organ, OrganGenerated):
            if organ.name not in ORGANS:
                raise UnknownNameError("organ", organ.name, ORGANS)
            patient = replace(organ, seed=0)  # thousands of patients may differ by the seed alone
            if patient in checked:
                continue
            checked.append(patient)
        resolve(Scenario(organ=organ, capsule=capsule, variation=False))


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
        positions = np.einsum("kc,kcx->kx", weights, corners) * self.points.fractions[:, 1:]
        sums = [np.bincount(self.points.cell, x, minlength=self.num_cells) for x in positions.T]
        return np.stack(sums, axis=-1) / np.maximum(self.cell_area, 1e-12)[:, None]


class Patients:
    """Patients of an environment, created on first use.

    Attributes:
        device: The capsule.
    """

    def __init__(
        self,
        organs: Sequence[Organ],
        device: Device,
        *,
        posture: str = "supine",
        lesions: tuple[Lesion, ...] = (),
        num_points: int = 4096,
        grid: tuple[int, int] = (32, 16),
        with_textures: bool = False,
    ) -> None:
        """Initialize without creating any patient.

        Args:
            organs: An organ for each patient.
            device: The capsule.
            posture: Posture of the patients.
            lesions: Lesions to insert into each organ.
            num_points: Number of sample points of the wall.
            grid: Numbers of cells of the map of the wall, along the gut and around it.
            with_textures: Whether the wall will be rendered.
        """
        self._organs, self.device, self._posture = tuple(organs_of(organs)), device, posture
        self._lesions, self._with_textures = lesions, with_textures
        self._num_points, self._grid = num_points, grid
        self._patients: dict[int, Patient] = {}

    def __len__(self) -> int:
        return len(self._organs)

    def __getitem__(self, index: int) -> Patient:
        if index not in self._patients:
            self._patients[index] = self._make(self._organ(self._organs[index]))
        return self._patients[index]

    def _make(self, organ: OrganSurface) -> Patient:
        model = Model(organ, self.device, posture_transform(self._posture))
        points = wall_points(organ, self._num_points, self._grid)
        return Patient(model, points, self._grid[0] * self._grid[1])

    def _organ(self, given: OrganGenerated | OrganFile | OrganSurface) -> OrganSurface:
        if isinstance(given, OrganSurface) and not (self._with_textures or self._lesions):
            return replace(given, appearance=None)
        scenario = Scenario(
            organ=given,
            capsule=self.device,
            posture=self._posture,
            lesions=self._lesions,
            variation=False,
        )
        organ = resolve(scenario).organ.load()
        return organ if self._with_textures else replace(organ, appearance=None)
