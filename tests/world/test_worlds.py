"""Several worlds side by side."""

from __future__ import annotations

import os
import subprocess
import sys

import numpy as np
import pytest

from vrcaps.errors import InputError
from vrcaps.tissue.tissue import Tissue
from vrcaps.world.control import Control
from vrcaps.world.model import Model, State
from vrcaps.world.snapshot import Snapshot
from vrcaps.world.world import World
from vrcaps.world.worlds import step_worlds

CONTROLS = [Control(force_world=(0.2 * k, 0.0, -0.3)) for k in range(4)]


def worlds_in(model: Model) -> list[World]:
    line, worlds = model.organ.centerline, []
    for sample in (60, 100, 150, 200):
        pose = np.eye(4)
        pose[:3, :3], pose[:3, 3] = line.frames[sample], line.points[sample]
        worlds.append(World(model, Tissue(), State(0.0, model.T_world_patient @ pose)))
    return worlds


def as_bytes(snapshot: Snapshot) -> bytes:
    return b"".join(np.asarray(value).tobytes() for value in vars(snapshot).values())


def test_the_same_bytes_as_alone(model: Model) -> None:
    together, alone = worlds_in(model), worlds_in(model)
    for _ in range(2):
        step_worlds(together, CONTROLS, 0.01)
        for world, control in zip(alone, CONTROLS, strict=True):
            world.step(control, 0.01)
    for a, b in zip(together, alone, strict=True):
        assert as_bytes(a.snapshot()) == as_bytes(b.snapshot())


@pytest.mark.slow
def test_the_same_bytes_on_any_number_of_threads() -> None:
    """Each in a process of its own, for the number of threads is fixed when the core loads."""
    code = (
        "import sys, hashlib; sys.path[:0] = sys.argv[1:]\n"
        "from tubes import bent_tube; import test_worlds as t\n"
        "from vrcaps.capsule.catalog import read_device\n"
        "worlds = t.worlds_in(t.Model(bent_tube(), read_device('mirocam')))\n"
        "t.step_worlds(worlds, t.CONTROLS, 0.01)\n"
        "print(hashlib.sha256(b''.join(t.as_bytes(w.snapshot()) for w in worlds)).hexdigest())"
    )
    here = __file__.rpartition("/")[0]
    found = {
        subprocess.run(
            [sys.executable, "-c", code, here, here.rpartition("/")[0]],
            env={**os.environ, "RAYON_NUM_THREADS": threads},
            capture_output=True,
            check=True,
        ).stdout
        for threads in ("1", "2")
    }
    assert len(found) == 1


def test_a_bad_world_does_not_hold_up_the_others(model: Model) -> None:
    worlds = worlds_in(model)
    before = [as_bytes(world.snapshot()) for world in worlds]
    controls = [*CONTROLS[:2], Control(force_world=(500.0, 0.0, 0.0)), CONTROLS[3]]
    with pytest.raises(
        InputError, match=r"World 2: Control's force_world is 500 strong.* 3 other worlds have"
    ):
        step_worlds(worlds, controls, 0.01)
    same = [as_bytes(w.snapshot()) == b for w, b in zip(worlds, before, strict=True)]
    assert same == [False, False, True, False]


def test_rejects_controls_that_do_not_match(model: Model) -> None:
    worlds = worlds_in(model)
    with pytest.raises(InputError, match=r"Number of controls is 1. Allowed: 4"):
        step_worlds(worlds, CONTROLS[:1], 0.01)
    with pytest.raises(InputError, match="A world is given twice"):
        step_worlds([worlds[0], worlds[0]], CONTROLS[:2], 0.01)
