"""Errors: one line that says what was given and what is allowed."""

from __future__ import annotations

import sys

import pytest
from PIL import UnidentifiedImageError

from vrcaps.core.errors import (
    InputError,
    MissingExtraError,
    UnknownNameError,
    VrcapsError,
    reading,
    require_extra,
)


def test_unknown_name_lists_the_known_ones_sorted() -> None:
    error = UnknownNameError("organ", "colom", ["stomach", "colon"])
    assert str(error) == "No organ named 'colom'. Known: colon, stomach. Did you mean 'colon'?"
    assert str(UnknownNameError("organ", "x", ["colon"])) == "No organ named 'x'. Known: colon."


def test_missing_extra_says_how_to_install() -> None:
    error = MissingExtraError("SimpleITK", "ct")
    assert str(error) == "SimpleITK is not installed. Install it with: pip install 'vrcaps[ct]'"


@pytest.mark.parametrize(
    ("error", "builtin"),
    [
        (InputError("A line."), ValueError),
        (UnknownNameError("organ", "x", ["colon"]), LookupError),
        (MissingExtraError("torch", "learn"), ImportError),
    ],
)
def test_every_error_is_a_vrcaps_error_and_its_builtin_kind(
    error: VrcapsError, builtin: type[Exception]
) -> None:
    assert isinstance(error, VrcapsError)
    assert isinstance(error, builtin)
    assert "\n" not in str(error)


@pytest.mark.parametrize(
    ("error", "text"),
    [
        (SyntaxError("broken PNG file"), "Cannot read a.png: broken PNG file."),
        (FileNotFoundError(2, "No such file or directory"), "a.png: No such file or directory."),
        (KeyError("frames"), "Cannot read a.png: 'frames' is missing."),
        (MemoryError(), "Cannot read a.png: it does not fit into memory."),
        (EOFError(), "Cannot read a.png: EOFError."),
        (ValueError("one\n  two."), "Cannot read a.png: one two."),
        (
            UnidentifiedImageError("<0x7f>"),
            "a.png: it is not an image of a known type, or its header is damaged.",
        ),
    ],
)
def test_reading_turns_any_error_into_one_line(error, text):
    with pytest.raises(InputError) as caught, reading("a.png"):
        raise error
    assert str(caught.value).endswith(text)


def test_reading_keeps_errors_that_are_clear():
    with pytest.raises(UnknownNameError), reading("a.png"):
        raise UnknownNameError("channel", "smell", ["rgb"])


def test_an_error_is_one_line_that_does_not_steer_the_terminal() -> None:
    error = InputError("No file a\x1b[31m\nb\x9b1m\u202egnp.é.")
    assert str(error) == r"No file a\x1b[31m\nb\x9b1m\u202egnp.é."


def test_an_extra_is_required_before_its_use(monkeypatch: pytest.MonkeyPatch) -> None:
    require_extra("reports", "matplotlib", "trimesh")
    monkeypatch.setitem(sys.modules, "trimesh", None)
    with pytest.raises(MissingExtraError, match=r"trimesh is not .* 'vrcaps\[reports\]'"):
        require_extra("reports", "matplotlib", "trimesh")
