from __future__ import annotations

import re
from pathlib import Path

import figures
import readme
from vrcaps.cli.benchmarks.page import read_sections, sources, table, write_section


def test_a_section_replaces_its_own_and_states_command_sources_and_time(tmp_path: Path) -> None:
    page = tmp_path / "docs" / "page.md"
    bench, script = "vrcaps bench render", "benchmarks/speed_fem.py"
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
    rows = list(readme.read_rows(f"## A\n\n{text}\n\nmore\n\n{text}"))
    assert len(rows) == 4
    assert readme.find(rows, "ms | plain | wet") == "4.1 (3.9–5.0)"
    assert readme.find(rows, "most ms") == "12.0"
    assert readme.find(rows, "least ms") == "4.1 (3.9–5.0)"
    assert readme.find(rows, "ms | gone") == "not measured"


_OTHER_PAGES = {
    *("ablate_simulator", "cohort", "speed_bake"),
    *("transfer_page", "validate_calibration", "validate_looks"),
}


def test_every_script_that_writes_a_table_is_among_the_figures() -> None:
    folder = Path(figures.__file__).parent
    scripts = {p.stem for p in folder.glob("*.py") if "write_section(" in p.read_text("utf-8")}
    listed = {Path(figure.name).stem for figure in figures.FIGURES}
    kept = {Path(name).stem for name in figures.KEPT}
    assert scripts - {"validation"} - _OTHER_PAGES <= listed | kept


def test_every_figure_of_the_front_page_is_of_a_section_that_is_measured() -> None:
    listed = {figure.name for figure in figures.FIGURES}
    assert {section for _, section, _ in readme.FIGURES} <= listed
