"""Episodes of a policy as a Minari data set, read and checked by Minari."""

from __future__ import annotations

import numpy as np
import pytest

from tests.support.small_envs import short_settings
from vrcaps.core.errors import InputError
from vrcaps.env.env import CapsuleEnv
from vrcaps.policy.catalog import read_policy
from vrcaps.policy.evaluate import _episode, record_minari

minari = pytest.importorskip("minari")


@pytest.fixture(autouse=True)
def folder(tmp_path, monkeypatch):
    monkeypatch.setenv("MINARI_DATASETS_PATH", str(tmp_path))
    return tmp_path


@pytest.mark.slow  # of the import of Minari's readers
def test_minari_reads_the_episodes_that_the_environment_gave():
    settings = short_settings()
    record_minari(read_policy("random"), settings, "vrcaps/tube-v0", episodes=2, seed=5)
    data = minari.load_dataset("vrcaps/tube-v0")
    assert data.total_episodes == 2
    assert data.total_steps == 8
    about = data.storage.metadata
    assert about["observation_names"]["state"][0] == "position_x [0.1 m]"
    assert about["action_names"][0] == "force_x [0.02 N]"
    episode = data[1]
    env = CapsuleEnv(settings)
    observation, _ = env.reset(seed=6)
    for k, action in enumerate(episode.actions):
        assert data.action_space.contains(action)
        stored = {name: values[k] for name, values in episode.observations.items()}
        assert data.observation_space.contains(stored)
        np.testing.assert_allclose(stored["state"], observation["state"], atol=1e-6)
        observation, reward, *_ = env.step(action)
        assert episode.rewards[k] == pytest.approx(reward, abs=1e-6)
    assert episode.truncations.tolist() == [False, False, False, True]
    assert not episode.terminations.any()


def test_what_cannot_be_stored_is_one_line():
    policy, settings = read_policy("random"), short_settings()
    with pytest.raises(InputError, match=r"dataset_id is '\.\./a'\. Allowed: letters"):
        record_minari(policy, settings, "../a")
    with pytest.raises(InputError, match=r"episodes is 0\. Allowed: 1 to"):
        record_minari(policy, settings, "a-v0", episodes=0)
    record_minari(policy, settings, "a-v0", episodes=1)
    with pytest.raises(InputError, match="data set a-v0 exists already"):
        record_minari(policy, settings, "a-v0", episodes=1)
    with pytest.raises(InputError, match=r"a-v0/b-v0 lies in the data set a-v0\. Give another"):
        record_minari(policy, settings, "a-v0/b-v0", episodes=1)
    with pytest.raises(InputError, match=r"episodes is 1\.5\. Allowed: 1 to"):
        record_minari(policy, settings, "b-v0", episodes=1.5)  # type: ignore[arg-type]
    with pytest.raises(InputError, match=r"seed is -1\. Allowed: a whole number"):
        record_minari(policy, settings, "b-v0", seed=-1)


@pytest.mark.parametrize("given", ["a/b-v0", "data/b-v0", "x" * 180 + "-v0", "b-v" + "1" * 99, 5])
def test_names_that_minari_cannot_list_are_refused_before_the_first_episode(folder, given):
    """They would end in a data set at which `minari.list_local_datasets` stops."""
    with pytest.raises(InputError, match=r"dataset_id is .*Allowed: letters"):
        record_minari(read_policy("random"), short_settings(), given)
    assert not list(folder.iterdir())


def test_an_episode_that_fails_leaves_no_data_set(folder, monkeypatch):
    run, numbers = _episode, []

    def fails(policy, env, seed):
        numbers.append(seed)
        if len(numbers) == 2:
            raise KeyboardInterrupt
        return run(policy, env, seed)

    monkeypatch.setitem(record_minari.__globals__, "_episode", fails)
    with pytest.raises(KeyboardInterrupt):
        record_minari(read_policy("random"), short_settings(), "vrcaps/b-v0", episodes=2)
    assert minari.list_local_datasets() == {}
    monkeypatch.undo()
    monkeypatch.setenv("MINARI_DATASETS_PATH", str(folder))
    record_minari(read_policy("random"), short_settings(), "vrcaps/b-v0", episodes=1)
    assert list(minari.list_local_datasets()) == ["vrcaps/b-v0"]


def test_a_folder_that_cannot_be_written_is_found_before_the_first_episode(folder, monkeypatch):
    (folder / "file").write_text("")
    monkeypatch.setenv("MINARI_DATASETS_PATH", str(folder / "file"))
    with pytest.raises(InputError, match=r"Cannot write Minari's folder: .*MINARI_DATASETS_PATH"):
        record_minari(read_policy("random"), short_settings(), "b-v0", episodes=1)
