"""Delay, dropout and quantization of actions and images; names of observations."""

from __future__ import annotations

import numpy as np
import pytest

from tests.support.small_envs import small_settings
from vrcaps.core.errors import InputError
from vrcaps.env.actuation import MagnetActuation, Wrench
from vrcaps.env.env import CapsuleEnv
from vrcaps.env.landmarks import LandmarksObservation
from vrcaps.env.observations import ImageObservation, MapObservation, StateObservation
from vrcaps.env.tasks import NavigateTask
from vrcaps.env.transmission import Transmission, _quantized
from vrcaps.env.vector_env import CapsuleVectorEnv

DEPTH = ImageObservation("depth", size=(8, 8))


def env_of(transmission: Transmission, **keywords) -> CapsuleEnv:
    keywords = {"observations": (StateObservation(), DEPTH)} | keywords
    return CapsuleEnv(small_settings(transmission=transmission, control_period=0.02, **keywords))


def run(env: CapsuleEnv, actions: np.ndarray) -> list[dict[str, np.ndarray]]:
    seen = [env.reset(seed=3)[0]]
    return seen + [env.step(action)[0] for action in actions]


def actions_of(count: int) -> np.ndarray:
    actions = np.random.default_rng(0).uniform(-1, 1, (count, 6)).astype(np.float32)
    return actions * [1, 1, 1, 0, 0, 0]


def test_delayed_actions_are_those_of_before():
    actions = actions_of(6)
    late = run(env_of(Transmission(action_delay=2)), actions)
    shifted = run(env_of(Transmission()), np.concatenate([np.zeros((2, 6)), actions[:-2]]))
    for one, other in zip(late, shifted, strict=True):
        assert all(np.array_equal(one[name], other[name]) for name in one)


def test_delayed_images_are_those_of_before_and_states_are_not_delayed():
    actions = actions_of(6)
    late = run(env_of(Transmission(image_delay=2)), actions)
    exact = run(env_of(Transmission()), actions)
    for k, one in enumerate(late):
        assert np.array_equal(one["depth"], exact[max(k - 2, 0)]["depth"])
        assert np.array_equal(one["state"], exact[k]["state"])
    assert not np.array_equal(exact[0]["depth"], exact[1]["depth"])


def test_lost_images_repeat_the_last_at_the_stated_rate():
    actions = actions_of(60)
    exact = run(env_of(Transmission(), max_speed=9.0), actions)
    lossy = run(env_of(Transmission(image_dropout=0.4), max_speed=9.0), actions)
    last, lost = exact[0]["depth"], 0
    for one, other in zip(lossy[1:], exact[1:], strict=True):
        is_lost = np.array_equal(one["depth"], last)
        assert is_lost or np.array_equal(one["depth"], other["depth"])
        last, lost = one["depth"], lost + is_lost
    assert 12 < lost < 36  # 24 ± 3 σ
    again = run(env_of(Transmission(image_dropout=0.4), max_speed=9.0), actions)
    assert all(np.array_equal(a["depth"], b["depth"]) for a, b in zip(lossy, again, strict=True))


def test_a_lost_action_lets_the_last_act_on():
    settings = small_settings(transmission=Transmission(action_dropout=0.5))
    envs = CapsuleVectorEnv(settings, 3)
    envs.reset(seed=0)
    link, active = envs.episode._link, np.array([True, False, True])
    before = np.zeros((3, 6))
    for k in range(40):
        sent = np.full((3, 6), (k + 1) / 50)
        acted = link.send(sent, active)
        assert np.array_equal(acted[1], sent[1])
        for w in (0, 2):
            is_kept = np.allclose(acted[w], before[w])
            assert is_kept or np.allclose(acted[w], sent[w])
        before = acted
    assert before.max() > 0.5


def test_levels_are_even_and_keep_the_limits():
    values = np.linspace(-1.0, 1.0, 1001)
    three = _quantized(values, -1.0, 1.0, 3)
    assert np.unique(three).tolist() == [-1.0, 0.0, 1.0]
    assert np.abs(three - values).max() <= 0.5
    grey = np.arange(256, dtype=np.uint8)
    four = _quantized(grey, 0, 255, 4)
    assert four.dtype == np.uint8
    assert np.unique(four).tolist() == [0, 85, 170, 255]
    assert np.array_equal(_quantized(grey, 0, 255, 256), grey)
    env = env_of(Transmission(image_levels=5))
    assert set(np.unique(env.reset(seed=0)[0]["depth"])) <= {0.0, 0.25, 0.5, 0.75, 1.0}


def test_a_snapshot_holds_what_is_on_its_way():
    env = env_of(Transmission(action_delay=1, image_delay=2, image_dropout=0.3))
    actions = actions_of(8)
    run(env, actions[:4])
    saved = env.snapshot()
    on = [env.step(action)[0] for action in actions[4:]]
    env.restore(saved)
    again = [env.step(action)[0] for action in actions[4:]]
    for one, other in zip(on, again, strict=True):
        assert all(np.array_equal(one[name], other[name]) for name in one)


def test_settings_may_be_tables_and_nothing_else():
    settings = small_settings(transmission={"image_delay": 3})
    assert settings.transmission == Transmission(image_delay=3)
    with pytest.raises(
        InputError, match=r"Unknown key transmission\.delay\. Allowed: action_delay"
    ):
        small_settings(transmission={"delay": 3})
    with pytest.raises(InputError, match=r"transmission is 3\. Allowed: a Transmission"):
        small_settings(transmission=3)


def test_choices_have_no_levels():
    with pytest.raises(InputError, match="action_levels is given, but the actions are choices"):
        env_of(Transmission(action_levels=4), actuation=Wrench(mode="discrete"))
    with pytest.raises(InputError, match=r"image_dropout is 1\.0\. Allowed: 0 to below 1"):
        Transmission(image_dropout=1.0)


@pytest.mark.parametrize("actuation", [Wrench(), MagnetActuation()])
def test_every_value_has_a_name_with_its_unit(actuation):
    observations = (
        StateObservation(),
        LandmarksObservation(),
        MapObservation(egocentric=True),
        ImageObservation("normal", size=(8, 8)),
        DEPTH,
    )
    env = CapsuleEnv(
        small_settings(
            actuation=actuation, observations=observations, task=NavigateTask(), capsule="magnetic"
        )
    )
    names = env.observation_names
    for name, space in env.observation_space.items():
        axis = {"map": 0, "normal": 2, "depth": 2}.get(name, 0)
        assert len(names[name]) == space.shape[axis], name
        assert len(set(names[name])) == len(names[name])
        assert all(text.endswith("]") for text in names[name])
    assert names["state"][:2] == ("position_x [0.1 m]", "position_y [0.1 m]")
    assert names["depth"] == ("depth [m]",)
    assert names["landmarks"][-1] == "to_goal [10 cm]"
    env.reset(seed=0)
    values = dict(zip(names["landmarks"], env.episode.observe()["landmarks"][0], strict=True))
    tangent = [values[f"tangent_{axis} [1]"] for axis in "xyz"]
    assert np.linalg.norm(tangent) == pytest.approx(1.0, abs=1e-5)
