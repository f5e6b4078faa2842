"""Units of a plan: the same in any order, patients in one split, twins alike."""

from collections import Counter
from pathlib import Path

import pytest

from vrcaps.core.errors import InputError
from vrcaps.data.plan import DatasetSettings, Plan, Split, read_plan
from vrcaps.data.units import Units, check_plan


def plan(scenario: dict, **settings) -> Plan:
    return Plan(DatasetSettings(**{"name": "test", **settings}), scenario)


COLONS = {
    "organ": {"name": {"choice": ["colon", "stomach"]}},
    "capsule": {"each": ["mirocam", "magnetic"]},
    "lesions": {"prevalence": 2.0},
    "clean_twin": {"each": [False, True]},
    "motion": {"speed": {"uniform": [0.005, 0.02]}},
}


def test_units_are_the_same_in_any_order() -> None:
    forward = Units(plan(COLONS, patients=3, repeats=2))
    assert len(forward) == 3 * 2 * 2 * 2
    backward = Units(plan(COLONS, patients=3, repeats=2))
    numbers = range(len(forward))
    assert [forward[k] for k in numbers] == [backward[k] for k in reversed(numbers)][::-1]
    names = [forward[k].name for k in numbers]
    assert len(set(names)) == len(names)


def test_more_patients_change_none_of_those_before() -> None:
    few, many = Units(plan(COLONS, patients=2)), Units(plan(COLONS, patients=5))
    assert [few[k].scenario for k in range(8)] == [many[k].scenario for k in range(8)]


def test_a_patient_has_one_organ_and_recordings_differ() -> None:
    units = Units(plan(COLONS, patients=2))
    first = [units[k].scenario for k in range(4)]
    assert len({s.organ for s in first}) == 1
    assert len({s.lesions for s in first}) == 1
    assert first[0].motion.speed != first[2].motion.speed
    assert units[4].scenario.organ.seed != first[0].organ.seed
    assert units[4].scenario.contents.seed != first[0].contents.seed


def test_a_clean_twin_moves_as_the_one_with_lesions() -> None:
    units = Units(plan(COLONS, patients=1))
    shown, twin = units[0].scenario, units[1].scenario
    assert (shown.clean_twin, twin.clean_twin) == (False, True)
    assert shown.motion == twin.motion
    assert shown.seed == twin.seed
    assert shown.contents == twin.contents


def test_lesions_of_the_colon_are_in_colons_only() -> None:
    units = Units(plan(COLONS, patients=12))
    for patient in range(12):
        scenario = units[4 * patient].scenario
        assert scenario.organ.name == "colon" or not scenario.lesions


def test_splits_are_by_patient_and_stratified() -> None:
    settings = {"patients": 200, "stratify": ("organ.name",)}
    units = Units(plan(COLONS, split=Split(0.5, 0.25, 0.25), **settings))
    assert Counter(units.splits) == {"train": 100, "val": 50, "test": 50}
    organs = [units[4 * k].scenario.organ.name for k in range(200)]
    by_organ = {
        name: [s for organ, s in zip(organs, units.splits, strict=True) if organ == name]
        for name in ("colon", "stomach")
    }
    for splits in by_organ.values():
        assert splits.count("train") / len(splits) == pytest.approx(0.5, abs=0.03)


def test_items_with_a_probability_are_there_as_often() -> None:
    lesion = {"probability": 0.3, "kind": "polyp", "size": {"uniform": [0.004, 0.01]}}
    units = Units(plan({"lesions": [lesion]}, patients=100))
    present = [bool(units[k].scenario.lesions) for k in range(100)]
    assert 15 <= sum(present) <= 45


