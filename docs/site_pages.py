"""Generated pages of the site: front page, API reference, examples, contributing, changelog.

MkDocs calls `on_files` and `on_page_markdown` (mkdocs.yml names this file). Links between the pages
and the other files of the repository are rewritten for the site.
"""

from __future__ import annotations

import ast
import logging
import posixpath
import re
from itertools import groupby
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Callable

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
API, EXAMPLES = "reference/api.md", "tutorials/examples.md"
LINK = re.compile(r"(!?)\[([^\]]*)\]\(([^)#:\s]+)(#[^)]*)?\)")


def on_files(files: Files, config: MkDocsConfig) -> Files:
    """Add the generated pages."""
    from mkdocs.structure.files import File

    pages = {page: note(ROOT / name) for name, page in NOTES.items()}
    pages[API] = api_reference(ROOT / "src" / "vrcaps" / "__init__.pyi")
    pages[EXAMPLES] = examples(ROOT / "examples")
    for name, text in pages.items():
        files.append(File.generated(config, name, content=text))
    return files


def note(path: Path) -> str:
    """Markdown file of the repository's root with links as a page of docs/ has them."""
    return with_links(path.read_text(), lambda link: posixpath.relpath(link, "docs"))


def on_page_markdown(markdown: str, page: Page, **_: object) -> str:
    """Links to files outside docs/ lead to pages of the site or become plain text."""
    folder = posixpath.dirname(page.file.src_uri)

    def target(link: str) -> str | None:
        path = posixpath.normpath(posixpath.join("docs", folder, link))
        if path.startswith("docs/"):
            return link
        if not (ROOT / path).exists():
            log.warning("%s links to %s, which does not exist", page.file.src_uri, link)
        if path.startswith("examples/") and path.endswith(".py"):
            return f"{posixpath.relpath(EXAMPLES, folder)}#{Path(path).stem}"
        site_page = EXAMPLES if path == "examples" else NOTES.get(path)
        return posixpath.relpath(site_page, folder) if site_page else None

    return with_links(markdown, target)


def with_links(text: str, target: Callable[[str], str | None]) -> str:
    """Replace the targets of links to files; a link without a target becomes its text."""

    def replaced(match: re.Match[str]) -> str:
        image, words, link, anchor = match.groups()
        new = target(link)
        return words if new is None else f"{image}[{words}]({new}{anchor or ''})"

    return LINK.sub(replaced, text)


def api_reference(stub: Path) -> str:
    """Public names of the package, grouped by the package that defines them."""
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
    """Source code of the example programs."""
    text = "# Examples\n\nEach is a short program; the tests run them all.\n"
    for path in sorted(folder.glob("[0-9]*.py")):
        program = path.read_text()
        text += f"\n## {path.name} {{ #{path.stem} }}\n\n```python\n{program}```\n"
    return text
