"""The reports of a trailer's and of a rover's run."""

from collections.abc import Callable, Sequence
from functools import partial
from typing import Any

from offtrack.reports.page import Column, Items, Player, Row, Section, Table
from offtrack.reports.player.encoding import encoded
from offtrack.reports.player.playback import Playback, rover_playback, trailer_playback
from offtrack.reports.sections import groups, number_table, provenance_sections, run_page, table_of, timing_section
from scenarios.results.rover_result import RoverResult
from scenarios.results.run_summary import Result, Summary, manifest
from scenarios.results.trailer_result import RunResult, trailer_summaries


def report_html(result: RunResult, summary: Summary) -> str:
    """The page as HTML; ``summary`` is the run in numbers as its method ``summary`` gives it."""
    text = _TRAILER.format(result.follow_distance, result.leader)
    ahead = [Section("Trailers", _TRAILERS, [_trailers(result)])] if len(result.trailers) > 1 else []
    stages = ("physics", "rendering", "odometry")
    return _html(result, summary, text, partial(trailer_playback, edges=True), stages, ahead)


def rover_report_html(result: RoverResult, summary: Summary) -> str:
    """The page as HTML."""
    return _html(result, summary, _ROVER, rover_playback, ("physics", "sand and camera", "slip estimator"))


def _html(
    result: Result,
    summary: Summary,
    text: str,
    playback: Callable[[Any], Playback],
    stages: Sequence[str],
    further: Sequence[Section] = (),
) -> str:
    """The page with the ``text`` above the playback, the names of the computing ``stages`` and ``further`` sections."""
    warnings, moved = result.all_warnings(), len(result.log) > 1
    sections = [
        *([Section("Warnings", content=[Items(warnings)])] if warnings else []),
        Section("Playback", text, [Player(encoded(playback(result)))]) if moved else Section("Nothing to draw", _STOOD),
        Section("All numbers", content=[number_table(summary)]),
        *further,
        timing_section(result.timing, stages),
        *provenance_sections(result.scenario_toml, manifest(result)),
    ]
    return run_page(table_of(result.scenario_toml), result.seed, summary, sections).html()


_STOOD = "The run ended before the vehicle had moved."
_TRAILER = (
    "The follow point lies {0:.1f} m behind the {1}. It should retrace the path of the {1}; it does where orange "
    "covers blue. Off-tracking is known once the unit has driven its own length. The page opens where it is largest."
)
_TRAILERS = (
    "Each trailer follows its own hitch. The charts above show the last trailer. The off-tracking and steering in the "
    "table above belong to the trailer with the largest off-tracking."
)
_ROVER = "The page opens where the rover is farthest from its path. Dead reckoning is with and without the slip angle."


def _trailers(result: RunResult) -> Table:
    """Off-tracking and steering of every watched trailer side by side."""
    of_each = trailer_summaries(result)
    rows: list[Row] = []
    for group, prefix in (("off_tracking", ""), ("steer", "steer_")):
        for name, number in groups()[group].numbers.items():
            values = [numbers.get(prefix + name) for numbers in of_each.values()]
            if any(value is not None for value in values):
                rows.append([number.label, *(number.text(value) for value in values)])
    return Table((Column("name"), *(Column("number", name) for name in of_each)), rows)
