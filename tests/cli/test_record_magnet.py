"""`vrcaps record --motion dynamics` with a magnet outside."""

from __future__ import annotations

from dataclasses import replace

import pytest

from vrcaps import cli
from vrcaps.actuation.steering_program import GENTLE_GAINS
from vrcaps.cli.record import Record
from vrcaps.motion.dynamics import Dynamics
from vrcaps.scenario.scenario import scenario_from_plain, scenario_to_plain


def test_values_reach_the_scenario_and_the_file():
    values = (
        "arm=panda",
        "wall=upper",
        "gains.upper_wall_force=0.2",
        "magnet=cylinder-76.2",
        "standoff=0.03",
        "speed=0.008",
        "arm_base=[0, 0.5, 0]",
        "end=0.8",
    )
    args = [
        "record",
        "--out",
        "o",
        "--organ",
        "stomach",
        "--capsule",
        "magnetic",
        "--motion",
        "dynamics",
    ]
    args += ["--pose", "located"]
    args += [word for value in values for word in ("--set", f"motion.magnet.{value}")]
    command = cli._parse(args)
    assert isinstance(command, Record)
    scenario = command.resolved()
    assert isinstance(scenario.motion, Dynamics)
    magnet = scenario.motion.magnet
    assert magnet is not None
    assert (magnet.magnet, magnet.arm, magnet.wall) == ("cylinder-76.2", "panda", "upper")
    assert magnet.pose == "located"
    gains = replace(GENTLE_GAINS, upper_wall_force=0.2)
    assert (magnet.standoff, magnet.speed, magnet.end) == (0.03, 0.008, 0.8)
    assert magnet.gains == gains
    assert magnet.arm_base == (0.0, 0.5, 0.0)
    assert scenario_from_plain(scenario_to_plain(scenario)) == scenario


@pytest.mark.parametrize("steered", ["magnet", "coils"])
def test_a_file_of_commands_steers_the_magnet_or_the_coils(steered, tmp_path):
    commands = tmp_path / "commands.csv"
    commands.write_text(
        "time_s,linear_x,linear_y,linear_z,angular_x,angular_y,angular_z\n0,1,0,0,0,0,0\n"
    )
    words = f"record --organ stomach --capsule magnetic --motion dynamics --steer {commands}"
    command = cli._parse([*words.split(), "--set", f"motion.{steered}={{}}"])
    assert isinstance(command, Record)
    motion = command.resolved().motion
    assert isinstance(motion, Dynamics)
    files = {
        name: None if part is None else part.command_file
        for name, part in (("magnet", motion.magnet), ("coils", motion.coils))
    }
    assert [name for name, file in files.items() if file is not None] == [steered]
    assert str(commands) in str(files[steered])


@pytest.mark.parametrize(
    ("flags", "message"),
    [
        ("--set motion.magnet.arm=panda", "motion.kind is missing. Allowed: dynamics, "),
        (
            "--motion dynamics --set motion.magnet.standoff=0",
            "motion.magnet: standoff is 0.0",
        ),
        ("--motion dynamics --speed 1", "Unknown key motion.speed. Allowed: start, angle"),
    ],
)
def test_mistakes_end_in_one_line(flags, message, tmp_path, capsys):
    with pytest.raises(SystemExit) as stopped:
        cli.main(f"record --out {tmp_path}/o {flags}".split())
    assert stopped.value.code == 2
    error = capsys.readouterr().err
    assert message in error
    assert error.count("\n") == 1
