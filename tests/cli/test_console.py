"""Commands in surroundings that lack something: a reader, an encoding, a place to write."""

import os
import subprocess
import sys

import pytest

from tests.support.programs import run_program
from vrcaps.cli.console import EXIT_BROKEN_PIPE

_MAIN = "from vrcaps.cli import main; main({args!r})"

pytestmark = pytest.mark.skipif(sys.platform == "win32", reason="closes descriptors as POSIX does")


def _run(redirection: str, *args: str, **variables: str) -> tuple[int, str, str]:
    """Status, output and messages of a command under a redirection of the shell."""
    command = f'"{sys.executable}" -c "$CODE" {redirection}'
    environment = {**os.environ, "CODE": _MAIN.format(args=args), **variables}
    done = subprocess.run(
        ["bash", "-o", "pipefail", "-c", command], env=environment, capture_output=True, check=False
    )
    return done.returncode, done.stdout.decode(), done.stderr.decode()


@pytest.mark.slow
def test_characters_that_the_terminal_lacks_are_replaced() -> None:
    status, output, _ = _run("", "organ", "list", PYTHONIOENCODING="ascii")
    assert status == 0
    assert "ORGANS" in output and output.isascii()


@pytest.mark.slow
@pytest.mark.parametrize("redirection", [">&-", "2>&-", "<&- >&- 2>&-"])
def test_closed_streams_do_not_matter(redirection: str) -> None:
    status, _, messages = _run(redirection, "organ", "list")
    assert (status, messages) == (0, "")


@pytest.mark.slow
def test_a_reader_that_has_gone_ends_the_command_without_a_message() -> None:
    status, _, messages = _run("| true", "--help")
    assert status in (0, EXIT_BROKEN_PIPE)
    assert messages == ""


@pytest.mark.slow
@pytest.mark.skipif(not os.path.exists("/dev/full"), reason="needs /dev/full")
@pytest.mark.parametrize("args", [("--help",), ("organ", "list")])
def test_a_full_device_is_one_line(args: tuple[str, ...]) -> None:
    status, _, messages = _run(">/dev/full", *args)
    assert status != 0
    assert messages.count("\n") == 1 and "No space left on device." in messages


@pytest.mark.slow
@pytest.mark.parametrize("columns", ["1", "0", "x"])
def test_a_narrow_terminal_is_none(columns: str) -> None:
    command = _MAIN.format(args=("organ", "list"))
    result = run_program(command, environment={"COLUMNS": columns})
    assert result.returncode == 0, result.stderr
