"""Organs on disk: the same after a round trip, made again where the file is broken."""

from __future__ import annotations

import ast
import dataclasses
import os
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import platformdirs
import pytest

import vrcaps.core.files as files_module
from vrcaps.core.files import cache_folder, temporary_beside
from vrcaps.organ import cache
from vrcaps.organ.cache import cached_organ
from vrcaps.organ.surface import Appearance, Centerline, OrganSurface


def make_organ(*, has_appearance: bool = True) -> OrganSurface:
    rng = np.random.default_rng(0)
    line = Centerline(rng.random((5, 3)), np.arange(5.0), np.ones(5), np.tile(np.eye(3), (5, 1, 1)))
    pixels = rng.integers(0, 255, (4, 4, 3), dtype=np.uint8)
    return OrganSurface(
        name="tube",
        vertices=rng.random((4, 3)),
        faces=np.array([[0, 1, 2], [0, 2, 3]], np.int32),
        normals=rng.random((4, 3)),
        uv=rng.random((2, 3, 2)),
        label=np.array([1, 1, 2, 2], np.uint8),
        label_names=("background", "one", "two"),
        instance=np.zeros(4, np.uint16),
        arc_length=rng.random(4),
        theta=rng.random(4),
        radius=rng.random(4),
        centerline=line,
        appearance=Appearance(pixels, pixels[..., 0], rng.random((4, 4)), ior=1.33)
        if has_appearance
        else None,
        metadata={"seed": 3, "parameters": {"length": 1.5}},
    )


def as_bytes(value: object) -> object:
    """Nested fields with arrays as type, shape and bytes, so that == is exact."""
    if isinstance(value, np.ndarray):
        return value.dtype, value.shape, value.tobytes()
    if dataclasses.is_dataclass(value):
        return {f.name: as_bytes(getattr(value, f.name)) for f in dataclasses.fields(value)}
    return value


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv("VRCAPS_CACHE", str(tmp_path))
    return tmp_path


@pytest.mark.parametrize("has_appearance", [True, False])
def test_an_organ_is_made_once_and_read_back_exactly(folder: Path, has_appearance: bool):
    organ = make_organ(has_appearance=has_appearance)
    made = []
    for _ in range(3):
        got = cached_organ("tube", lambda: made.append(1) or organ)
        assert as_bytes(got) == as_bytes(organ)
    assert len(made) == 1
    assert [path.name for path in (folder / "organs").iterdir()] == ["tube.npz"]


@pytest.mark.parametrize("damage", ["empty", "truncated", "garbage", "flipped", "other arrays"])
def test_a_broken_file_is_made_again(folder: Path, damage: str):
    organ = make_organ()
    cached_organ("tube", lambda: organ)
    path = folder / "organs" / "tube.npz"
    content = path.read_bytes()
    if damage == "other arrays":
        np.savez(path, vertices=np.zeros(3))
    else:
        middle = len(content) // 2
        path.write_bytes(
            {
                "empty": b"",
                "truncated": content[:middle],
                "garbage": b"not a zip file" * 100,
                "flipped": content[:400] + bytes([content[400] ^ 255]) + content[401:],
            }[damage]
        )
    made = []
    got = cached_organ("tube", lambda: made.append(1) or organ)
    assert made == [1]
    assert as_bytes(got) == as_bytes(organ)
    assert path.read_bytes() == content


def test_a_failed_write_leaves_nothing_and_warns(folder: Path, monkeypatch: pytest.MonkeyPatch):
    def full_disk(*_: object, **__: object) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(cache.np, "savez", full_disk)
    with pytest.warns(UserWarning, match="No space left on device.*set VRCAPS_CACHE"):
        assert cached_organ("tube", make_organ).name == "tube"
    assert list((folder / "organs").iterdir()) == []


