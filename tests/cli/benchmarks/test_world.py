from __future__ import annotations

from vrcaps.cli.benchmarks import world


def test_a_short_run_measures_every_claim() -> None:
    report = world.measure(60_000, 2)
    assert [claim.unit for claim in report.claims] == [
        "per second",
        "ms",
        "per second",
        "per second",
    ]
    for claim in report.claims:
        assert claim.measured is not None
        assert claim.measured.median > 0.0
    assert [len(table.rows) for table in report.tables] == [3, 1, 2, 1]
    assert "mm² touched" in report.tables[0].rows[0].note
