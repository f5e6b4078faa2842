"""Files of plain values: exact decimals, their conversion to SI, and one-line errors."""

import math
from decimal import Decimal

import numpy as np
import pytest

from vrcaps.config.plain_files import as_floats, from_si, read_plain, to_si, write_toml
from vrcaps.core.errors import InputError


def test_toml_is_read_with_decimals_and_written_back(tmp_path):
    path = tmp_path / "a.toml"
    value = {"a b": [1, Decimal("2.50"), True, 'say "µ"\n\x7f'], "c": {"d": Decimal("1E-7")}}
    write_toml(path, value, "test")
    assert read_plain(path, "test") == value
    assert [found.name for found in tmp_path.iterdir()] == ["a.toml"]


def test_json_is_read_as_floats(tmp_path):
    path = tmp_path / "a.json"
    path.write_text('{"a": 0.1}')
    assert read_plain(path, "test") == {"a": 0.1}


def test_a_file_without_an_end_is_refused(tmp_path, monkeypatch):
    monkeypatch.setattr("vrcaps.config.plain_files._LONGEST", 6)
    (tmp_path / "a.json").write_text("[1, 2]")
    assert read_plain(tmp_path / "a.json", "test") == [1, 2]
    (tmp_path / "a.json").write_text("[1, 2] ")
    with pytest.raises(InputError, match="is not JSON: it has more than 6 characters"):
        read_plain(tmp_path / "a.json", "test")


@pytest.mark.parametrize(("name", "text"), [("a.toml", "a = 1"), ("a.json", '{"a": 1}')])
def test_marks_of_windows_editors_are_no_values(tmp_path, name, text):
    (tmp_path / name).write_bytes(text.encode("utf-8-sig"))
    assert read_plain(tmp_path / name, "test") == {"a": 1}


@pytest.mark.parametrize(
    ("name", "content", "match"),
    [
        ("a.toml", b"a =", "The test file .*a.toml is not TOML"),
        ("a.json", b"{", "The test file .*a.json is not JSON"),
        ("a.toml", b"\xff", "is not TOML"),
        ("a.toml", f"x = 1e{'9' * 30}".encode(), "is not TOML"),
        ("a.toml", b"x = 0x" + b"f" * 6000, "is not TOML: it contains an integer of more than 64"),
        ("a.json", b"[" + b"1" * 30 + b"]", "is not JSON: it contains an integer of more than 64"),
        ("a.json", b"[" * 900 + b"]" * 900, "is not JSON: its tables or lists are nested more"),
        ("a.json", rb'{"a": "\ud800"}', "is not JSON: .*surrogates not allowed"),
        ("a.toml", None, "Cannot read the test file .*a.toml: No such file"),
    ],
)
def test_unreadable_files(tmp_path, name, content, match):
    if content is not None:
        (tmp_path / name).write_bytes(content)
    with pytest.raises(InputError, match=match):
        read_plain(tmp_path / name, "test")


def test_unwritable_values_and_places(tmp_path):
    with pytest.raises(InputError, match=r"Cannot write the test file .* as TOML: Object of type"):
        write_toml(tmp_path / "a.toml", {"a": object()}, "test")
    with pytest.raises(InputError, match=r"Cannot write the test file .*: No such file"):
        write_toml(tmp_path / "none" / "a.toml", {}, "test")


@pytest.mark.parametrize(
    ("value", "unit", "text"),
    [
        (0.0054, "mm", "5.4"),
        (0.0245, "mm", "24.5"),
        (0.0, "mm", "0"),
        (-0.00065, "mm", "-0.65"),
        (math.radians(85.0), "deg", "85"),
        (math.pi, "deg", "180"),
        (0.25, "", "0.25"),
    ],
)
def test_shortest_decimal(value, unit, text):
    assert str(from_si(value, unit)) == text
    assert to_si(Decimal(text), unit) == value


def test_every_float_survives_any_unit():
    rng = np.random.default_rng(0)
    values = rng.normal(size=300) * 10.0 ** rng.integers(-12, 12, 300)
    for value in [*values.tolist(), 5e-324, 1.7e308, 0.1 + 0.2]:
        for unit in ("mm", "deg", "px"):
            assert to_si(Decimal(str(from_si(value, unit))), unit) == value


def test_floats_and_whole_numbers_are_units_too():
    assert to_si(5.4, "mm") == 0.0054
    assert to_si(85, "deg") == math.radians(85.0)


def test_decimals_within_lists_and_tables():
    assert as_floats({"a": [Decimal("0.1"), 2], "b": "x"}) == {"a": [0.1, 2], "b": "x"}
