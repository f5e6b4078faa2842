"""The command line: how flags become scenarios, and how mistakes end."""

from __future__ import annotations

import dataclasses
import errno
import re
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import pytest

from vrcaps import cli
from vrcaps.cli import learn
from vrcaps.cli.episodes import Check
from vrcaps.cli.record import Record, _free_folder
from vrcaps.core.errors import InputError
from vrcaps.core.fields import FileRef
from vrcaps.learn.hub import read_index
from vrcaps.lumen.preparation import prepared
from vrcaps.motion.dynamics import Dynamics
from vrcaps.motion.fly_through import FlyThrough
from vrcaps.motion.replay import Replay
from vrcaps.scenario.scenario import OrganFile, OrganGenerated, Scenario
from vrcaps.sensors.sensors import HallPad, Imu, Sensors


def stop(args: list[str], capsys: pytest.CaptureFixture[str]) -> tuple[int, str]:
    """Exit status and stderr of a command that stops early."""
    with pytest.raises(SystemExit) as exit_info:
        cli.main(args)
    assert isinstance(exit_info.value.code, int)
    return exit_info.value.code, capsys.readouterr().err


@pytest.mark.parametrize("verb", [path.split() for path in cli._all_verbs()])
def test_every_verb_has_a_summary_and_help_with_an_example(
    verb: list[str], capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(SystemExit, match="0"):
        cli.main([*verb, "--help"])
    text = capsys.readouterr().out
    assert "For example:" in text
    assert f"vrcaps {' '.join(verb)}" in text


def resolved(args: str) -> Scenario:
    """Scenario of the flags of `record`."""
    command = cli._parse(["record", "--out", "o", *args.split()])
    assert isinstance(command, Record)
    return command.resolved()


def test_recorded_commands_steer(tmp_path: Path) -> None:
    """In a recording; in the cockpit one steers oneself."""
    commands = tmp_path / "commands.csv"
    asked = f"--motion dynamics --capsule magnetic --steer {commands}"
    motion = resolved(asked).motion
    assert isinstance(motion, Dynamics)
    assert motion.magnet is not None
    assert motion.magnet.command_file == FileRef(str(commands))
    with pytest.raises(InputError, match="which a drive does not support"):
        cli._parse(["cockpit", *asked.split()]).resolved()  # type: ignore[attr-defined]


def test_the_cockpit_has_a_stomach_and_a_capsule_with_a_magnet() -> None:
    plain = cli._parse(["cockpit"]).resolved()  # type: ignore[attr-defined]
    assert (plain.organ, plain.capsule) == (OrganGenerated("stomach"), "magnetic")
    assert plain.motion == Dynamics(substep=2e-4)
    given = cli._parse(["cockpit", "--organ", "colon"]).resolved()  # type: ignore[attr-defined]
    assert given.organ == OrganGenerated("colon")


def test_settings_of_the_cockpit_are_those_of_the_motion_that_is_driven(tmp_path: Path) -> None:
    """Dynamics, also where a file states another motion, whose start is kept."""
    words = ["cockpit", "--set", "motion.magnet.wall=upper"]
    driven = cli._parse(words).resolved()  # type: ignore[attr-defined]
    assert isinstance(driven.motion, Dynamics) and driven.motion.magnet is not None
    assert driven.motion.magnet.wall == "upper"
    with pytest.raises(InputError, match=r"Unknown key motion\.tilt\. Allowed: start, angle"):
        cli._parse(["cockpit", "--set", "motion.tilt=0.1"]).resolved()  # type: ignore[attr-defined]
    flown = tmp_path / "flown.toml"
    flown.write_text("[motion]\nstart = 0.4\n")
    driven = cli._parse(["cockpit", str(flown)]).resolved()  # type: ignore[attr-defined]
    assert driven.motion == Dynamics(start=0.4, substep=2e-4)


def test_without_flags_a_scenario_has_its_defaults() -> None:
    assert resolved("") == Scenario()


def test_flags_reach_the_scenario() -> None:
    scenario = resolved(
        "--organ colon --seed 4 --frames 7 --fps 2.5 --capsule pillcam-sb3 --channels rgb depth "
        "--start 0 --set motion.drift=0.1 --posture prone --light path --set render.spp=64 "
        "--sensors imu hall"
    )
    assert scenario.organ == OrganGenerated("colon", seed=4)
    assert (scenario.frames, scenario.fps, scenario.seed) == (7, 2.5, 4)
    assert (scenario.capsule, scenario.posture) == ("pillcam-sb3", "prone")
    assert scenario.channels == ("rgb", "depth")
    again = cli._parse(["record", "--out", "o", "--channels", "rgb,depth"])
    assert isinstance(again, Record) and again.resolved().channels == ("rgb", "depth")
    assert scenario.motion == FlyThrough(start=0.0, drift=0.1)
    assert (scenario.render.light, scenario.render.spp) == ("path", 64)
    assert scenario.sensors == Sensors(imu=Imu(), hall=HallPad())


@pytest.mark.slow
@pytest.mark.parametrize(
    ("flags", "says"),
    [
        (
            "--set render.mucus_film_um=-3",
            "render: mucus_film_um is -3.0. Allowed: 0",
        ),
        ("--set motion.drft=3", "Unknown key motion.drft. Allowed: start, end, speed"),
        ("--set seed=" + "1" * 5000, "--set seed: the value is not usable: Exceeds the limit"),
        (
            "--set render.spp=1" + "0" * 400,
            "--set render.spp: the value is not usable: it contains",
        ),
        ("--set motion.drift=" + "[" * 3000, "--set motion.drift: the value is not usable"),
        ("--set frames", "--set is 'frames'. Allowed: PATH=VALUE, such as motion.speed=0.01."),
        ("--set frames=many", "frames is 'many'. Allowed: a whole number."),
        (
            "--set motion.kind=swim",
            "motion.kind is 'swim'. Allowed: dynamics",
        ),
        ("--fps 0", "fps is 0.0. Allowed: above 0"),
        (
            "--organ x.ply --unit mm --patient-seed 1",
            "Unknown key organ.seed. Allowed",
        ),
        (
            "--organ x.ply --distension normal",
            "Unknown key organ.distension. Allowed",
        ),
        ("--organ colon --unit mm", "Unknown key organ.unit. Allowed: name, seed"),
        ("--preparation 4", "Preparation is 4. Allowed: a Boston score, 0 to 3"),
        ("--motion replay", "Missing key motion.path"),
    ],
)
def test_a_value_that_cannot_be_ends_in_one_line(flags, says, capsys) -> None:
    status, error = stop(["record", "--out", "o", *flags.split()], capsys)
    assert status == 2
    assert error.startswith(f"vrcaps: {says}")
    assert error.count("\n") == 1


def test_a_choice_that_is_not_there_names_those_that_are(capsys) -> None:
    status, error = stop(["record", "--out", "o", "--light", "glow"], capsys)
    assert status == 2
    assert error == "vrcaps: --light is 'glow'. Allowed: direct, path, radiosity.\n"


def test_a_preparation_fills_the_patients_colon() -> None:
    contents = resolved("--patient-seed 3 --preparation 1").contents
    assert contents == replace(prepared(1), seed=3)


def test_a_patient_may_be_flown_through_many_times() -> None:
    scenario = resolved("--seed 4 --patient-seed 1")
    assert (scenario.organ, scenario.seed) == (OrganGenerated("colon", seed=1), 4)
    organ = resolved("--organ stomach --seed 4 --distension collapsed").organ
    assert organ == OrganGenerated("stomach", 4, "collapsed")


def test_mesh_file_and_path_reach_the_scenario() -> None:
    scenario = resolved(
        "--organ a/colon.ply --unit 5cm --motion replay --set motion.path=poses.csv "
        "--set motion.format=unity-csv --set motion.unit=dm --set motion.frame=patient"
    )
    assert scenario.organ == OrganFile("a/colon.ply", unit="5cm")
    assert scenario.motion == Replay("poses.csv", "unity-csv", "dm", frame="patient")


def test_flags_change_values_of_a_scenario_file(tmp_path: Path) -> None:
    path = tmp_path / "mine.toml"
    path.write_text(
        'frames = 7\n[motion]\nkind = "dynamics"\nsettle = 2\n[[lesions]]\nkind = "polyp"\n'
    )
    scenario = resolved(f"{path} --frames 3 --set motion.step=0.01 --lesion erosion")
    assert (scenario.frames, scenario.motion) == (3, Dynamics(settle=2.0, step=0.01))
    assert [lesion.kind for lesion in scenario.lesions] == ["polyp", "erosion"]
    assert resolved(f"{path} --motion fly-through").motion == FlyThrough()


def test_all_settings_are_listed_with_type_unit_and_default(capsys) -> None:
    cli.main(["record", "--list-settings"])
    text = capsys.readouterr().out
    for line in (
        "frames: int (1 to 1000000) = 100",
        "motion.speed: float or none (above 0 m/s) = none [fly-through]",
        "motion.magnet.wall: upper, lower = lower [dynamics]",
        "render.light: direct, radiosity, path = radiosity",
        "organ.path: text = required [file]",
        "sensors.hall.gap: float (any finite number of m) = 0.05",
    ):
        assert line in text
    assert "-inf" not in text
    assert "Mean speed along the" in text


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
        ("record --out {tmp}/full", "contains other files"),
        ("record {tmp}/none.json --out {tmp}/o", "No file at"),
        ("record --out {tmp}/o --threads 0", "--threads is 0. Allowed: 1 to 256"),
        ("record --out {tmp}/o --threads 2000", "--threads is 2000. Allowed: 1 to 256"),
        ("dataset check {tmp} --workers 100000", "--workers is 100000. Allowed: 0 to 256"),
        ("organ inspect {tmp}/none.ply --unit mm", "No file at"),
        ("organ inspect {mesh}", "--unit is missing: "),
        ("organ inspect {mesh} --unit mm --seed 3", "--seed and --distension require a generated"),
        ("organ inspect colon --unit mm", "require a file, but 'colon' is a name"),
        ("organ inspect colom", "No organ named 'colom'. Known: "),
        ("organ inspect colon --seed -1", "Seed is -1. Allowed: 0 to 18446744073709551615"),
        ("organ inspect colon --picture {tmp}/a.txt", "Allowed: .png, .jpg, .pdf, .svg"),
        ("record --out {tmp}/o --organ {tmp}/none.glb", "none.glb: No such file"),
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
    assert text == "vrcaps: Interrupted. Files written so far are complete.\n"


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
    from vrcaps.capsule.device_file import device_names
    from vrcaps.lesion import LESIONS
    from vrcaps.mucosa.mucosa import MUCOSAE
    from vrcaps.organ.segments import ORGANS

    cli.main(["organ", "list"])
    text = capsys.readouterr().out
    for name in (*ORGANS, *LESIONS, *MUCOSAE, *device_names(), "collapsed", "splenic_flexure"):
        assert name in text
    assert "vrcaps organ make" in text


@pytest.mark.parametrize("verb", ["train", "evaluate", "predict"])
def test_registered_tasks_are_commands(
    verb: str, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Built-in tasks, and one that a user registers."""
    torch = pytest.importorskip("torch", reason="PyTorch is not installed")
    from vrcaps.learn import TASKS, Task

    class GlareTask(Task):
        """Fraction of glare in an image."""

        kind = "glare"

    monkeypatch.setattr(TASKS, "_added", {})
    TASKS.register(dataclasses.dataclass(frozen=True)(GlareTask))
    assert "glare" in TASKS and torch
    for task in ("depth", "glare"):
        with pytest.raises(SystemExit):
            cli.main([verb, task, "--help"])
        text = capsys.readouterr().out
        assert f"vrcaps {verb} {task} --" in text
    assert "Fraction of glare in an image." in text
    if verb != "evaluate":
        with pytest.raises(SystemExit):
            cli.main([verb, "--help"])
        listed = capsys.readouterr().out
        assert all(f"• {task} " in listed for task in TASKS)


def test_the_choice_between_published_weights_of_a_task_is_shown(
    capsys: pytest.CaptureFixture[str],
) -> None:
    given = learn._find_weights("depth", "depth")
    assert capsys.readouterr().out == ""
    assert learn._find_weights("", "depth") == given
    choice, names = " ".join(capsys.readouterr().out.split()), read_index(str(given.parent))
    for name in re.findall(r"--weights (\S+)", choice):
        assert names[name].task == "depth"
    for verb, is_with_unit in (("evaluate", False), ("predict", True)):
        with pytest.raises(SystemExit):
            cli.main([verb, "depth", "--help"])
        text = " ".join(capsys.readouterr().out.split())
        assert choice in text and ("in steps of 10 µm" in text) == is_with_unit


@pytest.mark.parametrize("words", [["--help"], ["train", "--help"], ["predict", "depth", "--help"]])
def test_help_lists_tasks_without_loading_pytorch(words: list[str]) -> None:
    code = (
        "import sys\nimport vrcaps.cli\n"
        f"try: vrcaps.cli.main({words!r})\n"
        "except SystemExit: print('torch' in sys.modules)"
    )
    result = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=True
    )
    assert result.stdout.splitlines()[-1] == "False"


def test_missing_pytorch_is_one_line(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    for name in [name for name in sys.modules if name.startswith("vrcaps.learn.task")]:
        monkeypatch.delitem(sys.modules, name)
    monkeypatch.setitem(sys.modules, "torch", None)
    with pytest.raises(SystemExit):
        cli.main(["train", "depth", "--data", str(tmp_path), "--out", "runs/b"])
    text = capsys.readouterr().err
    assert "torch is not installed. Install it with: pip install 'vrcaps[learn]'" in text
