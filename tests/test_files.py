"""Files are written whole or not at all."""

import hashlib
import os

import numpy as np
import pytest

from vrcaps.files import (
    TEMPORARY,
    atomic_write,
    file_sha256,
    is_new_folder,
    read_arrays,
    sync_folder,
    write_arrays,
    write_bytes,
    write_json,
)


def test_a_failed_write_leaves_what_was_there(tmp_path):
    path = tmp_path / "file.bin"
    write_bytes(path, b"old")

    def fail():
        with atomic_write(path) as temporary:
            temporary.write_bytes(b"half of the new")
            raise OSError("disk full")

    with pytest.raises(OSError, match="disk full"):
        fail()
    assert path.read_bytes() == b"old"
    assert [p.name for p in tmp_path.iterdir()] == ["file.bin"]


def test_json_refuses_nan(tmp_path):
    with pytest.raises(ValueError, match="not JSON compliant"):
        write_json(tmp_path / "x.json", {"value": float("nan")})
    assert list(tmp_path.iterdir()) == []


def test_two_writers_of_one_file_do_not_disturb_each_other(tmp_path):
    path = tmp_path / "file.bin"
    with atomic_write(path) as first, atomic_write(path) as second:
        assert first != second
        assert first.name.startswith(f".{path.name}.") and first.name.endswith(TEMPORARY)
        first.write_bytes(b"first")
        second.write_bytes(b"second")
    assert path.read_bytes() == b"first"
    assert [p.name for p in tmp_path.iterdir()] == ["file.bin"]


def test_pieces_are_written_in_order(tmp_path):
    write_bytes(tmp_path / "a", [b"one ", b"two"])
    assert (tmp_path / "a").read_bytes() == b"one two"
    assert file_sha256(tmp_path / "a") == hashlib.sha256(b"one two").hexdigest()


def test_bytes_are_on_the_disk_before_their_name(tmp_path, monkeypatch):
    calls, sync, rename = [], os.fsync, os.replace
    monkeypatch.setattr(os, "fsync", lambda f: calls.append(os.fstat(f).st_size) or sync(f))
    monkeypatch.setattr(os, "replace", lambda *paths: calls.append("name") or rename(*paths))
    write_bytes(tmp_path / "a", b"1234")
    assert calls == [4, "name"]
    sync_folder(tmp_path)
    assert len(calls) == 3


def test_damaged_arrays_are_errors_of_reading(tmp_path):
    path = tmp_path / "a.npz"
    write_arrays(path, {"x": np.arange(300.0), "n": np.array(3)})
    assert read_arrays(path)["n"] == 3
    whole = path.read_bytes()
    cut = [whole[:size] for size in range(0, len(whole), 90)]
    changed = [
        whole[:k] + bytes([whole[k] ^ 255]) + whole[k + 1 :] for k in range(0, len(whole), 9)
    ]
    for data in (*cut, *changed):
        path.write_bytes(data)
        try:
            assert set(read_arrays(path)) <= {"x", "n"} or data in changed
        except (OSError, ValueError):
            continue
        assert data in changed
    np.save(tmp_path / "b.npy", np.zeros(3))
    with pytest.raises(ValueError, match="no whole NumPy archive"):
        read_arrays(tmp_path / "b.npy")


def test_a_new_folder_is_one_that_is_not_there_or_empty(tmp_path):
    (tmp_path / "empty").mkdir()
    (tmp_path / "full").mkdir()
    (tmp_path / "full" / "file").touch()
    names = ("none", "empty", "full", "full/file")
    assert [is_new_folder(tmp_path / name) for name in names] == [True, True, False, False]
