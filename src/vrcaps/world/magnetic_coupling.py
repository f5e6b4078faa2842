"""Magnetic coupling: wrench of external sources on the capsule's magnets in a `World`."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from vrcaps import _core
from vrcaps.core.errors import InputError
from vrcaps.core.geometry import matrix_from_quaternion, quaternion_from_matrix, transform_from
from vrcaps.magnet.field import SourceSet
from vrcaps.magnet.sources import InternalMagnet, Source, UniformField, magnet_rows
from vrcaps.world.control import Control
from vrcaps.world.model import Coupling

if TYPE_CHECKING:
    from jaxtyping import Float


class MagneticCoupling:
    """Sources of a world, their positions, and the wrench computed by the core."""

    def __init__(
        self, core: _core.World, magnets: Sequence[InternalMagnet], sources: Sequence[Source]
    ) -> None:
        """Let sources act on the magnets of a capsule.

        Raises:
            InputError: If there are sources but no magnets.
        """
        if sources and not magnets:
            raise InputError(
                "The capsule contains no magnet, so no source can move it. Give a device with "
                "[[magnets]], such as magnetic, or no sources."
            )
        self._core, self._set = core, SourceSet(sources)
        poses = [np.asarray(source.T_world_magnet, float) for source in self._set.sources]
        self.rows: Float[np.ndarray, "k 8"] = rows_from_poses(np.array(poses).reshape(-1, 4, 4))
        self.rows[:, 7] = [getattr(source, "strength", 1.0) for source in self._set.sources]
        self._has_position = np.array(
            [not isinstance(s, UniformField) for s in self._set.sources], bool
        )
        if sources:
            core.set_magnets(self._set.core, magnet_rows(magnets))

    @property
    def sources(self) -> tuple[Source, ...]:
        """The sources at their current poses."""
        poses = poses_from_rows(self.rows)
        pairs = zip(self._set.sources, poses, strict=True)
        return tuple(replace(source, T_world_magnet=pose) for source, pose in pairs)

    def restore(
        self, rows: Float[np.ndarray, "k 8"], T_world_patient: Float[np.ndarray, "4 4"]
    ) -> None:
        """Restore the poses of the sources."""
        self.rows = rows
        self.aim(rows, 1.0, T_world_patient)

    def aim(
        self, end: Float[np.ndarray, "k 8"], dt: float, T_world_patient: Float[np.ndarray, "4 4"]
    ) -> None:
        """Move the sources to their poses after `dt` [s].

        Args:
            end: Rows of the sources at the end of the step.
            dt: Length of the step [s].
            T_world_patient: Posture of the patient.
        """
        if len(end):
            parts = (self._set.spread(self.rows), self._set.spread(end))
            self._core.aim_sources(*parts, dt, np.asarray(T_world_patient, float))

    def angle(self, T_world_capsule: Float[np.ndarray, "4 4"]) -> float:
        """Angle between the capsule's moment and the flux density [rad]; 0 without sources."""
        coupled = self._core.magnetic_coupling(T_world_capsule)
        return 0.0 if coupled is None else coupled[-1]

    def coupling(self, T_world_capsule: Float[np.ndarray, "4 4"]) -> Coupling | None:
        """Effect of the sources in the last step; None without sources."""
        coupled = self._core.magnetic_coupling(T_world_capsule)
        if coupled is None:
            return None
        force, torque, flux, gradient, fault, point, angle = coupled
        away = [math.dist(row[:3], point) for row in self.rows[self._has_position]]
        return Coupling(
            force_world=np.array(force),
            torque_world=np.array(torque),
            flux_density_world=np.array(flux),
            flux_gradient_world=np.array(gradient).reshape(3, 3),
            angle=angle,
            distance=min(away, default=math.inf),
            Ts_world_magnet=poses_from_rows(self.rows),
            strengths=self.rows[:, 7].copy(),
            is_exact=fault == 0,
        )


def rows_after(
    couplings: Sequence[MagneticCoupling], controls: Sequence[Control]
) -> tuple[list[Float[np.ndarray, "k 8"]], dict[int, str]]:
    """Target rows of the sources under controls, and errors of invalid controls, by index."""
    ends, failures, poses = [], {}, []
    for k, (coupling, control) in enumerate(zip(couplings, controls, strict=True)):
        end = coupling.rows
        for name in ("Ts_world_magnet", "strengths"):
            given = getattr(control, name)
            if given is not None and len(given) != len(end):
                message = f"Number of the control's {name} is {len(given)}. Allowed: {len(end)}."
                failures.setdefault(k, message)
        is_moved = control.Ts_world_magnet is not None and k not in failures
        ends.append(end if control.strengths is None and not is_moved else end.copy())
        if is_moved:
            poses.append((k, np.asarray(control.Ts_world_magnet, float)))
        if control.strengths is not None and k not in failures:
            ends[k][:, 7] = control.strengths
    if poses:
        rows = rows_from_poses(np.concatenate([given for _, given in poses]))
        first = 0
        for k, given in poses:
            ends[k][:, :7] = rows[first : first + len(given), :7]
            first += len(given)
    return ends, failures


def rows_from_poses(Ts_world_source: Float[np.ndarray, "k 4 4"]) -> Float[np.ndarray, "k 8"]:
    """Position [m], wxyz and a strength of 1 for each source."""
    wxyz = quaternion_from_matrix(Ts_world_source[:, :3, :3])
    ones = np.ones((len(Ts_world_source), 1))
    return np.concatenate([Ts_world_source[:, :3, 3], wxyz, ones], axis=1)


def poses_from_rows(rows: Float[np.ndarray, "k 8"]) -> Float[np.ndarray, "k 4 4"]:
    """Convert rows of `rows_from_poses` to poses."""
    return transform_from(matrix_from_quaternion(rows[:, 3:7]), rows[:, :3])
