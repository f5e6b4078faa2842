"""Viewpoints of the browsers in the 3D scene: targets to frame, directions and scale."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any
from urllib.parse import urlsplit

import numpy as np

from vrcaps.cockpit.messages import Viewpoint
from vrcaps.cockpit.server import SCENE_PATH
from vrcaps.core.geometry import matrix_from_quaternion

if TYPE_CHECKING:
    import viser
    from jaxtyping import Float

_FROM = np.array([0.25, -1.0, 0.45])
"""Direction of the initial viewpoint, from the target: the feet of a supine patient."""
_ROOM = 1.12
"""Distance of the viewpoint, in distances from which the target just fits."""
_FOV = np.deg2rad(45.0)
"""Vertical field of view."""


def scene_clients(server: viser.ViserServer) -> dict[int, Any]:
    """Scenes of the browsers, by the ID in their address."""
    handles, found = server.get_clients(), {}
    for identifier, socket in dict(server._websock_server._live_connections).items():
        match = SCENE_PATH.fullmatch(urlsplit(socket.request.path).path)  # type: ignore[union-attr]
        if match is not None and identifier in handles:
            found[int(match[1])] = handles[identifier]
    return found


def browser_of(server: viser.ViserServer, identifier: int | None) -> int | None:
    """ID of the browser that contains a scene; None if it is unknown."""
    for number, handle in scene_clients(server).items():
        if handle.client_id == identifier:
            return number
    return None


def aim(server: viser.ViserServer, low: np.ndarray, high: np.ndarray) -> None:
    """Aim the initial viewpoint at a box.

    Args:
        server: Server of the scene.
        low: Lower corner of the box in the world [m].
        high: Upper corner [m].
    """
    middle, back = 0.5 * (low + high), _FROM / np.linalg.norm(_FROM)
    camera = server.initial_camera
    camera.fov = _FOV
    camera.position = tuple(middle + _distance(low, high, back, 1.0) * back)
    camera.look_at = tuple(middle)
    server.scene.configure_default_lights(enabled=True, cast_shadow=False)


def frame_box(camera: Any, low: np.ndarray, high: np.ndarray) -> None:
    """Move a browser's viewpoint so that a box fills its scene; the direction stays the same.

    Args:
        camera: Camera of the scene.
        low: Lower corner of the box in the world [m].
        high: Upper corner [m].
    """
    middle = 0.5 * (low + high)
    back = np.asarray(camera.position) - np.asarray(camera.look_at)
    size = np.linalg.norm(back)
    back = back / size if size > 1e-9 else _FROM / np.linalg.norm(_FROM)
    camera.fov = _FOV
    aspect = camera.image_width / max(camera.image_height, 1)
    camera.position = middle + _distance(low, high, back, aspect) * back
    camera.look_at = middle


def _distance(
    low: np.ndarray, high: np.ndarray, back: Float[np.ndarray, " 3"], aspect: float
) -> float:
    """Distance from the center of a box at which all its corners are visible [m].

    Args:
        low: Lower corner of the box [m].
        high: Upper corner [m].
        back: Direction from the box to the viewpoint, of length 1.
        aspect: Width of the picture per height.
    """
    signs = np.stack(np.meshgrid(*3 * [[-0.5, 0.5]]), axis=-1).reshape(-1, 3)
    corners = signs * (high - low)
    right = np.cross([0.0, 0.0, 1.0], back)
    size = np.linalg.norm(right)
    right = right / size if size > 1e-6 else np.array([1.0, 0.0, 0.0])
    up = np.cross(back, right)
    tangent = float(np.tan(0.5 * _FOV))
    across = np.abs(corners @ right) / (tangent * max(aspect, 0.1))
    upwards = np.abs(corners @ up) / tangent
    return float(_ROOM * (corners @ back + np.maximum(across, upwards)).max())


def viewpoint_of(camera: Any, T_world_patient: Float[np.ndarray, "4 4"]) -> Viewpoint | None:
    """Viewpoint of a scene; None before its browser has reported one.

    Args:
        camera: Camera of the scene.
        T_world_patient: Posture of the patient; its x, y and z point left, back and to the head.
    """
    if camera._state.update_timestamp == 0.0:
        return None
    R_world_camera = matrix_from_quaternion(np.array(camera.wxyz, float))
    to_screen = np.diag([1.0, -1.0, -1.0]) @ R_world_camera.T  # right, up, towards the viewer
    distance = float(np.linalg.norm(np.asarray(camera.look_at) - np.asarray(camera.position)))
    height = 2.0 * distance * float(np.tan(0.5 * camera.fov))
    patient = to_screen @ T_world_patient[:3, :3]
    return Viewpoint(to_screen.T.round(4).tolist(), patient.T.round(4).tolist(), height)
