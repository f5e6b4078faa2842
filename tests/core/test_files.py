"""Files are written whole or not at all."""

import errno
import hashlib
import os
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pytest

from vrcaps.core import files
from vrcaps.core.errors import InputError, StorageError
from vrcaps.core.files import (
    atomic_folder,
    atomic_write,
    decode_array,
    file_sha256,
    is_new_folder,
    is_temporary,
    read_arrays,
    remove_stale,
    scratch_folder,
    sync_folder,
    write_arrays,
    write_bytes,
    write_json,
)
from vrcaps.core.processes import FolderInUseError


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
        assert first.name.startswith(f".{path.name}.") and is_temporary(first.name)
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
    with pytest.raises(ValueError, match="not a complete NumPy archive"):
        read_arrays(tmp_path / "b.npy")


def test_a_new_folder_is_one_that_is_not_there_or_empty(tmp_path):
    (tmp_path / "empty").mkdir()
    (tmp_path / "full").mkdir()
    (tmp_path / "full" / "file").touch()
    names = ("none", "empty", "full", "full/file")
    assert [is_new_folder(tmp_path / name) for name in names] == [True, True, False, False]


HOLD = """
import sys
from pathlib import Path
from vrcaps.core.files import atomic_folder, atomic_write
kind, path = sys.argv[1], Path(sys.argv[2])
with (atomic_write if kind == "file" else atomic_folder)(path) as temporary:
    (temporary if kind == "file" else temporary / "part").write_text("half")
    print("held", flush=True)
    sys.stdin.read()
"""


@contextmanager
def held_by_another_process(kind: str, path: Path) -> Iterator[subprocess.Popen]:
    """Another process that is writing a file or a folder, killed after the block."""
    command = [sys.executable, "-c", HOLD, kind, str(path)]
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE) as other:
        assert other.stdout is not None
        assert other.stdout.readline() == b"held\n"
        yield other
        other.kill()


@pytest.mark.slow
@pytest.mark.skipif(os.name == "nt", reason="Windows locks no open file")
def test_the_temporary_file_of_a_killed_process_is_removed_and_of_a_running_one_stays(tmp_path):
    path = tmp_path / "file.bin"
    with held_by_another_process("file", path):
        remove_stale(tmp_path)
        assert len(list(tmp_path.iterdir())) == 1
        assert is_new_folder(tmp_path)
    assert len(list(tmp_path.iterdir())) == 1
    write_bytes(tmp_path / "other.bin", b"whole")  # the first of this process in the folder
    assert [p.name for p in tmp_path.iterdir()] == ["other.bin"]


def test_only_temporary_files_are_removed(tmp_path):
    """Files of others with such an end, links and folders stay; the target of a link, too."""
    name = f".a.{'0' * 32}.tmp"
    kept = [".a.tmp", "a.tmp", ".a.partial", f"a.{'0' * 32}.tmp", f".a.{'g' * 32}.tmp"]
    for each in kept:
        (tmp_path / each).touch()
    (tmp_path / f".b.{'1' * 32}.tmp").mkdir()
    (tmp_path / f".c.{'2' * 32}.tmp").symlink_to(tmp_path / "a.tmp")
    of_core = f".a.png.{'3' * 16}.tmp"
    for each in (name, of_core):
        (tmp_path / each).touch()
    before = set(tmp_path.iterdir())
    remove_stale(tmp_path)
    assert before - set(tmp_path.iterdir()) == {tmp_path / name, tmp_path / of_core}
    remove_stale(tmp_path / "none")


def test_a_file_system_without_locks_keeps_temporary_files(tmp_path, monkeypatch):
    """There, nothing tells the file of a killed process from that of a running one."""

    def refuse(*_: object) -> None:
        raise OSError(errno.ENOLCK, "No locks available")

    monkeypatch.setattr(pytest.importorskip("fcntl"), "flock", refuse)
    left = tmp_path / f".a.{'0' * 32}.tmp"
    left.touch()
    write_bytes(tmp_path / "a", b"whole")
    assert (tmp_path / "a").read_bytes() == b"whole"
    remove_stale(tmp_path)
    assert left.exists()


def test_a_temporary_file_that_another_process_removed_before_its_lock_is_made_again(
    tmp_path, monkeypatch
):
    lock, calls = files.try_lock, []

    def late(file: int) -> bool:
        if not calls:
            for path in tmp_path.iterdir():
                path.unlink()
        calls.append(file)
        return lock(file)

    monkeypatch.setattr(files, "try_lock", late)
    write_bytes(tmp_path / "a", b"whole")
    assert len(calls) == 2
    assert [p.name for p in tmp_path.iterdir()] == ["a"]


def test_a_folder_appears_whole_or_not_at_all(tmp_path):
    out = tmp_path / "out"
    with pytest.raises(RuntimeError), atomic_folder(out) as partial:
        (partial / "a").touch()
        raise RuntimeError
    assert list(tmp_path.iterdir()) == []
    out.mkdir()
    with atomic_folder(out) as partial:
        (partial / "a").touch()
        with pytest.raises(FolderInUseError, match=rf"Process {os.getpid()} on .* writing .*out"):
            atomic_folder(out).__enter__()
    assert [p.name for p in tmp_path.iterdir()] == ["out"]
    assert [p.name for p in out.iterdir()] == ["a"]
    with pytest.raises(InputError, match="out exists"):
        atomic_folder(out).__enter__()


