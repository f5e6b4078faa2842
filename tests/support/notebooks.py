"""Run Jupyter notebooks as programs, with smaller parameters for a test."""

from __future__ import annotations

import json
from pathlib import Path

from tests.support.programs import run_program

PREAMBLE = """
import shlex, subprocess, sys, warnings
from tests.support.program_server import Branch
_branch = Branch()
warnings.filterwarnings("error", module="vrcaps|__main__")
def _shell(line):
    program, *words = shlex.split(line)
    if program == "vrcaps":
        status = _branch.run("from vrcaps.cli import main; main()", *words)
    else:
        status = subprocess.run(line, shell=True).returncode
    if status:
        sys.exit(f"Failed: {line}")
"""


def program_of(path: Path, *, smoke: bool) -> str:
    """Python program of a notebook's code cells; `!` lines become calls of the shell.

    Args:
        path: Notebook.
        smoke: Whether the values in the notebook's metadata replace those of its cell `parameters`.
    """
    notebook = json.loads(path.read_text("utf-8"))
    cells = [PREAMBLE]
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


def run_notebook(path: Path, folder: Path, *, smoke: bool, timeout: float) -> str:
    """Run a notebook in a folder; return the printed text.

    Raises:
        AssertionError: If a cell fails; with the error messages.
    """
    program = folder / f"{path.stem}.py"
    program.write_text(program_of(path, smoke=smoke), encoding="utf-8")
    result = run_program(program, folder=folder, environment={"MPLBACKEND": "agg"}, timeout=timeout)
    assert result.returncode == 0, result.stdout + result.stderr
    return result.stdout
