"""Copies by deepcopy and pickle: each goes on to the same bytes as its original."""

import copy
import pickle
from collections.abc import Callable
from typing import Any

import gymnasium
import numpy as np
import pytest

from tests.support.small_envs import GUT, SHORT_GUT, small_settings
from tests.support.tubes import straight_gut, textured
from vrcaps.camera_pipeline.effects import Effects
from vrcaps.camera_pipeline.pipeline import CameraPipeline
from vrcaps.capsule.device_file import read_device
from vrcaps.env.cameras import resized_camera
from vrcaps.env.env import CapsuleEnv
from vrcaps.env.observations import ImageObservation
from vrcaps.env.parallel_env import CapsuleParallelEnv
from vrcaps.env.randomization import Start
from vrcaps.env.settings import EnvSettings
from vrcaps.env.vector_env import CapsuleVectorEnv
from vrcaps.magnet.presets import read_magnet
from vrcaps.magnet.sources import magnet_pose
from vrcaps.motion.motion import Step
from vrcaps.render.renderer import Renderer
from vrcaps.tissue.motility.migrating_complex import Front
from vrcaps.tissue.motility.motility import Motility
from vrcaps.tissue.tissue import Tissue
from vrcaps.world.control import Control
from vrcaps.world.model import Model
from vrcaps.world.world import World

_MODEL = Model(textured(GUT), read_device("mirocam"))
_CAMERA = resized_camera(_MODEL.device.cameras[0], 32, 32)
_NEARBY = magnet_pose(np.array([0.09, 0.0, 0.2]), np.array([0.0, 0.0, 1.0]))

_COPIES: dict[str, Callable[[Any], Any]] = {
    "deepcopy": copy.deepcopy,
    "pickle": lambda thing: pickle.loads(pickle.dumps(thing)),
}


@pytest.fixture(params=_COPIES)
def copied(request: pytest.FixtureRequest) -> Callable[[Any], Any]:
    return _COPIES[request.param]


def _settings() -> EnvSettings:
    return small_settings(
        organs=(textured(GUT), textured(SHORT_GUT)),
        observations=("state", "map", ImageObservation(size=(16, 16))),
        start=Start(settle=0.0),
    )


def _bytes(things: Any) -> list[bytes]:
    if isinstance(things, dict):
        return [part for key, thing in things.items() if key != "failure" for part in _bytes(thing)]
    if isinstance(things, tuple | list):
        return [part for thing in things for part in _bytes(thing)]
    return [np.asarray(things).tobytes()]


def _rollout(env: Any) -> list[bytes]:
    """Two steps, and the reset after them, by the environment's own random numbers."""
    steps = [env.step(0.1 * env.action_space.sample()) for _ in range(2)]
    return _bytes([step[:-1] for step in steps]) + _bytes(env.reset()[0])


@pytest.mark.parametrize("make", [CapsuleEnv, lambda settings: CapsuleVectorEnv(settings, 2)])
def test_an_environment_within_an_episode(copied: Any, make: Callable[[EnvSettings], Any]) -> None:
    env = make(_settings())
    env.reset(seed=1)
    env.action_space.seed(2)
    env.step(0.1 * env.action_space.sample())
    one, two = copied(env), copied(copied(env))
    assert _rollout(one) == _rollout(two) == _rollout(env)


def test_an_environment_before_its_first_reset(copied: Any) -> None:
    env = CapsuleEnv(_settings())
    assert _bytes(copied(env).reset(seed=3)[0]) == _bytes(env.reset(seed=3)[0])


def test_the_original_is_not_changed_by_its_copy(copied: Any) -> None:
    env = CapsuleEnv(_settings())
    env.reset(seed=1)
    before = _bytes(env.episode.observe())
    _rollout(copied(env))
    assert _bytes(env.episode.observe()) == before


def test_an_environment_of_many_agents(copied: Any) -> None:
    env = CapsuleParallelEnv(_settings())
    env.reset(seed=1)
    actions = {agent: np.zeros(env.action_space(agent).shape) for agent in env.agents}
    other = copied(env)
    assert _bytes(other.step(actions)[:4]) == _bytes(env.step(actions)[:4])


