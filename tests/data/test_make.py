"""Making a data set: exactly once, the same bytes whoever makes it and whatever dies."""

import errno
import os
from collections.abc import Callable
from pathlib import Path

import pytest

import vrcaps
from tests.support.failing import fail
from vrcaps.cli import main
from vrcaps.core import build_info as made_with
from vrcaps.core.errors import InputError, StorageError
from vrcaps.core.processes import FolderInUseError, file_lock
from vrcaps.data.check import check_dataset
from vrcaps.data.estimate import Estimate
from vrcaps.data.ledger import enter_failure, entries, failures
from vrcaps.data.make import make_dataset
from vrcaps.data.make_unit import Job, Maker, make_unit
from vrcaps.data.plan import read_plan
from vrcaps.data.runners.local import InProcess
from vrcaps.data.store import LocalStore
from vrcaps.data.units import Units


def files(folder: Path) -> dict[str, bytes]:
    paths = (p for p in folder.rglob("*") if p.is_file() and ".staging" not in p.parts)
    return {path.relative_to(folder).as_posix(): path.read_bytes() for path in paths}


@pytest.mark.slow
def test_slices_make_the_same_bytes_as_one_run(made: Path, plan_file: Path, tmp_path: Path) -> None:
    plan, out = read_plan(plan_file), tmp_path / "slices"
    for numbers in (range(5, 8), range(3), range(2, 6)):
        make_dataset(plan, out, numbers=numbers, runner=InProcess())
    assert files(out) == files(made)
    again = make_dataset(plan, out, runner=InProcess())
    assert (again.made, again.present) == (0, 8)


def test_it_is_read_by_split_and_patient(made: Path) -> None:
    dataset = vrcaps.data.open(made)
    assert len(dataset) == 8
    assert len(dataset.patients("train")) == 2
    shared = set(dataset.patients("train")) & set(dataset.patients("test"))
    assert not shared
    episode = dataset.members("test")[0].read()
    assert episode[0]["depth"].shape == (36, 40)
    assert check_dataset(made) == []


def test_what_has_changed_or_gone_is_found(made: Path) -> None:
    name = next(iter(entries(LocalStore(made))))
    folder = made / "episodes" / name
    (folder / "front" / "rgb" / "000001.png").unlink()
    (folder / "frames.parquet").write_bytes(b"other")
    (folder / "notes.txt").write_text("mine")
    faults = "\n".join(check_dataset(made))
    assert "000001.png is missing" in faults
    assert "frames.parquet differs" in faults
    assert "notes.txt belongs to no unit" in faults


def test_a_unit_without_an_entry_does_not_count_and_is_made_again(made: Path, plan_file) -> None:
    name = next(iter(entries(LocalStore(made))))
    before = files(made)
    (made / "ledger" / f"{name}.json").unlink()
    assert len(vrcaps.data.open(made)) == 7
    assert make_dataset(read_plan(plan_file), made, runner=InProcess()).made == 1
    assert files(made) == before


@pytest.mark.slow
def test_a_failed_unit_is_noted_and_does_not_stop_the_rest(plan_file: Path, tmp_path: Path) -> None:
    text = plan_file.read_text().replace("each = [0.005, 0.01]", "each = [0.005, 900.0]")
    out, fast = tmp_path / "some", tmp_path / "fast.toml"
    fast.write_text(text)
    with pytest.raises(SystemExit):
        main(["dataset", "make", str(fast), "--out", str(out), "--workers", "0"])
    found = failures(LocalStore(out))
    assert len(found) == 4
    assert len(vrcaps.data.open(out)) == 4
    failure = next(iter(found.values()))
    assert f"--units {failure['number']}:{failure['number'] + 1}" in failure["reproduce"]


def test_bad_targets_are_one_clear_line(
    made: Path, plan_file: Path, tmp_path: Path, capsys
) -> None:
    other = tmp_path / "other.toml"
    other.write_text(plan_file.read_text().replace("seed = 3", "seed = 4"))
    with pytest.raises(InputError, match="another plan"):
        make_dataset(read_plan(other), made, runner=InProcess())
    with pytest.raises(InputError, match="A unit is 99"):
        make_dataset(read_plan(plan_file), made, numbers=[99], runner=InProcess())
    with pytest.raises(InputError, match="no data set"):
        vrcaps.data.open(tmp_path)
    for flags in (["--units", "3"], ["--units", "9:12"], ["--workers", "-1"]):
        with pytest.raises(SystemExit):
            main(["dataset", "make", str(plan_file), "--out", str(made), *flags])
    assert capsys.readouterr().err.count("vrcaps: --") == 3


