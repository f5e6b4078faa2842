"""The state by true values and by sensors."""

import numpy as np
import pytest

from tests.support.small_envs import GUT, small_env, small_settings
from vrcaps.core.errors import InputError, UnknownNameError
from vrcaps.env.env import CapsuleEnv
from vrcaps.env.observations import StateObservation
from vrcaps.env.vector_env import CapsuleVectorEnv
from vrcaps.sensors.tracking import CapsuleTracker, TrackingSensors
from vrcaps.world.model import Model

_LOCATED = (StateObservation(pose="located"),)


def test_located_pose_is_off_by_what_sensors_do_not_know_and_gets_nearer():
    env = small_env(seed=3, observations=_LOCATED, actuation="magnet")
    s = env.episode.simulation
    errors = []
    for _ in range(4):
        observation, *_ = env.step(np.zeros(6))
        told = observation["state"][:3] * 0.1 + s.memory["state/center"][0]
        errors.append(np.linalg.norm(told - s.worlds.T_world_capsule[0, :3, 3]))
    assert 0.0 < errors[-1] < 3e-3 < errors[0] + 3e-3
    assert observation["state"][3:6] @ s.worlds.T_world_capsule[0, :3, 0] > 0.95
    assert observation["state"].shape == env.observation_space["state"].shape


def test_located_worlds_side_by_side_and_from_a_snapshot_are_those_alone():
    settings = small_settings(observations=_LOCATED, actuation="magnet")
    envs, env = CapsuleVectorEnv(settings, 2), CapsuleEnv(settings)
    first, _ = envs.reset(seed=0)
    alone, _ = env.reset(seed=1)
    np.testing.assert_array_equal(first["state"][1], alone["state"])
    still = np.zeros((2, 6))
    envs.step(still)
    snapshot = envs.snapshot(1)
    after = envs.step(still)[0]["state"][1]
    env.step(still[0])
    np.testing.assert_array_equal(env.step(still[0])[0]["state"], after)
    other = CapsuleEnv(settings)
    other.restore(snapshot)
    np.testing.assert_array_equal(other.step(still[0])[0]["state"], after)


def test_size_of_a_trackers_state_is_as_stated():
    device = small_env().episode.simulation.worlds.device
    T = np.eye(4)
    tracker = CapsuleTracker(Model(GUT, device), TrackingSensors(), T, period=0.1, seed=0)
    assert len(tracker.to_array()) == CapsuleTracker.size


def test_bad_poses_say_what_is_allowed():
    with pytest.raises(UnknownNameError, match="No pose named 'guessed'"):
        StateObservation(pose="guessed")  # type: ignore[arg-type]
    with pytest.raises(InputError, match="by one magnet in the capsule; mirocam has 0"):
        CapsuleEnv(small_settings(observations=_LOCATED, capsule="mirocam"))
