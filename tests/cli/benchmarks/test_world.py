from __future__ import annotations

import pytest

from vrcaps.cli.benchmarks import world
from vrcaps.cli.benchmarks.stage import Stage


@pytest.mark.slow
def test_a_short_run_measures_every_claim(stage: Stage, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(world, "make_organ", lambda *_, **__: stage.model.organ)
    monkeypatch.setattr(world, "_MIN_DOF", 0)
    monkeypatch.setattr(world, "_REST", 0.2)
    monkeypatch.setattr(world, "_WARM", 1)
    report = world.measure(stage.num_triangles, 2)
    assert [claim.unit for claim in report.claims] == [
        "per second",
        "ms",
        "per second",
        "per second",
    ]
    for claim in report.claims:
        assert claim.measured is not None
        assert claim.measured.median > 0.0
    assert [len(table.rows) for table in report.tables] == [3, 1, 3, 1]
    assert "mm² touched" in report.tables[0].rows[0].note
