"""The report of a run: one HTML page that needs nothing but itself."""

from __future__ import annotations

import base64
from collections.abc import Iterable
from html import escape
from typing import Final

import cv2
import numpy as np

from scenarios.report import run_figures as figures
from scenarios.report.numbers import Shown, cards_html, table_html
from scenarios.report.page import html_page, section_html
from scenarios.results.run import CameraFrame, RunResult, Summary, manifest, trailer_summaries
from vehicle.clock import TICK
from vehicle.frames import FloatArray

_NUMBERS: Final = (
    Shown("off_tracking", "true_rms_m", "True off-tracking, RMS", "m", 1, 3,
          "How far the trailer's follow point typically runs beside the path of its hitch."),
    Shown("off_tracking", "true_max_m", "True off-tracking, largest", "m", 1, 3,
          "The largest distance of the follow point from the path of its hitch."),
    Shown("off_tracking", "estimate_error_rms_m", "Estimate error, RMS", "mm", 1e3, 1,
          "How far the estimate is typically from the truth at the moment the picture was taken."),
    Shown("off_tracking", "estimate_error_max_m", "Estimate error, largest", "mm", 1e3, 1,
          "The worst single estimate of the run."),
    Shown("off_tracking", "valid_fraction", "Valid estimates", "%", 100, 1,
          "Share of the estimates that could be used, once the trailer had driven its own length."),
    Shown("swept_path", "max_width_m", "Swept width", "m", 1, 2,
          "The widest strip of ground that the bodies of the combination need."),
    Shown("swept_path", "min_inner_radius_m", "Inner radius", "m", 1, 2,
          "The closest any body comes to the centre of the roundabout."),
    Shown("swept_path", "tail_swing_m", "Tail swing", "m", 1, 3,
          "How far a rear corner swings out beyond the straight before or after the turn."),
    Shown("swept_path", "tail_swing_entry_m", "of it into the turn", "m", 1, 3,
          "The same before the first turn alone."),
    Shown("swept_path", "tail_swing_exit_m", "of it out of the turn", "m", 1, 3, "The same after the last turn alone."),
    Shown("steer", "max_deg", "Largest trailer steer angle", "°", 1, 1,
          "The largest angle of any steered trailer wheel."),
    Shown("steer", "max_rate_deg_s", "Fastest trailer steering", "°/s", 1, 1,
          "The highest rate at which a trailer axle was turned."),
    Shown("tyres", "friction_used_max", "Friction used", "%", 100, 0,
          "The largest share of the available friction that any tyre used."),
    Shown("odometry", "matches_mean", "Matches per frame", "", 1, 0,
          "Features found again in all images of a frame, on average."),
    Shown("odometry", "inliers_mean", "Inliers per frame", "", 1, 0,
          "Those of them that agree on one motion of the camera, on average."),
    Shown("odometry", "lost_frames", "Lost frames", "", 1, 0,
          "Frames from which no motion of the camera could be found."),
    Shown("odometry", "drift_percent", "Drift", "%", 1, 3,
          "Position error of the visual odometry over one trailer length, as a share of the way driven."),
)  # fmt: skip
_GROUPS = {
    "off_tracking": "Off-tracking",
    "swept_path": "Swept path",
    "steer": "Steering",
    "tyres": "Tyres",
    "odometry": "Visual odometry",
}
_REALTIME: Final = Shown("timing", "realtime_factor", "Speed of the simulation", "× real time", 1, 2,
             "Simulated time over computing time: above 1 it ran faster than reality.")  # fmt: skip
_ON_CARDS: Final = ("true_rms_m", "estimate_error_rms_m", "max_width_m")
_CARDS: Final = (*(number for number in _NUMBERS if number.name in _ON_CARDS), _REALTIME)


def report_html(result: RunResult, summary: Summary) -> str:
    """The whole page; ``summary`` is the run in numbers as :func:`scenarios.results.run.summary` gives it."""
    body = "\n".join([_heading(result), cards_html(summary, _CARDS), *_sections(result, summary)])
    return html_page(f"{result.scenario} · offtrack", body)


