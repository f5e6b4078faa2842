"""Run Jupyter notebooks as programs, with smaller parameters for a test."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

from tests.support.coarse_organs import COARSE
from tests.support.programs import run_program
from tests.support.waiting import WATCHDOG

PREAMBLE = """
import subprocess, sys, warnings
warnings.filterwarnings("error", module="vrcaps|__main__")
def _shell(line):
    if subprocess.run(line, shell=True).returncode:
        sys.exit(f"Failed: {line}")
"""
SMOKE_PREAMBLE = f"""
import shlex, sys, warnings
from tests.support.program_server import Child
_server = Child()
{COARSE}
warnings.filterwarnings("error", module="vrcaps|__main__")
def _shell(line):
    program, *arguments = shlex.split(line)
    assert program == "vrcaps", line
    code = "from vrcaps.cli import main; main()"
    if arguments[:2] == ["dataset", "make"]:
        arguments += ["--workers", "0"]  # a worker process would import all modules again
    sys.stdout.flush()
    if _server.run(code, *arguments, setup={COARSE!r}, timeout={WATCHDOG}):
        sys.exit(f"Failed: {{line}}")
"""
"""Runs `vrcaps` without the start-up time of an interpreter, with coarse textures."""

LAUNCHER = "#!{python}\nfrom vrcaps.cli import main\nif __name__ == '__main__':\n    main()\n"


def program_of(path: Path, *, smoke: bool) -> str:
    """Python program of a notebook's code cells; `!` lines become calls of the shell.

    Args:
        path: Notebook.
        smoke: Whether the values in the notebook's metadata replace those of its cell `parameters`.
    """
    notebook = json.loads(path.read_text("utf-8"))
    cells = [SMOKE_PREAMBLE if smoke else PREAMBLE]
    for cell in notebook["cells"]:
        if cell["cell_type"] != "code":
            continue
        if smoke and "parameters" in cell["metadata"].get("tags", ()):
            values = notebook["metadata"]["vrcaps"]["smoke"]
            cells += [f"{name} = {value!r}" for name, value in values.items()]
        else:
            cells.append("".join(map(_line, cell["source"])))
    return "\n".join(cells)


def _line(line: str) -> str:
    """Line of a code cell as Python; the shell command of a `!` line may contain `{names}`."""
    return f"_shell(f{line[1:].strip()!r})\n" if line.startswith("!") else line


def run_smoke(path: Path, folder: Path) -> None:
    """Run a notebook with its smaller parameters and coarse textures in a folder.

    Raises:
        AssertionError: If a cell fails; with the error messages.
    """
    code = program_of(path, smoke=True)
    result = run_program(code, folder=folder, environment={"MPLBACKEND": "agg"}, is_loaded=True)
    assert result.returncode == 0, result.stdout + result.stderr


def run_notebook(path: Path, folder: Path, *, timeout: float) -> None:
    """Run a notebook as it is in a folder.

    Raises:
        AssertionError: If a cell fails; with the error messages.
    """
    programs = folder / "bin"
    programs.mkdir()
    launcher = programs / "vrcaps"
    launcher.write_text(LAUNCHER.format(python=sys.executable))
    launcher.chmod(0o755)
    program = folder / f"{path.stem}.py"
    program.write_text(program_of(path, smoke=False), encoding="utf-8")
    environment = {
        **os.environ,
        "PATH": f"{programs}{os.pathsep}{os.environ['PATH']}",
        "MPLBACKEND": "agg",
    }
    result = subprocess.run(
        [sys.executable, str(program)],
        capture_output=True,
        text=True,
        timeout=timeout,
        cwd=folder,
        env=environment,
        check=False,
    )
    assert result.returncode == 0, result.stdout + result.stderr
