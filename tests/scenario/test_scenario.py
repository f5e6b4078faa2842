import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from vrcaps.camera_pipeline.effects import Effects, parse_effects
from vrcaps.capsule.device_file import read_device
from vrcaps.core.errors import InputError, UnknownNameError
from vrcaps.core.fields import FileRef
from vrcaps.lesion import Location, Polyp
from vrcaps.motion.fly_through import FlyThrough
from vrcaps.motion.replay import Replay
from vrcaps.render.settings import RenderSettings
from vrcaps.scenario.build import build, resolve
from vrcaps.scenario.scenario import (
    OrganFile,
    OrganGenerated,
    Scenario,
    read_lesions,
    read_scenario,
    scenario_from_plain,
    scenario_to_plain,
)

SCENARIOS = [
    Scenario(),
    Scenario(
        organ=OrganFile("organ.ply", "mm", open_ends="keep"),
        capsule="pillcam-colon2",
        posture="prone",
        motion=FlyThrough(speed=0.01, roll=0.0),
        fps=12.0,
        channels=("depth", "rgb"),
        render=RenderSettings(light="direct", supersampling=2, shadows=True),
    ),
    Scenario(motion=Replay("path.csv", "unity-csv", "dm", handedness="right", pose="capsule")),
]


@pytest.mark.parametrize("scenario", SCENARIOS)
def test_round_trip_through_json(tmp_path, scenario):
    path = tmp_path / "scenario.json"
    path.write_text(json.dumps(scenario_to_plain(scenario)))
    assert read_scenario(path) == scenario
    path.write_text(
        json.dumps({"format": "vrcaps-episode/1", "scenario": scenario_to_plain(scenario)})
    )
    assert read_scenario(path) == scenario


def test_an_episode_from_before_keeps_its_motion_and_frame_rate(tmp_path):
    """It states no `whole`; a flight without speed covered all, a null rate was constant."""
    path, plain = tmp_path / "episode.json", scenario_to_plain(resolve(Scenario()).scenario)
    assert read_scenario(_episode(path, plain)) == resolve(Scenario()).scenario
    del plain["motion"]["whole"], plain["variation"]
    plain["motion"]["tilt"] = None
    plain["effects"] |= {"auto_exposure": 0, "adaptive_frame_rate": None, "bayer_filter": None}
    before = read_scenario(_episode(path, {**plain, "capsule": "pillcam-colon2"}))
    assert before.motion == resolve(before).scenario.motion == FlyThrough(whole=True)
    assert resolve(before).effects.adaptive_frame_rate == 0
    assert resolve(before).effects.auto_exposure == 0
    plain["motion"]["speed"] = 0.02
    assert read_scenario(_episode(path, plain)).motion == FlyThrough(speed=0.02)


def test_effects_that_an_earlier_episode_does_not_state_are_off(tmp_path):
    """It states every effect of its version; a scenario file that states none has the capsule's."""
    path, plain = tmp_path / "episode.json", scenario_to_plain(resolve(Scenario()).scenario)
    for name in ("sharpening", "denoising", "color_matrix", "tone_curve", "led_balance"):
        del plain["effects"][name]
    before = resolve(read_scenario(_episode(path, plain))).effects
    assert (before.sharpening, before.denoising, before.led_balance) == (0, 0, 0)
    assert before.jpeg == resolve(Scenario()).effects.jpeg
    path.write_text(json.dumps({"frames": 3}))
    assert resolve(read_scenario(path)).effects.sharpening != 0


@pytest.mark.parametrize("text", ["none", "none,jpeg=2", "default", "noise=1..3"])
def test_effects_of_a_file_may_be_a_text(text: str, tmp_path):
    path = tmp_path / "scenario.toml"
    path.write_text(f'effects = "{text}"\nframes = 2\n')
    assert read_scenario(path).effects == parse_effects(text)
    path.write_text('effects = "glow=1"\n')
    with pytest.raises(UnknownNameError, match="No effect named 'glow'"):
        read_scenario(path)


def _episode(path, plain):
    path.write_text(json.dumps({"format": "vrcaps-episode/1", "scenario": plain}))
    return path


def test_toml_with_few_keys(tmp_path):
    path = tmp_path / "scenario.toml"
    path.write_text(
        'frames = 7\n[organ]\nkind = "generated"\nseed = 4\ndistension = "collapsed"\n'
        "[render]\nshadows = true\n"
        '[motion]\nkind = "fly-through"\nspeed = 1e-2\n'
    )
    expected = Scenario(
        OrganGenerated(seed=4, distension="collapsed"),
        frames=7,
        motion=FlyThrough(speed=0.01),
        render=RenderSettings(light="radiosity", shadows=True),
    )
    assert read_scenario(path) == expected


@pytest.mark.parametrize(
    ("name", "text", "match"),
    [
        ("missing.json", None, "Cannot read the scenario .*missing.json"),
        ("bad.json", "{", "bad.json is not JSON"),
        ("bad.toml", "a =", "bad.toml is not TOML"),
        ("list.json", "[]", "A scenario is a table of keys, not list"),
        ("head.json", '{"format": "vrcaps-episode/1"}', "A scenario is a table of keys, not None"),
        ("key.json", '{"frame": 3}', r"Unknown key frame\. Allowed: organ, capsule"),
        ("kind.json", '{"organ": {"path": "a.ply"}}', "organ.kind is missing. Allowed: file, gen"),
        ("typo.json", '{"organ": {"pth": "a.ply"}}', r"Unknown key organ\.pth\. Allowed: name"),
        (
            "full.json",
            '{"organ": {"kind": "generated", "distension": "full"}}',
            r"organ\.distension is 'full'\. Allowed: 'inflated', 'normal', 'collapsed'",
        ),
        ("type.json", '{"frames": 2.5}', r"frames is 2\.5\. Allowed: a whole number"),
    ],
)
def test_bad_files(tmp_path, name, text, match):
    if text is not None:
        (tmp_path / name).write_text(text)
    with pytest.raises(InputError, match=match):
        read_scenario(tmp_path / name)


