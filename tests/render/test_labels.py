"""Labels are exact: against spheres and cylinders in closed form, and against Embree."""

from __future__ import annotations

import numpy as np
import pytest

from tests.support.oracle_embree import EmbreeCaster
from tests.support.shapes import (
    DIRECT,
    LENSES,
    RADIUS,
    looking,
    make_camera,
    make_model,
    sphere,
    tube,
)
from tests.support.twin import dot, unit
from vrcaps.camera.camera import camera_rays
from vrcaps.capsule.device_file import read_device
from vrcaps.core.geometry import invert, rotate_vectors
from vrcaps.organ.surface import OrganSurface, face_label
from vrcaps.render.renderer import Renderer
from vrcaps.world.model import Model

CHANNELS = (
    "depth", "ray_distance", "normal", "label", "instance", "arc_length", "position",
)  # fmt: skip
EYE = (0.004, -0.006, 0.003)


@pytest.fixture(scope="module")
def fine_sphere() -> OrganSurface:
    """1.3 million triangles: the middle of a triangle is 4e-6 of the radius inside the sphere."""
    return sphere(8)


def _angles_deg(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Angles between unit vectors, exact for small ones too."""
    return np.degrees(2.0 * np.arcsin(np.clip(0.5 * np.linalg.norm(a - b, axis=-1), 0.0, 1.0)))


@pytest.fixture(scope="module")
def sphere_renderer(fine_sphere: OrganSurface) -> Renderer:
    return Renderer(make_model(fine_sphere), DIRECT)


@pytest.mark.slow
@pytest.mark.parametrize("lens", LENSES)
def test_inside_a_sphere(sphere_renderer: Renderer, lens: str) -> None:
    """|o + t d| = r gives t = −o·d + √((o·d)² − o² + r²); the normal is −(o + t d)/r."""
    camera, state = make_camera(lens), looking(EYE)
    rays = camera_rays(camera).astype(float)
    rays_world = rotate_vectors(state.T_world_capsule, rays)
    along = rays_world @ EYE
    distance = -along + np.sqrt(along**2 - dot(np.array(EYE), np.array(EYE)) + RADIUS**2)
    frame = sphere_renderer.render(state, camera, channels=CHANNELS)
    valid = np.isfinite(rays[..., 0])
    np.testing.assert_array_equal(np.isfinite(frame.depth), valid)
    assert np.abs(frame.ray_distance / distance - 1.0)[valid].max() < 1e-5
    ahead = valid & (np.abs(rays[..., 2]) > 0.05)
    assert np.abs(frame.depth / (distance * rays[..., 2]) - 1.0)[ahead].max() < 1e-5
    point = np.array(EYE) + distance[..., None] * rays_world
    assert np.abs(frame.position - point)[valid].max() < 1e-5 * RADIUS
    normal = rotate_vectors(invert(state.T_world_capsule), -point / RADIUS)
    assert _angles_deg(frame.normal, normal)[valid].max() < 0.1
    np.testing.assert_allclose(frame.arc_length[valid], point[valid][:, 2], atol=2e-7)
    clear = valid & (np.abs(point).min(axis=-1) > 0.02 * RADIUS)
    octant = (point > 0.0) @ np.array([1, 2, 4]) + 1
    np.testing.assert_array_equal(frame.label[clear], octant[clear])
    np.testing.assert_array_equal(frame.instance[clear], 700 * (point[clear][:, 0] > 0.0))


@pytest.mark.parametrize("lens", LENSES)
def test_inside_an_open_cylinder(lens: str) -> None:
    """Distance is t = (−o·d + √((o·d)² − d²(o² − r²)))/d² in the cross-section; ends are open."""
    organ, camera, state = (
        tube(1200, 60, length=0.1),
        make_camera(lens),
        looking((0.003, 0.002, 0.04)),
    )
    rays = camera_rays(camera).astype(float)
    rays_world = rotate_vectors(state.T_world_capsule, rays)
    eye = state.T_world_capsule[:3, 3]
    across = rays_world[..., :2]
    square, along = dot(across, across), across @ eye[:2]
    root = np.sqrt(along**2 - square * (eye[:2] @ eye[:2] - RADIUS**2))
    distance = (root - along) / square
    point = eye + distance[..., None] * rays_world
    frame = Renderer(make_model(organ), DIRECT).render(state, camera, channels=CHANNELS)
    inside = (point[..., 2] > 1e-6) & (point[..., 2] < 0.1 - 1e-6)
    beyond = (point[..., 2] < -1e-6) | (point[..., 2] > 0.1 + 1e-6) | np.isnan(rays[..., 0])
    assert inside.mean() > 0.3
    assert beyond.any()
    assert np.isfinite(frame.depth[inside]).all()
    assert np.isnan(frame.depth[beyond]).all()
    assert not frame.label[beyond].any()
    assert np.abs(frame.ray_distance / distance - 1.0)[inside].max() < 1e-5
    off = np.abs(frame.arc_length - point[..., 2])
    assert np.all(off[inside] < 2e-5 * distance[inside])
    normal = -point / RADIUS * [1.0, 1.0, 0.0]
    normal = rotate_vectors(invert(state.T_world_capsule), normal)
    assert _angles_deg(frame.normal, normal)[inside].max() < 0.1


def _check_against_embree(model: Model, eyes: list[tuple], ahead: list[tuple]) -> None:
    """Every label of every camera is that of the triangle which Embree names."""
    organ, renderer = model.organ, Renderer(model, DIRECT)
    caster = EmbreeCaster(model.vertices_world, organ.faces)
    labels, instances = (face_label(x, organ.faces) for x in (organ.label, organ.instance))
    for camera in model.device.cameras:
        for eye, forward in zip(eyes, ahead, strict=True):
            state = looking(eye, forward)
            pose = state.T_world_capsule @ camera.T_capsule_camera
            rays = camera_rays(camera).reshape(-1, 3).astype(float)
            rays_world = rotate_vectors(pose, rays)
            origins = np.broadcast_to(pose[:3, 3], rays.shape)
            distance, face, weights = caster.cast(origins, rays_world)
            frame = renderer.render(state, camera, channels=CHANNELS)
            flat = {name: getattr(frame, name).reshape(len(rays), -1) for name in CHANNELS}
            seen = np.isfinite(flat["depth"][:, 0])
            assert np.mean(seen == (face >= 0)) > 0.9999
            both = seen & (face >= 0)
            depth = distance * rays[:, 2]
            near = np.abs(flat["depth"][both, 0] - depth[both]) < 1e-6
            assert near.mean() > 0.999
            corners = organ.faces[face]
            normals = unit(np.einsum("nc,ncx->nx", weights, organ.normals[corners]))
            normals = rotate_vectors(invert(pose), rotate_vectors(model.T_world_patient, normals))
            front = both & (dot(normals, rays) < 0.0)
            assert np.mean(_angles_deg(flat["normal"], normals)[front] < 0.1) > 0.999
            assert np.mean(flat["label"][both, 0] == labels[face[both]]) > 0.999
            assert np.mean(flat["instance"][both, 0] == instances[face[both]]) > 0.999
            arc = dot(weights, organ.arc_length[corners])
            assert np.mean(np.abs(flat["arc_length"][both, 0] - arc[both]) < 1e-6) > 0.999


@pytest.mark.slow
@pytest.mark.parametrize("device", ["mirocam", "pillcam-colon2", "panoramic"])
def test_folded_tube_against_embree(device: str) -> None:
    organ = tube(120, 300, folds=0.4)
    model = Model(organ, read_device(device))
    eyes = np.array([[0.002, -0.003, 0.06], [-0.004, 0.0, 0.14]])
    ahead = np.array([[0.3, 0.1, 1.0], [-0.2, 0.5, -1.0]])
    to_world = model.T_world_patient[:3, :3]
    _check_against_embree(model, list(eyes @ to_world.T), list(ahead @ to_world.T))


@pytest.mark.parametrize("name", ["colon_GI1_mm", "stomach_A_mm", "stomach_C_mm"])
def test_real_organs_against_embree(shared_data, name: str) -> None:
    """Bare meshes from CT, looked at from the deepest of some random points inside."""
    import trimesh

    from tests.support.shapes import make_organ

    mesh = trimesh.load(shared_data / "organs" / f"{name}.ply", process=False)
    organ = make_organ(np.asarray(mesh.vertices, float) * 1e-3, np.asarray(mesh.faces, np.int64))
    model = Model(organ, read_device("mirocam"))
    rng = np.random.default_rng(3)
    start = model.vertices_world[rng.integers(len(organ.vertices), size=200)]
    places = np.concatenate([start + rng.normal(0.0, 0.008, start.shape) for _ in range(5)])
    depth = model.wall.signed_distance(places)
    best = np.argsort(-depth)[:3]
    assert (depth[best] > 0.003).all()
    _check_against_embree(model, list(places[best]), list(rng.normal(size=(3, 3))))