def _sections(result: RunResult, summary: Summary) -> Iterable[str]:
    if len(result.log) > 1:
        yield from _drawn(result)
    else:
        yield section_html("Nothing to draw", "The run ended before the vehicle had moved.")
    yield section_html("All numbers", "", table_html(summary, _NUMBERS, _GROUPS))
    if result.trailers_ahead:
        yield section_html("Trailers", _TRAILERS, _trailers(result))
    yield section_html("Where the time went", _timing_line(result), _timing(result))
    yield _details(result)


def _drawn(result: RunResult) -> Iterable[str]:
    yield section_html("Plan view", _PLAN.format(result.follow_distance), figures.plan_view(result))
    yield section_html("Off-tracking", _OFF_TRACKING, figures.off_tracking(result))
    if np.isfinite(result.signal("health")).any():
        yield section_html("Error of the estimate", _ERROR, figures.estimate_error(result))
    else:
        yield section_html(
            "No estimate", "Nothing estimated the off-tracking in this run, so there is no error to show."
        )
    if result.steer_signals():
        yield section_html("Steer angles", _STEER, figures.steer(result))
    if result.frames:
        yield section_html("What the camera saw", _caption(result), camera_svg(_most_telling(result)))
    else:
        yield section_html("No pictures", "No camera image was kept in this run.")
    if np.isfinite(result.signal("matches")).any():
        yield section_html("Features", _MATCHES, figures.matches(result))


_PLAN = (
    "The follow point, {:.1f} m behind the hitch, is to drive where the hitch has driven. "
    "Where the orange line covers the blue one, it does."
)
_OFF_TRACKING = (
    "Lateral distance of the hitch's path from the follow point, seen from the trailer. It starts once the trailer has "
    "driven its own length; each estimate stands at the time its picture was taken."
)
_ERROR = "About 95 of 100 errors should lie inside the band; if they do, the estimator knows how good it is."
_STEER = "Solid: the road wheels as they stand. Dashed: what the controller asked for."
_TRAILERS = (
    "Each trailer follows its own hitch. The plots above are of the last one; the numbers of off-tracking and steering "
    "are those of the trailer that runs farthest beside its path."
)
_MATCHES = "Features found again in all images of a frame, and those of them that agree on one motion of the camera."


def _heading(result: RunResult) -> str:
    good = " completed" if result.outcome == "completed" else ""
    combination = " + ".join(unit.name for unit in result.units)
    return (
        f'<header>\n<h1>{escape(result.scenario)}<span class="outcome{good}">{escape(result.outcome)}</span></h1>\n'
        f"<p>{escape(combination)} · seed {result.seed} · {result.timing.simulated_s:.1f} s simulated</p>\n</header>"
    )


def _trailers(result: RunResult) -> str:
    """Off-tracking and steering of every watched trailer side by side."""
    of_each = trailer_summaries(result)
    head = "".join(f'<th class="value">{escape(name)}</th>' for name in of_each)
    lines = [f"<tr><th></th>{head}</tr>"]
    for number in _NUMBERS:
        key = f"steer_{number.name}" if number.group == "steer" else number.name
        values = [numbers.get(key) for numbers in of_each.values()]
        if any(value is not None for value in values):
            cells = "".join(f'<td class="value">{number.text(value)} {number.unit}</td>' for value in values)
            lines.append(f"<tr><th>{number.label}</th>{cells}</tr>")
    return '<div class="scroll"><table>' + "\n".join(lines) + "</table></div>"


