from __future__ import annotations

from pathlib import Path

import pytest

from benchmarks.structure.imports import ImportGraph
from benchmarks.structure.patterns import PATTERNS, Pattern, Text
from benchmarks.structure.walk import Walk

REPOSITORY = Text(Path(__file__).resolve().parents[2])


def write(folder: Path, files: dict[str, str]) -> Path:
    for name, text in files.items():
        path = folder / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text)
    return folder


def test_arrows_and_cycles_include_imports_of_functions_and_of_types(tmp_path: Path) -> None:
    files = {
        "vrcaps/__init__.py": "",
        "vrcaps/__init__.pyi": "from vrcaps.a.one import x",
        "vrcaps/a/one.py": "from vrcaps.a import two\nfrom vrcaps import __version__",
        "vrcaps/a/two.py": "def f():\n    from vrcaps.b.three import z",
        "vrcaps/b/three.py": "if TYPE_CHECKING:\n    from vrcaps.a.one import x",
        "vrcaps/c.py": "from vrcaps._core import Wall\nfrom vrcaps.a.two import f",
    }
    graph = ImportGraph(write(tmp_path, files) / "vrcaps")
    assert graph.parts == {"vrcaps", "_core", "a", "b", "c"}
    assert graph.arrows == {("vrcaps", "a"), ("a", "b"), ("b", "a"), ("c", "_core"), ("c", "a")}
    assert graph.cycles == (("vrcaps.a.one", "vrcaps.a.two", "vrcaps.b.three"),)


def test_a_climb_enters_a_higher_layer_and_helpers_do_not_count() -> None:
    ranks = {"core": 0, "mesh": 1, "render": 2, "scenario": 3}
    modules = ("scenario.build", "mesh.read", "core.files", "render.light", "scenario.build")
    walk = Walk(tuple((f"vrcaps.{name}", str(i)) for i, name in enumerate(modules)), ranks)
    assert len(walk.modules) == 4
    assert walk.climbs() == [
        ("vrcaps.core.files", "vrcaps.render.light"),
        ("vrcaps.render.light", "vrcaps.scenario.build"),
    ]
    assert walk.new_climbs() == [("vrcaps.mesh.read", "vrcaps.render.light")]


@pytest.mark.parametrize(
    ("number", "line"),
    (
        (1, '"""Where a triangle surface cuts through itself."""'),
        (3, "# The network that training begins with."),
        (5, '"""The reason is told."""'),
        (9, "_MOST_GRADIENT = 1.0"),
        (11, "for place in range(3):"),
        (12, "number = index + 1"),
        (14, "found = search()"),
        (17, 'TASK = "masks"'),
    ),
)
def test_patterns_find_what_they_are_named_after(tmp_path: Path, number: int, line: str) -> None:
    text = Text(write(tmp_path, {"src/vrcaps/x.py": f'"""Mean of values."""\n{line}\n'}))
    hits = {p.name.split()[0]: p.to_replace(text) for p in PATTERNS if p.to_replace(text)}
    assert f"P{number}" in hits
    assert hits[f"P{number}"] == [f"src/vrcaps/x.py:2: {line}"]


def test_standard_sentences_match_no_pattern(tmp_path: Path) -> None:
    lines = '"""Resume an interrupted recording; place lesions."""\nclasses = num_found = 0\n'
    text = Text(write(tmp_path, {"src/vrcaps/x.py": lines}))
    assert not [p.name for p in PATTERNS if p.to_replace(text)]


@pytest.mark.parametrize(
    ("correct", "wrong"),
    (
        ("motion = settings.begin(model)", "# Networks begin with these weights."),
        ("offset = file.tell()", '"""Tell the reason."""'),
        ('page = "<figure></figure>"', "# All figures of the table."),
        ('onnx = import_extra("onnx", "learn")', "# Networks learn depth."),
        ('layout: Literal["masks", "classes"] = "masks"', 'TASK = "masks"'),
    ),
)
def test_names_and_terms_are_kept(tmp_path: Path, correct: str, wrong: str) -> None:
    text = Text(write(tmp_path, {"src/vrcaps/x.py": f"{correct}\n{wrong}\n"}))
    assert [hit for p in PATTERNS for hit in p.to_replace(text)] == [f"src/vrcaps/x.py:2: {wrong}"]


@pytest.mark.slow
@pytest.mark.parametrize("pattern", PATTERNS, ids=lambda pattern: pattern.name.split()[0])
def test_each_pattern_meets_its_goal(pattern: Pattern) -> None:
    hits = pattern.to_replace(REPOSITORY)
    assert len(hits) <= pattern.goal, hits
