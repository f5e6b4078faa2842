"""The flags of `vrcaps record --motion dynamics`, and every mistake in them."""

from __future__ import annotations

from pathlib import Path

import pytest

from vrcaps import cli
from vrcaps.cli.record import Record
from vrcaps.cli.record_dynamics import DynamicsFlags
from vrcaps.motion.dynamics import Dynamics
from vrcaps.tissue.drag import Drag
from vrcaps.tissue.motility.propulsion import Propulsion
from vrcaps.world.schedule import Insufflation, PostureChange, Wrench

OUT = Path("out")


def stop(args: list[str], capsys: pytest.CaptureFixture[str]) -> tuple[int, str]:
    """Exit status and stderr of a command that stops early."""
    with pytest.raises(SystemExit) as exit_info:
        cli.main(args)
    assert isinstance(exit_info.value.code, int)
    return exit_info.value.code, capsys.readouterr().err


PHYSICS = "record --out o --motion dynamics --organ stomach --start 0.4"


def test_flags_of_physics_reach_the_scenario() -> None:
    args = f"{PHYSICS} --angle 3 --deformation rigid --drag incetan2021 --motility fasting"
    args += " --fallback-segment antrum --propulsion --force 0 0 -0.05 --torque 1e-4 0 0 --wall"
    args += " --wrench-frame gut --posture-change prone:time=2,duration=3"
    args += " --posture-change supine:time=9"
    args += " --insufflation 0:1,4:1.3 --settle 0.5 --step 0.01 --substep 2e-4"
    command = cli._parse(args.split())
    assert isinstance(command, Record)
    scenario = command.resolved()
    assert scenario.wall
    assert scenario.motion == Dynamics(
        start=0.4,
        angle=3.0,
        deformation="rigid",
        drag=Drag(law="incetan2021"),
        motility="fasting",
        fallback_segment="antrum",
        propulsion=Propulsion(),
        wrenches=(Wrench(0.0, (0.0, 0.0, -0.05), (1e-4, 0.0, 0.0)),),
        wrench_frame="gut",
        posture_changes=(PostureChange("prone", 2.0, 3.0), PostureChange("supine", 9.0)),
        insufflation=(Insufflation(0.0, 1.0), Insufflation(4.0, 1.3)),
        settle=0.5,
        step=0.01,
        substep=2e-4,
    )
    assert Record(OUT, motion="dynamics").resolved().motion == Dynamics()
    flags = DynamicsFlags(insufflation="1.2", wrench=Path("pull.csv"), friction=0.1)
    assert Record(OUT, motion="dynamics", dynamics=flags).resolved().motion == Dynamics(
        drag=Drag(friction=0.1), wrench_file="pull.csv", insufflation=(Insufflation(0.0, 1.2),)
    )


@pytest.mark.parametrize(
    ("flags", "message"),
    [
        ("--drift 0.1", "--end, --speed, --drift and the other flags of the fly-through"),
        ("--path p.txt", "--path and --motion dynamics exclude each other"),
        ("--start 2", "Dynamics' start is 2.0. Allowed: 0 to 1"),
        ("--angle nan", "Dynamics' angle is nan. Allowed: finite"),
        ("--deformation jelly", "invalid choice"),
        ("--drag none", "invalid choice"),
        (
            "--drag incetan2021 --friction 0.1",
            "--friction goes with --drag physical, not with incetan2021",
        ),
        ("--friction -1", "friction is -1.0. Allowed: 0 or more"),
        ("--propulsion", "Propulsion follows the muscle, but motility is none"),
        ("--motility fasting --fallback-segment tail", "No segment named 'tail'. Known: antrum"),
        ("--force nan 0 0", "entry 0 is not finite. Allowed: finite numbers"),
        (
            "--force 500 0 0 --frames 2 --settle 0.02 --substep 1e-3",
            "Control's force_world is 500 strong. Allowed: up to 100",
        ),
        (
            "--torque 0 0 99 --frames 2 --settle 0.02 --substep 1e-3",
            "Control's torque_world is 99 strong. Allowed: up to 10",
        ),
        ("--wrench {tmp}/none.csv", "none.csv: No such file"),
        ("--wrench {tmp}/bad.csv", "starts with 'a,b', not the header time_s,fx_n"),
        ("--wrench {tmp}/bad.csv --force 1 0 0", "--wrench states force and torque"),
        ("--posture-change upside", "No posture named 'upside'. Known: "),
        (
            "--posture-change prone:time=x",
            "--posture-change prone:time=x: time is 'x'. Allowed: a number",
        ),
        ("--posture-change prone:in=3", "no 'in'. Allowed: POSTURE:time=SECONDS,duration=SECONDS"),
        ("--posture-change prone:duration=0", "a turn takes 0.0 s. Allowed: above 0 s"),
        ("--insufflation much", "--insufflation much is 'much'. Allowed: a number"),
        ("--insufflation 0:1,x:2", "--insufflation 0:1,x:2 is 'x'. Allowed: a number"),
        ("--insufflation 5", "entry 0 is 5.0 at 0.0 s. Allowed: factors of 0.2 to 2"),
        ("--insufflation 1:1,0:1", "time 0 s does not come after 1 s"),
        ("--insufflation 1.1 --settle 0", "settle is 0 s, but the gut needs time"),
        ("--settle -1", "Dynamics' settle is -1.0. Allowed: 0 to 3600 s"),
        ("--step 2", "Dynamics' step is 2.0. Allowed: above 0 to 0.5 s"),
        ("--substep 1", "substep is 1.0. Allowed: above 0 to "),
        ("--motility phase-three --fallback-segment sigmoid", "motility is phase-three, but the"),
    ],
)
def test_mistakes_in_physics_end_in_one_line(
    flags: str, message: str, tube: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "bad.csv").write_text("a,b\n")
    args = f"record --out {tmp_path}/o --motion dynamics --organ {tube} --unit m {flags}"
    status, error = stop(args.format(tmp=tmp_path).split(), capsys)
    assert status == 2
    assert message in error
    if "invalid choice" not in message:
        assert error.count("\n") == 1
    head = tmp_path / "o" / "episode.json"
    assert not head.exists() or '"recording"' in head.read_text()


def test_flags_of_physics_without_it(capsys: pytest.CaptureFixture[str]) -> None:
    status, error = stop(["record", "--out", "o", "--force", "0", "0", "1"], capsys)
    assert status == 2
    assert "go with --motion dynamics or magnet. Add it, or drop" in error


@pytest.fixture(scope="module")
def tube(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A straight lumen with round ends, 30 mm wide and 130 mm long."""
    import trimesh

    path = tmp_path_factory.mktemp("organ") / "tube.ply"
    trimesh.creation.capsule(height=0.1, radius=0.015, count=(16, 16)).export(path)
    return path
