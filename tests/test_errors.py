"""Errors: one line that says what was given and what is allowed."""

from __future__ import annotations

import pytest

from vrcaps.errors import InputError, MissingExtraError, UnknownNameError, VrcapsError


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
