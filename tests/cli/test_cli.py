"""The command line: how flags become scenarios, and how mistakes end."""

from __future__ import annotations

import errno
from dataclasses import replace
from pathlib import Path

import pytest

from vrcaps import cli
from vrcaps.cli.check import Check
from vrcaps.cli.demo import _free_folder
from vrcaps.cli.record import Record
from vrcaps.errors import InputError
from vrcaps.lumen.bowel_preparation import prepared
from vrcaps.motion.fly_through import FlyThrough
from vrcaps.motion.replay import Replay
from vrcaps.scenario.scenario import OrganFile, OrganGenerated, Scenario

OUT = Path("out")


def stop(args: list[str], capsys: pytest.CaptureFixture[str]) -> tuple[int, str]:
    """Exit status and stderr of a command that stops early."""
    with pytest.raises(SystemExit) as exit_info:
        cli.main(args)
    assert isinstance(exit_info.value.code, int)
    return exit_info.value.code, capsys.readouterr().err


@pytest.mark.parametrize("verb", [path.split() for path in cli._VERBS])
def test_every_verb_has_a_summary_and_help_with_an_example(
    verb: list[str], capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(SystemExit, match="0"):
        cli.main([*verb, "--help"])
    text = capsys.readouterr().out
    assert "For example:" in text
    assert f"vrcaps {' '.join(verb)}" in text


def test_defaults_of_the_flags_are_the_defaults_of_a_scenario() -> None:
    assert Record(OUT).resolved() == Scenario()


def test_flags_reach_the_scenario(capsys: pytest.CaptureFixture[str]) -> None:
    args = "record --out o --organ colon --seed 4 --frames 7 --fps 2.5 --capsule pillcam-sb3"
    args += " --channels rgb depth --start 0.2 --drift 0.1 --posture prone"
    command = cli._parse(args.split())
    assert isinstance(command, Record)
    scenario = command.resolved()
    assert scenario.organ == OrganGenerated("colon", seed=4)
    assert (scenario.frames, scenario.fps, scenario.seed) == (7, 2.5, 4)
    assert (scenario.capsule, scenario.posture) == ("pillcam-sb3", "prone")
    assert scenario.channels == ("rgb", "depth")
    assert scenario.motion == FlyThrough(start=0.2, drift=0.1)


@pytest.mark.parametrize(
    ("flags", "says"),
    [
        (["--mucus-film-um", "-3"], "Mucus film is -3.0. Allowed: 0 to 1000 [µm]."),
        (["--drift", "3"], "Fly-through drift (--drift) is 3.0. Allowed: 0 to below 1."),
    ],
)
def test_a_value_that_cannot_be_ends_in_one_line(flags, says, capsys) -> None:
    assert stop(["record", "--out", "o", *flags], capsys) == (2, f"vrcaps: {says}\n")


def test_a_choice_that_is_not_there_names_those_that_are(capsys) -> None:
    status, error = stop(["record", "--out", "o", "--light", "glow"], capsys)
    assert status == 2
    assert "'--light'" in error and "'radiosity'" in error


def test_a_preparation_fills_the_patients_colon() -> None:
    contents = Record(OUT, patient=3, preparation=1).resolved().contents
    assert contents == replace(prepared(1), seed=3)


def test_a_patient_may_be_flown_through_many_times() -> None:
    scenario = Record(OUT, seed=4, patient=1).resolved()
    assert (scenario.organ, scenario.seed) == (OrganGenerated("colon", seed=1), 4)
    args = "record --out o --organ stomach --seed 4 --distension collapsed"
    command = cli._parse(args.split())
    assert isinstance(command, Record)
    assert command.resolved().organ == OrganGenerated("stomach", 4, "collapsed")


def test_mesh_file_and_path_reach_the_scenario() -> None:
    command = Record(
        OUT,
        organ="a/colon.ply",
        unit="5cm",
        path=Path("poses.csv"),
        path_format="unity-csv",
        path_unit="dm",
        path_frame="patient",
    )
    scenario = command.resolved()
    assert scenario.organ == OrganFile("a/colon.ply", unit="5cm")
    assert scenario.motion == Replay("poses.csv", "unity-csv", "dm", frame="patient")


@pytest.mark.parametrize(
    ("command", "message"),
    [
        (Record(OUT, organ="x.ply"), "--unit is missing: x.ply does not say its unit"),
        (Record(OUT, organ="colon", unit="mm"), "go with a mesh file, but 'colon' is a name"),
        (Record(OUT, organ="colon", reverse=True), "go with a mesh file"),
        (Record(OUT, organ="x.ply", unit="mm", patient=1), "--patient and --distension go with a"),
        (Record(OUT, organ="x.ply", unit="mm", distension="normal"), "go with a generated organ"),
        (Record(OUT, preparation=2, chyme=1), "Leave out --bubbles, --chyme and --liquid"),
        (Record(OUT, preparation=4), "Preparation is 4. Allowed: a Boston score, 0 to 3"),
        (Record(OUT, path=Path("p")), "--path needs --path-format. Allowed: tum, unity-csv"),
        (Record(OUT, path=Path("p"), path_format="tum"), "--path-unit is missing"),
        (Record(OUT, path=Path("p"), fly=FlyThrough(drift=0.0)), "flags of the fly-through"),
        (Record(OUT, scenario=Path("s.json"), frames=3), "--scenario states the whole recording"),
    ],
)
def test_contradicting_flags_are_an_error(command: Record, message: str) -> None:
    with pytest.raises(InputError, match=message):
        command.resolved()


@pytest.mark.parametrize(
    ("args", "message"),
    [
        ("record --out {tmp}/o --organ colom", "No organ named 'colom'. Known: "),
        ("record --out {tmp}/o --capsule pill", "No capsule named 'pill'. Known: "),
        ("record --out {tmp}/o --posture upside", "No posture named 'upside'. Known: "),
        ("record --out {tmp}/o --channels rgb deph", "No channel named 'deph'. Known: "),
        ("record --out {tmp}/o --frames 0", "frames is 0. Allowed: "),
        ("record --out {tmp}/o --organ none.ply --unit mm", "none.ply"),
        ("record --out {tmp}/o --organ {mesh} --unit inch", "Unknown length unit 'inch'. Allowed"),
        ("record --out {tmp}/o --organ {mesh} --unit mm", "is empty"),
        ("record --out {tmp}/full", "holds something else"),
        ("record --out {tmp}/o --scenario {tmp}/none.json", "Cannot read the scenario"),
        ("record --out {tmp}/o --threads 0", "--threads is 0. Allowed: 1 or more"),
        ("organ inspect {tmp}/none.ply --unit mm", "No file at"),
        ("organ inspect {mesh}", "--unit is missing: "),
        ("organ inspect {mesh} --unit mm --seed 3", "--seed and --distension go with a generated"),
        ("organ inspect colon --unit mm", "go with a file, but 'colon' is a name"),
        ("organ inspect colom", "No organ named 'colom'. Known: "),
        ("organ inspect colon --seed -1", "Seed -1 is negative. Allowed: 0, 1, 2"),
        ("organ inspect colon --picture {tmp}/a.txt", "Allowed: .png, .jpg, .pdf, .svg"),
        ("record --out {tmp}/o --organ {tmp}/none.glb", "--unit is missing"),
        ("organ make liver", "No organ named 'liver'. Known: "),
        ("organ make colon --out {tmp}/colon.stl", "Allowed: a name that ends in .glb"),
        ("check {tmp}/none", "No folder at"),
    ],
)
def test_mistakes_end_in_one_line_and_status_2(
    args: str, message: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    mesh = tmp_path / "empty.obj"
    mesh.write_text("# nothing\n")
    (tmp_path / "full").mkdir()
    (tmp_path / "full" / "thesis.tex").write_text("precious")
    status, text = stop(args.format(tmp=tmp_path, mesh=mesh).split(), capsys)
    assert status == cli.EXIT_BAD_INPUT
    assert text.count("\n") == 1
    assert text.startswith("vrcaps: ")
    assert message in text
    assert not (tmp_path / "o").exists()
    assert (tmp_path / "full" / "thesis.tex").read_text() == "precious"


@pytest.mark.parametrize(
    "args", [[], ["recrd"], ["record"], ["record", "--out", "o", "--fps", "x"]]
)
def test_what_cannot_be_parsed_ends_in_status_2(
    args: list[str], capsys: pytest.CaptureFixture[str]
) -> None:
    assert stop(args, capsys)[0] == cli.EXIT_BAD_INPUT


def test_interruption_ends_in_one_line_and_status_130(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def interrupt(self: Check) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(Check, "run", interrupt)
    status, text = stop(["check", "."], capsys)
    assert status == cli.EXIT_INTERRUPTED
    assert text == "vrcaps: Interrupted. Files written so far are whole.\n"


def test_a_failing_system_call_ends_in_one_line(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def fail(self: Check) -> None:
        raise PermissionError(errno.EACCES, "Permission denied", "/secret")

    monkeypatch.setattr(Check, "run", fail)
    assert stop(["check", "."], capsys) == (2, "vrcaps: /secret: Permission denied.\n")


def test_a_demo_never_writes_where_something_is(tmp_path: Path) -> None:
    wanted = tmp_path / "demo"
    assert _free_folder(wanted) == wanted
    wanted.mkdir()
    (tmp_path / "demo-2").mkdir()
    assert _free_folder(wanted) == tmp_path / "demo-3"


def test_list_names_all_that_goes_by_name(capsys: pytest.CaptureFixture[str]) -> None:
    from vrcaps.anatomy.catalog import ORGANS
    from vrcaps.capsule.catalog import device_names
    from vrcaps.lesion import LESIONS
    from vrcaps.mucosa.mucosa import MUCOSAE

    cli.main(["organ", "list"])
    text = capsys.readouterr().out
    for name in (*ORGANS, *LESIONS, *MUCOSAE, *device_names(), "collapsed", "splenic_flexure"):
        assert name in text
    assert "vrcaps organ make" in text
