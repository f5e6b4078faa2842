from __future__ import annotations

import re
import sys
from dataclasses import replace
from pathlib import Path

import pytest

from benchmarks.common.sections import (
    accepted,
    file_of,
    module_of,
    sources,
    stamp_of,
    stamped,
    write_section,
)
from benchmarks.common.sources import ROOT
from benchmarks.figures import __main__ as figures
from benchmarks.figures import paper, summary
from vrcaps.cli.benchmarks.report import read_sections, table, write_page


def test_a_section_replaces_its_own_and_states_command_sources_and_time(tmp_path: Path) -> None:
    page = tmp_path / "docs" / "page.md"
    bench, script = "vrcaps bench render", "benchmarks.speed.fem"
    for name, text in ((bench, "old"), (script, "first"), (bench, "new")):
        write_section(page, name, text, command=f"{name} --size 3", title="# Page\n")
    sections = read_sections(page)
    assert list(sections) == ["", script, bench]
    assert sections[""].strip() == "# Page"
    foot = rf"new\n\nWritten by `{bench} --size 3` from sources `{sources(bench)}` in \d+ s\."
    assert re.fullmatch(foot, sections[bench])
    assert sources(bench) != sources(script)


def test_figures_of_the_front_page_are_cells_of_the_tables() -> None:
    text = table(("frame", "ms"), [("plain | wet", "4.1 (3.9–5.0)"), ("other", "12.0")])
    rows = list(summary.read_rows(f"## A\n\n{text}\n\nmore\n\n{text}"))
    assert len(rows) == 4
    assert summary.find(rows, "ms | plain | wet") == "4.1 (3.9–5.0)"
    assert summary.find(rows, "most ms") == "12.0"
    assert summary.find(rows, "least ms") == "4.1 (3.9–5.0)"
    assert summary.find(rows, "ms | gone") == "not measured"
    assert summary.find(rows, "ms | other | 12.0") == "12.0"
    assert summary.find(rows, "ms | oth") == "not measured"


_OTHER_PAGES = {
    *("sim_to_real.page", "speed.bake"),
    *("appearance.distance", "validation.calibration", "validation.cohort"),
}


def test_every_script_that_writes_a_table_is_among_the_figures() -> None:
    folder = ROOT / "benchmarks"
    files = [p for p in folder.rglob("*.py") if "write_section(" in p.read_text("utf-8")]
    modules = {module_of(path) for path in files if path.parent.name != "common"}
    listed = {figure.name for figure in figures.FIGURES}
    others = {f"benchmarks.{name}" for name in _OTHER_PAGES}
    assert others <= modules
    assert modules - others <= listed | set(figures.KEPT)


def test_every_module_of_the_figures_exists() -> None:
    names = [f.name for f in figures.FIGURES if not f.name.startswith("vrcaps ")]
    assert all(module_of(file_of(name)) == name and file_of(name).is_file() for name in names)


def test_a_stamp_replaces_the_line_of_the_command() -> None:
    text = stamped("a\n\nWritten by `vrcaps bench render`.", "vrcaps bench render", "x --y", 3.2)
    assert text.startswith("a\n\nWritten by `x --y` from sources `")
    assert stamp_of(text) == (sources("vrcaps bench render"), "3", "")
    assert stamp_of("a") == ("", "", "")


def test_sources_are_accepted_for_a_stated_reason_and_measured_again() -> None:
    name = "vrcaps bench render"
    foot = f"a\n\nWritten by `{name} --size 3` from sources `0123456789` in 5 s"
    once = accepted(f"{foot}.", name, "modules renamed, guard episodes identical.")
    reason = "modules renamed, guard episodes identical"
    assert once == f"{foot}. Accepted for sources `{sources(name)}`: {reason}."
    assert stamp_of(once) == ("0123456789", "5", sources(name))
    twice = accepted(once.replace(sources(name), "9876543210"), name, "other")
    assert twice == f"{foot}. Accepted for sources `{sources(name)}`: other."
    assert stamp_of(stamped(twice, name, name, 3.0)) == (sources(name), "3", "")
    with pytest.raises(ValueError, match="has no measured sources"):
        accepted(f"a\n\nWritten by `{name}`.", name, reason)
    with pytest.raises(ValueError, match="empty or has several lines"):
        accepted(f"{foot}.", name, "a\nb")