@pytest.mark.parametrize(
    ("scenario", "settings", "message"),
    [
        ({"organ": {"name": {"each": ["colon"]}}}, {}, "belongs to the patient"),
        ({"organ": {"name": "colom"}}, {}, "organ"),
        ({"motion": {"sped": 1.0}}, {}, "Unknown key"),
        ({}, {"patients": 10**6, "repeats": 10**6}, "number of recordings is 1,000,000,000,000"),
        (
            {name: {"each": list(range(1, 4001))} for name in ("frames", "fps")},
            {"patients": 10**6, "repeats": 10**6},
            "number of recordings is 16,000,000,000,000,000,000",
        ),
        ({}, {"name": "x\x1b[31m"}, "The name of a data set is"),
        ({}, {"name": "x" * 200}, "Allowed: a relative path of at most 180 bytes"),
        ({}, {"split": Split(1.0, 0.0, 0.0), "stratify": ("capsule",)}, "differs between"),
    ],
)
def test_bad_plans_are_one_clear_line(scenario: dict, settings: dict, message: str) -> None:
    with pytest.raises(InputError, match=message):
        Units(plan(scenario, **settings))[0].scenario.organ.seed  # noqa: B018


@pytest.mark.parametrize(
    ("scenario", "message"),
    [
        ({"capsul": "mono"}, r"Unknown key capsul\..* Did you mean 'capsule'\?"),
        ({"capsule": "mirocm"}, r"No capsule named 'mirocm'\..* Did you mean 'mirocam'\?"),
        ({"capsule": {"each": ["mono", "sterio"]}}, "capsule = 'sterio' of the plan: No capsule"),
        (
            {"organ": {"name": {"choice": ["colon", "stomac"], "weights": [1e6, 1]}}},
            r"organ\.name = 'stomac' of the plan: .* Did you mean 'stomach'\?",
        ),
        (
            {"motion": {"drift": {"log-uniform": [1e-9, 1.5]}}},
            r"motion\.drift = 1\.5 of the plan: .* Allowed: 0 to below 1",
        ),
        ({"frames": {"integer": [-1, 10**5]}}, r"frames = -1 of the plan"),
        ({"motion": {"speed": {"unifrom": [0.1, 0.2]}}}, r"Did you mean 'uniform'\?"),
        ({"lesions": {"prevalance": 1.0}}, r"Did you mean 'prevalence'\?"),
    ],
)
def test_what_a_plan_may_draw_is_checked_before_anything_is_made(
    scenario: dict, message: str
) -> None:
    with pytest.raises(InputError, match=message):
        check_plan(Units(plan(scenario)))


def test_stratifying_by_what_the_plan_does_not_have_is_refused() -> None:
    check_plan(Units(plan(COLONS, stratify=("organ.name",))))
    with pytest.raises(InputError, match=r"organ\.nam, .* that it draws: lesions, organ\.name\."):
        check_plan(Units(plan(COLONS, stratify=("organ.nam",))))


def test_splits_of_a_large_cohort_draw_only_what_they_are_by() -> None:
    """Lesions take a thousand times longer to draw than the name of an organ."""
    few, many = (Units(plan(COLONS, patients=n, stratify=("organ.name",))) for n in (30, 30))
    names = [many[8 // 2 * k].scenario.organ.name for k in range(30)]
    assert [few._draw(k, False, only=("organ.name",))["organ.name"] for k in range(30)] == names


def test_bad_plan_files_are_one_clear_line(tmp_path: Path) -> None:
    path = tmp_path / "plan.toml"
    path.write_text("frames = 3\n")
    with pytest.raises(InputError, match=r"no table \[dataset\]"):
        read_plan(path)
    path.write_text('[dataset]\nname = "x"\npatients = 0\n')
    with pytest.raises(InputError, match="patients"):
        read_plan(path)
    path.write_text('[dataset]\nname = "x"\n[motion]\nspeed = { uniform = [2, 1] }\n')
    with pytest.raises(InputError, match=r"motion\.speed"):
        read_plan(path)
    with pytest.raises(InputError, match=r"adds up to 1\.15: train 0\.5, val 0\.15, test 0\.5"):
        Split(train=0.5, test=0.5)
