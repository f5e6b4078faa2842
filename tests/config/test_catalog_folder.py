"""Names and paths of a folder of TOML files."""

from __future__ import annotations

from pathlib import Path

import pytest

from vrcaps.config.plain_files import CatalogFolder
from vrcaps.core.errors import InputError, UnknownNameError


@pytest.fixture
def shells(tmp_path: Path) -> CatalogFolder:
    folder = tmp_path / "shells"
    folder.mkdir()
    for name in ("round", "oval", "notes.txt"):
        (folder / name).with_suffix(".txt" if "." in name else ".toml").write_text("")
    return CatalogFolder(folder, "shell")


def test_names_are_the_stems_sorted(shells: CatalogFolder) -> None:
    assert shells.names() == ("oval", "round")


def test_a_name_is_a_file_of_the_folder(shells: CatalogFolder) -> None:
    assert shells.find("oval") == shells.path / "oval.toml"


def test_a_path_is_a_users_own_file(shells: CatalogFolder, tmp_path: Path) -> None:
    own = tmp_path / "own.toml"
    own.write_text("")
    assert shells.find(own) == own
    assert shells.find(str(own)) == own


def test_unknown_name(shells: CatalogFolder) -> None:
    with pytest.raises(UnknownNameError, match=r"No shell named 'ovel'\. Known: oval, round"):
        shells.find("ovel")


def test_missing_file(shells: CatalogFolder, tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"No shell file at .*own\.toml\. Give .* oval, round"):
        shells.find(tmp_path / "own.toml")
