"""Commands that fail."""

from __future__ import annotations

import pytest

from vrcaps import cli


def fail(args: list[str], capsys: pytest.CaptureFixture[str]) -> str:
    """The one line on stderr of a command that ends in status 2."""
    with pytest.raises(SystemExit, match="2"):
        cli.main(args)
    error = capsys.readouterr().err
    assert error.startswith("vrcaps: ")
    assert error.count("\n") == 1
    return error
