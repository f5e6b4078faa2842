"""`vrcaps magnet`: what it prints is what the fields give, and one line for each mistake."""

from __future__ import annotations

import numpy as np
import pytest
from PIL import Image

from vrcaps.capsule.device_file import read_device
from vrcaps.cli.magnet import List, Show, properties, pull
from vrcaps.core.errors import InputError
from vrcaps.magnet.presets import read_magnet


def test_the_pull_is_that_of_two_dipoles_far_away():
    """F = 3 μ₀ m₁ m₂/(2π r⁴); 0.41 N at 20 cm from the center of the published magnet."""
    magnet, inside = read_magnet("cylinder-101.6"), read_device("magnetic").magnets
    gaps = np.array([0.2, 1.0]) - 0.5 * 0.1016 + 3e-3  # of the capsule's magnet, 3 mm behind
    (near, far), _ = pull(magnet, inside, gaps)
    assert near == pytest.approx(0.41, rel=0.05)
    assert far == pytest.approx(3 * 4e-7 * np.pi * 970.1 * 1.12 / (2 * np.pi), rel=0.02)


def test_it_prints_and_draws(tmp_path, capsys):
    path = tmp_path / "mine.toml"
    path.write_text('kind = "block"\nsize_mm = [20, 30, 40]\ngrade = "N52"')
    Show(str(path), picture=tmp_path / "mine.png").run()
    printed = capsys.readouterr().out
    assert "Magnet: block, size 20 x 30 x 40 mm, magnetized along z." in printed
    assert "Moment: 27.79 A·m². Mass: 0.18 kg, as NdFeB." in printed
    with Image.open(tmp_path / "mine.png") as picture:
        assert picture.width > 1000
    List().run()
    assert "capsule-6x6: In a usual capsule" in capsys.readouterr().out
    assert len(properties(read_magnet("cylinder-50.8"))) == 3


def test_a_figure_has_the_whole_name_of_the_magnet(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    Show("cylinder-50.8").run()
    assert [path.name for path in tmp_path.iterdir()] == ["cylinder-50.8-field.png"]


def test_a_capsule_without_a_magnet_is_one_line(tmp_path):
    with pytest.raises(InputError, match=r"Capsule mirocam contains no magnet\. Give"):
        Show("cylinder-50.8", capsule="mirocam", picture=tmp_path / "a.png").run()
    with pytest.raises(InputError, match=r"^--picture is .*a\.gif\. Allowed"):
        Show("cylinder-50.8", picture=tmp_path / "a.gif").run()
    with pytest.raises(InputError, match=r"^--picture is .*, but the folder .* does not exist"):
        Show("cylinder-50.8", picture=tmp_path / "no" / "a.png").run()
