"""Generated pages of the site: front page, API reference, examples, contributing, changelog.

MkDocs calls `on_files` and `on_page_markdown` (mkdocs.yml names this file). Links between the pages
and the other files of the repository are rewritten for the site.
"""

from __future__ import annotations

import ast
import logging
import posixpath
import re
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
EXAMPLES = "tutorials/examples.md"
AREAS = {
    "": "Names that are imported from `vrcaps` itself.",
    "env": "Environments for Gymnasium, Stable-Baselines3 and PettingZoo.",
    "data": "Data sets and frame sequences.",
    "learn": "Training, evaluation and prediction of networks.",
    "formats": "Export to and import from the layouts of other software.",
    "metrics": "Metrics in NumPy.",
    "policy": "Policies, baselines, training and evaluation.",
    "sensors": "Sensors of the capsule and around the patient.",
}
"""Areas of the Python API, by package."""
NOTEBOOK_LINK = re.compile(r'href="([^":#]+)\.(md|ipynb)(#[^"]*)?"')
LINK = re.compile(r"(!?)\[([^\]]*)\]\(([^)#:\s]+)(#[^)]*)?\)")


def on_files(files: Files, config: MkDocsConfig) -> Files:
    """Add the generated pages."""
    from mkdocs.structure.files import File

    pages = {page: note(ROOT / name) for name, page in NOTES.items()}
    pages |= {api_page(area): api_reference(area) for area in AREAS}
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


def on_post_page(output: str, page: Page, **_: object) -> str:
    """Links of a notebook to pages lead to their HTML files, as MkDocs does for Markdown."""
    if not page.file.src_uri.endswith(".ipynb"):
        return output
    folder = ROOT / "docs" / posixpath.dirname(page.file.src_uri)

    def replaced(match: re.Match[str]) -> str:
        link, ending, anchor = match.groups()
        if not (folder / f"{link}.{ending}").exists():
            log.warning("%s links to %s.%s, which does not exist", page.file.src_uri, link, ending)
        return f'href="{link}.html{anchor or ""}"'

    return NOTEBOOK_LINK.sub(replaced, output)


def with_links(text: str, target: Callable[[str], str | None]) -> str:
    """Replace the targets of links to files; a link without a target becomes its text."""

    def replaced(match: re.Match[str]) -> str:
        image, words, link, anchor = match.groups()
        new = target(link)
        return words if new is None else f"{image}[{words}]({new}{anchor or ''})"

    return LINK.sub(replaced, text)


def api_page(area: str) -> str:
    """Page of an area of the API."""
    return f"reference/api/{area or 'index'}.md"


def public_names(area: str) -> list[tuple[str, str]]:
    """Public names of an area: name and path of its definition, from the area's `__init__`."""
    folder = ROOT / "src" / "vrcaps" / area
    stub = folder / "__init__.pyi"
    source = stub if stub.exists() else folder / "__init__.py"
    package = ["vrcaps", *filter(None, [area])]
    names = []
    for node in ast.walk(ast.parse(source.read_text("utf-8"))):
        if not isinstance(node, ast.ImportFrom) or node.module in ("typing", "collections.abc"):
            continue
        module = ".".join([*package, *filter(None, [node.module])]) if node.level else node.module
        if not (module or "").startswith("vrcaps"):
            continue
        names += [
            (alias.name, f"{module}.{alias.name}")
            for alias in node.names
            if alias.asname == alias.name and not alias.name.startswith("_")
        ]
    return names


def api_reference(area: str) -> str:
    """Page of the public names of an area; modules and constants of the core are left out."""
    title = f"vrcaps.{area}" if area else "vrcaps"
    lines = [f"# {title}", "", AREAS[area], ""]
    if not area:
        pages = (f"[`vrcaps.{name}`]({name}.md)" for name in AREAS if name)
        lines += [f"Areas: {', '.join(pages)}.", ""]
    for name, path in public_names(area):
        if path.startswith("vrcaps._core") or path == f"vrcaps.{name}":
            continue
        lines += [f"::: {path}", ""]
    return "\n".join(lines)


def examples(folder: Path) -> str:
    """Source code of the example programs, with a thumbnail of each."""
    text = "# Examples\n\nEach is a short program; the tests run them all.\n"
    for path in sorted(folder.glob("[0-9]*.py")):
        program = path.read_text()
        title = (ast.get_docstring(ast.parse(program)) or "").partition("\n")[0].rstrip(".")
        text += f"\n## {title} {{ #{path.stem} }}\n\n"
        if (folder.parent / "docs" / "images" / f"example_{path.stem}.jpg").exists():
            text += f"![{title}](../images/example_{path.stem}.jpg)\n\n"
        text += f"`examples/{path.name}`\n\n```python\n{program}```\n"
    return text
