"""All sections of the validation, in the order of the page, and the page."""

import math
from collections.abc import Callable, Mapping, Sequence
from typing import Any, Final

import numpy as np

from offtrack.reports.page import Cell, Column, Emphasis, Figure, Items, Page, Table, Verdict, facts_table
from offtrack.reports.page import Section as PageSection
from offtrack.reports.plots import ESTIMATED, GREY, TRUE, WIDTH, drawn
from offtrack.studies.validation.check import Check, CheckSection, Plot, number, tally
from offtrack.studies.validation.driver_checks import driver
from offtrack.studies.validation.equations import integration, mechanics
from offtrack.studies.validation.lateral_checks import multibody_check, rearward_amplification
from offtrack.studies.validation.linear_checks import linear_theory, tyre_lag
from offtrack.studies.validation.no_slip_limit import design_vehicles, no_slip_limit
from offtrack.studies.validation.rollover_checks import rollover
from offtrack.studies.validation.stopping_checks import braking, parking
from offtrack.studies.validation.turns_without_slip import roundabout, steady_turns, tractrix

TASKS: Final[dict[str, Callable[[bool], CheckSection]]] = {  # argument: quick, with fewer cases
    "Design vehicles": design_vehicles,
    "Tractrix": tractrix,
    "Steady turns": steady_turns,
    "Roundabout": roundabout,
    "Kinematic limit": no_slip_limit,
    "Linear theory": linear_theory,
    "Rearward amplification": rearward_amplification,
    "Multibody model": multibody_check,
    "Rollover": rollover,
    "Tyre lag": tyre_lag,
    "Parking": parking,
    "Driver": driver,
    "Brakes and drive": braking,
    "Mechanics": mechanics,
    "Integrator": integration,
}


_STYLES: Final[dict[str, dict[str, Any]]] = {
    "model": {"linewidth": 1.8, "zorder": 4},
    "model points": {"color": TRUE, "linewidth": 0.0, "marker": "o", "markersize": 5.5, "zorder": 6},
    "reference": {"color": ESTIMATED, "linewidth": 1.3, "linestyle": (0, (4, 3)), "zorder": 5},
    "reference points": {"color": ESTIMATED, "linewidth": 0.0, "marker": "o", "markersize": 3.5, "zorder": 6},
    "faint": {"color": GREY, "linewidth": 0.7, "zorder": 2},
}
_MODELS: Final = (TRUE, "#2a9d8f", "#8e5ea2")  # of several model lines in one plot
_FLAT: Final = 3.2  # height of a plot that is not to scale [in]
_TALLEST: Final = 7.9  # [in]
_EMPHASIS: Mapping[str, Emphasis] = {"passed": "good", "failed": "bad", "skipped": "soft"}


def validation_page(sections: Sequence[CheckSection], facts: Mapping[str, str]) -> str:
    """The page as HTML; ``facts`` are versions and circumstances."""
    counts = tally(sections)
    verdicts = ", ".join(f"{count} {verdict}" for verdict, count in counts.items() if count or verdict != "skipped")
    return Page(
        title="validation",
        heading="Validation",
        subtitle=(
            "The vehicle model's numbers compared with closed forms, published tables and independent models. Each "
            "value must lie within the tolerance of its target; the bar shows the share of the tolerance that it uses."
        ),
        verdict=Verdict(verdicts, not counts["failed"]),
        sections=[
            *(_section(k, part) for k, part in enumerate(sections)),
            PageSection("Software", content=[facts_table(facts)]),
        ],
        wide=False,
    ).html()


def _section(index: int, part: CheckSection) -> PageSection:
    """The checks, the sources that their last column numbers, and the plots."""
    table, sources = checks_table(part)
    plots = [_figure(plot, f"validation-{index}-{k}") for k, plot in enumerate(part.plots)]
    return PageSection(part.title, part.text, [table, Items(sources, numbered=True), *plots])


def checks_table(part: CheckSection) -> tuple[Table, list[str]]:
    """A row for each check, and the sources that its last column numbers."""
    sources = list(dict.fromkeys(check.source for check in part.checks))
    columns = [
        Column("text", "quantity"),
        *(Column("number", title) for title in ("model", "target", "tolerance")),
        Column("text", "used"),
        Column("text"),
        Column("number", "source"),
    ]
    return Table(columns, [_row(check, 1 + sources.index(check.source)) for check in part.checks]), sources


def _row(check: Check, source: int) -> list[str | Cell]:
    emphasis = _EMPHASIS[check.verdict]
    share = None if check.used is None else 1.0 if math.isnan(check.used) else min(1.0, check.used)
    return [
        check.name + (f" ({check.remark})" if check.remark else ""),
        "–" if check.value is None else f"{number(check.value, check.tolerance)} {check.unit}",
        f"{number(check.target, check.tolerance)} {check.unit}",
        f"± {check.tolerance:.2g}",
        Cell("", "bad" if check.verdict == "failed" else "", share=share),
        Cell(check.verdict, emphasis),
        Cell(str(source), "soft"),
    ]


def _figure(plot: Plot, name: str) -> Figure:
    """The plot as a figure; ``name`` keeps the identifiers of several figures on a page apart."""
    with drawn(name, _height(plot), title=plot.title) as (drawing, ax):
        ax.set_prop_cycle(color=_MODELS)
        for series in plot.series:
            ax.plot(series.x, series.y, label=series.label or None, **_STYLES[series.style])
        scale = "log" if plot.logarithmic else "linear"
        ax.set(xlabel=plot.x_label, ylabel=plot.y_label, xscale=scale, yscale=scale)
        if plot.to_scale:
            ax.set(aspect="equal")
    return drawing.content


def _height(plot: Plot) -> float:
    if not plot.to_scale:
        return _FLAT
    x, y = (np.concatenate([series[k] for series in plot.series]) for k in (1, 2))
    return float(min(_TALLEST, max(_FLAT, WIDTH * np.ptp(y) / np.ptp(x) + 1.2)))
