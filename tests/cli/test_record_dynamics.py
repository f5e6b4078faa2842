"""`vrcaps record --motion dynamics` with its values, and every mistake in them."""

from __future__ import annotations

from pathlib import Path

import pytest

from vrcaps import cli
from vrcaps.cli.record import Record
from vrcaps.motion.dynamics import Dynamics
from vrcaps.tissue.motility.motility import Propulsion
from vrcaps.tissue.tissue import Drag
from vrcaps.world.schedule import Insufflation, PostureChange, Wrench


def stop(args: list[str], capsys: pytest.CaptureFixture[str]) -> tuple[int, str]:
    """Exit status and stderr of a command that stops early."""
    with pytest.raises(SystemExit) as exit_info:
        cli.main(args)
    assert isinstance(exit_info.value.code, int)
    return exit_info.value.code, capsys.readouterr().err


DYNAMICS = "record --out o --motion dynamics --organ stomach --start 0.4"
MOTION = (
    "angle=3",
    "deformation=rigid",
    "drag.law=incetan2021",
    "motility=fasting",
    "fallback_segment=antrum",
    "propulsion={}",
    "wrenches=[{force=[0, 0, -0.05], torque=[1e-4, 0, 0]}]",
    "wrench_frame=gut",
    "posture_changes=[{posture='prone', time=2, duration=3}, {posture='supine', time=9}]",
    "insufflation=[{}, {time=4, factor=1.3}]",
    "settle=0.5",
    "step=0.01",
    "substep=2e-4",
)


def changes(values: tuple[str, ...]) -> list[str]:
    """Flags that set values of the motion."""
    return [word for value in values for word in ("--set", f"motion.{value}")]


def test_values_of_the_motion_reach_the_scenario() -> None:
    command = cli._parse([*DYNAMICS.split(), "--set", "wall=true", *changes(MOTION)])
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


@pytest.mark.slow
@pytest.mark.parametrize(
    ("values", "message"),
    [
        (["drift=0.1"], "Unknown key motion.drift. Allowed: start, angle"),
        (["start=2"], "Dynamics' start is 2.0. Allowed: 0 to 1"),
        (["angle=nan"], "Dynamics' angle is nan. Allowed: finite"),
        (["deformation=jelly"], "motion.deformation is 'jelly'. Allowed: 'spring', 'fem', 'rigid'"),
        (["drag.law=none"], "motion.drag.law is 'none'. Allowed: 'incetan2021'"),
        (["drag.friction=-1"], "motion.drag: friction is -1.0. Allowed: 0 or more"),
        (["propulsion={}"], "Propulsion requires motility, but motility is none"),
        (["motility=fasting", "fallback_segment=tail"], "No segment named 'tail'. Known: antrum"),
        (["wrenches=[{force=[nan, 0, 0]}]"], "entry 0 is not finite. Allowed: finite numbers"),
        (
            ["wrenches=[{force=[500, 0, 0]}]", "settle=0.02", "substep=1e-3"],
            "Control's force_world is 500 strong. Allowed: up to 100",
        ),
        (
            ["wrenches=[{torque=[0, 0, 99]}]", "settle=0.02", "substep=1e-3"],
            "Control's torque_world is 99 strong. Allowed: up to 10",
        ),
        (["wrench_file={tmp}/none.csv"], "none.csv: No such file"),
        (["wrench_file={tmp}/bad.csv"], "starts with 'a,b', not the header time_s,fx_n"),
        (
            ["wrench_file={tmp}/bad.csv", "wrenches=[{force=[1, 0, 0]}]"],
            "wrenches and wrench_file are both given",
        ),
        (["posture_changes=[{posture='upside'}]"], "No posture named 'upside'. Known: "),
        (["posture_changes=[{posture='prone', time='x'}]"], "[0].time is 'x'. Allowed: a number"),
        (["posture_changes=[{posture='prone', in=3}]"], "changes[0].in. Allowed: posture, time"),
        (["posture_changes=[{posture='prone', duration=0}]"], "takes 0.0 s. Allowed: above 0 s"),
        (["insufflation=much"], "motion.insufflation is 'much'. Allowed: a list"),
        (["insufflation=[{factor=5}]"], "entry 0 is 5.0 at 0.0 s. Allowed: factors of 0.2 to 2"),
        (["insufflation=[{time=1}, {time=0}]"], "time 0 s does not come after 1 s"),
        (["insufflation=[{factor=1.1}]", "settle=0"], "settle is 0 s, but the gut needs time"),
        (["settle=-1"], "Dynamics' settle is -1.0. Allowed: 0 to 3600 s"),
        (["step=2"], "Dynamics' step is 2.0. Allowed: above 0 to 0.5 s"),
        (["substep=1"], "substep is 1.0. Allowed: above 0 to "),
        (["motility=phase-three", "fallback_segment=sigmoid"], "motility is phase-three, but the"),
    ],
)
def test_mistakes_end_in_one_line(
    values: list[str], message: str, tube: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "bad.csv").write_text("a,b\n")
    args = f"record --out {tmp_path}/o --frames 2 --motion dynamics --organ {tube} --unit m"
    given = tuple(value.replace("{tmp}", str(tmp_path)) for value in values)
    status, error = stop([*args.split(), *changes(given)], capsys)
    assert status == 2
    assert message in error
    assert error.count("\n") == 1
    head = tmp_path / "o" / "episode.json"
    assert not head.exists() or '"recording"' in head.read_text()


def test_values_of_another_kind_of_motion(capsys: pytest.CaptureFixture[str]) -> None:
    status, error = stop(["record", "--out", "o", "--set", "motion.motility=fasting"], capsys)
    assert status == 2
    assert "motion.kind is missing. Allowed: dynamics, fly-through, random-views" in error


@pytest.fixture(scope="module")
def tube(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A straight lumen with round ends, 30 mm wide and 130 mm long."""
    import trimesh

    path = tmp_path_factory.mktemp("organ") / "tube.ply"
    trimesh.creation.capsule(height=0.1, radius=0.015, count=(16, 16)).export(path)
    return path
