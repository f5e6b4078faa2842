import runpy
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from vrcaps.camera_pipeline.effect.base import MAX_SEVERITY
from vrcaps.camera_pipeline.effect.exposure import AdaptiveFrameRate, AutoExposure
from vrcaps.camera_pipeline.effect.optics import DepthOfField
from vrcaps.camera_pipeline.effect.sensor import BayerFilter
from vrcaps.camera_pipeline.effects import EFFECTS, SEVERITIES, Effects, parse_effects
from vrcaps.capsule.device_file import read_device
from vrcaps.config.convert import from_plain, to_plain
from vrcaps.core.errors import InputError, UnknownNameError
from vrcaps.lumen.contents import Contents


def test_effects_as_a_user_writes_them() -> None:
    assert parse_effects("specular=3, dof=1") == Effects(specular=3, depth_of_field=1)
    assert parse_effects("motion-blur=2,bayer=grbg") == Effects(
        motion_blur=2, bayer_filter=BayerFilter("grbg")
    )
    assert parse_effects("noise=1..3") == Effects(sensor_noise=(1, 3))
    assert parse_effects("jpeg=3,random,noise=0") == Effects(sensor_noise=0, random=True)
    assert parse_effects("random,none") == Effects.none()
    assert parse_effects("all=2").bloom == 2
    assert parse_effects("afr=2..6").adaptive_frame_rate == AdaptiveFrameRate(2.0, 6.0)
    assert parse_effects("ae=settled").auto_exposure == AutoExposure(0.0)


def test_an_effect_that_is_not_given_is_the_capsules_own() -> None:
    """PillCam COLON 2 adapts from 4 to 35 frames per second; the catalog exposes automatically."""
    device = read_device("pillcam-colon2")
    own = Effects().of_device(device)
    assert own.auto_exposure == AutoExposure(0.0, tolerance=0.3)
    assert own.adaptive_frame_rate == AdaptiveFrameRate(4.0, 35.0)
    assert own.of_device(device) == own
    assert own.without_device(device) == Effects()
    assert replace(own, jpeg=2).without_device(device) == Effects(jpeg=2)
    assert own.specular is None and own.dome_bubbles is None
    assert {own.motion_blur, own.droplets} == {0}
    given = parse_effects("ae=2,afr=0,bayer=0,noise=1").of_device(device)
    assert (given.auto_exposure, given.adaptive_frame_rate, given.bayer_filter) == (2, 0, 0)
    assert given.sensor_noise == 1
    assert given.resolve("adaptive_frame_rate") is None
    assert Effects().of_device(read_device("mirocam")).adaptive_frame_rate == 0
    fixed = replace(device, auto_exposure=False, lowest_frame_rate=None, image_chain=None)
    assert Effects().of_device(fixed) == parse_effects("none").of_device(fixed)
    assert parse_effects("none").of_device(device).is_ideal


@pytest.mark.parametrize(
    ("text", "error", "match"),
    [
        ("doff=1", UnknownNameError, "No effect named 'doff'. Known: .*depth_of_field"),
        ("", UnknownNameError, "No effect named ''"),
        ("dof=5", InputError, "depth_of_field has the severity 5. Allowed: 0 to 4"),
        ("dof=3..1", InputError, r"has the severity 3\.\.1\."),
        ("dof=much", InputError, "has the severity 'much'. Allowed: depth_of_field=0"),
        ("dof", InputError, "has the severity ''"),
        ("random=2", InputError, "random has the value '2'. Allowed: random alone"),
        ("default=", InputError, "default has the value ''. Allowed: default alone"),
        ("all=7", InputError, "Effect all has the severity 7. Allowed: 0 to 4, or an ascending"),
        ("all=3..1", InputError, r"Effect all has the severity 3\.\.1\."),
        ("jpeg=" + "9" * 5000, InputError, "Effect jpeg has the severity '9"),
        ("jpeg=\u0663", InputError, "Effect jpeg has the severity"),
        ("afr=6..2", InputError, "min_fps, max_fps is"),
        ("afr=often", InputError, "is 'often'. Allowed: adaptive_frame_rate=MIN..MAX"),
        ("bayer=rgb", UnknownNameError, "No pattern named 'rgb'. Known: bggr"),
    ],
)
def test_what_a_user_cannot_write(text: str, error: type[Exception], match: str) -> None:
    with pytest.raises(error, match=match):
        parse_effects(text)


@pytest.mark.parametrize(
    ("given", "match"),
    [
        ({"random": "false"}, "random is 'false'. Allowed: True or False"),
        ({"random": 1}, "random is 1. Allowed: True or False"),
        ({"nominal": "yes"}, "nominal is 'yes'. Allowed: True or False"),
        ({"jpeg": True}, "Effect jpeg has the severity True. Allowed: 0 to 4"),
        ({"jpeg": False}, "Effect jpeg has the severity False. Allowed: 0 to 4"),
        ({"jpeg": np.array([1, 2])}, r"Effect jpeg has the severity \[1 2\]. Allowed: 0 to 4"),
    ],
)
def test_values_of_a_wrong_type(given: dict, match: str) -> None:
    with pytest.raises(InputError, match=match):
        Effects(**given)


