"""A page to take along: a standalone HTML file; nothing is loaded from elsewhere."""

from collections.abc import Iterable, Sequence
from html import escape

from softcal.app.charts.palette import FONTS

DOCUMENT = """<!doctype html>
<html lang="{language}"><head><meta charset="utf-8"><meta name="viewport" content="width=device-width, initial-scale=1">
<title>{title}</title>
<style>
body {{ font: 15px/1.5 {fonts}; color: #1c2733; background: #eef1f4; margin: 0; word-break: keep-all; }}
main {{ max-width: 1080px; margin: 0 auto; padding: 24px 16px 64px; }}
header, section {{ background: #fff; border: 1px solid #d8dee4; border-radius: 10px; padding: 18px 24px;
  margin: 0 0 16px; overflow-x: auto; }}
h1 {{ font-size: 26px; line-height: 1.25; margin: 2px 0 8px; }}
h2 {{ font-size: 18px; margin: 0 0 10px; }} h3 {{ font-size: 15px; margin: 12px 0 0; }}
table {{ border-collapse: collapse; width: 100%; margin: 8px 0; font-size: 14px; }}
th, td {{ text-align: left; padding: 6px 10px; border-bottom: 1px solid #e4e8ec; vertical-align: top; }}
th {{ color: #55606c; font-weight: 600; }}
@media print {{ section {{ break-inside: avoid; }} body {{ background: #fff; }} }}
.drawing {{ width: 100%; height: auto; font-family: inherit; }}
{style}</style>
</head><body><main>{body}</main></body></html>
"""


def document(title: str, parts: Iterable[str], style: str = "", language: str = "") -> str:
    """Return a page from parts, which are HTML."""
    return DOCUMENT.format(fonts=FONTS, title=escape(title), body="\n".join(parts), style=style, language=language)


def section(title: str, *parts: str) -> str:
    """Return HTML under a heading."""
    return f"<section><h2>{escape(title)}</h2>{''.join(parts)}</section>"


def table(header: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    """Return a table whose cells are HTML."""
    head = "".join(f"<th>{escape(cell)}</th>" for cell in header)
    body = "".join(f"<tr>{''.join(f'<td>{cell}</td>' for cell in row)}</tr>" for row in rows)
    return f"<table><thead><tr>{head}</tr></thead><tbody>{body}</tbody></table>"
