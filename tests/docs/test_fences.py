"""Every fenced block of the documentation is run, parsed by a test, or marked as text."""

from __future__ import annotations

import ast
import json
import re
import tomllib
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
PAGES = [
    ROOT / "README.md",
    ROOT / "CONTRIBUTING.md",
    *sorted((ROOT / "docs").rglob("*.md")),
]
FENCE = re.compile(r"^( *)```([^\n]*)\n(.*?)^ *```$", re.MULTILINE | re.DOTALL)
LANGUAGES = {"python", "sh", "toml", "json", "text", "mermaid", "rust", "yaml"}
"""Python is run (`test_programs`, `test_extending`), commands in `sh` are parsed
(`cli/test_shown_options`), `toml`, `json` and `yaml` are read, `text` is output, and the lines of
`rust` belong to the program of their section in the guide to extensions."""


def blocks(page: Path) -> list[tuple[str, str]]:
    """Language and text of each fenced block."""
    return [
        (match[2].strip(), re.sub(rf"(?m)^{match[1]}", "", match[3]))
        for match in FENCE.finditer(page.read_text("utf-8"))
    ]


@pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(ROOT)))
def test_every_block_has_a_known_language_and_parses(page: Path) -> None:
    for language, text in blocks(page):
        assert language in LANGUAGES, f"{page}: ```{language}\n{text}"
        if language == "python":
            ast.parse(text)
        elif language == "toml":
            tomllib.loads(text)
        elif language == "json":
            json.loads(text)


@pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(ROOT)))
def test_links_lead_to_files(page: Path) -> None:
    text = FENCE.sub("", page.read_text("utf-8"))
    targets = re.findall(r"\]\(([^)#\s]+)(?:#[^)]*)?\)", text)
    generated = {"index.md", "examples.md"}  # written when the site is built
    missing = [
        target
        for target in targets
        if "://" not in target
        and not (page.parent / target).exists()
        and Path(target).name not in generated
        and "api/" not in target
    ]
    assert not missing