def test_an_error_of_the_maker_is_passed_on(folder: Path):
    def fail() -> OrganSurface:
        raise RuntimeError("no organ today")

    with pytest.raises(RuntimeError, match="no organ today"):
        cached_organ("tube", fail)
    assert not (folder / "organs").exists()


def test_the_folder_is_the_chosen_one_or_the_platforms(monkeypatch, tmp_path: Path):
    monkeypatch.setenv("VRCAPS_CACHE", str(tmp_path / "own"))
    assert cache_folder() == tmp_path / "own"
    monkeypatch.delenv("VRCAPS_CACHE")
    assert cache_folder() == platformdirs.user_cache_path("vrcaps", appauthor=False)
    if sys.platform == "linux":
        monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "xdg"))
        assert cache_folder() == tmp_path / "xdg" / "vrcaps"
        monkeypatch.delenv("XDG_CACHE_HOME")
        monkeypatch.setenv("HOME", str(tmp_path))
        assert cache_folder() == tmp_path / ".cache" / "vrcaps"


@pytest.mark.skipif(sys.platform == "win32", reason="has a home folder always")
def test_without_a_home_the_folder_is_temporary(monkeypatch, tmp_path: Path):
    monkeypatch.delenv("XDG_CACHE_HOME", raising=False)
    monkeypatch.delenv("HOME", raising=False)
    monkeypatch.setenv("VRCAPS_CACHE", "~/own")
    monkeypatch.setattr("os.path.expanduser", lambda path: path)  # no entry in the list of users
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path))
    files_module._temporary_folder.cache_clear()
    with pytest.warns(UserWarning, match="no home folder.*Set VRCAPS_CACHE to an absolute path"):
        folder = cache_folder()
    monkeypatch.delenv("VRCAPS_CACHE")
    assert folder == cache_folder() and folder.parent == tmp_path
    assert folder.stat().st_mode & 0o777 == 0o700
    files_module._temporary_folder.cache_clear()


def test_a_folder_that_is_closed_is_a_warning(folder: Path, monkeypatch: pytest.MonkeyPatch):
    def closed(*_: object, **__: object) -> bool:
        raise PermissionError(13, "Permission denied")

    monkeypatch.setattr(Path, "is_file", closed)
    monkeypatch.setattr(Path, "mkdir", closed)
    with pytest.warns(UserWarning, match="Permission denied.*set VRCAPS_CACHE"):
        assert cached_organ("tube", make_organ).name == "tube"


CODE = "SIZE = 3\n"


@pytest.mark.slow
def test_changed_parameters_or_statements_are_another_file(monkeypatch, tmp_path: Path):
    package = tmp_path / "vrcaps"
    shutil.copytree(Path(cache.__file__).parents[1], package, ignore=_all_but_python)
    monkeypatch.setattr(cache, "__file__", str(package / "organ" / "cache.py"))

    def digest(code: str, parameters: dict) -> str:
        (package / "anatomy" / "new.py").write_text(code)
        cache._code_digest.cache_clear()
        return cache.fingerprint(parameters)

    first = digest(CODE, {"a": 1})
    assert digest(CODE, {"a": 1}) == first
    assert digest(CODE, {"a": 2}) != first
    assert digest("SIZE = 4\n", {"a": 1}) != first


def test_every_module_that_makers_import_counts():
    """Without those that only types need; a new module must be named in the cache."""
    package = Path(cache.__file__).parents[1]
    counted = {path.resolve() for path in cache._files(package)}
    missing = {
        found.relative_to(package).as_posix()
        for path in counted - {package / "scenario" / "build.py"}
        for found in _imported(path, package)
        if found not in counted
    }
    assert missing == set()


def _imported(path: Path, package: Path) -> set[Path]:
    """Modules of the package that a module imports, other than for type checkers."""
    tree, found = ast.parse(path.read_bytes()), set()
    for node in ast.walk(tree):
        if isinstance(node, ast.If) and getattr(node.test, "id", "") == "TYPE_CHECKING":
            node.body = []
    for node in ast.walk(tree):
        if isinstance(node, ast.ImportFrom) and (node.module or "").startswith("vrcaps."):
            place = package.joinpath(*str(node.module).split(".")[1:])
            inside = [place / f"{alias.name}.py" for alias in node.names]
            found |= {p for p in (place.with_suffix(".py"), *inside) if p.is_file()}
    return found


