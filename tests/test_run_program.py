"""Programs in forks behave as in separate interpreters."""

import os
import signal
from pathlib import Path

import pytest

from tests.support.programs import run_program

pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(os.name != "posix", reason="forks"),
]


@pytest.mark.parametrize(
    ("code", "status", "messages"),
    [
        ("", 0, ""),
        ("import sys; sys.exit(3)", 3, ""),
        ("raise SystemExit('no such file')", 1, "no such file"),
        ("raise ValueError('broken')", 1, "ValueError: broken"),
        ("import os, signal; os.kill(os.getpid(), signal.SIGKILL)", -signal.SIGKILL, ""),
        ("import os; os._exit(4)", 4, ""),
    ],
)
def test_status_and_messages_come_back(code: str, status: int, messages: str) -> None:
    result = run_program(code)
    assert result.returncode == status
    assert messages in result.stderr


def test_vrcaps_is_imported_afresh_with_the_threads_of_the_environment() -> None:
    code = "import sys; print('vrcaps' in sys.modules); import vrcaps._core as core; "
    code += "print(core.num_threads())"
    for count in ("1", "3"):
        result = run_program(code, environment={"RAYON_NUM_THREADS": count})
        assert result.stdout.split() == ["False", count], result.stderr


def test_a_file_has_its_folder_arguments_and_strict_warnings(tmp_path: Path) -> None:
    program = tmp_path / "program.py"
    (tmp_path / "beside.py").write_text("name = 'beside'\n")
    program.write_text(
        "import atexit, os, sys, threading, warnings, beside\n"
        "atexit.register(print, 'end')\n"
        "threading.Thread(target=sys.stdout.write, args=('thread\\n',)).start()\n"
        "line = ' '.join([__name__, beside.name, os.getcwd(), *sys.argv[1:]])\n"
        "sys.stdout.write(line + '\\n')\n"
        "warnings.warn('old', stacklevel=1)\n"
    )
    result = run_program(program, "--a", "b", folder=tmp_path)
    assert result.returncode == 0, result.stderr
    lines = result.stdout.splitlines()
    assert sorted(lines[:2]) == [f"__main__ beside {tmp_path} --a b", "thread"]
    assert lines[2:] == ["end"]
    assert run_program(program, folder=tmp_path, warnings="__main__").returncode == 1


def test_a_program_starts_others_with_its_folder_and_streams(tmp_path: Path) -> None:
    code = (
        "import os\n"
        "from tests.support.program_server import Child\n"
        "child = Child()\n"
        "print('first', flush=True)\n"
        "other = 'import os, sys; print(os.getcwd(), *sys.argv[1:], name()); sys.exit(3)'\n"
        "setup = 'import builtins; builtins.name = lambda: 5'\n"
        "print(child.run(other, 'a', setup=setup, timeout=60.0))\n"
    )
    result = run_program(code, folder=tmp_path)
    assert result.stdout.splitlines() == ["first", f"{tmp_path} a 5", "3"], result.stderr
