from __future__ import annotations

import numpy as np
import pytest

from benchmarks.speed import peers
from benchmarks.speed.peers import PeerMissingError, embree, find_peers, mitsuba, welded_mesh
from tests.support.shapes import DIRECT
from vrcaps.cli.benchmarks.stage import Stage
from vrcaps.render.renderer import Renderer


@pytest.mark.slow
def test_welded_mesh_is_the_same_wall(stage: Stage) -> None:
    organ, mesh = stage.model.organ, welded_mesh(stage)
    np.testing.assert_array_equal(
        mesh.vertices[mesh.faces], stage.model.vertices_world[organ.faces]
    )
    np.testing.assert_array_equal(mesh.uv[mesh.faces], organ.uv)
    assert len(organ.vertices) < len(mesh.vertices) < 1.6 * len(organ.vertices)


@pytest.mark.slow
def test_embree_casts_the_rays_that_we_cast(stage: Stage) -> None:
    """Both timed subjects do the same work: the distances agree."""
    pytest.importorskip("embreex")
    (subject,) = embree.subjects(stage)
    answer = subject.frame(1)
    assert isinstance(answer, dict)
    frame = Renderer(stage.model, DIRECT).render(
        stage.states[1], stage.camera, channels=["ray_distance"]
    )
    assert frame.ray_distance is not None
    ours = frame.ray_distance[np.isfinite(frame.ray_distance)]
    theirs = answer["tfar"][answer["geomID"] >= 0]
    assert theirs.shape == ours.shape
    assert np.mean(np.isclose(theirs, ours, rtol=1e-3)) > 0.999


@pytest.mark.slow
def test_a_missing_package_is_left_out_with_how_to_get_it(
    monkeypatch: pytest.MonkeyPatch, stage: Stage
) -> None:
    monkeypatch.setattr(embree, "load_package", lambda _: peers.load_package("no_such_package"))
    found, skipped = find_peers(stage, ["embree"])
    assert found == []
    assert "no_such_package" in skipped["embree"]
    assert "pip install 'vrcaps[dev]'" in skipped["embree"]


@pytest.mark.slow
def test_an_llvm_that_cannot_work_is_a_reason_and_not_a_crash(
    monkeypatch: pytest.MonkeyPatch, stage: Stage
) -> None:
    pytest.importorskip("mitsuba")
    monkeypatch.setenv("DRJIT_LIBLLVM_PATH", "/nowhere/libLLVM.so")
    with pytest.raises(PeerMissingError, match="LLVM 16 or newer"):
        mitsuba.subjects(stage)
