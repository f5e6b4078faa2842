"""Memory of an environment: state of task, actuation and observations between steps."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from vrcaps.core.errors import InputError


class Memory:
    """Named arrays with a row for each world; saved and restored row by row.

    All state that changes during an episode is stored here, so that a snapshot of an environment is
    complete without knowledge of its parts.

    Example:
        >>> best = memory.allocate("coverage/best")
        >>> row = memory.row(3)

    Attributes:
        num_worlds: Number of worlds.
    """

    def __init__(self, num_worlds: int) -> None:
        self.num_worlds = num_worlds
        self._arrays: dict[str, np.ndarray] = {}

    def allocate(
        self, name: str, shape: Sequence[int] = (), dtype: Any = float, fill: float = 0
    ) -> np.ndarray:
        """Allocate an array [num_worlds, *shape] filled with one value."""
        if name in self._arrays:
            raise InputError(f"Buffer {name!r} exists already. Choose another name.")
        self._arrays[name] = np.full((self.num_worlds, *shape), fill, dtype)
        return self._arrays[name]

    def __getitem__(self, name: str) -> np.ndarray:
        return self._arrays[name]

    def __contains__(self, name: str) -> bool:
        return name in self._arrays

    def row(self, index: int) -> dict[str, np.ndarray]:
        """Return a copy of the rows of one world."""
        return {name: array[index].copy() for name, array in self._arrays.items()}

    def set_row(self, index: int, row: dict[str, np.ndarray]) -> None:
        """Restore the rows of one world from `row`.

        Raises:
            InputError: If they are of another memory.
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
