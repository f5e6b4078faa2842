"""Files of policies: settings, shapes and numbers are checked when they are read."""

import json

import numpy as np
import pytest

from vrcaps.core.errors import InputError
from vrcaps.core.files import read_arrays, write_arrays
from vrcaps.env.settings import EnvSettings
from vrcaps.policy.mlp_policy import (
    MlpPolicy,
    Normalizer,
    kept_settings,
    read_mlp_policy,
    write_mlp_policy,
)


@pytest.fixture
def path(tmp_path):
    rng = np.random.default_rng(0)
    layers = [(rng.normal(size=(8, 19)), np.zeros(8)), (rng.normal(size=(6, 8)), np.zeros(6))]
    policy = MlpPolicy(layers, Normalizer(np.zeros(19), np.ones(19)), kept_settings(EnvSettings()))
    write_mlp_policy(tmp_path / "policy.npz", policy, {})
    return tmp_path / "policy.npz"


def test_a_whole_policy_is_read(path):
    policy = read_mlp_policy(path)
    assert policy.output({"state": np.zeros((2, 19))}).shape == (2, 6)
    assert policy.requires.observations == ("state",)


@pytest.mark.parametrize(
    ("name", "array", "message"),
    [
        ("layer_0/weight", np.full((8, 19), np.nan), "not finite real numbers"),
        ("layer_1/bias", np.full(6, np.inf), "not finite real numbers"),
        ("layer_0/weight", np.ones((8, 19), complex), "not finite real numbers"),
        ("layer_0/bias", np.array(["x"] * 8), "not finite real numbers"),
        ("layer_0/weight", np.ones((8, 18)), "do not fit each other"),
        ("layer_1/weight", np.ones((6, 9)), "do not fit each other"),
        ("layer_1/bias", np.ones(5), "do not fit each other"),
        ("layer_0/weight", np.ones(8), "do not fit each other"),
        ("normalizer/mean", np.zeros(18), "do not fit each other"),
        ("normalizer/variance", np.full(19, -1.0), "do not fit each other"),
        ("normalizer/limit", np.ones(3), "do not fit each other"),
        ("normalizer/limit", np.array(-1.0), "do not fit each other"),
        ("header", np.array("["), "contains no policy"),
        ("header", np.array("[" * 5000), "contains no policy"),
        ("header", np.array("[]"), "contains no policy"),
    ],
)
def test_wrong_arrays_are_one_line(path, name, array, message):
    write_arrays(path, {**read_arrays(path), name: array})
    with pytest.raises(InputError, match=message):
        read_mlp_policy(path)


@pytest.mark.parametrize(
    ("key", "value", "message"),
    [
        ("num_points", 10**9, r"num_points is 1000000000\. Allowed: 64 to 1048576"),
        ("grid", [10**6, 10**6], r"grid is \(1000000, 1000000\)\. Allowed: 1 to 1024 cells"),
        ("episode_time", 1e30, r"episode_time is 1e\+30"),
        ("observations", None, "observations"),
        ("unknown", 1, "settings are not those of a policy: unknown"),
    ],
)
def test_settings_have_upper_limits(path, key, value, message):
    arrays = read_arrays(path)
    header = json.loads(str(arrays["header"]))
    header["settings"][key] = value
    write_arrays(path, {**arrays, "header": np.array(json.dumps(header))})
    with pytest.raises(InputError, match=message):
        read_mlp_policy(path)


def test_a_policy_without_observations_is_refused(path):
    arrays = read_arrays(path)
    header = json.loads(str(arrays["header"]))
    del header["settings"]["observations"]
    write_arrays(path, {**arrays, "header": np.array(json.dumps(header))})
    with pytest.raises(InputError, match="not those of a policy: observations"):
        read_mlp_policy(path)
