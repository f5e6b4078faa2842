"""Components of reports: plots without a display, and self-contained HTML pages."""

from __future__ import annotations

import base64
import html
import io
from collections.abc import Iterable, Mapping, Sequence
from typing import TYPE_CHECKING, Any

from vrcaps.core.errors import import_extra

if TYPE_CHECKING:
    import matplotlib.figure

_STYLE = """
body { font: 15px/1.45 system-ui, sans-serif; margin: 2em auto; max-width: 1280px; padding: 0 1em; }
h1 { font-size: 1.5em; } h2 { font-size: 1.15em; margin-top: 2em; }
img, video { max-width: 100%; }
.wide { overflow-x: auto; }
table { border-collapse: collapse; font-size: 13px; }
th, td { padding: .3em .7em; text-align: right; border-bottom: 1px solid #ddd; }
th { vertical-align: bottom; } th:first-child, td:first-child { text-align: left; }
p.note { color: #555; font-size: 13px; }
"""


def make_figure(width: float, height: float, **options: Any) -> matplotlib.figure.Figure:
    """Create a Matplotlib canvas of plots that needs no display.

    Args:
        width: Width [inch].
        height: Height [inch].
        options: Options of `matplotlib.figure.Figure`; the layout is constrained by default.

    Raises:
        MissingExtraError: If Matplotlib is not installed.
    """
    figure = import_extra("matplotlib.figure", "reports", package="matplotlib")
    agg = import_extra("matplotlib.backends.backend_agg", "reports", package="matplotlib")

    settings = {"layout": "constrained", **options}
    created = figure.Figure(figsize=(width, height), **settings)
    agg.FigureCanvasAgg(created)
    return created


def png_bytes(drawn: matplotlib.figure.Figure, dpi: float) -> bytes:
    """Render a plot as a PNG file."""
    data = io.BytesIO()
    drawn.savefig(data, dpi=dpi)
    return data.getvalue()


def html_page(title: str, parts: Iterable[str], style: str = "") -> bytes:
    """Self-contained HTML page.

    Args:
        title: Title of the page, as text.
        parts: Content in HTML; empty parts are left out.
        style: CSS in addition to the common style.
    """
    head = (
        "<!doctype html><html lang='en'><meta charset='utf-8'>"
        "<meta name='viewport' content='width=device-width'>"
        f"<title>{html.escape(title)}</title><style>{_STYLE}{style}</style>"
    )
    return "\n".join(filter(None, [head, *parts])).encode()


def html_note(text: str) -> str:
    """Paragraph in small print; the text is HTML."""
    return f"<p class='note'>{text}</p>"


def html_image(alt: str, png: bytes) -> str:
    """Embedded PNG image."""
    return f"<img alt='{alt}' src='{data_url(png, 'image/png')}'>"


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