def _most_telling(result: RunResult) -> CameraFrame:
    """The frame taken where the off-tracking was largest: in the middle of the turn, where the image flows most."""
    true = result.signal("off_tracking_true")
    if not np.isfinite(true).any():
        return result.frames[len(result.frames) // 2]
    worst = 1e3 * float(result.log["time"][np.nanargmax(np.abs(true))])
    return min(result.frames, key=lambda frame: abs(frame.tick - worst))


def _caption(result: RunResult) -> str:
    frame = _most_telling(result)
    if not len(frame.tracks):
        return f"The left camera at {frame.tick * TICK:.1f} s."
    return (
        f"The left camera at {frame.tick * TICK:.1f} s, where the off-tracking was largest: {frame.matches} matches, "
        f"{frame.inliers} of them inliers. Each stroke leads from where a feature was a frame ago to where it is."
    )


def camera_svg(frame: CameraFrame) -> str:
    """The picture with the flow of its features drawn over it."""
    image = cv2.imdecode(np.frombuffer(frame.jpeg, np.uint8), cv2.IMREAD_COLOR)
    height, width = (0, 0) if image is None else image.shape[:2]
    jpeg = base64.b64encode(frame.jpeg).decode()
    return (
        f'<svg class="camera" viewBox="0 0 {width} {height}" role="img" aria-label="camera image with its features">'
        f'<image width="{width}" height="{height}" href="data:image/jpeg;base64,{jpeg}"/>'
        f'<g stroke-width="1.6" stroke-linecap="round">{_strokes(frame.tracks.astype(np.float64))}</g></svg>'
    )


def _strokes(tracks: FloatArray) -> str:
    """Lines from the previous to the current place of every feature, coloured by their length."""
    if not len(tracks):
        return ""
    length = np.hypot(*(tracks[:, 2:] - tracks[:, :2]).T)
    hue = 200.0 - 165.0 * np.clip(length / max(np.percentile(length, 95), 1e-9), 0.0, 1.0)  # blue: still; orange: fast
    colours = [f"hsl({h:.0f} 95% 58%)" for h in hue]
    return "".join(
        f'<g stroke="{c}" fill="{c}"><path d="M{u0:.1f} {v0:.1f}L{u1:.1f} {v1:.1f}"/>'
        f'<circle cx="{u1:.1f}" cy="{v1:.1f}" r="1.6"/></g>'
        for (u0, v0, u1, v1), c in zip(tracks + 0.5, colours, strict=True)  # SVG counts from a pixel's corner
    )


_STAGES = (("physics", "#1f5fa8"), ("rendering", "#2a9d8f"), ("odometry", "#e0761a"), ("everything else", "#b8c0c8"))


def _timing_line(result: RunResult) -> str:
    timing = result.timing
    return (
        f"{timing.simulated_s:.1f} s of driving took {timing.wall_s:.1f} s of computing: "
        f"{timing.realtime_factor:.2f} times real time."
        + (f" {timing.odometry_beside_s:.1f} s of odometry ran beside it." if timing.odometry_beside_s > 0.05 else "")
    )


def _timing(result: RunResult) -> str:
    timing = result.timing
    seconds = (timing.physics_s, timing.render_s, timing.odometry_s, timing.rest_s)
    total = max(sum(seconds), 1e-9)
    bar = "".join(
        f'<div style="width:{100 * t / total:.2f}%;background:{colour}"></div>'
        for (_, colour), t in zip(_STAGES, seconds, strict=True)
    )
    rows = "".join(
        f'<tr><th><span class="key" style="background:{colour}"></span>{name}</th><td class="value">{t:.2f} s</td>'
        f'<td class="value">{100 * t / total:.0f} %</td>'
        f'<td class="value">{1e3 * t / max(timing.simulated_s, 1e-9):.0f} ms per simulated second</td></tr>'
        for (name, colour), t in zip(_STAGES, seconds, strict=True)
    )
    return f'<div class="bar">{bar}</div><div class="scroll"><table>{rows}</table></div>'


def _details(result: RunResult) -> str:
    facts = "".join(
        f"<tr><th>{escape(key)}</th><td>{escape(_fact(value))}</td></tr>" for key, value in manifest(result).items()
    )
    return (
        f"<section><details><summary>Resolved scenario</summary>"
        f"<pre>{escape(result.scenario_toml)}</pre></details></section>"
        f"<section><details><summary>Where these numbers come from</summary>"
        f'<div class="scroll"><table>{facts}</table></div></details></section>'
    )


def _fact(value: object) -> str:
    return ", ".join(f"{name} {version}" for name, version in value.items()) if isinstance(value, dict) else str(value)
