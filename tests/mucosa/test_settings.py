"""Settings of a mucosa: names, textures and changed parameters."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest

from vrcaps.config.convert import from_plain, to_plain
from vrcaps.core.errors import InputError
from vrcaps.core.fields import with_checksums
from vrcaps.mucosa.mucosa import MUCOSAE, MucosaSettings
from vrcaps.scenario.scenario import OrganGenerated
from vrcaps.scenario.settings import settings


def test_changes_apply_to_the_named_mucosa_or_to_that_of_the_organ():
    changed = MucosaSettings(bile=0.9, pit_slope=0.1)
    expected = replace(MUCOSAE["small-bowel"], bile=0.9, pit_slope=0.1)
    assert changed.of("small-bowel") == expected
    assert replace(changed, path="small-bowel").of("colon") == expected
    assert MucosaSettings("stomach").of("colon") == "stomach"


def test_plain_scenarios_hold_changed_parameters_and_names():
    plain = {"name": "small-bowel", "mucosa": {"bile": 0.9}}
    organ = from_plain(OrganGenerated, plain, at="organ")
    assert organ.mucosa == MucosaSettings(bile=0.9)
    assert from_plain(OrganGenerated, to_plain(organ, OrganGenerated), at="organ") == organ
    assert from_plain(OrganGenerated, {"mucosa": "stomach"}, at="organ").mucosa == "stomach"


def test_every_number_of_a_mucosa_but_few_has_a_path():
    own = {name for name, value in vars(MUCOSAE["colon"]).items() if isinstance(value, float)}
    paths = {s.path.removeprefix("organ.mucosa.") for s in settings() if "mucosa." in s.path}
    assert own - paths == {"trunk_spacing", "capillary_radius"}


def test_textures_have_checksums_and_no_parameters(tmp_path: Path):
    (tmp_path / "mucosa.json").write_text("{}")
    organ = with_checksums(OrganGenerated(mucosa=str(tmp_path)))
    assert isinstance(organ.mucosa, MucosaSettings)
    assert len(organ.mucosa.sha256) == 64
    assert organ.mucosa.of("colon") == str(tmp_path)
    with pytest.raises(InputError, match="no parameters"):
        MucosaSettings(str(tmp_path), bile=0.1)


def test_a_tract_needs_the_name_of_one_mucosa():
    with pytest.raises(InputError, match="several mucosae"):
        OrganGenerated("full-tract", mucosa=MucosaSettings(bile=0.2))
    OrganGenerated("full-tract", mucosa=MucosaSettings("colon", bile=0.2))


@pytest.mark.parametrize("value", [-0.1, float("nan"), float("inf")])
def test_numbers_outside_their_range_are_refused(value: float):
    with pytest.raises(InputError, match="bile"):
        MucosaSettings(bile=value)
