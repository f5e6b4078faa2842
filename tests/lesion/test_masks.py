"""Masks of lesions against rays cast by Embree and footprints measured anew."""

from dataclasses import replace

import numpy as np
import pytest

from tests.support.shapes import DIRECT
from vrcaps.capsule.device_file import read_device
from vrcaps.core.geometry import look_along, transform_from
from vrcaps.core.units import MM
from vrcaps.lesion import Bleeding, Colitis, Location, Polyp, add_lesions
from vrcaps.render.renderer import Renderer
from vrcaps.world.model import Model, State

trimesh = pytest.importorskip("trimesh")
pytest.importorskip("embreex")

from tests.support.oracle_footprint import Footprint, Witness  # noqa: E402

PLACE = Location(arc_length=80.0 * MM, theta=0.3)
SOME = [
    Polyp(shape="Ip", location=PLACE),
    Polyp(shape="IIb", location=PLACE),
    Bleeding(severity=2, location=PLACE),
    Colitis(mayo=3, spread=30.0 * MM, location=PLACE),
]
"""All kinds: benchmarks/validation/lesions.py."""


@pytest.mark.slow
@pytest.mark.parametrize("lesion", SOME, ids=lambda x: f"{x.kind} {x.grade}".strip())
def test_mask_is_the_footprint(tube, lesion):
    """Ten views: the mask covers what the outline covers, IoU ≥ 0.98 over all."""
    bare = replace(tube, appearance=None)
    with Witness() as witness:
        patient = add_lesions(bare, [lesion], np.random.default_rng(5))
    organ, footprint = patient.organ, Footprint(bare, patient.clean, witness)
    scene = trimesh.Trimesh(organ.vertices, organ.faces, process=False).ray
    device = read_device("mirocam")
    camera, renderer = device.cameras[0], Renderer(Model(organ, device, np.eye(4)), DIRECT)
    pixels = np.stack(np.meshgrid(np.arange(camera.width), np.arange(camera.height)), axis=-1)
    pixels = pixels[::2, ::2].reshape(-1, 2)
    rays = camera.lens.unproject(pixels.astype(float))
    pixels, rays = pixels[np.isfinite(rays[:, 0])], rays[np.isfinite(rays[:, 0])]
    both = either = 0
    for pose in poses(organ):
        state = State(0.0, pose @ np.linalg.inv(camera.T_capsule_camera))
        image = renderer.render(state, camera, channels=("instance", "label"))
        seen = np.asarray(image.instance)[pixels[:, 1], pixels[:, 0]] == 1
        in_circle = np.asarray(image.label)[pixels[:, 1], pixels[:, 0]] > 0
        expected = in_circle & inside(patient, scene, footprint, pose, rays)
        both, either = both + (seen & expected).sum(), either + (seen | expected).sum()
    assert either > 300
    assert both / either >= 0.98


def poses(organ):
    """Ten cameras between the middle of the lumen and the wall across, looking at the lesion."""
    own = organ.vertices[organ.instance == 1]
    center = np.array(organ.metadata["lesions"][0]["center_m"])
    rng = np.random.default_rng(0)
    for _ in range(10):
        target = own[rng.integers(len(own))]
        eye = np.array([*(-0.45 * center[:2]), center[2] + rng.uniform(-20.0, 20.0) * MM])
        yield transform_from(look_along(target - eye, np.array([0.1, 0.2, 1.0])), eye)


def inside(patient, scene, footprint, pose, rays):
    """Return whether rays first meet the wall inside the footprint, measured on the clean wall."""
    eye = np.broadcast_to(pose[:3, 3], rays.shape)
    face, ray, hit = scene.intersects_id(
        eye, rays @ pose[:3, :3].T, multiple_hits=False, return_locations=True
    )
    corners = patient.organ.faces[face]
    weights = trimesh.triangles.points_to_barycentric(patient.organ.vertices[corners], hit)
    places = np.einsum("nk,nkx->nx", weights, patient.clean.vertices[corners])
    found = np.zeros(len(rays), bool)
    found[ray] = footprint.signed_distance(places) > 0.0
    return found
