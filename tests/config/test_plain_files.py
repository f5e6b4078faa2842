"""Files of plain values: exact decimals, and what is wrong in one line."""

from decimal import Decimal

import pytest

from vrcaps.config.plain_files import read_plain, write_toml
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
