"""Actuation by the currents of an array of electromagnets."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Annotated, Any, ClassVar

import numpy as np

from vrcaps.actuation.coil_array import (
    CoilArray,
    CoilState,
    advance_coils,
    coils_at_rest,
    read_coil_array,
)
from vrcaps.actuation.coil_program import array_pose
from vrcaps.core.fields import Range, check_fields
from vrcaps.core.units import CM
from vrcaps.env.parts import Actuation, EnvView
from vrcaps.world.control import Control

if TYPE_CHECKING:
    from jaxtyping import Float

    from vrcaps.magnet.sources import Source
    from vrcaps.world.model import State

_LIMIT_NAMES = np.array(["", "temperature"], object)


@dataclass(frozen=True)
class CoilActuation(Actuation):
    """Electromagnets below the patient.

    An action has a value from −1 to 1 for each coil: its commanded current relative to its maximum.
    The current follows with its rise time; a coil that is too hot is switched off, and
    `info["coil_limit"]` is then `temperature`. `info["coil_temperature"]` is that of the hottest
    coil [°C]. Episodes start without currents, at the ambient temperature.

    Attributes:
        coils: Name of the array, see `vrcaps.actuation.coil_array.coil_array_names`, path of
            its TOML file, or an array in memory.
        standoff: Gap between the array's surface and the organ's lowest point [m].
    """

    coils: str | CoilArray = "table-3x3"
    standoff: Annotated[float, Range(min=0.0, max=1.0, unit="m")] = 3.0 * CM

    kind: ClassVar[str] = "coils"

    def __post_init__(self) -> None:
        check_fields(self)
        object.__setattr__(self, "coils", read_coil_array(self.coils))

    @cached_property
    def _array(self) -> CoilArray:
        return read_coil_array(self.coils)

    @cached_property
    def _max_currents(self) -> Float[np.ndarray, " k"]:
        return self._array.values("max_current")

    def space(self) -> Any:
        """Action space: a value from −1 to 1 for each coil."""
        from gymnasium import spaces

        return spaces.Box(-1.0, 1.0, (len(self._array.coils),), np.float32)

    @property
    def names(self) -> tuple[str, ...]:
        """Current of each coil."""
        currents = enumerate(self._max_currents, 1)
        return tuple(f"coil_{k}_current [{current:g} A]" for k, current in currents)

    def allocate(self, view: EnvView) -> None:
        """Allocate currents and temperatures."""
        count = len(self._array.coils)
        view.memory.allocate("coils/current", (count,))
        view.memory.allocate("coils/temperature", (count,))
        view.memory.allocate("coils/is_hot", (count,), dtype=bool)

    def begin(self, view: EnvView, index: int, start: State) -> tuple[Source, ...]:
        """Place the array below the organ, without currents."""
        del start
        self._keep(view, index, coils_at_rest(self._array))
        pose = array_pose(view.patient(index).model, None, self.standoff)
        return self._array.sources(pose)

    def controls(
        self, view: EnvView, actions: np.ndarray, indices: np.ndarray
    ) -> Sequence[Control]:
        """Set the currents for a control period."""
        commands = self._max_currents * np.asarray(actions, float)[indices]
        names = ("current", "temperature", "is_hot")
        state = CoilState(*(view.memory[f"coils/{name}"][indices] for name in names))
        state = advance_coils(self._array, state, commands, view.control_period)
        self._keep(view, indices, state)
        return [Control(strengths=currents) for currents in state.currents]

    def measures(self, view: EnvView) -> dict[str, np.ndarray]:
        """Return whether a coil was switched off, and the highest temperature [°C]."""
        memory = view.memory
        is_hot = memory["coils/is_hot"].any(axis=1).astype(int)
        hottest = memory["coils/temperature"].max(axis=1)
        return {"coil_limit": _LIMIT_NAMES[is_hot], "coil_temperature": hottest}

    @staticmethod
    def _keep(view: EnvView, index: int | np.ndarray, state: CoilState) -> None:
        view.memory["coils/current"][index] = state.currents
        view.memory["coils/temperature"][index] = state.temperatures
        view.memory["coils/is_hot"][index] = state.is_hot
