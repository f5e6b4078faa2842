"""Images of the capsule's cameras as observations."""

import numpy as np
import pytest

from tests.support.small_envs import GUT, SHORT_GUT, simulation_of, small_settings
from tests.support.tubes import textured
from vrcaps.core.errors import InputError, UnknownNameError
from vrcaps.env.cameras import resized_camera
from vrcaps.env.env import CapsuleEnv
from vrcaps.env.observations import LIMITS, ImageObservation
from vrcaps.env.randomization import Start
from vrcaps.env.vector_env import CapsuleVectorEnv
from vrcaps.render.renderer import Renderer
from vrcaps.render.settings import RenderSettings
from vrcaps.world.model import State

_GUTS = (textured(GUT), textured(SHORT_GUT))
_DIRECT = RenderSettings(light="direct")


def _images(**more):
    size = (24, 32)
    observations = tuple(ImageObservation(channel, size=size) for channel in LIMITS)
    keywords = {"observations": observations, "organs": _GUTS, "start": Start(settle=0.0)}
    return keywords | more


def test_image_is_what_the_renderer_shows_of_the_world():
    simulation = simulation_of(1, **_images())
    camera = resized_camera(simulation.worlds.device.cameras[0], 24, 32)
    assert (camera.height, camera.width) == (24, 32)
    renderer = Renderer(simulation.worlds.patient(0).model, _DIRECT)
    frame = renderer.render(
        State(0.0, simulation.worlds.T_world_capsule[0]), camera, channels=("rgb", "depth", "label")
    )
    told = {o.name: o.observe(simulation.view)[0] for o in simulation.settings.observations}
    depth = np.nan_to_num(frame.depth)
    np.testing.assert_allclose(told["depth"][..., 0], depth, atol=1e-5)
    assert (told["label"][..., 0] == frame.label).mean() > 0.99
    assert np.abs(told["rgb"].astype(int) - frame.rgb).mean() < 1.0
    assert told["rgb"].std() > 5.0


def test_images_fit_their_spaces():
    simulation = simulation_of(2, **_images())
    for observation in simulation.settings.observations:
        space, told = observation.space(simulation.view), observation.observe(simulation.view)
        assert told.dtype == space.dtype and space.contains(told[1]), observation.name
        assert not np.shares_memory(told, observation.observe(simulation.view))


def test_worlds_that_begin_anew_are_seen_at_once_and_the_others_are_not_rendered():
    simulation = simulation_of(2, **_images())
    observation = simulation.settings.observations[0]
    first = observation.observe(simulation.view)
    rendered, views = [], simulation.cameras
    render, views._render = views._render, lambda *of: (rendered.extend(of[0]), render(*of))
    np.testing.assert_array_equal(observation.observe(simulation.view), first)
    assert rendered == []
    simulation.reset(1, np.random.default_rng(7))
    second = observation.observe(simulation.view)
    assert rendered == [1]
    np.testing.assert_array_equal(second[0], first[0])
    assert (second[1] != first[1]).any()
    alone = simulation_of(1, **_images())
    alone.reset(0, np.random.default_rng(7))
    np.testing.assert_array_equal(observation.observe(alone.view)[0], second[1])


def test_capsule_in_a_wall_that_has_moved_is_seen_there():
    env = CapsuleEnv(small_settings(**_images()))
    before, _ = env.reset(seed=3)
    env.step(np.array([0.0, 0.0, -1.0, 0.0, 0.0, 0.0]))
    after, *_ = env.step(np.array([0.0, 0.0, -1.0, 0.0, 0.0, 0.0]))
    assert (after["rgb"] != before["rgb"]).mean() > 0.1


def test_looking_changes_nothing():
    still, color = np.full(6, 0.1), ImageObservation(size=(16, 16))
    states = []
    for observations in (("state",), ("state", color)):
        env = CapsuleEnv(small_settings(**_images(observations=observations)))
        env.reset(seed=3)
        states.append([env.step(still)[0]["state"].tobytes() for _ in range(3)])
    assert states[0] == states[1]


def test_image_to_show_is_of_the_first_camera_in_its_own_size():
    small = {"observations": ("state",), "organs": _GUTS}
    env = CapsuleEnv(small_settings(**small), render_mode="rgb_array")
    with pytest.raises(InputError, match="a reset before the first step"):
        env.render()
    env.reset(seed=0)
    image, camera = env.render(), env.episode.simulation.worlds.device.cameras[0]
    assert image.shape == (camera.height, camera.width, 3) and image.dtype == np.uint8
    assert image.std() > 5.0
    envs = CapsuleVectorEnv(env.settings, 1, render_mode="rgb_array")
    with pytest.raises(InputError, match="a reset before an image"):
        envs.render()
    envs.reset(seed=0)
    np.testing.assert_array_equal(envs.render()[0], image)


def test_resized_camera_keeps_the_middle_and_the_field_of_the_longer_side():
    camera = simulation_of().worlds.device.cameras[0]
    small = resized_camera(camera, 20, 40)
    axis = np.array([0.0, 0.0, 1.0])
    middle = camera.lens.project(axis) - (0.5 * (camera.width - 1), 0.5 * (camera.height - 1))
    np.testing.assert_allclose(
        small.lens.project(axis), (19.5, 9.5) + middle * 40 / camera.width, atol=1e-9
    )


def test_bad_images_say_what_is_allowed():
    with pytest.raises(UnknownNameError, match="No channel to observe named 'heat'"):
        ImageObservation("heat")
    with pytest.raises(InputError, match=r"size is \(4, 64\)\. Allowed: 2 whole numbers"):
        ImageObservation(size=(4, 64))
    with pytest.raises(UnknownNameError, match="No camera named 'side'"):
        CapsuleEnv(small_settings(observations=(ImageObservation(camera="side"),)))