@pytest.mark.slow
def test_the_folder_of_a_killed_process_is_replaced(tmp_path):
    out = tmp_path / "out"
    with (
        held_by_another_process("folder", out) as other,
        pytest.raises(FolderInUseError, match=f"Process {other.pid} on"),
    ):
        atomic_folder(out).__enter__()
    assert sorted(p.name for p in tmp_path.iterdir()) == [".out.lock", ".out.partial"]
    with atomic_folder(out) as partial:
        assert list(partial.iterdir()) == []
    assert [p.name for p in tmp_path.iterdir()] == ["out"]


@pytest.mark.skipif(os.name == "nt", reason="links need rights on Windows")
def test_a_link_in_the_place_of_a_temporary_folder_is_not_followed(tmp_path):
    """Another user of a shared folder may put it there."""
    target = tmp_path / "target"
    target.mkdir()
    (target / "thesis").touch()
    (tmp_path / ".out.partial").symlink_to(target)
    with atomic_folder(tmp_path / "out") as partial:
        assert not partial.is_symlink()
    assert (target / "thesis").exists()
    (tmp_path / ".new.lock").symlink_to(target / "thesis")
    with pytest.raises(StorageError, match="Cannot write"):
        atomic_folder(tmp_path / "new").__enter__()
    (tmp_path / ".other.partial").touch()
    with pytest.raises(StorageError, match=r"Cannot write .*other\.partial: Not a directory"):
        atomic_folder(tmp_path / "other").__enter__()


SCRATCH = """
import sys
from vrcaps.core.files import scratch_folder
with scratch_folder() as folder:
    (folder / "part").touch()
    print("held", flush=True)
    sys.stdin.read()
"""


@pytest.mark.slow
@pytest.mark.skipif(os.name == "nt", reason="Windows does not say who owns a folder")
def test_the_scratch_folder_of_a_killed_process_is_removed_and_of_a_running_one_stays(
    tmp_path, monkeypatch
):
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    other = tmp_path / "vrcaps-scratch-without-lock"
    other.mkdir()
    environment = {**os.environ, "TMPDIR": str(tmp_path)}
    command, pipe = [sys.executable, "-c", SCRATCH], subprocess.PIPE
    with subprocess.Popen(command, stdin=pipe, stdout=pipe, env=environment) as process:
        assert process.stdout is not None
        assert process.stdout.readline() == b"held\n"
        with scratch_folder() as folder:
            assert list(folder.iterdir()) == []
            assert len({*tmp_path.iterdir()} - {other, folder.parent}) == 1
        process.kill()
    assert len(list(tmp_path.iterdir())) == 2
    with scratch_folder() as folder:
        assert {*tmp_path.iterdir()} == {other, folder.parent}
    assert [*tmp_path.iterdir()] == [other]


def _npy(shape: tuple[int, ...], data: bytes = b"", descr: str = "<f4") -> bytes:
    import io

    file = io.BytesIO()
    header = {"descr": descr, "fortran_order": False, "shape": shape}
    np.lib.format.write_array_header_1_0(file, header)
    return file.getvalue() + data


@pytest.mark.parametrize(
    ("data", "message"),
    [
        (_npy((1 << 30, 1 << 30)), "its header states"),
        (_npy((-1, -1), bytes(4)), "its header states"),
        (_npy((2,), bytes(7)), "its header states 8 bytes, but it has 7"),
        (_npy((1,), bytes(8), "|O"), "not numbers"),
        (b"", "not a complete NumPy array"),
        (b"\x93NUMPY\x01\x00\x08\x00{'descr(", "not a complete NumPy array"),
        (b"\x93NUMPY\x09\x00\x08\x00{}", "not a complete NumPy array"),
    ],
)
def test_an_array_is_as_large_as_its_bytes(data, message):
    with pytest.raises(ValueError, match=message):
        decode_array(data)


def test_arrays_are_decoded_exactly():
    import io

    for array in (np.arange(6.0).reshape(2, 3), np.asfortranarray(np.eye(3)), np.array("text")):
        file = io.BytesIO()
        np.save(file, array)
        found = decode_array(file.getvalue())
        np.testing.assert_array_equal(found, array)
        assert found.flags.writeable


def test_an_archive_has_a_largest_size(tmp_path):
    """A megabyte of zeros packs into a kilobyte; a header that states less is not passed."""
    path = tmp_path / "a.npz"
    write_arrays(path, {"x": np.zeros(2**17)})
    assert path.stat().st_size < 5000
    with pytest.raises(ValueError, match="its arrays take 1048704 bytes, more than 1000000"):
        read_arrays(path, 1_000_000)
    assert read_arrays(path)["x"].size == 2**17
