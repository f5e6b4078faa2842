"""Data sets at a URL: the bytes of a local one, whole through kills and a lost network."""

import os
import signal
import subprocess
import sys
from collections.abc import Iterator
from itertools import islice
from pathlib import Path

import numpy as np
import pytest
from torch.utils.data import DataLoader

import vrcaps
from tests.support.failing import fail
from tests.support.s3_server import BUCKET, Line, s3_server
from tests.support.waiting import WATCHDOG
from vrcaps.cli import main
from vrcaps.core.errors import InputError, MissingExtraError, StorageError
from vrcaps.data.check import check_dataset
from vrcaps.data.ledger import complete_units, entries
from vrcaps.data.loading import FrameWindows
from vrcaps.data.make import make_dataset
from vrcaps.data.plan import read_plan
from vrcaps.data.runners.local import InProcess
from vrcaps.data.store import LocalStore, open_store

KILLED = """
import os, signal
from vrcaps.data import make_unit
from vrcaps.cli import main
done = []
def enter(*given):
    if done:
        os.kill(os.getpid(), signal.SIGKILL)
    done.append(before(*given))
before, make_unit.enter = make_unit.enter, enter
main({words!r})
"""
"""A run whose process dies when all files of its second unit are there, and not its entry."""


@pytest.fixture
def line(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Iterator[Line]:
    monkeypatch.setenv("VRCAPS_CACHE", str(tmp_path / "cache"))
    with s3_server(monkeypatch) as found:
        yield found


def contents(folder: Path) -> dict[str, bytes]:
    paths = (p for p in folder.rglob("*") if p.is_file() and ".staging" not in p.parts)
    return {path.relative_to(folder).as_posix(): path.read_bytes() for path in paths}


def remote_contents(url: str) -> dict[str, bytes]:
    import fsspec

    system, root = fsspec.core.url_to_fs(url)
    system.invalidate_cache()
    return {p.removeprefix(f"{root}/"): system.cat_file(p) for p in system.find(root)}


@pytest.mark.server
def test_an_s3_store_outlives_kills_and_a_lost_network(
    whole: Path, plan_file: Path, line: Line, tmp_path: Path, capsys
) -> None:
    url = f"s3://{BUCKET}/tubes"
    words = ["dataset", "make", str(plan_file), "--out", url, "--workers", "0"]
    script = tmp_path / "run.py"
    script.write_text(KILLED.format(words=words))
    killed = subprocess.run(
        [sys.executable, script], env={**os.environ}, check=False, timeout=WATCHDOG
    )
    assert killed.returncode == -signal.SIGKILL
    store = open_store(url)
    assert len(complete_units(store)) == 1

    def cut(done: int, _: int) -> None:
        if done == 5:
            line.cut()

    with pytest.raises(
        StorageError, match=r"Cannot \w+ the data set s3://cohorts/tubes: .*to resume"
    ):
        make_dataset(read_plan(plan_file), url, runner=InProcess(), progress=cut)
    line.mend()
    assert len(complete_units(store)) == 5
    made = make_dataset(read_plan(plan_file), url, runner=InProcess())
    assert (made.made, made.present, made.failed) == (3, 5, {})
    assert remote_contents(url) == contents(whole)
    main(["dataset", "check", url])
    assert "8 recordings of 4 patients" in capsys.readouterr().out
    require_same_batches(url, whole)


def require_same_batches(url: str, folder: Path) -> None:
    """Forked workers read the first frames of a data set at a URL as those of a folder."""
    first, second = (
        DataLoader(
            FrameWindows(vrcaps.data.open(place).sequences("train"), threads=2),
            batch_size=4,
            num_workers=2,
            multiprocessing_context="fork",
            timeout=WATCHDOG,
        )
        for place in (url, folder)
    )
    for ours, theirs in zip(islice(first, 2), islice(second, 2), strict=True):
        for name, values in ours.items():
            np.testing.assert_array_equal(values, theirs[name], err_msg=name)


def test_files_of_an_s3_store_are_made_and_removed(line: Line) -> None:
    store = open_store(f"s3://{BUCKET}/other")
    assert store.is_empty()
    assert store.create("ledger/a.json", b"first")
    assert not store.create("ledger/a.json", b"second")
    assert store.read("ledger/a.json") == b"first"
    assert (store.has("ledger/a.json"), store.has("ledger")) == (True, False)
    assert not store.is_empty()
    store.remove("ledger/a.json")
    store.remove("ledger/a.json")
    assert store.names("ledger") == []
    with pytest.raises(FileNotFoundError):
        store.read("ledger/a.json")


def test_a_place_that_is_not_there_is_one_clear_line(
    line: Line, plan_file: Path, capsys, tmp_path: Path
) -> None:
    plan = read_plan(plan_file)
    with pytest.raises(StorageError, match=r"write the data set s3://none/a: .*bucket does not"):
        make_dataset(plan, "s3://none/a", runner=InProcess())
    with pytest.raises(InputError, match="no data set"):
        check_dataset(f"s3://{BUCKET}/none")
    with pytest.raises(InputError, match=r"Cannot open nope://x"):
        open_store("nope://x")
    assert "nope://x" in fail(["dataset", "check", "nope://x"], capsys)


def test_what_is_not_installed_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    import fsspec

    def missing(url: str) -> None:
        raise ImportError("Install s3fs to access S3")

    monkeypatch.setattr(fsspec.core, "url_to_fs", missing)
    with pytest.raises(MissingExtraError, match=r"vrcaps\[scale\]"):
        open_store("s3://bucket/name")
    monkeypatch.setitem(sys.modules, "fsspec", None)
    with pytest.raises(MissingExtraError, match="fsspec is not installed"):
        open_store("s3://bucket/name")


@pytest.mark.slow
def test_a_store_without_whole_writes_is_written_under_other_names(plan_file: Path, made) -> None:
    """fsspec's file systems that are no object stores: each file is moved to its name."""
    url = "memory://cohort"
    make_dataset(read_plan(plan_file), url, numbers=range(2), runner=InProcess())
    store, local = open_store(url), LocalStore(made)
    assert len(entries(store)) == 2
    found = remote_contents(url)
    assert len(found) > 20
    assert found == {name: local.read(name) for name in found}
    assert not store.create("plan.json", b"other")
    store.remove("plan.json")
    assert not store.has("plan.json")
