"""Pieces of a self-contained HTML page: no script, no file and no address besides it; all text is escaped here."""

from base64 import b64encode
from collections.abc import Mapping, Sequence
from html import escape
from pathlib import Path

PICTURES = {".png": "image/png", ".svg": "image/svg+xml"}  # suffix -> kind, the preferred first
SHORT = 64  # lines of text that are shown without a click
STYLE = """
:root { color-scheme: light dark; --ink: #1b1f24; --soft: #5b6570; --line: #d5dae0; --paper: #fff; --block: #f5f7f9 }
@media (prefers-color-scheme: dark) {
  :root { --ink: #e4e8ec; --soft: #9aa5b1; --line: #3a424b; --paper: #15181c; --block: #1e2329 }
}
body { max-width: 68rem; margin: 0 auto; padding: 1rem; font: 1rem/1.5 system-ui, sans-serif }
body { color: var(--ink); background: var(--paper) }
h2 { margin-top: 3rem; border-top: 1px solid var(--line); padding-top: 1rem }
a { color: inherit }
.setup, caption { color: var(--soft); font-size: .85rem }
.scroll, pre { overflow-x: auto }
pre { background: var(--block); padding: .75rem; font: .75rem/1.4 ui-monospace, monospace }
table { border-collapse: collapse; font-size: .85rem; font-variant-numeric: tabular-nums }
caption { text-align: left; padding-bottom: .4rem }
th, td { padding: .15rem .6rem; border-bottom: 1px solid var(--line); text-align: right; white-space: nowrap }
th:first-child, td:first-child { text-align: left }
img { max-width: 100%; background: #fff }
figure { margin: 1rem 0 }
details { margin: .6rem 0 }
summary { cursor: pointer }
.quick { font-weight: bold; border: 2px solid #d55e00; padding: .2rem .6rem }
"""
# What the browser may load: nothing but what is in the page.
POLICY = "default-src 'none'; img-src data:; style-src 'unsafe-inline'"


def paragraph(text: str, kind: str = "") -> str:
    """One paragraph, of a class of ``STYLE`` if ``kind`` names it."""
    return f'<p class="{kind}">{escape(text)}</p>' if kind else f"<p>{escape(text)}</p>"


def pre(text: str) -> str:
    """Text whose columns are aligned by spaces."""
    return f'<pre tabindex="0">{escape(text.strip(chr(10)))}</pre>'


def table(caption: str, heads: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """A table whose first column names its lines; it scrolls sideways where it is too wide."""
    top = "".join(f'<th scope="col">{escape(head)}</th>' for head in heads)
    body = "".join(
        f'<tr><th scope="row">{escape(first)}</th>{"".join(f"<td>{escape(cell)}</td>" for cell in cells)}</tr>\n'
        for first, *cells in rows
    )
    return (
        f'<div class="scroll" tabindex="0"><table><caption>{escape(caption)}</caption>'
        f"<thead><tr>{top}</tr></thead>\n<tbody>{body}</tbody></table></div>"
    )


def fold(summary: str, body: str, *, opened: bool = False) -> str:
    """``body`` (HTML) under a line that opens and closes it."""
    return f"<details{' open' * opened}><summary>{escape(summary)}</summary>{body}</details>"


def text(lines: str) -> str:
    """Text as ``pre`` has it; more than ``SHORT`` lines wait for a click."""
    count = lines.strip("\n").count("\n") + 1
    return fold(f"{count} lines", pre(lines), opened=count <= SHORT)


def picture(path: Path, alt: str) -> str:
    """The picture itself, not its address."""
    data = b64encode(path.read_bytes()).decode("ascii")
    kind = PICTURES[path.suffix]
    return f'<figure><img src="data:{kind};base64,{data}" alt="{escape(alt)}"></figure>'


def document(title: str, head: str, sections: Mapping[str, str]) -> str:
    """A page with a table of contents: ``head`` and ``sections`` (title -> body) are HTML."""
    contents = body = ""
    for number, (name, html) in enumerate(sections.items()):
        contents += f'<li><a href="#s{number}">{escape(name)}</a></li>'
        body += f'<section id="s{number}"><h2>{escape(name)}</h2>\n{html}\n</section>\n'
    return (
        '<!doctype html>\n<html lang="en"><head><meta charset="utf-8">'
        '<meta name="viewport" content="width=device-width, initial-scale=1">'
        f'<meta http-equiv="Content-Security-Policy" content="{escape(POLICY)}">'
        f"<title>{escape(title)}</title><style>{STYLE}</style></head>\n<body><h1>{escape(title)}</h1>\n{head}\n"
        f'<nav aria-label="Contents"><ol>{contents}</ol></nav>\n<main>{body}</main></body></html>\n'
    )
