"""The reports of a trailer's and of a rover's run."""

from collections.abc import Iterator
from typing import Final

import numpy as np

from offtrack.reports import plots
from offtrack.reports.film import photo_of
from offtrack.reports.page import Column, Figure, Items, Photos, Player, Row, Section, Table
from offtrack.reports.player.encoding import encoded
from offtrack.reports.player.playback import rover_playback, trailer_playback
from offtrack.reports.sections import (
    ERROR_TEXT,
    FEATURES_TEXT,
    groups,
    number_table,
    provenance_sections,
    run_html,
    timing_section,
)
from scenarios.results.rover_result import RoverResult
from scenarios.results.run_summary import Summary, manifest
from scenarios.results.trailer_result import CameraFrame, RunResult, trailer_summaries
from vehicle.clock import TICK
from vehicle.frames import arc_length

_ON_CARDS: Final = (
    "off_tracking.true_rms_m",
    "off_tracking.estimate_error_rms_m",
    "swept_path.max_width_m",
    "timing.realtime_factor",
)
_ROVER_CARDS: Final = ("slip.cross_track_rms_m", "slip.error_rms_deg", "slip.true_mean_deg", "timing.realtime_factor")
_SHOWN: Final = (0.15, 0.5, 0.85)  # frames of a rover on the page, as shares of the run


def report_html(result: RunResult, summary: Summary) -> str:
    """The page as HTML; ``summary`` is the run in numbers as its method ``summary`` gives it."""
    return run_html(result, summary, _ON_CARDS, _sections(result, summary))


def _sections(result: RunResult, summary: Summary) -> Iterator[Section]:
    if warnings := result.all_warnings():
        yield Section("Warnings", content=[Items(warnings)])
    if len(result.log) > 1:
        yield from _drawn(result)
    else:
        yield Section("Nothing to draw", "The run ended before the vehicle had moved.")
    yield Section("All numbers", content=[number_table(summary)])
    if result.trailers_ahead:
        yield Section("Trailers", _TRAILERS, [_trailers(result)])
    yield timing_section(result.timing, ("physics", "rendering", "odometry"))
    yield from provenance_sections(result.scenario_toml, manifest(result))


def _drawn(result: RunResult) -> Iterator[Section]:
    playback = trailer_playback(result)
    yield Section("Playback", content=[Player(encoded(playback))])
    yield Section("Plan view", _PLAN.format(result.follow_distance, result.leader), [plots.plan_figure(playback)])
    about = {
        "Off-tracking": _OFF_TRACKING.format(result.leader, result.trailer.name),
        "Error of the estimate": ERROR_TEXT,
        "Steer angles of the road wheels": _STEER,
        "Features per frame": FEATURES_TEXT,
    }
    yield from plots.chart_sections(playback, about)
    if not np.isfinite(result.signal("health")).any():
        yield Section("No estimate", "This run had no estimator of the off-tracking.")
    if result.frames:
        frame = _shown_frame(result)
        picture = playback.runs[0].pictures[result.frames.index(frame)]
        yield Section("Camera image", _caption(frame), [Photos([photo_of(picture)])])
    else:
        yield Section("No camera images", "This run kept no camera images.")


_PLAN: Final = (
    "The follow point lies {0:.1f} m behind the {1}. It should retrace the path of the {1}; it does where orange "
    "covers blue."
)
_OFF_TRACKING: Final = (
    "Lateral distance from the follow point to the path of the {0}, in the frame of the {1}. It is known once the {1} "
    "has driven its own length. Each estimate is drawn at the time its image was taken."
)
_STEER: Final = "Solid: actual angles of the road wheels. Dashed: angles that the controller commanded."
_TRAILERS: Final = (
    "Each trailer follows its own hitch. The figures above show the last trailer. The off-tracking and steering in the "
    "table above belong to the trailer with the largest off-tracking."
)


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


def _shown_frame(result: RunResult) -> CameraFrame:
    """The frame taken where the off-tracking was largest: in the middle of the turn, where the image flows most."""
    true = result.signal("off_tracking_true")
    if not np.isfinite(true).any():
        return result.frames[len(result.frames) // 2]
    worst = 1e3 * float(result.log["time"][np.nanargmax(np.abs(true))])
    return min(result.frames, key=lambda frame: abs(frame.tick - worst))


def _caption(frame: CameraFrame) -> str:
    time = f"{frame.tick * TICK:.1f} s"
    if not len(frame.tracks):
        return f"Left camera at {time}."
    return (
        f"Left camera at {time}, where the off-tracking was largest: {frame.matches} matches, {frame.inliers} of them "
        "inliers. Each stroke runs from a feature's position in the previous frame to its position in this one."
    )


_ROVER_TEXTS: Final = {
    "Slip angle": "Angle from the body's axis to the direction of travel, + left.",
    "Error of the estimate": ERROR_TEXT,
    "Distance from the path": "Lateral distance of the rover from its path.",
    "Slip ratio of the wheels": "Share of a wheel's rolling distance by which the rover does not advance.",
}


def rover_report_html(result: RoverResult, summary: Summary) -> str:
    """The page as HTML."""
    return run_html(result, summary, _ROVER_CARDS, _rover_sections(result, summary))


def _rover_sections(result: RoverResult, summary: Summary) -> Iterator[Section]:
    if warnings := result.all_warnings():
        yield Section("Warnings", content=[Items(warnings)])
    if len(result.log) > 1:
        yield from _rover_drawn(result)
    yield Section("All numbers", content=[number_table(summary)])
    yield timing_section(result.timing, ("physics", "sand and camera", "slip estimator"))
    yield from provenance_sections(result.scenario_toml, manifest(result))


def _rover_drawn(result: RoverResult) -> Iterator[Section]:
    playback = rover_playback(result)
    yield Section("Playback", content=[Player(encoded(playback))])
    text = "The path to follow, the path driven, and two estimates of it by dead reckoning."
    yield Section("Plan view", text, [plots.plan_figure(playback, bodies=False)])
    if pictures := playback.runs[0].pictures:
        wheel = result.rig.wheels[result.rig.watched].name.replace("_", " ")
        text = (
            f"Ground behind the {wheel} wheel. Blue: true direction of travel. Orange: direction "
            "estimated from the trace."
        )
        shown = [pictures[round(share * (len(pictures) - 1))] for share in _SHOWN]
        yield Section("Camera images", text, [Photos([photo_of(one) for one in shown])])
    yield from plots.chart_sections(playback, _ROVER_TEXTS)
    if np.isfinite(result.log["x_corrected"]).any():
        text = (
            "Dead reckoning by wheels and compass assumes that the rover moves along its axis. The corrected one turns "
            "each step by the estimated slip angle."
        )
        yield Section("Position error", text, [_position(result)])


def _position(result: RoverResult) -> Figure:
    """Position error of both dead reckonings over the distance driven."""
    log = result.log
    distance = arc_length(np.column_stack([log["x"], log["y"]]))
    with plots.drawn("rover position", 2.6) as (drawing, ax):
        for name, colour, label in (
            ("wheels", plots.INK, "dead reckoning by wheels and compass"),
            ("corrected", plots.ESTIMATED, "corrected by the slip angle"),
        ):
            error = np.hypot(log[f"x_{name}"] - log["x"], log[f"y_{name}"] - log["y"])
            ax.plot(distance, error, color=colour, label=label)
        ax.set(xlabel="distance driven [m]", ylabel="position error [m]", ylim=(0.0, None))
    return drawing.content