def test_accepted_sections_are_current(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    figure, page = figures.Figure("vrcaps bench render"), tmp_path / "page.md"
    monkeypatch.setattr(figures, "page_of", lambda name: page)
    text = f"a\n\nWritten by `{figure.name}` from sources `0123456789` in 5 s."
    write_page(page, {"": "# Page\n", figure.name: text})
    assert not figures.is_current(figure)
    figures.accept([figure], "modules renamed")
    assert figures.is_current(figure)
    assert figures.age(figure) == "accepted, of sources 0123456789, took 5 s"


def test_every_figure_of_the_front_page_is_of_a_section_that_is_measured() -> None:
    listed = {figure.name for figure in figures.FIGURES}
    assert {section for _, section, _ in summary.FIGURES} <= listed


def test_the_page_of_the_paper_is_what_the_tables_and_commands_say() -> None:
    page = paper.PAPER.read_text(encoding="utf-8")
    assert paper.table_text() in page, "Run python -m benchmarks.figures.paper."
    assert "not measured" not in paper.table_text()
    conditions = page.partition("## Conditions")[2]
    for one in paper.EXPERIMENTS:
        assert f"`{one.command}`" in conditions
        assert one.command.startswith("vrcaps ") or file_of(one.command.split()[2]).is_file()


def test_an_experiment_without_data_is_skipped_and_a_failed_one_is_named(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(paper, "PAPER", tmp_path / "paper.md")
    page = "# Page\n\n| task | VR-Caps | of old |\n| --- | --- | --- |\n\n## Conditions\n"
    paper.PAPER.write_text(page, encoding="utf-8")
    good, bad, lacking = (
        replace(paper.EXPERIMENTS[0], name=name, command=f"python -c 'import {what}'", data=data)
        for name, what, data in (
            ("good", "sys", (("REAL", "give --real"),)),
            ("bad", "no_such_module", ()),
            ("lacking", "no_such_module", (("runs/none", "make it by `make none`"),)),
        )
    )
    monkeypatch.setattr(paper, "EXPERIMENTS", (good, bad, lacking))
    words = ["--real", str(tmp_path)]
    monkeypatch.setattr(sys, "argv", ["paper", *words])
    with pytest.raises(SystemExit) as ended:
        paper.main()
    assert ended.value.code == 0  # listed only
    line = "lacking: python -c 'import no_such_module' (skipped: runs/none is missing; make it by"
    assert line in capsys.readouterr().out
    assert paper.PAPER.read_text("utf-8") == f"# Page\n\n{paper.table_text()}\n\n## Conditions\n"
    monkeypatch.setattr(sys, "argv", ["paper", "--run", *words])
    with pytest.raises(SystemExit, match=r"^Failed: bad$"):
        paper.main()
    monkeypatch.setattr(sys, "argv", ["paper", "--run", "--only", "good", *words])
    with pytest.raises(SystemExit) as ended:
        paper.main()
    assert ended.value.code == 0


def test_a_command_runs_in_this_interpreter_with_the_given_real_images() -> None:
    by_name = {one.name: one for one in paper.EXPERIMENTS}
    depth, bleeding = (by_name[name].words(Path("/data/a b")) for name in ("depth", "bleeding"))
    assert depth[:2] == [sys.executable, "-c"] and depth[3:5] == ["evaluate", "depth"]
    assert bleeding[:5] == [
        *(sys.executable, "-m", "benchmarks.sim_to_real"),
        *("--real", "/data/a b"),
    ]
