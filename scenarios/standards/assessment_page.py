"""The assessment as one HTML page that needs nothing but itself."""

from __future__ import annotations

import math
from collections.abc import Iterator
from html import escape
from typing import Final

from scenarios.report.page import html_page, section_html
from scenarios.results.run import versions
from scenarios.standards.assessment import Assessment
from scenarios.standards.levels import Judgement
from scenarios.standards.manoeuvre import Manoeuvre
from scenarios.standards.manoeuvre_figures import pictures
from scenarios.standards.quantities import BY_NAME

_OWN_STYLE: Final = """
td.level { white-space: nowrap; font-weight: 600; }
td.good { color: #12633a; }
td.bad { color: #9b1c13; }
td.source, td.bounds { color: var(--soft); font-size: .88rem; }
thead th { font-size: .82rem; color: var(--soft); }
svg + svg { margin-top: 1rem; }
"""
_TOGETHER: Final = "\N{NO-BREAK SPACE}"
_LEVELS: Final = (
    "Which level of each standard the combination reaches. Limits marked “from memory” were not checked against the "
    "standard's text: look them up before you rely on them."
)


def assessment_page(assessment: Assessment) -> str:
    """The whole page."""
    body = "\n".join([_heading(assessment), *_sections(assessment)])
    return html_page(f"{assessment.vehicle.name} · assessment · offtrack", body, _OWN_STYLE)


def bounds_text(judgement: Judgement) -> str:
    """The bounds of a criterion in one line, in the units people are shown, levels as L1, L2 and so on."""
    quantity = BY_NAME[judgement.criterion.quantity]
    sign = "≤" if judgement.criterion.at_most else "≥"
    bounds = [f"{level.replace('level ', 'L')} {quantity.text(bound)}".strip() for level, bound in judgement.bounds]
    return f"{sign}{_TOGETHER}" + " · ".join(bound.replace(" ", _TOGETHER) for bound in bounds)


def _heading(assessment: Assessment) -> str:
    vehicle = assessment.vehicle
    law = assessment.trailer_steering
    steered = any(unit.steered_axles for unit in vehicle.units[1:])
    trailer = f" · trailer steering: {escape(law)}" if steered else ""
    return (
        f"<header>\n<h1>{escape(vehicle.name)} in standard manoeuvres</h1>\n"
        f"<p>{escape(vehicle.summary)} · {vehicle.mass / 1e3:.1f} t · {vehicle.length:.2f} m{trailer}</p>\n</header>"
    )


def _sections(assessment: Assessment) -> Iterator[str]:
    yield section_html("Levels", _LEVELS, _levels(assessment))
    for manoeuvre in assessment.manoeuvres:
        drawn = "\n".join(pictures(assessment.vehicle, manoeuvre))
        yield section_html(_title(manoeuvre), escape(manoeuvre.how), drawn + _measured(assessment, manoeuvre))
    used = ", ".join(f"{name} {version}" for name, version in versions().items())
    yield section_html("Made with", escape(used))


def _title(manoeuvre: Manoeuvre) -> str:
    good = " completed" if manoeuvre.outcome == "completed" else ""
    return f'{escape(manoeuvre.title)}<span class="outcome{good}">{escape(manoeuvre.outcome)}</span>'


def _levels(assessment: Assessment) -> str:
    head = "<thead><tr><th></th><th>measured</th><th>reached</th><th>limits</th><th>standard</th></tr></thead>"
    rows = "\n".join(_level_row(judgement) for judgement in assessment.judgements)
    return f'<div class="scroll"><table>{head}<tbody>{rows}</tbody></table></div>'


def _level_row(judgement: Judgement) -> str:
    criterion, quantity = judgement.criterion, BY_NAME[judgement.criterion.quantity]
    bad = judgement.reached in ("none", "missed", "not measured")
    return (
        f'<tr><th>{escape(quantity.label)}</th><td class="value">{quantity.text(judgement.measured)}</td>'
        f'<td class="level {"bad" if bad else "good"}">{escape(judgement.reached)}</td>'
        f'<td class="bounds">{escape(bounds_text(judgement))}</td>'
        f'<td class="source">{escape(criterion.standard)} ({escape(criterion.source)})</td></tr>'
    )


def _measured(assessment: Assessment, manoeuvre: Manoeuvre) -> str:
    """A table of what was measured, with linear theory beside it where there is one."""
    theory = {name: assessment.linear[name] for name in manoeuvre.figures if name in assessment.linear}
    head = "<thead><tr><th></th><th>measured</th><th>linear theory</th><th></th></tr></thead>" if theory else ""
    rows = []
    for name, value in manoeuvre.figures.items():
        quantity = BY_NAME[name]
        beside = f'<td class="value">{quantity.text(theory[name]) if name in theory else ""}</td>' if theory else ""
        rows.append(
            f'<tr><th>{escape(quantity.label)}</th><td class="value">{quantity.text(value)}</td>{beside}'
            f'<td class="meaning">{escape(quantity.meaning)}</td></tr>'
            if math.isfinite(value) or manoeuvre.outcome != "completed"
            else ""
        )
    return f'<div class="scroll"><table>{head}<tbody>{"".join(rows)}</tbody></table></div>'