def test_versions_of_packages_and_the_core_count(monkeypatch):
    monkeypatch.setattr(cache, "_files", lambda _: [])
    cache._code_digest.cache_clear()
    first = cache.fingerprint({})
    for name, other in (("versions", lambda _: {"numpy": "0"}), ("core_sha256", lambda: "other")):
        with monkeypatch.context() as patch:
            patch.setattr(cache, name, other)
            cache._code_digest.cache_clear()
            assert cache.fingerprint({}) != first
    cache._code_digest.cache_clear()


def _all_but_python(folder: str, names: list[str]) -> list[str]:
    return [n for n in names if Path(folder, n).is_file() and not n.endswith(".py")]


@pytest.mark.slow
def test_the_digest_is_the_same_in_every_process():
    """Sets of constants are in another order where strings have other hashes."""
    show = "from vrcaps.organ.cache import fingerprint; print(fingerprint({}))"
    found = {
        subprocess.run(
            [sys.executable, "-c", show],
            env={**os.environ, "PYTHONHASHSEED": seed},
            capture_output=True,
            check=True,
        ).stdout
        for seed in ("1", "2")
    }
    assert len(found) == 1


def test_files_being_written_count_as_used_space(folder: Path, monkeypatch):
    cached_organ("a", make_organ)
    path = folder / "organs" / "a.npz"
    size = path.stat().st_size
    os.utime(path, (2.0, 2.0))
    with temporary_beside(path.with_name("other.npz")) as part:
        part.write_bytes(bytes(size))
        cached_organ("b", make_organ)
        assert {p.name for p in path.parent.iterdir()} == {"a.npz", "b.npz", part.name}
        monkeypatch.setattr(cache, "_MAX_BYTES", 2.5 * size)
        cached_organ("c", make_organ)
        assert {p.name for p in path.parent.iterdir()} == {"c.npz", part.name}


def test_organs_used_longest_ago_make_room(folder: Path, monkeypatch: pytest.MonkeyPatch):
    """Beyond the limit the oldest go; reading an organ makes it young; the newest always stays."""
    for age, name in enumerate("abc"):
        cached_organ(name, make_organ)
        path = folder / "organs" / f"{name}.npz"
        os.utime(path, (age, age))
    size = path.stat().st_size
    cached_organ("a", make_organ)
    monkeypatch.setattr(cache, "_MAX_BYTES", 2.5 * size)
    cached_organ("d", make_organ)
    assert {path.stem for path in (folder / "organs").iterdir()} == {"a", "d"}
    monkeypatch.setattr(cache, "_MAX_BYTES", 0)
    cached_organ("e", make_organ)
    assert {path.stem for path in (folder / "organs").iterdir()} == {"e"}


def test_short_lived_organs_are_few_and_drive_out_no_others(folder: Path, monkeypatch):
    cached_organ("mine", make_organ)
    size = (folder / "organs" / "mine.npz").stat().st_size
    monkeypatch.setattr(cache, "_MAX_SHORT_LIVED_BYTES", 2.5 * size)
    made = []
    with cache.short_lived_organs():
        for age, name in enumerate(("a", "b", "c", "mine")):
            cached_organ(name, lambda name=name: made.append(name) or make_organ())
            path = folder / "organs" / "passing" / f"{name}.npz"
            if path.exists():
                os.utime(path, (age, age))
    assert made == ["a", "b", "c"]
    assert {path.stem for path in (folder / "organs").rglob("*.npz")} == {"mine", "b", "c"}
    cached_organ("c", lambda: pytest.fail("it is there"))
