"""The report of a campaign, with figures of the smallest faults that fail."""

import math
from collections.abc import Iterator, Mapping, Sequence
from typing import Final

from offtrack.reports import page
from offtrack.reports.page import (
    Column,
    Items,
    Matrix,
    Page,
    Preformatted,
    Section,
    Shade,
    Table,
    Verdict,
    software_section,
    some,
)
from offtrack.reports.sections import changes, length
from offtrack.studies.campaigns import failures
from offtrack.studies.campaigns.campaign import Campaign
from offtrack.studies.campaigns.fault_entry import NONE
from offtrack.studies.campaigns.verdict import DETECTION, END_OF_RUN, RECOVERY, Judgement, Requirements
from offtrack.studies.case import machines
from offtrack.studies.study_figures import explorer
from offtrack.studies.study_page import machine_sections, resolved
from offtrack.studies.table import CONFIDENCE, Exceeding
from scenarios.results.run_summary import versions

_PERCENT: Final = f"{100 * CONFIDENCE:.0f} %"


def campaign_page(
    title: str,
    campaign: Campaign,
    runs: Sequence[Judgement],
    cells: Sequence[failures.Cell],
    searches: Sequence[failures.Search],
    links: Sequence[str],
) -> str:
    """The page as HTML; ``links`` are the addresses of the runs' pages, empty where there is none."""
    link_of = {id(run): link for run, link in zip(runs, links, strict=True)}
    faulty = [run for run in runs if run.fault != NONE]
    case = runs[0].outcome.case
    scenario, name = resolved(case), title.partition("-")[2] or title
    seeds = ", ".join(map(str, campaign.seeds))
    facts = ("fault campaign", campaign.scenario, f"{len(runs)} runs, {len(faulty)} with a fault", f"seeds {seeds}")
    made_on = machines([run.outcome.provenance for run in runs])
    return Page(
        title=name,
        subtitle=" · ".join(facts),
        changes=changes(scenario, [key for key, _ in case.axes]).replace("Changed:", "Changed in all runs:"),
        verdict=_verdict(campaign, cells),
        answer=_answer(campaign, cells),
        sections=[
            Section("Probability of failing", _MATRIX, [_matrix(campaign, [*cells, *failures.totals(cells)], link_of)]),
            Section("Requirements", _requirements_text(runs), [_requirements(campaign, runs)]),
            *_times(campaign, cells),
            Section("Worst runs", _WORST, [_worst(campaign, runs, link_of)]),
            *_searches(searches),
            Section("Intervals and differences", _INTERVALS, [_intervals(campaign, [*cells, *failures.totals(cells)])]),
            *_explored(runs, links),
            *(machine_sections(made_on) if len(made_on) > 1 else [Section("Machine", content=[Items(made_on)])]),
            Section("Campaign file", "offtrack campaign runs this file.", [Preformatted(campaign.to_toml())]),
            software_section(versions()),
        ],
    ).html()


_MATRIX = (
    "Runs that failed, of those that were made, for each fault and law. A run fails if it breaks any requirement. A "
    "field leads to the page of its worst run, which plays it."
)
_INTERVALS = (
    f"Share of the runs that failed, with the {_PERCENT} interval of the probability (Clopper-Pearson), as if the runs "
    "had been drawn independently from the mixture of amounts, onsets, durations and seeds of the campaign. The last "
    "numbers compare with the runs of the same law and conditions without a fault: by how much more fail, and by how "
    "much the largest deviation of one grew at most."
)
_WORST = "The run of each fault and of each law that broke a requirement by most, or came nearest to it."


def _verdict(campaign: Campaign, cells: Sequence[failures.Cell]) -> Verdict | None:
    if campaign.accept is None:
        return None
    broken = failures.unaccepted(campaign, cells)
    return Verdict(f"{len(broken)} probabilities not accepted" if broken else "accepted", not broken)


def _answer(campaign: Campaign, cells: Sequence[failures.Cell]) -> list[str]:
    """Laws that fail without a fault, then how often each fails with one."""
    alone = [cell for cell in cells if cell.place[0] == NONE and cell.failing.beyond]
    faulty = failures.totals(cells) or [cell for cell in cells if cell.place[0] != NONE]
    sentences = [f"Without any fault {_counted(cell)} of {_where(campaign, cell)} fail." for cell in alone]
    sentences += [f"{_where(campaign, cell)}: {_counted(cell)} with a fault fail." for cell in faulty]
    return some(sentences, _MOST_SENTENCES)


_MOST_SENTENCES: Final = 6


def _counted(cell: failures.Cell) -> str:
    return f"{cell.failing.beyond} of {cell.failing.runs} run{'s' if cell.failing.runs > 1 else ''}"


