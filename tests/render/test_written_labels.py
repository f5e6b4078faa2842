"""Labels are exact through the files that a recording writes: pose, camera and `organ.glb`."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from tests.support.coarse_organs import patch_looks
from tests.support.shapes import tube
from tests.support.write_ply import write_ply
from vrcaps.mesh.mesh import Mesh
from vrcaps.scenario.scenario import OrganFile


@pytest.mark.slow
def test_recorded_labels_agree_with_embree(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    from benchmarks.validation.labels import STEP, measure

    organ = tube(48, 120, length=0.12, folds=0.15, capped=True)
    write_ply(tmp_path / "tube.ply", Mesh(organ.vertices, organ.faces))
    patch_looks(monkeypatch)
    tally = measure(OrganFile(str(tmp_path / "tube.ply"), "m"), "mono", frames=3)
    assert np.concatenate(tally.same_holes).mean() > 0.9999
    assert np.mean(np.concatenate(tally.depth) <= STEP) > 0.999
    assert np.mean(np.concatenate(tally.normal_deg) <= 0.1) > 0.999
    assert np.concatenate(tally.label).mean() > 0.999
    assert np.concatenate(tally.arc_length).mean() > 0.999
    assert np.mean(np.concatenate(tally.flow_px) <= 0.05) > 0.999
