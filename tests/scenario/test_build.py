"""Lesions as users name them."""

import pytest

from vrcaps.core.errors import InputError, UnknownNameError
from vrcaps.lesion import Colitis, Polyp
from vrcaps.scenario.scenario import parse_lesions


def test_file_first_then_one_by_one(tmp_path):
    path = tmp_path / "mine.toml"
    path.write_text('[[lesions]]\nkind = "colitis"\nmayo = 3\n')
    assert parse_lesions(["polyp-Ip"], str(path), 0, "colon") == (
        Colitis(mayo=3),
        Polyp(shape="Ip"),
    )


def test_prevalence_goes_with_the_patient():
    drawn = [parse_lesions([], "prevalence", seed, "full-tract") for seed in (1, 1, 2)]
    assert drawn[0] == drawn[1] != drawn[2]


def test_errors():
    with pytest.raises(UnknownNameError, match="No lesion named 'wart'"):
        parse_lesions(["wart"], None, 0, "colon")
    with pytest.raises(InputError, match="Cannot read the lesions"):
        parse_lesions([], "absent.toml", 0, "colon")
    with pytest.raises(InputError, match="a table of the colon, but the organ is stomach"):
        parse_lesions([], "prevalence", 0, "stomach")
