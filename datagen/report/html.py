"""Parts of all HTML pages: head and style, tables, and pictures inside the file."""

from __future__ import annotations

import base64
import io
from collections.abc import Sequence
from html import escape

from matplotlib.figure import Figure

_STYLE = """
body { font: 15px/1.5 system-ui, sans-serif; color: #222; max-width: 1225px; margin: 2em auto; padding: 0 1em; }
h1, h2 { line-height: 1.2; } h2 { margin-top: 2em; border-bottom: 1px solid #ccc; }
table { border-collapse: collapse; font-size: 13px; } td, th { padding: .3em .7em; text-align: left;
vertical-align: top; border-bottom: 1px solid #e4e4e4; } tr:nth-child(even) { background: #f7f7f7; }
img { max-width: 100%; height: auto; }
pre, .wide { overflow-x: auto; } code { background: #f0f0f0; padding: 0 .25em; } td small { color: #666; }
"""


def head(title: str) -> str:
    """The beginning of a page, headline included; `title` is plain text."""
    text = escape(title)
    return (
        f'<!doctype html>\n<html lang="en"><head><meta charset="utf-8">'
        f'<meta name="viewport" content="width=device-width, initial-scale=1"><title>{text}</title>'
        f"<style>{_STYLE}</style></head><body><h1>{text}</h1>"
    )


def table(header: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """A table of plain text."""
    top = "<tr>" + "".join(f"<th>{escape(cell)}</th>" for cell in header) + "</tr>"
    body = "".join("<tr>" + "".join(f"<td>{escape(cell)}</td>" for cell in row) + "</tr>" for row in rows)
    return f'<div class="wide"><table>{top}{body}</table></div>'


def inside(figure: Figure, meaning: str) -> str:
    """A figure as a PNG within the page itself; `meaning` is read aloud to those who cannot see it."""
    file = io.BytesIO()
    figure.savefig(file, format="png", metadata={"Software": None})
    return picture(file.getvalue(), "png", meaning)


def picture(content: bytes, kind: str, meaning: str) -> str:
    """The bytes of a picture within the page itself. kind : `png` or `gif`. meaning : as for `inside`."""
    data = base64.b64encode(content).decode()
    return f'<p><img alt="{escape(meaning)}" src="data:image/{kind};base64,{data}"></p>'
