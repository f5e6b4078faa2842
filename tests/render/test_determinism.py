"""The same bytes for every number of threads and every order; odd sizes and the widest lenses."""

from __future__ import annotations

import hashlib

import numpy as np
import pytest

from tests.support import twin_shade
from tests.support.shapes import DIRECT, looking, make_camera, make_model, patterned, sphere, tube
from tests.support.threads import digests_by_threads
from vrcaps.camera.lens import LensEquidistant, LensEquirectangular, LensPinhole
from vrcaps.render.renderer import Renderer
from vrcaps.render.settings import RenderSettings

CHANNELS = (
    "rgb", "radiance", "depth", "ray_distance", "normal", "label", "instance", "albedo",
    "arc_length", "position", "flow_forward", "flow_backward", "occlusion",
)  # fmt: skip


def digest() -> str:
    """Checksum of all channels of two frames in a moving, folded tube, and of indirect light."""
    rng = np.random.default_rng(5)
    look = patterned(rng, relief=3e-4)
    organ = tube(60, 120, folds=0.4, capped=True, appearance=look)
    camera = make_camera("scaramuzza")
    renderer = Renderer(
        make_model(organ, camera), RenderSettings(light="direct", supersampling=2, shadows=True)
    )
    moved = [organ.vertices * scale for scale in (1.0, 1.01, 1.02)]
    states = [
        looking((0.004, -0.003, 0.05 + 0.002 * k), vertices_world=v) for k, v in enumerate(moved)
    ]
    total = hashlib.sha256()
    for _ in range(2):
        frame = renderer.render(
            states[1], camera, channels=CHANNELS, state_next=states[2], state_previous=states[0]
        )
        for name in CHANNELS:
            total.update(getattr(frame, name).tobytes())
    for scattering in (False, True):
        settings = RenderSettings(light="path", spp=5, max_bounces=5, scattering=scattering)
        traced = Renderer(renderer.model, settings)
        total.update(traced.render(states[1], camera, channels=("radiance",)).radiance.tobytes())
    return total.hexdigest()


@pytest.mark.slow
def test_same_bytes_for_any_number_of_threads() -> None:
    counts, digests = digests_by_threads(digest, (1, 3))
    assert counts == [1, 3]
    assert digests == {digest()}


def test_a_frame_does_not_depend_on_what_was_rendered_before() -> None:
    organ = tube(60, 120, folds=0.4, capped=True)
    model, camera = make_model(organ), make_camera("equidistant")
    state = looking((0.004, -0.003, 0.05), vertices_world=organ.vertices * 1.01)
    fresh = Renderer(model, DIRECT).render(state, camera, channels=("depth", "label", "rgb"))
    used = Renderer(model, DIRECT)
    rng = np.random.default_rng(0)
    used.render(looking((0.0, 0.0, 0.1), vertices_world=organ.vertices * 1.1), camera)
    used.render(looking((0.0, 0.0, 0.1), tuple(rng.normal(size=3))), make_camera("pinhole"))
    again = used.render(state, camera, channels=("depth", "label", "rgb"))
    # The hierarchy was first built from another shape: equal but for ties on shared edges.
    assert np.mean(fresh.label == again.label) > 0.999
    np.testing.assert_allclose(fresh.depth, again.depth, rtol=1e-5)


@pytest.mark.parametrize(("width", "height"), [(1, 1), (7, 5), (8, 8), (9, 17), (64, 1), (3, 50)])
def test_any_image_size(width: int, height: int) -> None:
    """Each pixel is the same as in a larger image."""
    organ = tube(40, 60, folds=0.3, capped=True)
    state = looking((0.004, -0.003, 0.05))
    lens = LensPinhole(40.0, 40.0, 0.0, 0.0)  # its center is in every size
    model = make_model(organ)
    whole = Renderer(model, DIRECT).render(state, make_camera((lens, 64, 64)))
    part = Renderer(model, DIRECT).render(state, make_camera((lens, width, height)))
    assert part.depth.shape == (height, width)
    np.testing.assert_allclose(part.depth, whole.depth[:height, :width], rtol=1e-6)
    assert np.mean(part.label == whole.label[:height, :width]) > 0.99
    assert np.mean(np.abs(part.rgb.astype(int) - whole.rgb[:height, :width]) <= 1) > 0.98


@pytest.mark.parametrize(
    "lens",
    [
        (LensEquirectangular(16 / 2 / np.pi, 16 / 2 / np.pi, 7.5, 3.5), 16, 8),
        (LensEquirectangular(4 / 2 / np.pi, 4 / 2 / np.pi, 1.5, 0.5), 4, 2),
        (LensEquidistant(2.5, 3.5, 3.5), 8, 8),
        (LensEquidistant(1.2, 3.5, 3.5), 9, 9),
    ],
)
def test_a_tile_that_sees_all_around(rng: np.random.Generator, lens: tuple) -> None:
    """Neighboring rays more than a right angle apart have no pyramid around them."""
    organ = sphere(2, appearance=patterned(rng))
    camera = make_camera(lens)
    model, state = make_model(organ, camera), looking((0.004, -0.006, 0.003))
    expected = twin_shade.render(model, camera, state)
    frame = Renderer(model, DIRECT).render(state, camera)
    np.testing.assert_allclose(frame.ray_distance, expected["ray_distance"], rtol=1e-5)
    assert np.mean(frame.label == expected["label"]) > 0.98