def _matrix(campaign: Campaign, cells: Sequence[failures.Cell], link_of: Mapping[int, str]) -> Matrix:
    of_place = {cell.place: cell for cell in cells}
    further = dict.fromkeys(cell.place[1] for cell in cells)
    laws = {of: list(dict.fromkeys(c.place[2] for c in cells if c.place[1] == of)) for of in further}
    rows = []
    for fault in dict.fromkeys(cell.place[0] for cell in cells):
        places = [(fault, of, law) for of in further for law in laws[of]]
        rows.append((fault, [_shade(of_place.get(place), link_of) for place in places]))
    names = {of: [law.replace("_", "_\u200b") or "runs" for law in laws[of]] for of in further}  # a break may follow
    groups = [(_further_title(campaign, of), names[of]) for of in further]
    return Matrix(groups, rows, "Share of the runs that failed")


def _further_title(campaign: Campaign, text: str) -> str:
    """Names of the further axes with the values of a group of columns."""
    return ", ".join(
        f"{key.rpartition('.')[2]} {value}" for key, value in zip(campaign.further, text.split(" · "), strict=False)
    )


def _shade(cell: failures.Cell | None, link_of: Mapping[int, str]) -> Shade | None:
    if cell is None:
        return None
    found = cell.failing
    low, high = found.interval()
    endings = ", ".join(f"{count} {ending}" for ending, count in cell.endings.items())
    meaning = f"{100 * low:.0f} to {100 * high:.0f} % with {_PERCENT} confidence; {endings}"
    return Shade(f"{found.beyond}/{found.runs}", found.share, meaning, link_of.get(id(cell.worst), ""))


def _requirements_text(runs: Sequence[Judgement]) -> str:
    lost = sum(not run.reached for run in runs)
    late = f" {lost} runs were completed before their fault began and are left out." if lost else ""
    return f"Runs with a fault that broke each requirement, and the {_PERCENT} interval of the probability.{late}"


def _requirements(campaign: Campaign, runs: Sequence[Judgement]) -> Table:
    found = failures.requirement_failures(campaign, runs)
    laws = list(dict.fromkeys(law for of_laws in found.values() for law in of_laws))
    columns = [Column("name", "requirement"), *(Column("number", law or "runs") for law in laws)]
    texts = requirement_texts(campaign.requirements)
    return Table(
        columns, [[texts[name], *(_share_text(of_laws[law]) for law in laws)] for name, of_laws in found.items()]
    )


def requirement_texts(needed: Requirements) -> dict[str, str]:
    """The requirements in words, by their names in breaches."""
    texts = {END_OF_RUN: f"Outcome: {' or '.join(needed.outcomes)}"}
    texts |= {limit.path: limit.text for limit in needed.limits}
    if needed.detect is not None:
        harmful = f", if the deviation exceeds {needed.harmless_below:g} m" if needed.harmless_below else ""
        texts[DETECTION] = f"Fault noticed within {needed.detect:g} s{harmful}"
    if needed.recover is not None:
        texts[RECOVERY] = (
            f"All well within {needed.recover:g} s after the fault, deviation {needed.recovered_below:g} m"
        )
    return texts


def _share_text(found: Exceeding) -> str:
    low, high = found.interval()
    return f"{found.beyond}/{found.runs}  ({100 * low:.0f}–{100 * high:.0f} %)"


def _times(campaign: Campaign, cells: Sequence[failures.Cell]) -> Iterator[Section]:
    table = times_table(campaign, cells)
    if not table.rows:
        return
    text = (
        "From the onset of a fault until the health of the estimate is not ok, the fallback steers or the guard "
        "distrusts a signal; and from its end until health is ok, no fallback steers and the follow point has been "
        f"within {campaign.requirements.recovered_below:g} m for a second. The time of a health is that of its "
        "image: the cameras' latency comes on top. Never: in that many of the runs."
    )
    yield Section("Detection and recovery", text, [table])
    if alarms := [(cell, sum(run.response.alarm for run in cell.runs)) for cell in cells if cell.place[0] == NONE]:
        lines = [f"{_where(campaign, cell)}: {count} of {len(cell.runs)}" for cell, count in alarms]
        text = "Runs without a fault in which the health was not ok at some time."
        yield Section("False alarms", text, [Items(lines)])


def times_table(campaign: Campaign, cells: Sequence[failures.Cell]) -> Table:
    """Times to detect and to recover of the cells with a fault that have any."""
    shown = [cell for cell in cells if cell.place[0] != NONE and (cell.detection.known or cell.recovery.known)]
    columns = [Column("name", "fault"), *(Column("text", key) for key in ("", "law") if key or campaign.further)]
    for what in ("detected", "recovered"):
        columns += [Column("number", f"{what}, median"), Column("number", "worst"), Column("number", "never")]
    return Table(
        columns,
        [[*_place_cells(campaign, cell), *_time_cells(cell.detection), *_time_cells(cell.recovery)] for cell in shown],
    )


def _place_cells(campaign: Campaign, cell: failures.Cell) -> list[str]:
    fault, further, law = cell.place
    return [fault, *([_further_title(campaign, further)] if campaign.further else []), law]


def _where(campaign: Campaign, cell: failures.Cell) -> str:
    return " · ".join(filter(None, (cell.place[2], _further_title(campaign, cell.place[1])))) or "all runs"


def _time_cells(times: failures.Times) -> list[str]:
    if not times.known:
        return ["–", "–", "–"]
    return [_time_text(times.median), _time_text(times.worst), f"{times.never}/{times.known}"]


