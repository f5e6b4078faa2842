"""The flags of `vrcaps record --motion magnet`."""

from __future__ import annotations

from pathlib import Path

import pytest
import tyro

from vrcaps import cli
from vrcaps.cli.record import Record
from vrcaps.motion.dynamics import Dynamics
from vrcaps.scenario.scenario import scenario_from_plain, scenario_to_plain
from vrcaps.units import MM


def test_flags_reach_the_scenario_and_the_file(tmp_path: Path):
    flags = (
        "--out o --organ stomach --capsule magnetic --motion magnet --arm panda --wall-side upper "
        "--wall-force 0.2 --magnet cylinder-76.2 --standoff-mm 30 --steering-speed-mm-per-s 8 "
        "--arm-base 0 0.5 0 "
        "--steering-end 0.8 --posture-change prone:time=1"
    )
    scenario = tyro.cli(Record, args=flags.split()).resolved()
    assert isinstance(scenario.motion, Dynamics)
    magnet = scenario.motion.magnet
    assert magnet is not None
    assert (magnet.magnet, magnet.arm, magnet.wall) == ("cylinder-76.2", "panda", "upper")
    assert magnet.gains.upper_wall_force == magnet.gains.lower_wall_force == 0.2
    assert magnet.standoff == pytest.approx(30 * MM)
    assert magnet.speed == pytest.approx(8 * MM)
    assert magnet.end == 0.8
    assert magnet.arm_base == (0.0, 0.5, 0.0)
    assert len(scenario.motion.posture_changes) == 1
    assert scenario_from_plain(scenario_to_plain(scenario)) == scenario


@pytest.mark.parametrize(
    ("flags", "message"),
    [
        ("--arm panda", "go with --motion magnet. Add it, or drop them"),
        ("--motion magnet --path x.txt", "--path and --motion magnet exclude each other"),
        ("--motion magnet --standoff-mm 0", "MagnetSteering's standoff is 0.0"),
        ("--motion magnet --speed 1", "--motion magnet lets the capsule move by itself"),
    ],
)
def test_mistakes_end_in_one_line(flags, message, tmp_path, capsys):
    with pytest.raises(SystemExit) as stopped:
        cli.main(f"record --out {tmp_path}/o {flags}".split())
    assert stopped.value.code == 2
    error = capsys.readouterr().err
    assert message in error
    assert error.count("\n") == 1
