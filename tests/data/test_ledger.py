"""Ledgers of others: entries are typed, and what they name lies in the data set."""

import json

import pytest

from vrcaps.core.errors import InputError
from vrcaps.data import dataset
from vrcaps.data.ledger import FAILED, LEDGER, PLAN, entries, failures, read_plain_plan
from vrcaps.data.store import LocalStore

ENTRY = {
    "number": 0,
    "patient": 0,
    "split": "train",
    "files": {"episode.json": "0" * 64},
    "bytes": 10,
    "about": {"frames": 2, "seconds": 0.5, "cameras": {}, "segments": {}},
    "organ": {"path": f"organs/{'a' * 64}.glb", "sha256": "0" * 64, "bytes": 5},
}


@pytest.fixture
def store(tmp_path) -> LocalStore:
    for name in (LEDGER, FAILED):
        (tmp_path / name).mkdir()
    (tmp_path / PLAN).write_text('{"dataset": {}}')
    (tmp_path / LEDGER / "a.json").write_text(json.dumps(ENTRY))
    (tmp_path / LEDGER / "._a.json").write_bytes(b"\0\5\x16\7")
    return LocalStore(tmp_path)


def test_an_entry_is_read_as_it_is(store):
    assert entries(store) == {"a": ENTRY}
    assert [(m.name, m.patient, m.split) for m in dataset.open(store.folder)] == [("a", 0, "train")]


@pytest.mark.parametrize("text", ["[]", "{}", "null", "3", "[" * 5000, "{", "\ufeff{", "NaN"])
def test_what_is_no_entry_is_one_line(store, text):
    (store.folder / LEDGER / "a.json").write_text(text)
    with pytest.raises(InputError, match=r"ledger/a\.json is damaged .*Delete it") as error:
        entries(store)
    assert "\n" not in str(error.value)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"number": "x"}, "number is 'x'"),
        ({"number": -1}, "number is -1"),
        ({"patient": [1]}, r"patient is \[1\]"),
        ({"patient": True}, "patient is True"),
        ({"split": None}, "split is None"),
        ({"split": "../../x"}, r"split is '\.\./\.\./x'"),
        ({"files": {"../../x": "0"}}, r"The name of a file is '\.\./\.\./x'"),
        ({"files": {"/etc/passwd": "0"}}, "The name of a file is '/etc/passwd'"),
        ({"files": {"a": 1}}, "Checksum of a is 1"),
        ({"organ": {**ENTRY["organ"], "path": "../../x.glb"}}, "path is '../../x.glb'"),
        ({"about": {**ENTRY["about"], "frames": 10**12}}, r"about\.frames is 1000000000000"),
        ({"about": {**ENTRY["about"], "seconds": "1"}}, r"about\.seconds is '1'"),
        ({"about": {**ENTRY["about"], "cameras": []}}, r"about\.cameras is \[\]"),
        ({"more": 1}, "unknown key more"),
    ],
)
def test_values_of_an_entry_are_checked(store, change, message):
    (store.folder / LEDGER / "a.json").write_text(json.dumps(ENTRY | change))
    with pytest.raises(InputError, match=message):
        dataset.open(store.folder)


def test_failures_and_plans_are_checked(store):
    (store.folder / FAILED / "b.json").write_text('{"number": 1}')
    with pytest.raises(InputError, match=r"failed/b\.json is damaged .*missing key error"):
        failures(store)
    for text in ("[]", "[" * 5000, "{"):
        (store.folder / PLAN).write_text(text)
        with pytest.raises(InputError, match=r"plan\.json is damaged"):
            read_plain_plan(store)
