"""Magnets from files, in memory and in capsules: one parser, and one line for each mistake."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from tests.support.small_envs import small_settings
from vrcaps.actuation.steering_program import MagnetSteering
from vrcaps.capsule.device_file import read_device
from vrcaps.config.convert import from_plain, to_plain
from vrcaps.core.errors import InputError, UnknownNameError
from vrcaps.env.actuation import ArmActuation, MagnetActuation
from vrcaps.env.settings import env_settings
from vrcaps.magnet.field import magnet_lines
from vrcaps.magnet.magnets import MAGNETIC_CONSTANT, Magnet, magnet_mesh, remanence_of
from vrcaps.magnet.presets import magnet_of, read_magnet
from vrcaps.magnet.sources import Block, Cylinder, Ring, Sphere
from vrcaps.motion.dynamics import Dynamics
from vrcaps.scenario.scenario import Scenario, scenario_from_plain, scenario_to_plain

MAGNETS = {
    'kind = "cylinder"\ndiameter_mm = 50\nlength_mm = 40\nremanence_t = 1.4': Cylinder(
        0.05, 0.04, 1.4
    ),
    'kind = "ring"\ndiameter_mm = 30\nhole_diameter_mm = 10\nlength_mm = 5\ngrade = "N42"\n'
    'magnetization = "diametric"': Ring(
        0.03, 0.01, 0.005, remanence_of("N42"), magnetization="diametric"
    ),
    'kind = "block"\nsize_mm = [10, 20, 30]\nremanence_t = 1.2': Block((0.01, 0.02, 0.03), 1.2),
    'kind = "sphere"\ndiameter_mm = 50\nmoment_a_m2 = 70': Sphere(
        0.05, 70.0 * MAGNETIC_CONSTANT / (np.pi / 6 * 0.05**3)
    ),
}


@pytest.mark.parametrize("text", MAGNETS)
def test_a_file_is_the_magnet_that_it_describes(tmp_path, text):
    path = tmp_path / "mine.toml"
    path.write_text(text)
    read, expected = read_magnet(str(path)), MAGNETS[text]
    assert type(read) is type(expected)
    assert read.moment == pytest.approx(expected.moment, rel=1e-12)
    assert replace(read, remanence=expected.remanence) == expected
    assert from_plain(Magnet, to_plain(read, Magnet), at="magnet") == read


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (
            "diameter_mm = 5",
            r"mine\.toml: kind is missing\. Allowed: block, cylinder, ring, sphere",
        ),
        ('kind = "cone"', r"mine\.toml: kind is 'cone'\. Allowed: block, cylinder, ring, sphere"),
        (
            'kind = "cylinder"\ndiameter = 5\ngrade = "N52"',
            r"Unknown key diameter\. Allowed: kind, diameter_mm, length_mm, magnetization, and one "
            r"of grade, remanence_t, moment_a_m2",
        ),
        ('kind = "sphere"\ndiameter_mm = 5', r"0 strengths are given\. Allowed: kind, diameter_mm"),
        ('kind = "sphere"\ndiameter_mm = -5\ngrade = "N52"', r"diameter is -0\.005\. Allowed"),
        ('kind = "sphere"\ndiameter_mm = 5\ngrade = "N99"', r"No grade named 'N99'\. Known: N35"),
        ('kind = "sphere"\ndiameter_mm = 5\nmoment_a_m2 = 1', r"takes a remanence of 19\.2 T"),
        ('kind = "sphere"\ndiameter_mm = 5\nremanence_t = "a"', r"remanence_t is 'a'\. Allowed"),
        ('kind = "block"\nsize_mm = [1, 2]\ngrade = "N52"', r"size_mm has 2 values\. Allowed: 3"),
        ('kind = "block"\nsize_mm = [1, 2, 0]\ngrade = "N52"', "size is .*three edges above 0"),
        (
            'kind = "ring"\ndiameter_mm = 5\nhole_diameter_mm = 6\nlength_mm = 1\ngrade = "N52"',
            r"hole_diameter is 0\.006 m\. Allowed: below the outer diameter, 0\.005 m",
        ),
        ("[[", "is not TOML"),
    ],
)
def test_a_file_that_describes_no_magnet_is_one_line(tmp_path, text, message):
    path = tmp_path / "mine.toml"
    path.write_text(text)
    with pytest.raises((InputError, UnknownNameError), match=message) as raised:
        read_magnet(path)
    assert "\n" not in str(raised.value)
    assert "mine.toml" in str(raised.value)


def test_what_is_no_magnet_at_all():
    with pytest.raises(InputError, match=r"type int\. Allowed: a name \(cylinder-152\.4, .*Sphere"):
        magnet_of(3)  # type: ignore[arg-type]
    with pytest.raises(UnknownNameError, match="No magnet named 'big'"):
        MagnetSteering(magnet="big")
    with pytest.raises(InputError, match=r"Cannot read the magnet file no/mine\.toml"):
        MagnetActuation(magnet="no/mine.toml")
    with pytest.raises(InputError, match=r"diameter is 'a'\. Allowed: a number, above 0 to 1 m"):
        Cylinder("a", 0.05, 1.0)  # type: ignore[arg-type]
    with pytest.raises(InputError, match=r"remanence is 3\.0\. Allowed: above 0 to 2 T"):
        Cylinder(0.05, 0.05, 3.0)


@pytest.mark.parametrize("actuation", [MagnetActuation, ArmActuation])
def test_environments_take_a_magnet_in_memory(actuation):
    own = Cylinder(0.06, 0.05, 1.3, magnetization="diametric")
    settings = small_settings(actuation=actuation(magnet=own))
    assert hash(settings.actuation) == hash(actuation(magnet=replace(own)))
    from vrcaps.env.simulation import Simulation

    simulation = Simulation(settings, 1)
    simulation.reset(0, np.random.default_rng(0))
    (source,) = simulation.worlds.batch.worlds[0]._magnetic.sources
    assert source == own
    np.testing.assert_allclose(source.T_world_magnet, simulation.memory["magnet/T"][0], atol=1e-12)


def test_parts_of_environments_may_be_tables():
    table = {"kind": "magnet", "magnet": {"kind": "sphere", "diameter": 0.05, "remanence": 1.4}}
    assert env_settings(actuation=table).actuation == MagnetActuation(magnet=Sphere(0.05, 1.4))
    with pytest.raises(InputError, match=r"Unknown key actuation\.magnit\. Allowed: magnet, speed"):
        env_settings(actuation={"kind": "magnet", "magnit": "cylinder-76.2"})


def test_a_scenario_holds_the_magnet_of_a_file(tmp_path):
    path = tmp_path / "mine.toml"
    path.write_text('kind = "sphere"\ndiameter_mm = 60\ngrade = "N52"')
    scenario = Scenario("stomach", "magnetic", motion=Dynamics(magnet=MagnetSteering(str(path))))
    path.unlink()
    again = scenario_from_plain(scenario_to_plain(scenario))
    assert again.motion.magnet.magnet == Sphere(0.06, 1.455)
    table = {"kind": "block", "size_mm": [50, 50, 50], "grade": "N52"}
    plain = {"capsule": "magnetic", "motion": {"kind": "dynamics", "magnet": {"magnet": table}}}
    assert scenario_from_plain(plain, units=True).motion.magnet.magnet.size == (0.05, 0.05, 0.05)


def test_capsules_contain_magnets_by_size_and_grade(tmp_path):
    own = tmp_path / "own.toml"
    base = (read_device_path("magnetic")).read_text()
    shape = 'kind = "cylinder"\ndiameter_mm = 11\nlength_mm = 10\nremanence_t = 1.48'
    text = base[: base.index("[[magnets]]")]
    own.write_text(f"{text}[[magnets]]\nposition_mm = [0, 0, -3]\ndirection = [0, 0, 1]\n{shape}\n")
    expected = read_device("magnetic").magnets[0]
    (magnet,) = read_device(own).magnets
    np.testing.assert_allclose(magnet.moment_capsule, expected.moment_capsule, rtol=1e-12)
    for wrong, message in (
        (
            shape.replace("= 11", "= 13"),
            r"weighs 9\.95 g and is 10 mm wide\. Allowed: up to the capsule's 9\.9 g and 12 mm",
        ),
        (shape.replace('kind = "cylinder"\n', ""), r"Allowed: position_mm with moment_a_m2; or"),
    ):
        own.write_text(
            f"{text}[[magnets]]\nposition_mm = [0, 0, -3]\ndirection = [0, 0, 1]\n{wrong}\n"
        )
        with pytest.raises(InputError, match=message):
            read_device(own)


def read_device_path(name):
    from vrcaps.capsule.device_file import _DEVICES

    return _DEVICES.find(name)


@pytest.mark.parametrize("text", MAGNETS)
def test_mesh_bounds_and_lines_fit_the_magnet(text):
    magnet = MAGNETS[text]
    mesh = magnet_mesh(magnet)
    assert mesh.is_watertight
    assert mesh.volume == pytest.approx(magnet.volume, rel=1e-2)
    radius, half = (0.5 * extent for extent in magnet.bounds)
    assert np.hypot(*mesh.vertices[:, :2].T).max() <= radius * (1 + 1e-9)
    assert np.abs(mesh.vertices[:, 2]).max() == pytest.approx(half)
    lines = magnet_lines(magnet, reach=0.2, step=2e-3, rings=2, meridians=3)
    assert len(lines) == 6
