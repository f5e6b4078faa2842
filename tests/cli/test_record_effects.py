"""Effects on the command line, and what a user may get wrong about them."""

from __future__ import annotations

from pathlib import Path

import pytest

from vrcaps import cli
from vrcaps.camera_pipeline.effect.sensor import BayerFilter
from vrcaps.camera_pipeline.effects import Effects
from vrcaps.cli.record import Record

BASE = "record --out o --organ colon --frames 2"


def resolved(text: str) -> Effects:
    command = cli._parse([*BASE.split(), "--effects", text])
    assert isinstance(command, Record)
    return command.resolved().effects


def test_effects_reach_the_scenario() -> None:
    assert resolved("specular=3,dof=1") == Effects(specular=3, depth_of_field=1)
    assert resolved("noise=1..3,bayer=bggr") == Effects(
        sensor_noise=(1, 3), bayer_filter=BayerFilter("bggr")
    )
    assert resolved("bloom=1,random,jpeg=0") == Effects(jpeg=0, random=True)
    assert Record().resolved().effects == Effects()


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("glow=3", "No effect named 'glow'. Known: adaptive_frame_rate, ae"),
        ("bloom=7", "Effect bloom has the severity 7. Allowed: 0 to 4"),
        ("bloom", "Effect bloom has the severity ''. Allowed: bloom=0 to bloom=4"),
        ("bayer=none", "No pattern named 'none'. Known: bggr, gbrg"),
    ],
)
def test_mistakes_end_in_one_line_and_status_2(
    text: str, words: str, capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(SystemExit) as exit_info:
        cli.main([*BASE.split(), "--effects", text])
    error = capsys.readouterr().err
    assert exit_info.value.code == 2
    assert error.count("\n") == 1
    assert words in error


@pytest.mark.parametrize(
    ("table", "words"),
    [
        (
            "sensor_noise = { full_well = 1000, read_noise = -2 }",
            "SensorNoise's read_noise is -2.0",
        ),
        ("depth_of_field = { aperture = 0 }", "DepthOfField's aperture is 0.0. Allowed: above 0"),
        (
            "specular = { clearcoat = 0.5, ior = 0.8 }",
            "SpecularReflection's ior is 0.8. Allowed: 1 to below 3",
        ),
        (
            "sensor_noise = { full_wel = 1000 }",
            "Unknown key effects.sensor_noise.full_wel",
        ),
        ("bloom = 'much'", "effects.bloom is 'much'"),
    ],
)
def test_mistakes_in_a_scenario_file(
    table: str, words: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "scenario.toml"
    path.write_text(f"[effects]\n{table}\n")
    with pytest.raises(SystemExit) as exit_info:
        cli.main(["record", "--out", str(tmp_path / "o"), str(path)])
    error = capsys.readouterr().err
    assert exit_info.value.code == 2
    assert error.count("\n") == 1
    assert words in error
