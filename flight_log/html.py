"""Elements of self-contained HTML pages: no scripts, no external files, printable."""

import base64
from collections.abc import Iterable, Sequence
from html import escape

STYLE = """
:root { color-scheme: light dark; }
body { font: 15px/1.45 system-ui, sans-serif; max-width: 68rem; margin: 2rem auto; padding: 0 1rem; }
h1 { font-size: 1.5rem; margin-bottom: .2rem; } h2 { font-size: 1.15rem; margin-top: 2rem; }
table { border-collapse: collapse; margin: .5rem 0; } th, td { text-align: left; padding: .15rem .9rem .15rem 0; }
td.number { text-align: right; font-variant-numeric: tabular-nums; } tr { border-bottom: 1px solid #8884; }
pre, code { font: 13px/1.4 ui-monospace, monospace; } pre { overflow-x: auto; padding: .6rem; background: #8882; }
img { max-width: 100%; background: white; } .good { color: #1a7f37; } .bad { color: #cf222e; font-weight: 600; }
.values td { text-align: left; overflow-wrap: anywhere; min-width: 5rem; }
.values td:first-child { white-space: nowrap; }
caption { text-align: left; font-weight: 600; } figure { margin: 1.5rem 0; }
.scroll { overflow-x: auto; } .quiet { opacity: .7; }
"""


def page(title: str, parts: Iterable[str]) -> str:
    """A complete page; empty parts are left out."""
    return (
        '<!doctype html>\n<html lang="en"><head><meta charset="utf-8">'
        '<meta name="viewport" content="width=device-width, initial-scale=1">'
        f"<title>{escape(title)}</title><style>{STYLE}</style></head>\n<body>\n<h1>{escape(title)}</h1>\n"
        + "\n".join(part for part in parts if part)
        + "\n</body></html>\n"
    )


def section(title: str, *parts: str) -> str:
    """A section with a heading; "" if all parts are empty."""
    body = "\n".join(part for part in parts if part)
    return f"<h2>{escape(title)}</h2>\n{body}" if body else ""


def table(rows: Sequence[Sequence[str]], head: Sequence[str] = (), caption: str = "") -> str:
    """A table of plain texts; numbers are aligned to the right, **texts** are bold. "" if there are no rows."""
    if not rows:
        return ""
    named = f"<caption>{escape(caption)}</caption>" if caption else ""
    top = "<tr>" + "".join(f"<th>{escape(cell)}</th>" for cell in head) + "</tr>" if head else ""
    return f'<div class="scroll"><table>{named}{top}{"".join(map(_row, rows))}</table></div>'


def values_table(rows: Sequence[Sequence[str]], head: Sequence[str] = ()) -> str:
    """A table of names and values of any kind: all aligned to the left, long values broken. "" if there are no rows."""
    body = table(rows, head)
    return f'<div class="values">{body}</div>' if body else ""


def details(title: str, body: str) -> str:
    """HTML that opens on a click."""
    return f"<details><summary>{escape(title)}</summary>{body}</details>"


def code(text: str) -> str:
    """Preformatted text."""
    return f"<pre>{escape(text)}</pre>"


def figure(png: bytes, caption: str) -> str:
    """A PNG image with its caption."""
    return f"<figure>{image(png, caption)}<figcaption>{escape(caption)}</figcaption></figure>"


def image(png: bytes, name: str) -> str:
    """A PNG image, embedded in the page."""
    return f'<img alt="{escape(name)}" src="data:image/png;base64,{base64.b64encode(png).decode()}">'


def paragraph(text: str, style: str = "") -> str:
    """A paragraph; `style` is a class in STYLE. "" if there is no text."""
    return f'<p class="{style}">{escape(text)}</p>' if text else ""


def _row(cells: Sequence[str]) -> str:
    return "<tr>" + "".join(_cell(cell) for cell in cells) + "</tr>"


def _cell(text: str) -> str:
    if text.startswith("**") and text.endswith("**"):
        return f"<td><strong>{escape(text.strip('*'))}</strong></td>"
    number = text.strip().lstrip("+-").replace(".", "", 1).replace("e-", "", 1).isdigit()
    return f'<td class="number">{escape(text)}</td>' if number else f"<td>{escape(text)}</td>"
