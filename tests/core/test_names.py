"""Names that data state: relative paths below their folder, or one line."""

import os
from pathlib import Path

import pytest

from vrcaps.core.errors import InputError
from vrcaps.core.names import inside, listed, regular, require_links_inside, require_name


@pytest.mark.parametrize(
    "name", ["colon-0007/front", "a b", "säule", "v1.2", "..a", ".hidden", "50%", "x" * 180]
)
def test_relative_names_are_allowed(name):
    assert require_name("sequence", name) == name


@pytest.mark.parametrize(
    "name",
    [
        *("", ".", "..", "/etc", "../x", "a/../../x", "a/..", "...", "a/. ./b", " "),
        *(
            "C:\\x",
            "c:x",
            "a\\..\\b",
            "\\\\host\\x",
            "a\0b",
            "a\nb",
            "\ud800",
            "x" * 181,
            "ä" * 91,
        ),
        *("a\x85b", "a\x9b31mb", "a\u2028b", "a\u202egnp.b"),
        *(None, 3, ["a"], {"a": 1}),
    ],
)
def test_names_that_lead_elsewhere_are_one_line(name):
    with pytest.raises(
        InputError, match=r"The name of a sequence is .* Allowed: a relative path"
    ) as e:
        require_name("sequence", name)
    assert len(str(e.value)) < 250


@pytest.fixture
def folder(tmp_path) -> Path:
    """A folder with a file, beside a file that is not in it."""
    (tmp_path / "data/rgb").mkdir(parents=True)
    (tmp_path / "data/rgb/0.png").write_bytes(b"x")
    (tmp_path / "secret.png").write_bytes(b"x")
    return tmp_path / "data"


def test_a_stated_file_lies_in_the_folder(folder):
    assert inside(folder, "rgb/0.png") == folder / "rgb/0.png"
    assert inside(folder / "rgb", "../rgb/0.png").is_file()
    for name in ("../secret.png", str(folder.parent / "secret.png"), "rgb/../../secret.png"):
        with pytest.raises(InputError, match=r"leads out of .*Copy them there"):
            inside(folder, name)
    for name in (None, 7, "a\0b", ["x"]):
        with pytest.raises(InputError, match="Allowed: a relative path"):
            inside(folder, name)


def test_links_are_followed_before_they_are_checked(folder):
    os.symlink("0.png", folder / "rgb/1.png")
    require_links_inside(folder)
    assert inside(folder, "rgb/1.png").is_file()
    os.symlink(folder.parent, folder / "out")
    with pytest.raises(InputError, match="leads out of"):
        inside(folder, "out/secret.png")
    with pytest.raises(InputError, match="out leads out of"):
        require_links_inside(folder)


def test_a_folder_may_be_a_link_itself(folder, tmp_path):
    os.symlink(folder, tmp_path / "link")
    require_links_inside(tmp_path / "link")
    assert inside(tmp_path / "link", "rgb/0.png").is_file()


def test_hidden_and_system_files_are_not_listed(folder):
    for name in ("._0.png", ".DS_Store", "Thumbs.db", "desktop.ini"):
        (folder / "rgb" / name).write_bytes(b"")
    (folder / "__MACOSX").mkdir()
    (folder / "__MACOSX/9.png").write_bytes(b"")
    assert listed(folder, "**/*") == [folder / "rgb", folder / "rgb/0.png"]
    assert listed(folder, "rgb/*.png") == [folder / "rgb/0.png"]


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="no pipes in folders")
def test_a_pipe_is_refused_since_reading_it_never_ends(folder):
    os.mkfifo(folder / "pipe")
    for read in (
        lambda: inside(folder, "pipe"),
        lambda: regular(folder / "pipe"),
        lambda: require_links_inside(folder),
    ):
        with pytest.raises(InputError, match=r"pipe is a pipe, socket or device\. Allowed: a file"):
            read()
    assert regular(folder) == folder
    assert regular(folder / "none") == folder / "none"
