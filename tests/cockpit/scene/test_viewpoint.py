"""Viewpoints: a framed box just fits, and directions on the screen are those of the patient."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from vrcaps.cockpit.scene.viewpoint import _FOV, frame_box, viewpoint_of
from vrcaps.core.geometry import quaternion_from_matrix
from vrcaps.world.model import posture_transform


def camera(back: list[float], aspect: float = 1.0) -> Any:
    """Camera that looks at the origin from a direction, with z up."""
    towards = -np.array(back) / np.linalg.norm(back)
    right = np.cross(towards, [0.0, 0.0, 1.0])
    right /= np.linalg.norm(right)
    rotation = np.stack([right, np.cross(towards, right), towards], axis=1)
    return SimpleNamespace(
        position=np.array(back),
        look_at=np.zeros(3),
        wxyz=quaternion_from_matrix(rotation),
        fov=_FOV,
        image_width=int(600 * aspect),
        image_height=600,
        _state=SimpleNamespace(update_timestamp=1.0),
    )


@pytest.mark.parametrize("aspect", [0.5, 1.0, 2.0])
def test_all_corners_of_a_framed_box_are_visible_and_some_nearly_touch_the_edge(aspect):
    view = camera([0.25, -1.0, 0.45], aspect)
    before = view.position / np.linalg.norm(view.position)
    low, high = np.array([0.1, 0.0, 0.0]), np.array([0.3, 0.1, 0.4])
    frame_box(view, low, high)
    np.testing.assert_allclose(view.look_at, [0.2, 0.05, 0.2])
    back = view.position - view.look_at
    np.testing.assert_allclose(back / np.linalg.norm(back), before)
    towards = -before
    right = np.cross(towards, [0.0, 0.0, 1.0])
    right /= np.linalg.norm(right)
    up = np.cross(right, towards)
    corners = np.stack(np.meshgrid(*np.stack([low, high], axis=1)), axis=-1).reshape(-1, 3)
    offset = corners - view.position
    tangent = np.tan(0.5 * _FOV)
    x = offset @ right / (offset @ towards) / (tangent * aspect)
    y = offset @ up / (offset @ towards) / tangent
    farthest = np.abs([x, y]).max()
    assert 0.75 < farthest < 1.0


def test_directions_on_the_screen_and_the_visible_height():
    """From the feet of a supine patient: left of the patient is at the right, the front is up."""
    found = viewpoint_of(camera([0.0, -2.0, 0.0]), posture_transform("supine"))
    assert found is not None
    left, posterior, superior = np.array(found.patient)
    np.testing.assert_allclose(left, [1.0, 0.0, 0.0], atol=1e-6)
    np.testing.assert_allclose(posterior, [0.0, -1.0, 0.0], atol=1e-6)
    np.testing.assert_allclose(superior, [0.0, 0.0, -1.0], atol=1e-6)
    np.testing.assert_allclose(found.world[2], [0.0, 1.0, 0.0], atol=1e-6)
    assert found.height == pytest.approx(4.0 * np.tan(0.5 * _FOV))


def test_a_scene_that_has_reported_nothing_has_no_viewpoint():
    view = camera([0.0, -1.0, 0.0])
    view._state.update_timestamp = 0.0
    assert viewpoint_of(view, np.eye(4)) is None
