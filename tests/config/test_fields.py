"""References to files: checksums are filled in and checked anywhere in a tree."""

from dataclasses import dataclass

import pytest

from vrcaps.config.fields import FileRef, file_ref, path_of, with_checksums
from vrcaps.core.errors import InputError


@dataclass(frozen=True)
class Leaf:
    file: FileRef | None = None
    number: int = 1


@dataclass(frozen=True)
class Tree:
    leaf: Leaf
    leaves: tuple[Leaf, ...] = ()


def test_checksums_anywhere_in_a_tree(tmp_path):
    (tmp_path / "a").write_text("x")
    given = FileRef(str(tmp_path / "a"))
    tree = Tree(Leaf(given), (Leaf(), Leaf(given, 2)))
    checked = with_checksums(tree)
    assert len(checked.leaf.file.sha256) == 64
    assert checked.leaves == (Leaf(), Leaf(checked.leaf.file, 2))
    assert with_checksums(checked) == checked
    (tmp_path / "a").write_text("y")
    with pytest.raises(InputError, match="but the scenario was made with"):
        with_checksums(checked)


def test_a_texture_is_checked_by_its_head(tmp_path):
    with pytest.raises(InputError, match="Cannot read"):
        FileRef(str(tmp_path)).checked()
    (tmp_path / "mucosa.json").write_text("{}")
    assert FileRef(str(tmp_path)).checked().sha256


def test_paths_alone_are_references(tmp_path):
    assert file_ref("a/b") == FileRef("a/b")
    assert path_of(FileRef("a/b")) == path_of("a/b")
