"""The validation as one HTML page that needs nothing but itself."""

from __future__ import annotations

import math
from collections.abc import Sequence
from html import escape

from scenarios.report.page import html_page, section_html
from scenarios.validation.check import Check, Section, number, tally
from scenarios.validation.validation_figures import svg

_OWN_STYLE = """
table.checks th { white-space: normal; font-weight: 500; }
table.checks thead th { font-weight: 600; color: var(--soft); font-size: .82rem; }
table.checks thead th.number { text-align: right; }
td.source { color: var(--soft); text-align: right; padding-right: 0; }
ol.sources { color: var(--soft); font-size: .86rem; margin: .7rem 0 0; padding-left: 1.4rem; }
.verdict { font-weight: 600; }
.passed { color: #12633a; }
.failed { color: #9b1c13; }
.skipped { color: var(--soft); }
.used { display: inline-block; width: 4.2rem; height: .55rem; border-radius: 3px; background: #e6e9ec;
        overflow: hidden; }
.used i { display: block; height: 100%; background: var(--blue); }
.used.failed i { background: #9b1c13; }
h3 { margin: 1.4rem 0 .2rem; font-size: .98rem; }
"""


def validation_page(sections: Sequence[Section], facts: dict[str, str]) -> str:
    """The whole page; ``facts`` say with what it was made."""
    body = "\n".join([_heading(sections), *(_section(k, part) for k, part in enumerate(sections)), _facts(facts)])
    return html_page("validation · offtrack", body, _OWN_STYLE)


def _heading(sections: Sequence[Section]) -> str:
    counts = tally(sections)
    good = "" if counts["failed"] else " completed"
    told = ", ".join(f"{count} {verdict}" for verdict, count in counts.items() if count or verdict != "skipped")
    return (
        f'<header>\n<h1>Validation<span class="outcome{good}">{told}</span></h1>\n'
        "<p>The vehicle model's numbers beside closed forms, published tables and independent models. "
        "Each value has to lie within the tolerance of its target; the bar shows how much of it is used.</p>\n</header>"
    )


def _section(index: int, part: Section) -> str:
    plots = "".join(
        f"<h3>{escape(plot.title)}</h3>\n{svg(plot, f'validation-{index}-{k}')}\n" for k, plot in enumerate(part.plots)
    )
    return section_html(escape(part.title), escape(part.text), _table(part.checks) + plots)


def _table(checks: Sequence[Check]) -> str:
    """The checks, and under them the sources that their last column numbers."""
    sources = list(dict.fromkeys(check.source for check in checks))
    rows = "\n".join(_row(check, 1 + sources.index(check.source)) for check in checks)
    told = "".join(f"<li>{escape(source)}</li>" for source in sources)
    return (
        '<div class="scroll"><table class="checks"><thead><tr><th>quantity</th><th class="number">model</th>'
        '<th class="number">target</th><th class="number">tolerance</th><th>used</th><th></th>'
        f'<th class="number">source</th></tr></thead><tbody>{rows}</tbody></table></div>\n'
        f'<ol class="sources">{told}</ol>\n'
    )


def _row(check: Check, source: int) -> str:
    value = "–" if check.value is None else f"{number(check.value, check.tolerance)} {check.unit}"
    remark = f" ({escape(check.remark)})" if check.remark else ""
    return (
        f'<tr><th>{escape(check.name)}{remark}</th><td class="value">{value}</td>'
        f'<td class="value">{number(check.target, check.tolerance)} {check.unit}</td>'
        f'<td class="value">± {check.tolerance:.2g}</td><td>{_used(check)}</td>'
        f'<td><span class="verdict {check.verdict}">{check.verdict}</span></td><td class="source">{source}</td></tr>'
    )


def _used(check: Check) -> str:
    if check.used is None:
        return ""
    share = 1.0 if math.isnan(check.used) else min(1.0, check.used)
    return f'<span class="used {check.verdict}"><i style="width:{100 * share:.0f}%"></i></span>'


def _facts(facts: dict[str, str]) -> str:
    rows = "".join(f"<tr><th>{escape(key)}</th><td>{escape(value)}</td></tr>" for key, value in facts.items())
    return section_html("Made with", "", f'<div class="scroll"><table>{rows}</table></div>')
