"""Snapshots: from one, the same actions lead to the same bytes."""

from dataclasses import replace

import numpy as np
import pytest

from tests.support.small_envs import GUT, SHORT_GUT, small_settings
from tests.support.tubes import textured
from vrcaps.core.errors import InputError
from vrcaps.env.actuation import Wrench
from vrcaps.env.env import CapsuleEnv
from vrcaps.env.observations import ImageObservation
from vrcaps.env.randomization import Start
from vrcaps.env.rewards import AreaGain, ProgressGain, TotalVariation
from vrcaps.env.settings import EnvSettings
from vrcaps.env.simulation import read_env_snapshot, write_env_snapshot
from vrcaps.env.vector_env import CapsuleVectorEnv

_GENTLE = Wrench(force=2e-3, torque=0.0)
"""With more, the capsule tumbles, which takes the physics long."""


def _settings(**more) -> EnvSettings:
    rewards = (AreaGain(), TotalVariation(), ProgressGain())
    observations = ("state", "landmarks", "map", ImageObservation(size=(16, 16)))
    own = {"observations": observations, "rewards": rewards, "start": Start(settle=0.0)}
    own["actuation"] = _GENTLE
    return small_settings(organs=(textured(GUT), textured(SHORT_GUT)), **(own | more))


def _went_on(env, steps=2, seed=4):
    """All that an environment gives in some steps, as bytes."""
    draw, given = np.random.default_rng(seed), []
    for _ in range(steps):
        observation, *rest = env.step(draw.uniform(-1.0, 1.0, env.action_space.shape))
        info = rest.pop()
        given += [array.tobytes() for array in observation.values()]
        given += [np.asarray(x).tobytes() for x in rest]
        given += [np.asarray(x).tobytes() for k, x in info.items() if "failure" not in k]
    return given


@pytest.mark.parametrize(
    ("actuation", "dynamics"),
    [(_GENTLE, "physics"), (_GENTLE, "quasi-static"), ("magnet", "quasi-static")],
    ids=["wrench-physics", "wrench", "magnet"],
)
def test_environment_goes_on_to_the_same_bytes_from_a_snapshot(tmp_path, actuation, dynamics):
    settings = _settings(actuation=actuation, dynamics=dynamics)
    env = CapsuleEnv(settings)
    env.reset(seed=1)
    _went_on(env, 1)
    snapshot = env.snapshot()
    write_env_snapshot(tmp_path / "begun.npz", snapshot)
    seen = env.episode.observe()
    expected = _went_on(env)
    for seed in range(2, 9):  # until another patient came
        env.reset(seed=seed)
    restored = env.restore(snapshot)
    for name, array in seen.items():
        np.testing.assert_array_equal(restored[name], array[0])
    assert _went_on(env) == expected
    other = CapsuleEnv(settings)
    other.restore(read_env_snapshot(tmp_path / "begun.npz"))
    assert _went_on(other) == expected
    # The generator, too: both draw the same next patient and start.
    one, two = (e.reset()[0]["state"].tobytes() for e in (env, other))
    assert one == two


def test_one_world_of_many_is_put_back_and_the_others_go_on():
    settings = _settings(observations=("state", "map"))
    envs = CapsuleVectorEnv(settings, 3)
    envs.reset(seed=0)
    _went_on(envs, 1)
    whole, one = envs.snapshot(), envs.snapshot(1)
    expected = _went_on(envs)
    envs.reset(seed=50)
    envs.restore(whole)
    assert _went_on(envs) == expected
    fresh = CapsuleVectorEnv(settings, 3)
    fresh.restore(whole)
    assert _went_on(fresh) == expected
    before = envs.episode.observe()["state"]
    after = envs.restore(one, 1)["state"]
    np.testing.assert_array_equal(after[[0, 2]], before[[0, 2]])
    assert (after[1] != before[1]).any()
    alone = CapsuleEnv(settings)
    np.testing.assert_array_equal(alone.restore(one)["state"], after[1])


def test_bad_snapshots_say_so(tmp_path):
    settings = _settings(observations=("state",))
    env = CapsuleEnv(settings)
    with pytest.raises(InputError, match=r"The world is none\. Allowed: a reset"):
        env.snapshot()
    env.reset(seed=0)
    snapshot = env.snapshot()
    with pytest.raises(InputError, match="with other settings"):
        CapsuleEnv(replace(settings, episode_time=9.0)).restore(snapshot)
    with pytest.raises(InputError, match=r"version is 0\.0\. Allowed: "):
        env.restore(replace(snapshot, version="0.0"))
    envs = CapsuleVectorEnv(settings, 2)
    with pytest.raises(InputError, match=r"number of worlds is 1\. Allowed: 2"):
        envs.restore(snapshot)
    with pytest.raises(InputError, match=r"restore is one\. Allowed: all before"):
        envs.restore(snapshot, 0)
    with pytest.raises(InputError, match=r"a reset before a snapshot"):
        envs.snapshot()
    envs.reset(seed=0)
    with pytest.raises(InputError, match=r"index is 2\. Allowed: 0 to 1"):
        envs.snapshot(2)
    torn = {name: a for name, a in snapshot.worlds[0].memory.items() if name != "time"}
    with pytest.raises(InputError, match="The snapshot is of another environment"):
        env.restore(replace(snapshot, worlds=(replace(snapshot.worlds[0], memory=torn),)))
    (tmp_path / "text.npz").write_text("no archive")
    with pytest.raises(InputError, match="Cannot read the snapshot of an environment"):
        read_env_snapshot(tmp_path / "text.npz")
