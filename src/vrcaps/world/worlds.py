"""Several worlds, stepped in parallel."""

from __future__ import annotations

from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor

from vrcaps import _core
from vrcaps.errors import InputError, require
from vrcaps.world.control import Control
from vrcaps.world.world import World


def step_worlds(worlds: Sequence[World], controls: Sequence[Control], dt: float) -> None:
    """Moves each world on by a time `dt` [s], as `World.step` does, on all processors.

    Each world goes on to the same bytes as alone. `RAYON_NUM_THREADS` sets how many run at a time.

    Raises:
        InputError: If there is not one control for each world, a world is given twice, or a world
            cannot step. The worlds that cannot stay as they were, all others have stepped.
    """
    require(len(controls) == len(worlds), "Number of controls", len(controls), f"{len(worlds)}")
    if len({id(world) for world in worlds}) < len(worlds):
        raise InputError("A world is given twice. Allowed: each world once.")

    def step(world: World, control: Control) -> str | None:
        try:
            world.step(control, dt)
        except InputError as error:
            return str(error)
        return None

    with ThreadPoolExecutor(max_workers=_core.num_threads()) as threads:
        failures = list(threads.map(step, worlds, controls))
    told = [f"World {k}: {failure}" for k, failure in enumerate(failures) if failure]
    if told:
        raise InputError(f"{' '.join(told)} {len(worlds) - len(told)} other worlds have stepped.")
