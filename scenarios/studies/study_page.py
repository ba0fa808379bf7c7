"""The report of a study: one HTML page that needs nothing but itself."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from html import escape
from pathlib import Path

from scenarios.report.page import html_page, section_html
from scenarios.results.run import versions
from scenarios.studies import study_figures as figures
from scenarios.studies.case import Outcome
from scenarios.studies.study import Study
from scenarios.studies.table import Row, shown_quantities, text_of

_STYLE = "main { max-width: 1340px; } section > p { max-width: 75rem; } td.best { font-weight: 700; }"


def study_page(title: str, study: Study, outcomes: Sequence[Outcome], rows: Sequence[Row], cells: Path) -> str:
    """The whole page."""
    finished = sum(outcome.completed for outcome in outcomes)
    heading = (
        f"<header>\n<h1>{escape(title)}</h1>\n<p>{escape(study.scenario)} · {len(outcomes)} runs, "
        f"{finished} completed · seeds {', '.join(map(str, study.seeds))}</p>\n</header>"
    )
    body = "\n".join([heading, *_sections(study, outcomes, rows, cells)])
    return html_page(f"{title} · offtrack", body, _STYLE)


def _sections(study: Study, outcomes: Sequence[Outcome], rows: Sequence[Row], cells: Path) -> Iterator[str]:
    columns = " · ".join(f"{q.label}: {q.meaning}" for q in shown_quantities(rows))
    told = (
        f"{escape(columns)}. Of several seeds the RMS values are averaged as such, of others the largest is shown. "
        "Bold: the smallest of its column."
    )
    yield section_html("Table", told, _table(rows))
    drives = figures.drives_of(outcomes, cells) if _has_off_tracking(rows) else []
    if drives:
        words = (
            "The follow point is to drive where the hitch has driven. First seed, first value of what else is varied."
        )
        yield section_html("Plan view", words, figures.plan(drives))
        yield section_html("Off-tracking", "The same runs over the way of the hitch.", figures.off_tracking(drives))
    axis = figures.numeric_axis(rows)
    if axis:
        for quantity in shown_quantities(rows)[:3]:
            yield section_html(
                f"{quantity.meaning[0].upper()}{quantity.meaning[1:]}, over {axis}",
                "",
                figures.trend(rows, axis, quantity),
            )
    yield section_html("The study", "`offtrack sweep` takes this file.", f"<pre>{escape(study.to_toml())}</pre>")
    yield section_html("Made with", ", ".join(f"{name} {version}" for name, version in versions().items()))


def _has_off_tracking(rows: Sequence[Row]) -> bool:
    return any(row.numbers["off_tracking.true_rms_m"] is not None for row in rows)


def _table(rows: Sequence[Row]) -> str:
    quantities = shown_quantities(rows)
    axes = [key for key, _ in rows[0].axes]
    head = "".join(f"<th>{escape(key)}</th>" for key in axes) + "<th>completed</th>"
    head += "".join(f"<th>{escape(q.label)} [{q.unit}]</th>" for q in quantities)
    best = {q.path: min(v for row in rows if (v := row.numbers[q.path]) is not None) for q in quantities}
    lines = [f"<tr>{head}</tr>"]
    for row in rows:
        cells = "".join(f"<td>{escape(value)}</td>" for _, value in row.axes)
        ended = f" ({escape(', '.join(row.endings))})" if row.endings else ""
        cells += f"<td>{row.completed} of {row.runs}{ended}</td>"
        for q in quantities:
            value = row.numbers[q.path]
            mark = "value best" if value is not None and value == best[q.path] and len(rows) > 1 else "value"
            cells += f'<td class="{mark}">{text_of(q, value)}</td>'
        lines.append(f"<tr>{cells}</tr>")
    return '<div class="scroll"><table>\n' + "\n".join(lines) + "\n</table></div>"
