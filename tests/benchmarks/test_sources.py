from __future__ import annotations

from pathlib import Path

from benchmarks.common.sections import sources
from benchmarks.common.sources import PACKAGE, ROOT, digest, reached
from benchmarks.figures import __main__ as figures

BENCHES = PACKAGE / "cli" / "benchmarks"


def packages(command: Path) -> set[str]:
    """Names of what lies directly in vrcaps among the files that a command may import."""
    inside = (path for path in reached(command) if path.is_relative_to(PACKAGE))
    return {path.relative_to(PACKAGE).parts[0] for path in inside}


def test_a_command_depends_on_what_it_imports_and_on_nothing_else() -> None:
    found = packages(ROOT / "benchmarks" / "speed" / "path.py")
    assert {"render", "anatomy", "organ", "cli"} <= found
    assert not found & {"cockpit", "learn", "data", "env", "policy", "recording"}


def test_modules_run_by_name_in_another_process_count() -> None:
    assert {"recording", "scenario", "render"} <= packages(BENCHES / "record.py")


def test_names_that_the_package_loads_lazily_are_followed(tmp_path: Path) -> None:
    script = tmp_path / "script.py"
    script.write_text("def run():\n    from vrcaps import read_arm\n", encoding="utf-8")
    assert PACKAGE / "actuation" / "arm" / "arm.py" in reached(script)
    assert "render" not in packages(script)
    other = tmp_path / "other.py"
    other.write_text("import vrcaps\n", encoding="utf-8")
    assert "render" in packages(other)


def test_a_change_in_a_file_that_is_imported_changes_the_digest(tmp_path: Path) -> None:
    script, other, third = (tmp_path / f"{name}.py" for name in ("script", "other", "third"))
    script.write_text("import other\n", encoding="utf-8")
    for path in (other, third):
        path.write_text("VALUE = 1\n", encoding="utf-8")
    before = digest(script)
    third.write_text("VALUE = 2\n", encoding="utf-8")
    assert digest(script) == before
    other.write_text("VALUE = 2\n", encoding="utf-8")
    assert digest(script) != before


def test_what_is_said_about_the_code_does_not_count(tmp_path: Path) -> None:
    script = tmp_path / "script.py"
    script.write_text('"""One."""\nSIZE = "3"\n"""Of it."""\n', encoding="utf-8")
    before = digest(script)
    text = '"""Two."""\n\nSIZE = "3"  # three\n\n\ndef empty():\n    """None."""\n'
    script.write_text(text.partition("\n\n\n")[0], encoding="utf-8")
    assert digest(script) == before
    script.write_text(text, encoding="utf-8")
    assert digest(script) != before


def test_every_figure_has_sources() -> None:
    for figure in figures.FIGURES:
        assert sources(figure.name)
