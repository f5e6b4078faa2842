"""Images in batches and the same one by one; bundles of rays, packets and single rays."""

import hashlib

import numpy as np
import pytest

from tests.support.shapes import DIRECT, looking, make_camera, make_model, patterned, pinhole, tube
from tests.support.threads import digests_by_threads
from vrcaps import _core
from vrcaps.camera.camera import Led, camera_rays
from vrcaps.core.errors import InputError, UnknownNameError
from vrcaps.core.geometry import wall_of
from vrcaps.render.batch import BATCH_CHANNELS, render_batch
from vrcaps.render.renderer import Renderer
from vrcaps.render.settings import RenderSettings

LEDS = tuple(Led((0.003 * np.cos(a), 0.003 * np.sin(a), 0.0)) for a in range(6))
CAMERA = make_camera(pinhole(20), leds=LEDS)
LIT = RenderSettings(light="direct")
PLACES = ((0.004, -0.003, 0.05), (-0.005, 0.002, 0.06), (0.0, 0.004, 0.03))
STATES = [looking(place) for place in PLACES]


def _renderer(folds: float = 0.4, settings: RenderSettings = LIT) -> Renderer:
    look = patterned(np.random.default_rng(5), relief=3e-4)
    organ = tube(40, 60, folds=folds, capped=True, appearance=look)
    return Renderer(make_model(organ, CAMERA), settings)


def _poses() -> np.ndarray:
    return np.array([state.T_world_capsule @ CAMERA.T_capsule_camera for state in STATES])


def digest() -> str:
    """Checksum of a batch."""
    images = render_batch([_renderer()], _poses(), CAMERA, BATCH_CHANNELS)
    return hashlib.sha256(b"".join(image.tobytes() for image in images.values())).hexdigest()


def test_a_batch_has_the_bytes_of_single_images():
    renderers = [_renderer(0.4), _renderer(0.2), _renderer(0.0)]
    images = render_batch(renderers, _poses(), CAMERA, BATCH_CHANNELS)
    for number, (renderer, state) in enumerate(zip(renderers, STATES, strict=True)):
        frame = renderer.render(state, CAMERA, channels=BATCH_CHANNELS)
        for name in BATCH_CHANNELS:
            assert images[name][number].tobytes() == getattr(frame, name).tobytes(), name


def test_arrays_are_overwritten_and_may_be_none():
    renderer, out = _renderer(), {"depth": np.zeros((3, 20, 20), np.float32)}
    images = render_batch([renderer], _poses(), CAMERA, ("depth",), out=out)
    assert images["depth"] is out["depth"] and (out["depth"] > 0.0).all()
    assert render_batch([renderer], np.zeros((0, 4, 4)), CAMERA)["rgb"].shape == (0, 20, 20, 3)


def test_a_wall_that_followed_its_world_has_its_normals():
    renderer = _renderer()
    organ, vertices = renderer.model.organ, renderer.model.organ.vertices * (1.1, 1.1, 1.0)
    images = render_batch([renderer], _poses(), CAMERA, walls=[wall_of(vertices, organ.faces)])
    for number, place in enumerate(PLACES):
        state = looking(place, vertices_world=vertices)
        frame = renderer.render(state, CAMERA, channels=("rgb", "depth"))
        np.testing.assert_allclose(images["depth"][number], frame.depth, rtol=1e-4, atol=1e-5)
        assert np.abs(images["rgb"][number].astype(int) - frame.rgb).mean() < 0.5


@pytest.mark.slow
def test_same_bytes_for_any_number_of_threads():
    counts, digests = digests_by_threads(digest, (1, 2))
    assert counts == [1, 2]
    assert digests == {digest()}


def test_rays_in_bundles_meet_what_single_rays_meet():
    renderer = _renderer(settings=DIRECT)
    images = render_batch([renderer], _poses(), CAMERA, ("face", "ray_distance"))
    directions = camera_rays(CAMERA).reshape(-1, 3).astype(float)
    for number, pose in enumerate(_poses()):
        origins = np.tile(pose[:3, 3], (len(directions), 1))
        distance, face = renderer.model.wall.cast(origins, directions @ pose[:3, :3].T)
        np.testing.assert_allclose(images["ray_distance"][number].ravel(), distance, rtol=1e-5)
        assert (images["face"][number].ravel() == face).mean() > 0.99


def test_shadows_in_bundles_are_those_of_packets():
    """A narrow camera traces packets; its pixels are among those of a wide one, traced in bundles.

    The images are of the same field; each pixel of the small one is the middle of 9 by 9.
    """
    plain = Renderer(make_model(tube(40, 60, folds=0.4, capped=True), CAMERA), LIT)
    fine = make_camera(pinhole(180), leds=LEDS)
    wide = render_batch([plain], _poses(), CAMERA, ("radiance",))["radiance"]
    narrow = render_batch([plain], _poses(), fine, ("radiance",))["radiance"]
    middle = narrow[:, 4::9, 4::9]
    assert wide.shape == middle.shape
    close = np.isclose(wide, middle, rtol=1e-3, atol=1e-6).all(axis=-1)
    assert close.mean() > 0.995


def test_bad_batches_are_one_clear_line():
    renderer, poses = _renderer(), _poses()
    with pytest.raises(UnknownNameError, match="channel of a batch"):
        render_batch([renderer], poses, CAMERA, ("flow_forward",))
    with pytest.raises(InputError, match="renderers is empty"):
        render_batch([], poses, CAMERA)
    with pytest.raises(InputError, match="light is 'radiosity'"):
        render_batch([_renderer(settings=RenderSettings())], poses, CAMERA)
    with pytest.raises(InputError, match="different settings"):
        render_batch([renderer, _renderer(settings=DIRECT), renderer], poses, CAMERA)
    with pytest.raises(InputError, match="need 1 or 3 walls and scenes"):
        render_batch([renderer] * 2, poses, CAMERA)
    with pytest.raises(InputError, match="finite 4 x 4"):
        render_batch([renderer], poses * np.nan, CAMERA)
    with pytest.raises(InputError, match=r"Allowed: \(n, 4, 4\)"):
        render_batch([renderer], poses[0], CAMERA)
    with pytest.raises(InputError, match=r"Array of rgb is float64 \(3, 20, 20\)"):
        render_batch([renderer], poses, CAMERA, out={"rgb": np.zeros((3, 20, 20))})
    with pytest.raises(ValueError, match="radiance_planar is not available for several"):
        rays, planes = renderer._table(CAMERA, 1), np.zeros((3, 20, 20), np.float32)
        _core.render_batch(
            [renderer.model.wall],
            [renderer._scene],
            rays,
            poses[:1],
            np.zeros((0, 11)),
            {"radiance_planar": planes},
            exposure=1.0,
            shadows=False,
        )
