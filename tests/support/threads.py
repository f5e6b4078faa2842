"""The same work of a test module in processes with other numbers of threads."""

from __future__ import annotations

import hashlib
import inspect
import os
from collections.abc import Callable, Iterable
from pathlib import Path

import numpy as np

from tests.support.programs import run_program
from tests.support.shapes import looking
from vrcaps import _core
from vrcaps.camera.camera import Camera
from vrcaps.render.renderer import Renderer

VARIABLES = ("RAYON_NUM_THREADS", "OIDN_NUM_THREADS")


def digests_by_threads(
    digest: Callable[[], str], threads: Iterable[int]
) -> tuple[list[int], set[str]]:
    """The number of threads of each process, and the result of a module's `digest` in them.

    One is this process if it has as many, for it has imported all; each other is a new one, for the
    number of threads is fixed when the core loads.
    """
    test = Path(inspect.getfile(digest))
    code = (
        f"import sys; sys.path[:0] = [{str(test.parent)!r}]\n"
        f"import {test.stem} as test\n"
        "from vrcaps import _core\n"
        "print(_core.num_threads(), test.digest())"
    )

    def result(count: int) -> list[str]:
        has_as_many = all(os.environ.get(name) == str(count) for name in VARIABLES)
        if has_as_many and _core.num_threads() == count:
            return [str(count), digest()]
        return run_program(code, environment=dict.fromkeys(VARIABLES, str(count))).stdout.split()

    results = [result(count) for count in threads]
    return [int(count) for count, _ in results], {checksum for _, checksum in results}


def digest_at_rest_and_moved(
    renderer: Renderer, camera: Camera, place: tuple[float, float, float]
) -> str:
    """Checksum of two frames, the second of a wall that has moved, and of the first again."""
    wide = renderer.model.organ.vertices * np.array([1.02, 1.02, 1.0])
    states = (looking(place), looking((0.0, 0.002, 0.08), vertices_world=wide), looking(place))
    total = hashlib.sha256()
    for state in states:
        frame = renderer.render(state, camera, channels=("rgb", "radiance"))
        assert frame.rgb is not None and frame.radiance is not None
        total.update(frame.rgb.tobytes() + frame.radiance.tobytes())
    return total.hexdigest()
