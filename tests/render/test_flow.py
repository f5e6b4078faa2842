"""Flow lands on the same surface point, where the occlusion mask says it can be seen."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from tests.support import twin
from tests.support.shapes import DIRECT, LENSES, looking, make_camera, make_model, pinhole, tube
from vrcaps.camera.camera import Camera, pixel_grid, project_points, unproject_pixels
from vrcaps.core.errors import InputError
from vrcaps.core.geometry import invert, rotate_vectors, transform_points
from vrcaps.render.renderer import Renderer
from vrcaps.world.model import Model, State

CHANNELS = ("flow_forward", "occlusion", "position")


def _wave(vertices: np.ndarray, phase: float) -> np.ndarray:
    """The wall squeezed by a traveling ring, and swaying."""
    squeeze = 1.0 - 0.25 * np.exp(-(((vertices[:, 2] - 0.08 - phase) / 0.02) ** 2))
    moved = vertices * np.stack([squeeze, squeeze, np.ones_like(squeeze)], axis=1)
    return moved + np.array([0.002, -0.001, 0.003]) * np.sin(20.0 * phase)


def _states(moving: bool, organ) -> tuple[State, State]:
    first, second = (
        looking((0.004, -0.003, 0.05)),
        looking((0.003, -0.001, 0.054), (0.25, -0.2, 1.0)),
    )
    if not moving:
        return first, second
    return (
        replace(first, vertices_world=_wave(organ.vertices, 0.0)),
        replace(second, vertices_world=_wave(organ.vertices, 0.004)),
    )


def _landing_error_px(model: Model, camera: Camera, now: State, after: State) -> np.ndarray:
    """Pixels between where flow points to and where it should: NaN where occluded.

    The ray of the target pixel is cast at the next wall; the point of the wall it meets is taken
    back to where that same point is now, and this is seen in the first image.
    """
    renderer, faces = Renderer(model, DIRECT), model.organ.faces
    frame = renderer.render(now, camera, channels=CHANNELS, state_next=after)
    target = pixel_grid(camera.width, camera.height) + frame.flow_forward
    pose = after.T_world_capsule @ camera.T_capsule_camera
    rays = rotate_vectors(pose, unproject_pixels(camera, target)).reshape(-1, 3)
    free = ~frame.occlusion.reshape(-1)
    assert free.mean() > 0.3
    origins = np.broadcast_to(pose[:3, 3], rays.shape)
    vertices_after = model.vertices_world if after.vertices_world is None else after.vertices_world
    vertices_now = model.vertices_world if now.vertices_world is None else now.vertices_world
    _, face, weights = twin.nearest_hits(vertices_after[faces], origins[free], rays[free])
    back = np.einsum("nc,ncx->nx", weights, vertices_now[faces[face]])
    T_camera_world = invert(now.T_world_capsule @ camera.T_capsule_camera)
    landed = project_points(camera, transform_points(T_camera_world, back))
    return np.linalg.norm(
        landed - pixel_grid(camera.width, camera.height).reshape(-1, 2)[free], axis=1
    )


@pytest.mark.slow
@pytest.mark.parametrize("moving", [False, True])
@pytest.mark.parametrize("lens", LENSES)
def test_forward_flow_lands_on_the_same_surface_point(lens: str, moving: bool) -> None:
    organ, camera = tube(24, 31, length=0.15, folds=0.4, capped=True), make_camera(lens)
    model = make_model(organ, camera)
    error = _landing_error_px(model, camera, *_states(moving, organ))
    assert np.isfinite(error).mean() > 0.995  # a point on the image circle's edge may fall out
    # Where a fold hides what lies just behind its rim, the target's ray may meet the rim.
    assert np.mean(error[np.isfinite(error)] < 0.05) > 0.995
    assert np.nanmedian(error) < 1e-3


@pytest.mark.parametrize("lens", LENSES)
def test_backward_flow_is_the_inverse_of_forward_flow(lens: str) -> None:
    """Looked up between pixels where the image of the flow is smooth."""
    from scipy.ndimage import map_coordinates

    organ, camera = tube(160, 100, length=0.2, capped=True), make_camera(lens)
    model, (now, after) = make_model(organ, camera), _states(True, organ)
    renderer = Renderer(model, DIRECT)
    forward = renderer.render(now, camera, channels=CHANNELS, state_next=after)
    backward = renderer.render(after, camera, channels=("flow_backward",), state_previous=now)
    target = pixel_grid(camera.width, camera.height) + forward.flow_forward
    coordinates = np.moveaxis(target[..., ::-1], -1, 0)
    there = np.stack(
        [
            map_coordinates(backward.flow_backward[..., k], coordinates, order=1, cval=np.nan)
            for k in range(2)
        ],
        axis=-1,
    )
    size = np.array([camera.width, camera.height])
    inner = np.all((target > 8) & (target < size - 9), axis=-1)  # clear of a panorama's seam
    error = np.linalg.norm(forward.flow_forward + there, axis=-1)[inner & ~forward.occlusion]
    error = error[np.isfinite(error)]
    assert len(error) > 500
    assert np.median(error) < 0.02
    assert np.mean(error < 0.3) > 0.97


def test_nothing_moves_when_nothing_moves() -> None:
    organ, camera = tube(40, 40, folds=0.3, capped=True), make_camera("scaramuzza")
    model, state = make_model(organ, camera), looking((0.003, 0.0, 0.05))
    names = ("flow_forward", "flow_backward", "occlusion", "depth")
    frame = Renderer(model, DIRECT).render(
        state, camera, channels=names, state_next=state, state_previous=state
    )
    seen = np.isfinite(frame.depth)
    assert np.abs(frame.flow_forward[seen]).max() < 1e-3
    assert np.abs(frame.flow_backward[seen]).max() < 1e-3
    assert not frame.occlusion[seen].any()
    assert frame.occlusion[~seen].all()
    assert np.isnan(frame.flow_forward[~seen]).all()


def test_wall_at_rest_may_be_given_or_left_out() -> None:
    organ, camera = tube(40, 40, folds=0.3, capped=True), make_camera()
    model, (now, after) = make_model(organ, camera), _states(False, organ)
    given = [replace(s, vertices_world=model.vertices_world) for s in (now, after)]
    names = ("flow_forward", "depth", "occlusion")
    one = Renderer(model, DIRECT).render(now, camera, channels=names, state_next=after)
    two = Renderer(model, DIRECT).render(given[0], camera, channels=names, state_next=given[1])
    np.testing.assert_array_equal(one.depth, two.depth)
    np.testing.assert_allclose(one.flow_forward, two.flow_forward, atol=1e-3)
    assert np.mean(one.occlusion == two.occlusion) > 0.999


@pytest.mark.slow
@pytest.mark.parametrize("moving", [False, True])
def test_occlusion_agrees_with_brute_force(moving: bool) -> None:
    organ = tube(24, 31, length=0.15, folds=0.5, capped=True)
    camera = make_camera(pinhole(48))
    model, (now, after) = make_model(organ, camera), _states(moving, organ)
    frame = Renderer(model, DIRECT).render(
        now, camera, channels=(*CHANNELS, "label"), state_next=after
    )
    target = pixel_grid(48, 48) + frame.flow_forward
    in_view = np.all((target >= -0.5) & (target < 47.5), axis=-1).ravel()
    vertices = model.vertices_world if after.vertices_world is None else after.vertices_world
    points = frame.position.reshape(-1, 3).astype(float)
    if moving:  # where those points of the wall are in the next frame
        eye = now.T_world_capsule[:3, 3]
        rays = points - eye
        origins = np.broadcast_to(eye, rays.shape)
        _, face, weights = twin.nearest_hits(now.vertices_world[organ.faces], origins, rays)
        points = np.einsum("nc,ncx->nx", weights, vertices[organ.faces[face]])
    free = twin.is_visible(vertices[organ.faces], after.T_world_capsule[:3, 3], points)
    assert 0.02 < frame.occlusion.mean() < 0.9
    assert np.mean(frame.occlusion.ravel() == ~(in_view & free)) > 0.995


def test_a_wall_that_follows_the_camera_has_no_flow() -> None:
    """The wall's own motion is part of the flow."""
    organ, camera = tube(40, 40, folds=0.3, capped=True), make_camera("equidistant")
    model, shift = make_model(organ, camera), np.array([0.003, 0.001, 0.01])
    now = looking((0.003, 0.0, 0.05), vertices_world=organ.vertices)
    after = looking((0.006, 0.001, 0.06), vertices_world=organ.vertices + shift)
    frame = Renderer(model, DIRECT).render(now, camera, channels=CHANNELS, state_next=after)
    seen = np.isfinite(frame.position[..., 0])
    assert np.abs(frame.flow_forward[seen]).max() < 1e-2


def test_motion_needs_the_neighboring_states() -> None:
    organ, camera = tube(8, 4), make_camera()
    renderer, state = Renderer(make_model(organ, camera), DIRECT), looking((0.0, 0.0, 0.05))
    for name in ("flow_forward", "occlusion"):
        with pytest.raises(InputError, match=f"'{name}' needs the next state. Give state_next"):
            renderer.render(state, camera, channels=(name,))
    with pytest.raises(InputError, match="'flow_backward' needs the previous state"):
        renderer.render(state, camera, channels=("flow_backward",), state_next=state)
