"""Components of self-contained HTML pages: style, tables, embedded files."""

from __future__ import annotations

import base64
import html
from collections.abc import Mapping, Sequence

STYLE = """
body { font: 15px/1.45 system-ui, sans-serif; margin: 2em auto; max-width: 1280px; padding: 0 1em; }
h1 { font-size: 1.5em; } h2 { font-size: 1.15em; margin-top: 2em; }
img, video { max-width: 100%; }
.wide { overflow-x: auto; }
table { border-collapse: collapse; font-size: 13px; }
th, td { padding: .3em .7em; text-align: right; border-bottom: 1px solid #ddd; }
th { vertical-align: bottom; } th:first-child, td:first-child { text-align: left; }
p.note { color: #555; font-size: 13px; }
"""


def html_table(rows: Sequence[Mapping[str, str]]) -> str:
    """Table with a row for each mapping; the keys of the first are the header."""
    head = "".join(f"<th>{html.escape(name)}</th>" for name in rows[0])
    body = "".join(
        f"<tr>{''.join(f'<td>{html.escape(value)}</td>' for value in row.values())}</tr>"
        for row in rows
    )
    return f"<div class='wide'><table><tr>{head}</tr>{body}</table></div>"


def data_url(data: bytes, kind: str) -> str:
    """Encode a file as a data URL.

    Args:
        data: Content of the file.
        kind: Media type, such as ``image/png``.
    """
    return f"data:{kind};base64,{base64.b64encode(data).decode()}"