def test_every_severity_is_declared_and_differs() -> None:
    assert set(SEVERITIES) < set(Effects.__dataclass_fields__)
    for name, figures in SEVERITIES.items():
        assert len(figures) == MAX_SEVERITY + 1
        assert len(set(map(str, figures))) == MAX_SEVERITY + 1, name
    for severity in range(MAX_SEVERITY + 1):
        effects = Effects(**dict.fromkeys(SEVERITIES, severity))
        plain = to_plain(effects, Effects)
        assert from_plain(Effects, plain, at="effects") == effects
        device = effects.device(read_device("mirocam"))
        assert device.cameras[0].width == round(320 * (1, 0.75, 0.5, 0.375, 0.25)[severity])


def test_sampled_severities_are_fair_and_independent() -> None:
    ranges = Effects(sensor_noise=(1, 3), jpeg=(0, 4), dome_bubbles=(0, 4))
    sampled = [ranges.sample(seed) for seed in range(600)]
    assert sampled[5] == ranges.sample(5)
    counts = np.bincount([effects.sensor_noise for effects in sampled], minlength=5)
    assert counts[[0, 4]].sum() == 0
    assert (np.abs(counts[1:4] - 200) < 60).all()
    alone = Effects(sensor_noise=(1, 3))
    assert all(alone.sample(seed).sensor_noise == sampled[seed].sensor_noise for seed in range(50))
    pair = np.array([(effects.sensor_noise, effects.jpeg) for effects in sampled])
    assert abs(np.corrcoef(pair.T)[0, 1]) < 0.15


def test_random_effects_are_few_and_moderate() -> None:
    random = Effects(jpeg=0, random=True)
    sampled = [random.sample(seed) for seed in range(200)]
    assert sampled[5] == random.sample(5)
    drawn = [{n: v for n in SEVERITIES if (v := getattr(one, n))} for one in sampled]
    assert {len(one) for one in drawn} == {3, 4, 5}
    assert {severity for one in drawn for severity in one.values()} == {1, 2}
    assert {name for one in drawn for name in one} == set(SEVERITIES) - {"jpeg"}
    assert not any(one.random for one in sampled)
    with pytest.raises(InputError, match=r"Effects are random. Call sample\(seed\) first"):
        random.resolve("jpeg")
    assert Effects(**dict.fromkeys(SEVERITIES, 0), random=True).sample(0).is_ideal


def test_exact_parameters_take_the_place_of_a_severity() -> None:
    effects = Effects(depth_of_field=DepthOfField(0.4e-3, 0.02))
    assert effects.resolve("depth_of_field") == DepthOfField(0.4e-3, 0.02)
    assert not effects.is_ideal
    assert Effects(specular=2, resolution=3, dome_bubbles=1, distortion=1, field_of_view=4).is_ideal
    plain = to_plain(effects, Effects)
    assert from_plain(Effects, plain, at="effects") == effects
    with pytest.raises(InputError, match=r"Call sample\(seed\) first"):
        Effects(sensor_noise=(0, 2)).resolve("sensor_noise")


def test_bubbles_sit_on_the_capsule_beside_those_of_the_contents() -> None:
    assert Effects().contents(Contents(2)) == Contents(2)
    only = Effects(dome_bubbles=3).contents(Contents()).resolved[0]
    assert (only.on_dome, only.per_area) == (4, 0.0)
    both = Effects(dome_bubbles=4).contents(Contents(1)).resolved[0]
    assert both.on_dome == 9
    assert both.per_area > 0.0


def test_every_field_is_an_effect_that_describes_itself() -> None:
    for name, kind in EFFECTS.items():
        assert kind.name == name
        assert kind.acts_on in ("scene", "camera", "image", "timing")
        assert kind.summary().endswith(".")
        assert len(kind.severities) in (0, MAX_SEVERITY + 1)


@pytest.mark.parametrize(
    ("given", "match"),
    [
        ({"bloom": 5}, "bloom has the severity 5. Allowed: 0 to 4"),
        ({"bloom": (3, 1)}, r"bloom has the severity 3\.\.1"),
        ({"bloom": 0.5}, "bloom has the severity 0.5"),
        ({"bloom": BayerFilter("rggb")}, "bloom has the severity"),
        ({"bayer_filter": 2}, r"bayer_filter is 2. Allowed: BayerFilter\(…\), 0 or None"),
    ],
)
def test_what_cannot_be(given: dict, match: str) -> None:
    with pytest.raises(InputError, match=match):
        Effects(**given)


def test_tables_of_the_page_follow_from_the_effects() -> None:
    script = runpy.run_path(str(Path(__file__).parents[2] / "docs" / "effect_tables.py"))
    page = script["PAGE"].read_text(encoding="utf-8")
    assert script["with_tables"](page) == page, "Run: python -m docs.effect_tables"