def _time_text(seconds: float) -> str:
    """A time with its unit; "never" if it is infinite."""
    return "–" if math.isnan(seconds) else "never" if math.isinf(seconds) else f"{seconds:.2f} s"


def _worst(campaign: Campaign, runs: Sequence[Judgement], link_of: Mapping[int, str]) -> Table:
    columns = [Column("name"), Column("text", "run"), Column("text", "verdict"), Column("note", "reasons")]
    rows: list[page.Row] = []
    groups = (("faults", lambda run: run.fault), ("laws", lambda run: failures.place_of(campaign, run)[2]))
    for heading, key in groups:
        found = failures.by(runs, key)
        rows += [[heading]] if len(found) > 1 else []
        for name, group in found.items() if len(found) > 1 else ():
            worst = max(group, key=failures.badness)
            run = page.Cell(worst.outcome.case.title, link=link_of[id(worst)])
            rows.append([name, run, page.Cell(worst.verdict, "bad" if worst.failed else "good"), worst.reasons])
    return Table(columns, rows)


def _intervals(campaign: Campaign, cells: Sequence[failures.Cell]) -> Table:
    columns = [Column("name", "fault"), *(Column("text", key) for key in ("", "law") if key or campaign.further)]
    names = ("failed", "runs", "share", "from", "to", "more fail", "deviation grows")
    columns += [Column("number", name) for name in names] + [Column("note", "outcomes")]
    references = {cell.place[1:]: cell for cell in cells if cell.place[0] == NONE}
    rows: list[page.Row] = []
    for cell in cells:
        found = cell.failing
        shares = (f"{100 * share:.1f} %" for share in (found.share, *found.interval()))
        endings = ", ".join(f"{count} {ending}" for ending, count in cell.endings.items())
        more = _differences(cell, references.get(cell.place[1:]))
        rows.append([*_place_cells(campaign, cell), str(found.beyond), str(found.runs), *shares, *more, endings])
    return Table(columns, rows)


_DEVIATIONS: Final = ("off_tracking.true_max_m", "slip.cross_track_max_m")


def _differences(cell: failures.Cell, reference: failures.Cell | None) -> tuple[str, str]:
    """By how much more runs fail than without the fault, and by how much the largest deviation of one grew at most."""
    if reference is None or cell is reference:
        return "", ""
    of_seed = {run.outcome.case.seed: _deviation(run) for run in reference.runs}
    grown = [_deviation(run) - of_seed.get(run.outcome.case.seed, math.nan) for run in cell.runs]
    most = max((one for one in grown if math.isfinite(one)), default=math.nan)
    more = 100.0 * (cell.failing.share - reference.failing.share)
    return f"{more:+z.0f} %", "–" if math.isnan(most) else f"{'+' if most >= 0.0 else '-'}{length(abs(most))}"


def _deviation(run: Judgement) -> float:
    """Largest deviation of the follow point or the rover from its path [m]; NaN: it is not known."""
    return next((one for path in _DEVIATIONS if (one := run.outcome.number(path)) is not None), math.nan)


def _searches(searches: Sequence[failures.Search]) -> Iterator[Section]:
    if not searches:
        return
    text = (
        "Smallest value at which a run fails, by bisection: the run with this value fails, the one below it by the "
        "tolerance or less does not."
    )
    yield Section("Smallest fault that fails", text, [searches_table(searches)])


def searches_table(searches: Sequence[failures.Search]) -> Table:
    """The smallest value that fails, of each search."""
    columns = [Column("name", "fault"), Column("text", "law"), Column("text"), Column("number", "seed")]
    columns += [Column("number", "smallest that fails"), Column("note")]
    rows = [
        [f"{s.entry.title}: {_searched(s)}", s.law, s.further, str(s.seed), _found_text(s), _note_of(s)]
        for s in searches
    ]
    return Table(columns, rows)


def _searched(search: failures.Search) -> str:
    """The searched number with its unit."""
    if search.table.of == "duration":
        return "duration [s]"
    option = search.entry.options()[0]
    return f"{option.name} [{option.unit}]"


def _found_text(search: failures.Search) -> str:
    """The smallest value that fails, or that there is none in the range."""
    if search.finding == "found":
        return f"{search.bracket[1]:g}"
    end = search.table.high if search.finding == "never fails" else search.table.low
    return f"{'above' if search.finding == 'never fails' else 'below'} {end:g}"


def _note_of(search: failures.Search) -> str:
    """Remarks on a bisection: never or always fails, and values that contradict a threshold."""
    notes = (
        [] if search.finding == "found" else [f"{search.finding} from {search.table.low:g} to {search.table.high:g}"]
    )
    if search.exceptions:
        notes.append(f"not monotone: see the runs with {', '.join(f'{value:g}' for value in search.exceptions)}")
    return "; ".join(notes)


def _explored(runs: Sequence[Judgement], links: Sequence[str]) -> Iterator[Section]:
    if found := explorer([run.outcome for run in runs], links):
        yield Section(
            "Runs", "A click opens the page that plays the run; red: it did not complete its course.", [found]
        )
