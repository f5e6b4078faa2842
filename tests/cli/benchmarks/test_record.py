from __future__ import annotations

import subprocess
import sys

import pytest

from vrcaps.cli.benchmarks import record
from vrcaps.core.errors import InputError


@pytest.mark.slow
@pytest.mark.usefixtures("coarse_organs")
def test_a_short_recording_is_measured() -> None:
    report = record.measure(num_frames=2, num_runs=1)
    *rates, memory = report.claims
    for rate in rates:
        assert rate.measured is not None
        assert rate.measured.median > 0.0
    if sys.platform != "win32":
        assert memory.measured is not None
        assert 0.05 < memory.measured.median < 4.0
    *stages, whole = report.tables
    for table in stages:
        assert {row.name for row in table.rows} >= {"render", "PNG"}
    assert all(value is not None and value.median > 0.0 for r in whole.rows for value in r.values)
    assert "kB a frame" in report.setting


def test_a_recording_that_fails_is_one_line(monkeypatch: pytest.MonkeyPatch) -> None:
    answer = subprocess.CompletedProcess([], 1, stdout="", stderr="Traceback\nValueError: broken\n")
    monkeypatch.setattr(subprocess, "run", lambda *_, **__: answer)
    with pytest.raises(InputError, match="The recording to be measured failed: ValueError: broken"):
        record.measure(num_frames=4, num_runs=1)
