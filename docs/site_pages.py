"""Pages of the site that are made when it is built: front page, API reference, examples, notes.

MkDocs calls `on_files` and `on_page_markdown` (mkdocs.yml names this file). Links between the pages
and the project's other files are rewritten for the site.
"""

from __future__ import annotations

import ast
import logging
import re
from itertools import groupby
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from mkdocs.config.defaults import MkDocsConfig
    from mkdocs.structure.files import Files
    from mkdocs.structure.pages import Page

log = logging.getLogger("mkdocs.hooks.site_pages")

ROOT = Path(__file__).resolve().parents[1]
NOTES = {
    "README.md": "index.md",
    "CONTRIBUTING.md": "contributing.md",
    "CHANGELOG.md": "changelog.md",
}
LINK = re.compile(r"(?<!!)\[([^\]]*)\]\(([^)#:]+)(#[^)]*)?\)")


def on_files(files: Files, config: MkDocsConfig) -> Files:
    """Adds the pages to those of docs/."""
    from mkdocs.structure.files import File

    pages = {page: note(ROOT / name) for name, page in NOTES.items()}
    pages["api.md"] = api_reference(ROOT / "src" / "vrcaps" / "__init__.pyi")
    pages["examples.md"] = examples(ROOT / "examples")
    for name, text in pages.items():
        files.append(File.generated(config, name, content=text))
    return files


def note(path: Path) -> str:
    """A note of the project's root, with links as a page of docs/ has them."""

    def moved(match: re.Match[str]) -> str:
        text, target, anchor = match.groups()
        inside = target.removeprefix("docs/")
        return f"[{text}]({inside if inside != target else '../' + target}{anchor or ''})"

    text = path.read_text().replace("](docs/images/", "](images/")
    return LINK.sub(moved, text)


def on_page_markdown(markdown: str, page: Page, **_: object) -> str:
    """Links out of docs/ lead to pages of the site; a file outside the site keeps its name only."""

    def moved(match: re.Match[str]) -> str:
        text, target, anchor = match.groups()
        if not target.startswith("../"):
            return match[0]
        path = ROOT / target.removeprefix("../")
        if not path.exists():
            log.warning("%s links to %s, which does not exist", page.file.src_uri, target)
        if path.parent.name == "examples":
            return f"[{text}](examples.md#{path.stem})"
        if path.name == "examples":
            return f"[{text}](examples.md)"
        name = NOTES.get(path.name)
        return f"[{text}]({name}{anchor or ''})" if name else text

    return LINK.sub(moved, markdown)


def api_reference(stub: Path) -> str:
    """The public names of the package, grouped by the package that defines them."""
    names = []
    for node in ast.parse(stub.read_text()).body:
        if isinstance(node, ast.ImportFrom) and node.module and node.module != "_core":
            names += [(node.module, alias.name) for alias in node.names]
    text = "# Python API\n\nAll of these are imported from `vrcaps` itself.\n"
    for package, members in groupby(names, lambda name: name[0].split(".")[0]):
        text += f"\n## {package.replace('_', ' ').capitalize()}\n\n"
        text += "".join(f"::: vrcaps.{module}.{name}\n\n" for module, name in members)
    return text


def examples(folder: Path) -> str:
    """The example programs with what their docstrings say."""
    text = "# Examples\n\nEach is a short program; the tests run them all.\n"
    for path in sorted(folder.glob("[0-9]*.py")):
        program = path.read_text()
        text += f"\n## {path.name} {{ #{path.stem} }}\n\n```python\n{program}```\n"
    return text
