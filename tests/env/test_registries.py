"""Parts of an environment that a user registers."""

import copy
import pickle
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any, ClassVar

import gymnasium
import numpy as np
import pytest

from tests.support.small_envs import GUT
from vrcaps.config.convert import from_plain, to_plain
from vrcaps.core.errors import UnknownNameError
from vrcaps.env import (
    ACTUATIONS,
    OBSERVATIONS,
    REWARDS,
    TASKS,
    Actuation,
    CapsuleVectorEnv,
    EnvSettings,
    EnvView,
    Observation,
    Reward,
    Task,
)
from vrcaps.env.settings import env_settings
from vrcaps.training import changed_settings
from vrcaps.world.control import Control


@dataclass(frozen=True)
class Rise(Task):
    """Be above the start."""

    kind: ClassVar[str] = "rise"

    @property
    def rewards(self) -> tuple[Reward, ...]:
        return (Height(2.0),)

    def allocate(self, view: EnvView) -> None:
        view.memory.allocate("rise/start")

    def begin(self, view: EnvView, index: int, rng: np.random.Generator) -> None:
        view.memory["rise/start"][index] = view.T_world_capsule[index, 2, 3]

    def progress(self, view: EnvView) -> np.ndarray:
        return (view.T_world_capsule[:, 2, 3] - view.memory["rise/start"]).clip(0.0, 1.0)


@dataclass(frozen=True)
class Height(Reward):
    """Height above the start."""

    kind: ClassVar[str] = "height"

    def term(self, view: EnvView) -> np.ndarray:
        return view.T_world_capsule[:, 2, 3] - view.memory["rise/start"]


@dataclass(frozen=True)
class Level(Observation):
    """Height of the capsule."""

    scale: float = 1.0

    kind: ClassVar[str] = "level"

    def space(self, view: EnvView) -> Any:
        return gymnasium.spaces.Box(-np.inf, np.inf, (1,), np.float32)

    def observe(self, view: EnvView) -> np.ndarray:
        return (self.scale * view.T_world_capsule[:, 2, 3:4]).astype(np.float32)


@dataclass(frozen=True)
class Lift(Actuation):
    """Vertical force."""

    kind: ClassVar[str] = "lift"

    def space(self) -> Any:
        return gymnasium.spaces.Box(-1.0, 1.0, (1,), np.float32)

    def controls(self, view: EnvView, actions: np.ndarray, indices: np.ndarray) -> list[Control]:
        return [Control((0.0, 0.0, 0.1 * float(actions[k, 0]))) for k in indices]


@pytest.fixture(autouse=True)
def registered() -> Iterator[None]:
    members: tuple[tuple[Any, Any], ...] = (
        (TASKS, Rise),
        (REWARDS, Height),
        (OBSERVATIONS, Level),
        (ACTUATIONS, Lift),
    )
    for registry, cls in members:
        registry.register(cls)
    yield
    for registry, cls in members:
        del registry._added[cls.kind]


NAMES = {"task": "rise", "actuation": "lift", "observations": ("level",), "rewards": ("height",)}


def small_names() -> dict[str, Any]:
    return NAMES | {"organs": (GUT,), "num_points": 64}


def test_registered_parts_work_by_name_in_make() -> None:
    env = gymnasium.make("vrcaps.env:Coverage-v0", **small_names())
    observation, _ = env.reset(seed=0)
    before = float(observation["level"][0])
    for _ in range(3):
        observation, reward, *_, info = env.step(np.ones(1, np.float32))
    rise = float(observation["level"][0]) - before
    assert rise > 0.0
    assert reward == pytest.approx(rise, abs=1e-6) == info["reward_height"]


def test_registered_parts_survive_copies_and_files() -> None:
    envs = CapsuleVectorEnv(env_settings(**small_names()), 2)
    envs.reset(seed=0)
    others = copy.deepcopy(envs), pickle.loads(pickle.dumps(envs))
    actions = np.ones((2, 1), np.float32)
    expected = envs.step(actions)[0]["level"]
    for other in others:
        np.testing.assert_array_equal(other.step(actions)[0]["level"], expected)
    settings = env_settings(**NAMES)
    plain = to_plain(settings, EnvSettings)
    assert plain["observations"] == [{"kind": "level", "scale": 1.0}]
    assert from_plain(EnvSettings, plain, at="env") == settings


def test_registered_parts_are_set_by_name_on_the_command_line() -> None:
    settings = changed_settings(EnvSettings(), (("rewards", ["height", "success"]),))
    settings = changed_settings(settings, (("observations", ["level"]),))
    assert [part.kind for part in (*settings.rewards, *settings.observations)] == [
        "height",
        "success",
        "level",
    ]
    assert changed_settings(settings, (("task", "rise"),)).task == Rise()


def test_messages_list_registered_names() -> None:
    with pytest.raises(UnknownNameError, match=r"Known: .*rise"):
        env_settings(task="fall")


def test_views_are_read_only() -> None:
    envs = CapsuleVectorEnv(env_settings(**small_names()), 1)
    with pytest.raises(ValueError, match="read-only"):
        envs.view.T_world_capsule[:] = 0.0
