"""The seen wall is the same when watched live and when replayed."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest

from tests.support.tubes import straight_gut
from vrcaps.camera.derive import scaled_camera
from vrcaps.camera_pipeline.effects import Effects
from vrcaps.capsule.device_file import read_device
from vrcaps.cockpit.session.seen_wall import SeenWall
from vrcaps.world.model import Model
from vrcaps.world.schedule import PostureChange, patient_at

if TYPE_CHECKING:
    from vrcaps.cockpit.session.clock import View

FPS = 2.0
TURN = (PostureChange("standing", 0.0, 1.0),)


@pytest.fixture(scope="module")
def model() -> Model:
    device = read_device("magnetic")
    device = replace(device, cameras=(scaled_camera(device.cameras[0], 0.1),))
    return Model(straight_gut({"jejunum": 0.2}, radius=0.014), device)


def session_of(model: Model, poses: np.ndarray) -> Any:
    """As much of a session as counts here."""
    rollout = SimpleNamespace(fps=FPS, settings=SimpleNamespace(posture_changes=TURN))
    scenario = SimpleNamespace(effects=Effects())
    return SimpleNamespace(model=model, rollout=rollout, poses=poses, scenario=scenario)


def test_after_a_return_frames_of_a_turned_patient_count_as_when_they_were_seen(model):
    lying = [patient_at(model.T_world_patient, TURN, frame / FPS) for frame in range(4)]
    at_rest = model.centerline_poses(np.array([0.10, 0.05, 0.12, 0.15]))
    poses = np.array(
        [
            now @ np.linalg.inv(model.T_world_patient) @ pose
            for now, pose in zip(lying, at_rest, strict=True)
        ]
    )

    def view_of(frame: int) -> View:
        state = replace(model.place(), time=frame / FPS, T_world_capsule=poses[frame])
        return SimpleNamespace(frame=frame, state=state, T_world_patient=lying[frame])  # type: ignore[return-value]

    watched = SeenWall(session_of(model, poses))
    for frame in range(3):
        watched.see(view_of(frame))
    gone_back = SeenWall(session_of(model, poses[:3]))
    gone_back.see(view_of(3))
    gone_back.see(view_of(2))
    assert watched.vertices.any()
    assert not watched.vertices.all()
    np.testing.assert_array_equal(gone_back.vertices, watched.vertices)
    assert gone_back.fraction == pytest.approx(watched.fraction)
