"""Settings chosen for the next drive change only that setting."""

from __future__ import annotations

from dataclasses import replace

import pytest

from vrcaps.camera_pipeline.effects import Effects
from vrcaps.capsule.device_file import read_device
from vrcaps.cockpit.session.drive import Choice, chosen_scenario, magnetic_capsules
from vrcaps.core.errors import InputError, UnknownNameError
from vrcaps.lumen.contents import Bubbles, Contents
from vrcaps.scenario.scenario import OrganGenerated, Scenario

BEFORE = Scenario(
    OrganGenerated("stomach", seed=3, distension="inflated"),
    "magnetic",
    fps=read_device("magnetic").frame_rate,
    contents=Contents(bubbles=Bubbles(per_area=5.0)),
    effects=Effects(sensor_noise=2),
)


def test_nothing_chosen_changes_nothing():
    assert chosen_scenario(BEFORE, Choice()) == BEFORE


def test_another_patient_has_contents_of_its_own():
    after = chosen_scenario(BEFORE, Choice(seed=5, contents={"chyme": 2}))
    assert after.organ == OrganGenerated("stomach", seed=5, distension="inflated")
    assert after.contents == replace(BEFORE.contents, chyme=2, seed=5)
    assert after.effects == BEFORE.effects


def test_another_organ_is_of_the_same_patient():
    after = chosen_scenario(BEFORE, Choice(organ="colon", lesions="polyp-Ip:size=12mm colitis-2"))
    assert after.organ == OrganGenerated("colon", seed=3)
    assert [lesion.kind for lesion in after.lesions] == ["polyp", "colitis"]
    assert after.lesions[0].size == pytest.approx(0.012)
    assert chosen_scenario(after, Choice(lesions="none")).lesions == ()
    drawn = chosen_scenario(after, Choice(lesions="prevalence")).lesions
    assert drawn == chosen_scenario(after, Choice(lesions=" prevalence ")).lesions
    assert drawn != after.lesions


def test_another_capsule_has_its_own_frame_rate(tmp_path):
    assert "magnetic" in magnetic_capsules()
    assert "mirocam" not in magnetic_capsules()
    after = chosen_scenario(BEFORE, Choice(capsule="magnetic", effects={"distortion": 3}))
    assert after.capsule == read_device("magnetic")
    assert after.fps is None
    assert after.effects == replace(BEFORE.effects, distortion=3)
    slow = replace(BEFORE, fps=1.5)
    assert chosen_scenario(slow, Choice(capsule="magnetic")).fps == 1.5


def test_says_what_cannot_be(tmp_path):
    with pytest.raises(UnknownNameError, match="No lesion named 'wart'"):
        chosen_scenario(BEFORE, Choice(lesions="wart"))
    with pytest.raises(InputError, match="a table of the colon, but the organ is stomach"):
        chosen_scenario(BEFORE, Choice(lesions="prevalence"))
    wrong = tmp_path / "mine.toml"
    wrong.write_text("length_mm = 'long'")
    with pytest.raises(InputError, match=r"mine\.toml"):
        chosen_scenario(BEFORE, Choice(capsule=str(wrong)))
