"""Memory of an environment: what tasks, actuation and observations carry from step to step."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from vrcaps.errors import InputError


class Memory:
    """Named arrays with a row for each world; saved and restored row by row.

    Whatever changes during an episode lives here, so that a snapshot of an environment is complete
    without any part knowing of it.

    Example:
        >>> best = memory.allocate("coverage/best")
        >>> row = memory.row(3)
    """

    def __init__(self, num_worlds: int) -> None:
        self._num_worlds = num_worlds
        self._arrays: dict[str, np.ndarray] = {}

    def allocate(
        self, name: str, shape: Sequence[int] = (), dtype: Any = float, fill: float = 0
    ) -> np.ndarray:
        """A new array [num_worlds, *shape] that is full of one value."""
        if name in self._arrays:
            raise InputError(f"Memory {name!r} is taken. Allowed: a name of its own.")
        self._arrays[name] = np.full((self._num_worlds, *shape), fill, dtype)
        return self._arrays[name]

    def __getitem__(self, name: str) -> np.ndarray:
        return self._arrays[name]

    def __contains__(self, name: str) -> bool:
        return name in self._arrays

    def row(self, index: int) -> dict[str, np.ndarray]:
        """A copy of all that belongs to one world."""
        return {name: array[index].copy() for name, array in self._arrays.items()}

    def set_row(self, index: int, row: dict[str, np.ndarray]) -> None:
        """Puts back what `row` gave.

        Raises:
            InputError: If it is of another memory.
        """
        arrays = self._arrays
        fits = set(row) == set(arrays) and all(
            np.shape(row[name]) == array.shape[1:] for name, array in arrays.items()
        )
        if not fits:
            raise InputError(
                "The snapshot is of another environment. Give one of an environment with the same "
                "settings."
            )
        for name, value in row.items():
            arrays[name][index] = value