def test_a_target_that_holds_something_else_is_left_alone(
    plan_file: Path, whole: Path, tmp_path: Path
) -> None:
    (tmp_path / "thesis.tex").write_text("mine")
    (tmp_path / ".hidden").write_text("does not count")
    with pytest.raises(InputError, match=r"is not empty and contains no data set"):
        make_dataset(read_plan(plan_file), tmp_path, runner=InProcess())
    with pytest.raises(InputError, match=r"is not empty"):
        make_dataset(read_plan(plan_file), tmp_path / "thesis.tex", runner=InProcess())
    assert sorted(p.name for p in tmp_path.iterdir()) == [".hidden", "thesis.tex"]
    (tmp_path / "plan.json").write_text("{")
    with pytest.raises(InputError, match=r"plan\.json is damaged .* delete that file"):
        make_dataset(read_plan(plan_file), tmp_path, runner=InProcess())


def test_a_data_set_is_gone_on_with_by_the_same_versions_only(
    plan_file: Path, made: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    versions = made_with.versions
    monkeypatch.setattr(made_with, "versions", lambda names: versions(names) | {"numpy": "1.0"})
    with pytest.raises(
        InputError, match=r"was started with numpy \S+; this installation has 1\.0, so bytes"
    ):
        make_dataset(read_plan(plan_file), made, runner=InProcess())
    job = Job(read_plan(plan_file), str(made), made, made_with={"numpy": "2.0"})
    with pytest.raises(InputError, match=r"A worker has numpy 1\.0, the head node has 2\.0"):
        Maker(job)


@pytest.mark.slow
@pytest.mark.parametrize("code", [errno.ENOSPC, errno.EACCES])
def test_a_full_disk_stops_the_run_and_loses_nothing(
    plan_file: Path, made: Path, monkeypatch: pytest.MonkeyPatch, code: int
) -> None:
    """The second of two units fails where its entry is written; none is noted as failed."""
    before, names = files(made), sorted(entries(LocalStore(made)))[:2]
    for name in names:
        (made / "ledger" / f"{name}.json").unlink()
    replace, left = os.replace, [names[0]]

    def full(source: Path, path: Path) -> None:
        if path.parent.name == "ledger" and not (left and left.pop() in path.name):
            raise OSError(code, os.strerror(code), str(path))
        replace(source, path)

    monkeypatch.setattr(os, "replace", full)
    with pytest.raises(StorageError, match=rf"{os.strerror(code)}\. .* the command to resume"):
        make_dataset(read_plan(plan_file), made, runner=InProcess())
    monkeypatch.undo()
    assert failures(LocalStore(made)) == {}
    assert len(entries(LocalStore(made))) == 7
    again = make_dataset(read_plan(plan_file), made, runner=InProcess())
    assert (again.made, again.present) == (1, 7)
    assert files(made) == before


def test_a_unit_is_one_makers_until_it_is_entered(
    plan_file: Path, made: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Else another one would go on in the folder that is just moved to its name."""
    before, name = files(made), min(entries(LocalStore(made)))
    (made / "ledger" / f"{name}.json").unlink()
    debris = LocalStore(made).staging(name) / "front" / "rgb"  # of such another one
    debris.mkdir(parents=True)
    held = []

    def locked(what: str) -> Callable[..., None]:
        run = getattr(LocalStore, what)

        def call(store: LocalStore, *given: object) -> None:
            with (
                pytest.raises(FolderInUseError, match="is writing"),
                file_lock(store.staging(f"{name}.lock"), name),
            ):
                pass
            held.append(what)
            run(store, *given)

        return call

    for what in ("put", "write"):
        monkeypatch.setattr(LocalStore, what, locked(what))
    units = Units(read_plan(plan_file))
    number = next(k for k in range(len(units)) if units[k].name == name)
    make_unit(units, LocalStore(made), number)
    assert held == ["put", "write"]
    assert files(made) == before


def test_a_killed_maker_leaves_no_part_file_beside_the_data(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    store = LocalStore(tmp_path / "set")
    store.write("ledger/a.json", b"{}")

    def killed(*paths: object) -> None:
        raise KeyboardInterrupt

    for name, write in (("replace", store.write), ("link", store.create)):
        with monkeypatch.context() as patched:
            patched.setattr(Path, "unlink", lambda path, **more: None)
            patched.setattr(os, name, killed)
            with pytest.raises(KeyboardInterrupt):
                write("ledger/b.json", b"{}")
        assert os.listdir(store.folder / "ledger") == ["a.json"]
    assert store.write("ledger/b.json", b"{}") is None
    assert not store.create("ledger/b.json", b"[]")
    assert store.create("ledger/c.json", b"[]")
    assert sorted(os.listdir(store.folder / "ledger")) == ["a.json", "b.json", "c.json"]


@pytest.mark.skipif(os.name == "nt" or os.geteuid() == 0, reason="root may write anywhere")
def test_a_place_without_permission_is_one_clear_line(plan_file: Path, tmp_path: Path) -> None:
    tmp_path.chmod(0o500)
    with pytest.raises(StorageError, match="Permission denied"):
        make_dataset(read_plan(plan_file), tmp_path / "out", runner=InProcess())


@pytest.mark.slow
def test_a_failure_is_forgotten_when_the_unit_is_made(plan_file: Path, made: Path) -> None:
    store, name = LocalStore(made), sorted(entries(LocalStore(made)))[1]
    before = files(made)
    (made / "ledger" / f"{name}.json").unlink()
    enter_failure(store, name, 1, "told", "again")
    assert failures(store)[name]["error"] == "told"
    make_dataset(read_plan(plan_file), made, runner=InProcess())
    assert failures(store) == {}
    assert files(made) == before


@pytest.mark.slow
def test_a_dry_run_says_what_will_be_made(
    plan_file: Path, made: Path, tmp_path: Path, capsys
) -> None:
    command = ["dataset", "make", str(plan_file), "--dry-run", "--out"]
    main([*command, str(tmp_path / "none"), "--estimate"])
    said = capsys.readouterr().out
    assert "tubes: 4 patients (2 train, 1 val, 1 test), 8 recordings." in said
    assert "To record: 8 recordings, 24 frames.\nAbout " in said
    assert f"{tmp_path / 'none'} has " in said
    assert "Measured with tube with tiny." in said
    assert not (tmp_path / "none").exists()
    main([*command, str(made), "--units", "2:4"])
    said = capsys.readouterr().out
    assert "Selected: recordings 2 to 3.\n2 of them exist.\nNothing to do" in said


def test_a_dry_run_records_nothing(
    plan_file: Path, tmp_path: Path, capsys, monkeypatch: pytest.MonkeyPatch
) -> None:
    def refuse(*_):
        raise AssertionError("a dry run measures nothing")

    monkeypatch.setattr("vrcaps.data.estimate.estimate", refuse)
    main(["dataset", "make", str(plan_file), "--dry-run", "--out", str(tmp_path / "none")])
    assert capsys.readouterr().out.endswith("To record: 8 recordings, 24 frames.\n")
    assert not (tmp_path / "none").exists()


def test_an_estimate_refuses_what_the_disk_cannot_hold(
    plan_file: Path, made: Path, tmp_path: Path, capsys, monkeypatch: pytest.MonkeyPatch
) -> None:
    found = Estimate(7500.0, 3 * 10**9, ("tube with tiny",))
    monkeypatch.setattr("vrcaps.data.estimate.estimate", lambda *_: found)
    monkeypatch.setattr(LocalStore, "free_bytes", lambda _: 10**6)
    command = ["dataset", "make", str(plan_file), "--estimate", "--out"]
    said = fail([*command, str(tmp_path / "none")], capsys)
    assert "has 1.0 MB free; 3.0 GB are required. Give an --out with more space" in said
    other = tmp_path / "other.toml"
    other.write_text(plan_file.read_text().replace("seed = 3", "seed = 4"))
    assert "another plan (its dataset.seed differs)" in fail(
        ["dataset", "make", str(other), "--dry-run", "--out", str(made)], capsys
    )


@pytest.mark.parametrize("name", ["ledger", "episodes", ".staging"])
def test_a_link_that_leads_out_of_the_data_set_is_refused(tmp_path: Path, name: str) -> None:
    (tmp_path / "set").mkdir()
    (tmp_path / "outside").mkdir()
    (tmp_path / "set" / name).symlink_to(tmp_path / "outside")
    store = LocalStore(tmp_path / "set")

    def fill() -> None:
        store.write("ledger/a.json", b"{}")
        staged = store.staging("a")
        staged.mkdir(parents=True)
        store.put(staged, "episodes/a")

    with pytest.raises(InputError, match=rf"{name}.* leads out of .*set"):
        fill()
    assert not list((tmp_path / "outside").iterdir())
