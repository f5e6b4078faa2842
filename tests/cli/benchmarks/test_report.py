from __future__ import annotations

import io
from dataclasses import replace
from pathlib import Path

import pytest
from rich.console import Console

from vrcaps.cli.benchmarks.report import (
    Claim,
    Report,
    Row,
    Spread,
    Table,
    check_out,
    machine_facts,
    show_report,
)
from vrcaps.core.errors import InputError

FAST = Claim(text="fast", sense="≥", limit=100.0, unit="per second", reference="a paper | page 3")
REPORT = Report(
    title="Rendering speed",
    command="vrcaps bench render",
    setting="A wall.",
    claims=(
        replace(FAST, measured=Spread(123.4, 99.94, 150.0)),
        replace(FAST, text="lean", sense="≤", limit=0.4, measured=Spread(0.5, 0.4, 0.6)),
        replace(FAST, text="other", reason="no peer"),
    ),
    tables=(
        Table("One frame", ("ms", "ratio"), (Row("ours", (Spread(8.1, 8.1, 8.1), None), "n"),)),
    ),
    skipped={"mitsuba": "no LLVM"},
    machine={"processor": "P"},
)


@pytest.mark.parametrize(
    ("sense", "value", "verdict"),
    [("≥", 99.0, "FAIL"), ("≥", 100.0, "pass"), ("≤", 100.0, "pass"), ("≤", 101.0, "FAIL")],
)
def test_verdict_is_of_the_median(sense: str, value: float, verdict: str) -> None:
    spread = Spread(value, 0.0, 1e9)
    assert replace(FAST, sense=sense, measured=spread).verdict == verdict


def test_what_was_not_measured_is_neither() -> None:
    assert FAST.verdict == "not measured"


def test_page_holds_claims_tables_and_reasons(tmp_path: Path) -> None:
    out = tmp_path / "docs" / "results" / "benchmarks.md"
    show_report(REPORT, out, Console(quiet=True))
    page = out.read_text("utf-8")
    assert "| fast | ≥ 100 per second | 123 (99.9–150) | pass | a paper \\| page 3 |" in page
    assert "| lean | ≤ 0.4 per second | 0.50 (0.40–0.60) | FAIL |" in page
    assert "| other | ≥ 100 per second | no peer | not measured |" in page
    assert "| ours | 8.10 |  | n |" in page
    assert "Left out: mitsuba: no LLVM." in page


def test_page_keeps_what_another_benchmark_wrote(tmp_path: Path) -> None:
    out = tmp_path / "benchmarks.md"
    show_report(REPORT, out, Console(quiet=True))
    show_report(
        replace(REPORT, title="Other", command="vrcaps bench record"), out, Console(quiet=True)
    )
    page = out.read_text("utf-8")
    assert page.index("## Other") < page.index("## Rendering speed")


def test_console_shows_the_verdict() -> None:
    console = Console(record=True, width=140, file=io.StringIO())
    show_report(REPORT, None, console)
    text = console.export_text()
    assert "FAIL" in text
    assert "Left out: mitsuba: no LLVM." in text


def test_out_must_be_markdown() -> None:
    with pytest.raises(InputError, match=r"--out is x.json. Allowed: a file name that ends in .md"):
        check_out(Path("x.json"))


def test_machine_facts_name_processor_and_versions() -> None:
    facts = machine_facts()
    assert facts["processor"]
    assert "threads" in facts["vrcaps"]
