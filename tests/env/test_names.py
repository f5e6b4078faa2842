"""Names of environments: what the documentation uses, and mistakes that `make` reports."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

gymnasium = pytest.importorskip("gymnasium")

import vrcaps.env  # noqa: E402
from vrcaps.camera_pipeline.effects import parse_effects  # noqa: E402
from vrcaps.core.errors import InputError, UnknownNameError  # noqa: E402
from vrcaps.env import EnvSettings, Randomization  # noqa: E402
from vrcaps.env.settings import env_settings  # noqa: E402
from vrcaps.lesion import Polyp  # noqa: E402
from vrcaps.scenario.scenario import OrganFile, OrganGenerated  # noqa: E402

PAGE = Path(__file__).parents[2] / "docs" / "concepts" / "environments.md"
KINDS = "Observation Actuation Settings Randomization Tissue Drag Polyp VecEnv ParallelEnv Wrench"
PART = re.compile(
    rf"[A-Z][A-Za-z0-9]*(?:{KINDS.replace(' ', '|')})|Randomization|Tissue|Drag|Polyp"
)


def test_the_package_has_the_names_of_its_page() -> None:
    named = {*PART.findall(PAGE.read_text("utf-8"))}
    assert {"MapObservation", "StateObservation", "Randomization", "Tissue", "Polyp"} <= named
    named -= {"SubprocVecEnv"}  # of Stable-Baselines3
    lazy = {*vrcaps.env._OPTIONAL}
    assert lazy <= named
    assert not {name for name in named - lazy if not hasattr(vrcaps.env, name)}
    with pytest.raises(AttributeError, match="has no attribute 'Nothing'"):
        _ = vrcaps.env.Nothing


def test_a_text_names_organs_and_their_seeds() -> None:
    settings = EnvSettings(organs=("stomach:0-1", "colon:4", "small-bowel", "mine.ply:mm"))
    assert settings.organs == (
        OrganGenerated("stomach", seed=0),
        OrganGenerated("stomach", seed=1),
        OrganGenerated("colon", seed=4),
        OrganGenerated("small-bowel"),
        OrganFile("mine.ply", unit="mm"),
    )
    env = gymnasium.make("vrcaps.env:Coverage-v0", organs="stomach:0-1")
    assert len(env.unwrapped.settings.organs) == 2


@pytest.mark.parametrize(
    ("keywords", "error", "message"),
    [
        ({"organs": "stomac"}, UnknownNameError, "No organ named 'stomac'. Known: "),
        ({"organs": ("colon", "stomac:0-3")}, UnknownNameError, "Did you mean 'stomach'"),
        ({"organs": "gone.ply:mm"}, InputError, "Cannot read gone.ply: No such file"),
        ({"organs": "stomach:a"}, InputError, "NAME:SEED, NAME:FIRST-LAST, FILE:UNIT"),
        ({"organs": "stomach:3-1"}, InputError, "ascending seeds, such as stomach:1-3"),
        ({"organs": "stomach:0-100000"}, InputError, "number of seeds is 100001. Allowed: up to"),
        ({"capsule": "magnetik"}, UnknownNameError, "No capsule named 'magnetik'"),
        ({"capsule": "gone.toml"}, InputError, "No capsule file at gone.toml"),
        ({"actuation": "tractor"}, UnknownNameError, "No actuation named 'tractor'"),
        ({"observations": "stat"}, UnknownNameError, "No observation named 'stat'"),
        ({"rewards": ("area",)}, UnknownNameError, "named 'area'"),
        ({"posture": "upside"}, UnknownNameError, "No posture named 'upside'"),
        ({"organ": "stomach"}, UnknownNameError, "No setting named 'organ'"),
    ],
)
@pytest.mark.parametrize("make", [gymnasium.make, gymnasium.make_vec])
def test_a_wrong_name_is_reported_when_the_environment_is_made(
    make, keywords, error, message
) -> None:
    with pytest.raises(error, match=re.escape(message)):
        make("vrcaps.env:Coverage-v0", **keywords)


def test_effects_may_be_given_as_a_text() -> None:
    varied = Randomization(effects="noise=1..3,bloom=2")
    assert varied.effects == parse_effects("noise=1..3,bloom=2")
    assert varied.has_effects
    with pytest.raises(UnknownNameError, match="'nois'"):
        Randomization(effects="nois=1")
    with pytest.raises(InputError, match="hold motion_blur, which needs a recording"):
        Randomization(effects="motion_blur=1")


def test_an_action_beyond_its_limits_is_explained() -> None:
    env = gymnasium.make("vrcaps.env:Coverage-v0", organs="stomach", disable_env_checker=True)
    episode = env.unwrapped.episode
    with pytest.raises(InputError, match=r"An action is a share, -1 to 1, of the largest force"):
        episode.check_actions([[2.0] * 6])
    discrete = gymnasium.make(
        "vrcaps.env:Coverage-v0", actuation=vrcaps.env.Wrench("discrete"), disable_env_checker=True
    )
    with pytest.raises(InputError, match="An action is the number of a choice"):
        discrete.unwrapped.episode.check_actions([9])


def test_a_text_names_lesions() -> None:
    one = env_settings(lesions="polyp-Ip:size=12mm")
    assert one.lesions == (Polyp(shape="Ip", size=0.012),)
    assert env_settings(lesions=("polyp-Ip:size=12mm",)) == one
    with pytest.raises(UnknownNameError, match=r"'polp'.*Did you mean 'polyp"):
        env_settings(lesions=("polp",))


def test_each_value_of_an_action_has_a_name_with_its_unit() -> None:
    parts = {"wrench": "torque_z [0.0001 N·m]", "magnet": "angular_velocity_z [1 rad/s]"}
    parts |= {"arm": "joint_7_velocity [0.261 rad/s]", "coils": "coil_9_current [60 A]"}
    for kind, last in parts.items():
        actuation = env_settings(actuation=kind).actuation
        assert actuation.names[-1] == last
        assert len(actuation.names) == actuation.space().shape[0]
    discrete = env_settings(actuation={"kind": "wrench", "mode": "discrete"}).actuation
    assert discrete.names == ("choice [0.02 N]",)