def test_resolve_fills_in_what_is_open(mesh_file, device_file):
    scenario = Scenario(
        OrganFile(str(mesh_file), "m"), str(device_file), channels=("depth", "rgb", "depth")
    )
    resolved = resolve(scenario)
    assert resolved.fps == 4.0
    assert resolved.effects == Effects().of_device(read_device(str(device_file)))
    assert resolved.channels == ("rgb", "depth")
    organ = resolved.organ.given
    assert isinstance(organ, OrganFile)
    assert isinstance(organ.path, FileRef)
    assert len(organ.path.sha256) == 64
    assert resolve(resolved.scenario).scenario == resolved.scenario


def test_resolve_checks_checksums(mesh_file, tmp_path):
    organ = OrganFile(FileRef(str(mesh_file), "0" * 64), "m")
    with pytest.raises(InputError, match="but the scenario was made with 000000000000"):
        resolve(Scenario(organ))
    missing = Replay(str(tmp_path / "none.csv"), "tum", "m")
    with pytest.raises(InputError, match=r"Cannot read .*none\.csv: No such file"):
        resolve(Scenario(motion=missing))


@pytest.mark.parametrize(
    ("change", "error", "match"),
    [
        ({"frames": 0}, InputError, "frames is 0. Allowed: 1 to 1000000"),
        ({"fps": 0.0}, InputError, "fps is 0.0. Allowed: above 0 to 10000"),
        ({"fps": 1e300}, InputError, "fps is 1e\\+300. Allowed: above 0 to 10000"),
        ({"seed": -1}, InputError, "seed is -1. Allowed: 0 to 18446744073709551615"),
        ({"seed": 2**64}, InputError, "seed is 18446744073709551616. Allowed: 0 to"),
        ({"channels": ()}, InputError, "channels is .*Allowed: at least one"),
        ({"channels": ("color",)}, UnknownNameError, "No channel named 'color'. Known: albedo"),
        ({"posture": "upside"}, UnknownNameError, "No posture named 'upside'"),
        ({"capsule": "xcam"}, UnknownNameError, "No capsule named 'xcam'"),
    ],
)
def test_values_out_of_range(change, error, match):
    with pytest.raises(error, match=match):
        resolve(replace(Scenario(), **change))


def test_unknown_unit_of_a_mesh_file(mesh_file, device_file):
    with pytest.raises(InputError, match="Unknown length unit 'furlong'"):
        resolve(Scenario(OrganFile(str(mesh_file), "furlong"), str(device_file)))


@pytest.mark.slow
def test_organ_is_loaded_as_stated(mesh_file, device_file):
    """With half a meter as its unit the tube is half as long; an appearance is always there."""
    scenario = Scenario(OrganFile(str(mesh_file), "500mm"), str(device_file))
    organ = resolve(scenario).organ.load()
    assert np.ptp(organ.vertices, axis=0).max() == pytest.approx(0.12, rel=1e-6)
    assert organ.appearance is not None


@pytest.mark.slow
def test_plain_form_is_json(scenario):
    plain = scenario_to_plain(scenario)
    assert scenario_from_plain(json.loads(json.dumps(plain))) == scenario
    assert plain["organ"]["path"]["path"] == str(Path(plain["organ"]["path"]["path"]))


LESIONS = (
    'lesions = [{kind = "polyp", shape = "Is", size = 0.006, location = {arc_length = 0.12}}]\n'
)


def test_lesions_of_a_file(tmp_path):
    path = tmp_path / "lesions.toml"
    path.write_text(LESIONS)
    expected = (Polyp(shape="Is", size=0.006, location=Location(arc_length=0.12)),)
    assert read_lesions(path) == expected
    assert scenario_from_plain(
        {"lesions": scenario_to_plain(Scenario(lesions=expected))["lesions"]}
    )
    path.write_text(LESIONS + "frames = 3\n")
    with pytest.raises(InputError, match=r"Allowed: tables \[\[lesions\]\]"):
        read_lesions(path)
    with pytest.raises(InputError, match="Cannot read the lesions file"):
        read_lesions(tmp_path / "none.toml")


@pytest.mark.slow
def test_clean_twin_has_the_same_motion(scenario, tmp_path, monkeypatch):
    monkeypatch.setenv("VRCAPS_CACHE", str(tmp_path))
    lesions = (Polyp(size=6e-3, location=Location(arc_length=0.12)),)
    sick = replace(scenario, lesions=lesions)
    twin, same = build(replace(sick, clean_twin=True))  # lesions are added once for both
    model, trajectory = build(sick)
    assert np.array_equal(trajectory.Ts_world_capsule, same.Ts_world_capsule)
    assert np.array_equal(model.organ.faces, twin.organ.faces)
    assert model.organ.instance.max() == 1
    assert twin.organ.instance.max() == 0
    assert model.organ.metadata["lesions"][0]["kind"] == "polyp"
    assert twin.organ.metadata["lesions"] == []
    assert twin.organ.metadata["clean_twin_of"] == model.organ.metadata["lesions"]