def test_a_wrapped_environment(copied: Any) -> None:
    env = gymnasium.make("vrcaps.env:Coverage-v0", organs=(GUT,), num_points=64)
    env.reset(seed=0)
    action = np.zeros(env.action_space.shape or ())
    assert _bytes(copied(env).step(action)[:-1]) == _bytes(env.step(action)[:-1])


def _worlds() -> dict[str, World]:
    """With what a world may hold beside capsule and wall."""
    magnetic = read_device("magnetic")
    sources = (read_magnet("cylinder-50.8", _NEARBY),)
    bowel = Model(straight_gut({"jejunum": 0.2}), magnetic)
    moving = World(bowel, Tissue(motility=Motility(front=0.05)), seed=3)
    asleep = World(bowel, Tissue(motility=None), seed=4)
    asleep.add_muscle(Motility(is_asleep=True))
    asleep.begin_fronts((Front(0.0, 0.05),))
    return {
        "still": World(_MODEL, seed=2),
        "pulled": World(Model(GUT, magnetic), sources=sources),
        "moving": moving,
        "woken": asleep,
    }


@pytest.mark.parametrize("kind", ["still", "pulled", "moving", "woken"])
def test_a_world(copied: Any, kind: str) -> None:
    world = _worlds()[kind]

    def stepped(world: World) -> list[bytes]:
        for _ in range(2):
            world.step(Control(), 5e-3)
        return _bytes(list(vars(world.snapshot()).values()))

    stepped(world)
    other = copied(world)
    assert stepped(other) == stepped(world)


def test_a_model_and_its_renderer(copied: Any) -> None:
    renderer = Renderer(_MODEL)

    def drawn(renderer: Renderer) -> list[bytes]:
        frame = renderer.render(_MODEL.place(0.09), _CAMERA, channels=("rgb", "depth"))
        return _bytes([frame.rgb, frame.depth])

    expected = drawn(renderer)
    assert drawn(copied(renderer)) == expected
    assert drawn(Renderer(copied(_MODEL))) == expected


def test_a_camera_pipeline(copied: Any) -> None:
    effects = Effects(sensor_noise=2, auto_exposure=2)
    pipeline = CameraPipeline(Renderer(_MODEL), _CAMERA, effects, fps=4.0, seed=5)
    steps = [Step(k, _MODEL.place(0.05 + 0.01 * k)) for k in range(4)]

    def captured(pipeline: CameraPipeline) -> list[bytes]:
        return [_bytes(pipeline.capture(step).rgb)[0] for step in steps[2:]]

    for step in steps[:2]:
        pipeline.capture(step)
    other = copied(pipeline)
    assert captured(other) == captured(pipeline)
    assert other.state == pipeline.state


@pytest.mark.slow
@pytest.mark.parametrize("context", ["fork", "forkserver"])
def test_environments_in_processes_of_gymnasium(context: str) -> None:
    settings = small_settings(num_points=64)
    alone = CapsuleEnv(settings)
    expected = [_bytes(alone.reset(seed=k)[0]) for k in (5, 6)]
    envs = gymnasium.vector.AsyncVectorEnv([lambda: CapsuleEnv(settings)] * 2, context=context)
    given = envs.reset(seed=5)[0]
    rows = [_bytes({name: array[k] for name, array in given.items()}) for k in range(2)]
    envs.close()
    assert rows == expected


@pytest.mark.slow
@pytest.mark.parametrize(
    "method", ["fork", pytest.param("forkserver", marks=pytest.mark.validation)]
)
def test_environments_in_processes_of_stable_baselines(method: str) -> None:
    vec_env = pytest.importorskip("stable_baselines3.common.vec_env")
    settings = small_settings(num_points=64)
    alone = CapsuleEnv(settings)
    expected = [_bytes(alone.reset(seed=k)[0]) for k in (5, 6)]
    envs = vec_env.SubprocVecEnv([lambda: CapsuleEnv(settings)] * 2, start_method=method)
    envs.seed(5)
    given = envs.reset()
    rows = [_bytes({name: array[k] for name, array in given.items()}) for k in range(2)]
    envs.close()
    assert rows == expected
