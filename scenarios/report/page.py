"""The HTML pages of reports: one self-contained file each, in one style."""

from __future__ import annotations

from html import escape

_STYLE = """
:root { color-scheme: light; --ink: #1d2730; --soft: #5b6673; --line: #dfe4e8; --blue: #1f5fa8; --paper: #fff; }
* { box-sizing: border-box; }
body { margin: 0; background: #f4f6f8; color: var(--ink); line-height: 1.5;
       font: 16px/1.5 system-ui, "Segoe UI", Roboto, "Helvetica Neue", Arial, "Liberation Sans", sans-serif; }
main { max-width: 1060px; margin: 0 auto; padding: 2.2rem 1.2rem 4rem; }
header h1 { margin: 0; font-size: 1.9rem; line-height: 1.2; letter-spacing: -.01em; }
header p { margin: .5rem 0 0; color: var(--soft); }
.outcome { display: inline-block; padding: .1rem .65rem; border-radius: 1rem; font-size: .9rem; font-weight: 600;
           background: #fbe4e2; color: #9b1c13; vertical-align: .3em; margin-left: .6rem; }
.outcome.completed { background: #dcf2e4; color: #12633a; }
section { background: var(--paper); border: 1px solid var(--line); border-radius: 10px; margin-top: 1.2rem;
          padding: 1.2rem 1.4rem 1.3rem; }
h2 { margin: 0 0 .3rem; font-size: 1.15rem; }
section > p { margin: 0 0 .9rem; color: var(--soft); max-width: 54rem; }
.cards { display: grid; grid-template-columns: repeat(auto-fit, minmax(225px, 1fr)); gap: 1rem; margin-top: 1.4rem; }
.card { background: var(--paper); border: 1px solid var(--line); border-radius: 10px; padding: .9rem 1.1rem 1rem; }
.card b { display: block; font-size: 1.75rem; line-height: 1.25; letter-spacing: -.02em; font-weight: 650; }
.card b small { font-size: 1rem; font-weight: 500; color: var(--soft); letter-spacing: 0; }
.card span { font-weight: 600; font-size: .92rem; }
.card p { margin: .25rem 0 0; color: var(--soft); font-size: .88rem; line-height: 1.4; }
.scroll { overflow-x: auto; }
table { border-collapse: collapse; width: 100%; font-size: .93rem; }
th, td { text-align: left; padding: .42rem .9rem .42rem 0; border-top: 1px solid var(--line); vertical-align: top; }
tr:first-child > * { border-top: 0; }
th { font-weight: 600; white-space: nowrap; }
td.value { text-align: right; white-space: nowrap; font-variant-numeric: tabular-nums; }
td.meaning { color: var(--soft); }
tr.group th { padding-top: 1rem; color: var(--blue); font-size: .8rem; text-transform: uppercase;
              letter-spacing: .06em; }
svg { display: block; width: 100%; height: auto; }
svg text { font-family: system-ui, "Segoe UI", Roboto, "Helvetica Neue", Arial, "Liberation Sans",
                        sans-serif !important; }
.camera { border-radius: 6px; overflow: hidden; }
.bar { display: flex; height: 1.5rem; border-radius: 6px; overflow: hidden; margin: .2rem 0 .9rem; }
.key { display: inline-block; width: .8rem; height: .8rem; border-radius: 3px; margin-right: .5rem; }
details summary { cursor: pointer; font-weight: 600; }
pre { background: #f4f6f8; border-radius: 6px; padding: .9rem 1rem; overflow-x: auto; font-size: .85rem;
      line-height: 1.45; margin: .8rem 0 0; }
@media print { body { background: #fff; } section, .card { break-inside: avoid; } }
"""


def html_page(title: str, body: str, style: str = "") -> str:
    """A whole page around its ``body`` (HTML); ``style`` (CSS) is what only this page needs."""
    return (
        f'<!doctype html>\n<html lang="en">\n<head>\n<meta charset="utf-8">\n'
        f'<meta name="viewport" content="width=device-width, initial-scale=1">\n'
        f"<title>{escape(title)}</title>\n<style>{_STYLE}{style}</style>\n</head>\n"
        f"<body>\n<main>\n{body}\n</main>\n</body>\n</html>\n"
    )


def section_html(title: str, text: str, content: str = "") -> str:
    """A section with its heading, some words (HTML) and what it shows (HTML)."""
    return f"<section>\n<h2>{title}</h2>\n" + (f"<p>{text}</p>\n" if text else "") + f"{content}\n</section>"
