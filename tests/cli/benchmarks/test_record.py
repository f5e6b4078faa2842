from __future__ import annotations

import subprocess
import sys

import pytest

from tests.support.coarse_organs import COARSE
from tests.support.programs import run_program
from vrcaps.cli.benchmarks import record
from vrcaps.cli.benchmarks.recording_process import SUBJECTS
from vrcaps.core.errors import InputError


def run_module(command: list[str], **_: object) -> subprocess.CompletedProcess[str]:
    """Run a module as a process does, with small images."""
    assert command[:2] == [sys.executable, "-m"]
    code = f"import runpy; runpy.run_module({command[2]!r}, run_name='__main__')"
    return run_program(code, *command[3:], setup=COARSE, is_loaded=True)


@pytest.mark.slow
@pytest.mark.usefixtures("coarse_organs")
def test_a_short_recording_is_measured(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(subprocess, "run", run_module)
    report = record.measure(num_frames=2, num_runs=1)
    *claims, memory = report.claims
    assert len(claims) == 3
    for rate in claims:
        assert rate.measured is not None
        assert rate.measured.median > 0.0
    if sys.platform != "win32":
        assert memory.measured is not None
        assert 0.05 < memory.measured.median < 4.0
    rates, *stages, whole = report.tables
    assert len(rates.rows) == len(SUBJECTS)
    for table in stages:
        assert {row.name for row in table.rows} >= {"pose", "render", "PNG"}
    assert all(value is not None and value.median > 0.0 for r in whole.rows for value in r.values)
    assert "kB a frame" in report.setting


def test_a_recording_that_fails_is_one_line(monkeypatch: pytest.MonkeyPatch) -> None:
    answer = subprocess.CompletedProcess([], 1, stdout="", stderr="Traceback\nValueError: broken\n")
    monkeypatch.setattr(subprocess, "run", lambda *_, **__: answer)
    with pytest.raises(InputError, match="The recording to be measured failed: ValueError: broken"):
        record.measure(num_frames=4, num_runs=1)
