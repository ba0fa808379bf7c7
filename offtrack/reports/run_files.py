"""Run directories: written with report and video, read back, and laid over each other in one page.

A run directory holds ``scenario.toml`` (runs again identically), ``manifest.json`` (versions, seed, hashes),
``signals.parquet`` (SI, units in the schema), ``summary.json``, ``report.html``, a video, and after an exception
``traceback.txt``.
"""

import base64
import binascii
import dataclasses
import html
import json
import math
import os
import shutil
import tomllib
import traceback
import zlib
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor, wait
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from queue import SimpleQueue
from time import monotonic
from typing import Any, Final, NamedTuple

import numpy as np

from offtrack.reports import page
from offtrack.reports.canvas import Picture as Drawing
from offtrack.reports.canvas import write_h264, write_video
from offtrack.reports.film import Film
from offtrack.reports.player.encoding import encoded
from offtrack.reports.player.playback import Picture, Playback, rover_playback, trailer_playback
from offtrack.reports.run_page import report_html, rover_report_html
from offtrack.reports.sections import changes, groups, number_table, run_page, scenario_facts
from scenarios.assembly.adapters import course_of, ground_friction, outlines, plant_vehicle, vehicle_of
from scenarios.assembly.rover_run import rover_path
from scenarios.options.scenario import AnyScenario, RoverScenario, Scenario, load_any_scenario
from scenarios.progress import Progress, no_progress
from scenarios.results.log import Log, Signal, read_log, write_log
from scenarios.results.rover_result import RoverResult
from scenarios.results.run_directory import added_as_a_whole, mark_complete, mark_interrupted, write_or_rescue
from scenarios.results.run_inputs import write_inputs
from scenarios.results.run_summary import Result, Summary, Timing, manifest, number_at, versions
from scenarios.results.trailer_result import JudgedTrailer, RunResult, friction_picture
from sensors.sand.trace_rig import nominal_rig
from vehicle.combination.description import Vehicle
from vehicle.foundation.user_file import FileKind, read_json, read_text, shown
from vehicle.frames import FloatArray
from vehicle.rover.description import load_rover
from vehicle.surface import Surface

_SPACING: Final = 0.02  # of points on a rover's path [m]
_FARTHEST: Final = 1e9  # position [m], yaw [rad] and time [s] of a run that is shown
_RATE: Final = 10  # pictures of a video a second


class Kind(NamedTuple):
    """How runs of a kind of vehicle are reported; results and scenarios are those of this kind."""

    page: Callable[[Any, Summary], str]
    playback: Callable[[Any], Playback]
    whole: Callable[[Any], Playback]  # with what takes longer, for pages
    rebuilt: Callable[[Any, Log, Mapping[str, Any]], Result]  # ValueError: the signals are not those of the scenario
    pace: float  # seconds of the run in a second of its video


def _trailer_rebuilt(scenario: Scenario, log: Log, summary: Mapping[str, Any]) -> RunResult:
    """The result of a combination's run from its scenario, signals and summary."""
    nominal = vehicle_of(scenario)
    vehicle, course = plant_vehicle(scenario), course_of(scenario, nominal)
    units = outlines(vehicle)
    _check(log, ["time", *(name for unit in units for name in unit.pose_signals)])
    surface = Surface(friction=ground_friction(scenario.surface, course.centreline, course.friction))
    return RunResult(
        scenario=scenario.name,
        scenario_toml=scenario.to_toml(),
        seed=int(summary.get("seed", 0)),
        outcome=str(summary["outcome"]),
        log=log,
        units=units,
        trailers=_judged(vehicle, log),
        road=course.centreline,
        road_half_width=course.road_half_width,
        lanes=course.lanes,
        things=course.things,
        friction=friction_picture(surface, course.centreline),
        circle_centre=course.surface_centre,
        arcs=course.arcs,
        path_deviation=course.deviation,
        placement=course.placement.record() if course.placement else {},
        timing=_timing(summary),
        frames=(),
        manifest={},
    )


def _judged(vehicle: Vehicle, log: Log) -> tuple[JudgedTrailer, ...]:
    """The trailers with an off-tracking in the log; the last in any case."""
    trailers = []
    for k in range(min(1, len(vehicle.units) - 1), len(vehicle.units)):
        unit = vehicle.led_unit(k)
        if f"off_tracking_true_{unit.name}" not in log and k < len(vehicle.units) - 1:
            continue
        steered = sum(f"steer_trailer_{k}_command_{unit.name}" in log for k in range(1, len(unit.axles) + 1))
        trailers.append(
            JudgedTrailer(name=unit.name, follow_distance=-(unit.follow_x or 0.0), n_steered=steered, max_steer=None)
        )
    return tuple(trailers)


def _check(log: Log, poses: list[str], others: Sequence[str] = ()) -> None:
    """Refuse a log that lacks one of these signals, or in which a pose is no place on Earth."""
    missing = [name for name in (*poses, *others) if name not in log]
    if missing or not len(log):
        what = f"has no signal {shown(missing[0])}" if missing else "has no rows"
        raise ValueError(f"{what}, so it is not of this scenario")
    for name in poses:
        wrong = np.flatnonzero(~(np.abs(log[name]) <= _FARTHEST))  # also NaN
        if wrong.size:
            value = f"{log[name][wrong[0]]:g}, must be from -{_FARTHEST:g} to {_FARTHEST:g}"
            raise ValueError(f"row {wrong[0] + 1}: {name} = {value}")


def _timing(summary: Mapping[str, Any]) -> Timing:
    names = ("simulated_s", "wall_s", "physics_s", "render_s", "odometry_s")
    numbers = {name: number_at(summary, f"timing.{name}") for name in names}
    return Timing(**{name: math.nan if value is None else value for name, value in numbers.items()})


def _rover_rebuilt(scenario: RoverScenario, log: Log, summary: Mapping[str, Any]) -> RoverResult:
    """The result of a rover's run from its scenario, signals and summary."""
    rover = load_rover(scenario.vehicle)
    _check(log, ["time", "x", "y", "psi"], ["slip_angle_true", "x_wheels", "x_corrected"])
    return RoverResult(
        scenario=scenario.name,
        scenario_toml=scenario.to_toml(),
        seed=int(summary.get("seed", 0)),
        outcome=str(summary["outcome"]),
        log=log,
        rover=rover.name,
        path=rover_path(scenario).points(_SPACING),
        rig=nominal_rig(rover),
        timing=_timing(summary),
        frames=(),
        manifest={},
    )


KINDS: Final[Mapping[str, Kind]] = {  # by a result's ``kind``
    "trailer": Kind(report_html, trailer_playback, partial(trailer_playback, edges=True), _trailer_rebuilt, 1.0),
    "rover": Kind(rover_report_html, rover_playback, rover_playback, _rover_rebuilt, 2.0),  # it is slow
}


_SHARE: Final = 20.0  # the run goes on for this multiple of what a snapshot costs it, and for a second
_UNDER_WAY: Final = 3.0  # newest part of a snapshot, of which not all estimates have arrived yet [s]


class FilmAlong:
    """The video of a run, drawn by a thread while the run goes on, from snapshots between two steps; needs PyAV."""

    def __init__(self, folder: Path, duration: float) -> None:
        """Begin a file in ``folder``; the run is expected to take a ``duration`` [s]."""
        self.drawn = 0  # pictures
        self._duration, self._stopped, self._next = duration, False, 0.0
        self._snapshots = SimpleQueue[tuple[Result, float] | None]()  # with the time up to which pictures are drawn [s]
        thread = ThreadPoolExecutor(max_workers=1, thread_name_prefix="film")
        self._film = thread.submit(write_h264, self._pictures(), _RATE, folder / "video")

    def step(self, result: Callable[[], Result]) -> None:
        """Take a snapshot if one is due; the run calls this between two steps."""
        now = monotonic()
        if now < self._next or not self._snapshots.empty() or self._film.done():
            return
        with suppress(Exception):  # of a part or a signal that can't be shown: the run itself goes on
            snapshot = result()
            if len(snapshot.log) > 1:
                self._snapshots.put((snapshot, float(snapshot.log["time"][-1]) - _UNDER_WAY))
        self._next = monotonic() + 1.0 + _SHARE * (monotonic() - now)

    def end(self, result: Result | None = None) -> None:
        """Draw the rest of a run, but not of one that was interrupted; without a result stop at once."""
        self._stopped = result is None or result.outcome == "interrupted"
        self._snapshots.put(None if result is None else (result, math.inf))

    def path(self, progress: Progress, total: int) -> Path | None:
        """The file, once its ``total`` pictures are drawn; None if there is none, or not all could be drawn."""
        while not wait([self._film], 0.1).done:
            progress(self.drawn, total)
        return self._film.result() if self.drawn and self._film.exception() is None else None

    def _pictures(self) -> Iterator[Drawing]:
        until = 0.0
        while until < math.inf and (snapshot := self._snapshots.get()):
            result, until = snapshot
            film = Film(KINDS[result.kind].playback(result), duration=self._duration)
            for moment in film_times(result)[self.drawn :]:
                if moment > until or self._stopped:
                    break
                yield film.picture(moment)
                self.drawn += 1


def film_times(result: Result) -> FloatArray:
    """Times of the pictures of a run's video [s]."""
    return np.arange(0.0, float(result.log["time"][-1]) + 1e-4, KINDS[result.kind].pace / _RATE)


def write_run(
    result: Result,
    directory: Path,
    *,
    video: bool | FilmAlong = True,
    progress: Progress = no_progress,
    recording: Path | None = None,
) -> Path:
    """Write the run directory and return it; ``progress`` counts the frames of the video.

    Scenario, signals, manifest and summary are there before report and video are drawn, and stay if that fails. A
    ``recording`` of the run counts as interrupted until all is drawn.

    Raises:
        ValueError: if the directory can not take a run, see ``run_directory.check_run_directory``; or, when all that
            can be written is, if the report or the video can not be drawn, or the results had to go elsewhere.
        KeyboardInterrupt: if the drawing was interrupted; all that was finished is written.
    """
    if isinstance(video, FilmAlong):
        video.end(result if len(result.log) > 1 else None)  # the rest is drawn beside the report
    with ExitStack() as claims:
        directory, lost = write_or_rescue(directory, partial(_write_data, result), claims)
        failures = list[str]()
        _draw(result, directory, video, progress, failures)
        if result.outcome != "interrupted":
            for folder in (recording, directory):
                if folder is not None:
                    mark_complete(folder)
        if failures:
            tracebacks = "\n".join([result.traceback, *failures]).strip() + "\n"
            with suppress(OSError), added_as_a_whole(directory) as folder:
                (folder / "traceback.txt").write_text(tracebacks, encoding="utf-8", errors="replace")
            lost = " and ".join(filter(None, [lost, *(failure.partition("\n")[0] for failure in failures)]))
        if lost:
            more = ", and traceback.txt tells more" if (directory / "traceback.txt").exists() else ""
            raise ValueError(f"{lost}; all else is in {directory}{more}")
    return directory


def _write_data(result: Result, folder: Path) -> None:
    """Write all but the drawings, the signals first."""
    write_log(result.log, folder / "signals.parquet")
    write_json(folder / "summary.json", result.summary())
    scenario_toml = write_inputs(result.scenario_toml, result.inputs, folder)
    (folder / "scenario.toml").write_text(scenario_toml, encoding="utf-8")
    write_json(folder / "manifest.json", manifest(result))
    if result.traceback:
        (folder / "traceback.txt").write_text(result.traceback, encoding="utf-8", errors="replace")
    mark_interrupted(folder)  # until all is drawn


def _draw(result: Result, directory: Path, video: bool | FilmAlong, progress: Progress, failures: list[str]) -> None:
    """Add report and video to a run directory; ``failures`` receives what could not be drawn."""
    kind = KINDS[result.kind]
    with _lost_alone("report", failures), added_as_a_whole(directory) as folder:
        (folder / "report.html").write_text(kind.page(result, result.summary()), encoding="utf-8")
    if video and len(result.log) > 1:
        with _lost_alone("video", failures), added_as_a_whole(directory) as folder:
            times = film_times(result)
            if isinstance(video, FilmAlong) and (path := video.path(progress, len(times))):
                shutil.move(path, folder / path.name)
            elif video is True or result.outcome != "interrupted":
                write_video(Film(kind.playback(result)).picture, times, _RATE, folder / "video", progress)


@contextmanager
def _lost_alone(what: str, failures: list[str]) -> Iterator[None]:
    """Note an exception, as a line and its traceback, and go on: a drawing is less than the run."""
    try:
        yield
    except Exception as error:
        system = isinstance(error, OSError) and error.errno
        why = os.strerror(system) if system else f"{type(error).__name__}: {error}"
        line = " ".join(f"the {what} could not be drawn: {why}".split())
        failures.append(f"{line}\n{traceback.format_exc()}")


def write_results(
    directory: Path,
    name: str,
    log: Log,
    numbers: dict[str, Any],
    texts: Mapping[str, str],
    film: Callable[[Path], object] | None,
) -> None:
    """Write the directory of an estimation: its log, its other files by name, video and summary.

    An interrupt while the video is drawn keeps all other results and the part of the video that is finished.

    Raises:
        ValueError: if the directory exists and is not empty, or the results had to go elsewhere.
    """

    def write(folder: Path) -> None:
        write_log(log, folder / f"{name}.parquet")
        for file, text in texts.items():
            (folder / file).write_text(text, encoding="utf-8")
        write_json(folder / "summary.json", numbers)
        if film is not None:
            try:
                film(folder / "video")
            except KeyboardInterrupt:
                numbers["outcome"] = "interrupted"
                write_json(folder / "summary.json", numbers)
        if numbers["outcome"] == "interrupted":
            mark_interrupted(folder)

    with ExitStack() as claims:
        place, lost = write_or_rescue(directory, write, claims)
        if lost:
            raise ValueError(f"{lost}; the results are in {place}")


def write_json(path: Path, content: Mapping[str, object]) -> None:
    """Write a table as JSON."""
    path.write_text(json.dumps(content, indent=2, allow_nan=False) + "\n", encoding="utf-8")


def csv_text(log: Log, words: Mapping[float, str], formats: Mapping[str, str], other: str) -> str:
    """A log as CSV: column names end in the unit, health is in words, missing values are empty.

    ``formats`` are by the unit, ``other`` is that of all other units.
    """

    def cell(signal: Signal, value: float) -> str:
        if signal.name.endswith("health"):
            return words.get(value, "")
        return format(value, formats.get(signal.unit, other)) if math.isfinite(value) else ""

    names = [one.name + ("" if one.unit == "-" else f"_{one.unit.replace('/', '_')}") for one in log.signals]
    rows = ([cell(*one) for one in zip(log.signals, row, strict=True)] for row in log.rows.tolist())
    return "".join(",".join(row) + "\n" for row in (names, *rows))


_MOST: Final = 200_000_000  # bytes of the numbers of a page


def pictures_of_page(path: Path) -> tuple[Picture, ...]:
    """The pictures with their strokes; none if the page is missing, or is not of this version."""
    try:
        text = read_text(path, FileKind.IMAGE)
        table = json.loads(html.unescape(_element(text, "table")))["runs"][0]["pictures"]
        data = zlib.decompressobj(wbits=31).decompress(base64.b64decode(_element(text, "numbers")), _MOST)
        return _pictures(table, data, _element(text, "pictures").split("\n"))
    except (LookupError, TypeError, ValueError, AttributeError, RecursionError, binascii.Error, zlib.error):
        return ()


def _element(text: str, name: str) -> str:
    """Content of an element of the playback, which has no other inside."""
    begin = text.index(mark := f' id="playback-{name}">') + len(mark)
    return text[begin : text.index("<", begin)]


def _pictures(table: dict[str, Any], data: bytes, lines: list[str]) -> tuple[Picture, ...]:
    place, counts = table["strokes"], table["counts"]
    strokes = np.frombuffer(data, "<i2", place["count"], place["at"]).reshape(-1, 4).astype(np.float32) / 8.0 - 0.5
    ends = np.cumsum([0, *counts])
    pictures = []
    for k, time in enumerate(table["times"]):
        jpeg = base64.b64decode(lines[table["first"] + k], validate=True)
        caption = table["captions"][k] if table["captions"] else ""
        drawn = tuple(table["lines"][k]) if table["lines"] else ()
        pictures.append(Picture(float(time), jpeg, strokes[ends[k] : ends[k + 1]], str(caption), drawn))
    return tuple(pictures)


_NEEDED = ("summary.json", "scenario.toml", "signals.parquet")


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class FinishedRun:
    """A finished run as its directory tells it."""

    name: str
    directory: Path
    summary: Mapping[str, Any]
    result: Result
    pictures: tuple[Picture, ...] = ()  # those of its page


def read_summary(directory: Path) -> dict[str, Any]:
    """The content of a finished run's ``summary.json``.

    Raises:
        ValueError: one line, if the directory holds no finished run, or the file is broken.
    """
    for file in _NEEDED:
        if not (directory / file).is_file():
            raise ValueError(f"{shown(str(directory))}: is no finished run: it has no {file}")
    summary = read_json(directory / "summary.json", FileKind.RECORD)
    texts = all(isinstance(summary.get(name), str) for name in ("outcome", "scenario"))
    if not texts or not isinstance(seed := summary.get("seed"), int) or seed < 0:
        raise ValueError(f"{directory / 'summary.json'}: is no summary of a run: it needs outcome, scenario and seed")
    return summary


def finished_run(directory: Path, name: str) -> FinishedRun:
    """The run of a directory.

    Raises:
        ValueError: one line, if it holds no finished run, or its files do not fit each other.
    """
    summary = read_summary(directory)
    scenario = load_any_scenario(str(directory / "scenario.toml"))
    log = read_log(directory / "signals.parquet")
    return FinishedRun(
        name=name,
        directory=directory,
        summary=summary,
        result=rebuilt(scenario, log, summary, directory / "signals.parquet"),
        pictures=pictures_of_page(directory / "report.html"),
    )


def rebuilt(scenario: AnyScenario, log: Log, summary: Mapping[str, Any], signals: Path) -> Result:
    """The result of a run whose log was read from the file ``signals``.

    Raises:
        ValueError: one line, if the signals are not those of the scenario.
    """
    try:
        return KINDS[scenario.vehicle_kind].rebuilt(scenario, log, summary)
    except ValueError as error:
        raise ValueError(f"{signals}: {error}") from error


MOST_RUNS = 6  # as many as there are colours


def view_page(runs: Sequence[FinishedRun], links: Sequence[str] = ()) -> str:
    """The page as HTML; ``links`` are the addresses of the runs' own pages, empty where there is none.

    Raises:
        ValueError: one line, if there are too many runs, or both trailers' and rovers'.
    """
    playback = overlaid(runs, links)
    title = " and ".join(run.name for run in runs) if len(runs) < 3 else f"{len(runs)} runs"
    return page.Page(
        title=title,
        subtitle="laid over each other, at the same time or after the same distance" if len(runs) > 1 else "",
        sections=[
            page.Section("Playback", content=[page.Player(encoded(playback))]),
            page.Section("Runs", content=[_facts(runs)]),
            page.Section("Differences", _DIFFERENCES if len(runs) > 1 else "", [differences(runs)]),
            page.software_section(versions()),
        ],
    ).html()


_DIFFERENCES = "In brackets: the difference from the first run."


def page_in_study(run: FinishedRun, values: int) -> str:
    """The page of a run of a study, which has no page of its own: it is played, with about ``values`` values.

    Raises:
        ValueError: one line, if the files of the run do not fit each other.
    """
    sections = [
        page.Section("Playback", content=[page.Player(encoded(overlaid([run]), values=values))]),
        page.Section("All numbers", content=[number_table(run.summary)]),
        page.Section("Resolved scenario", content=[page.Preformatted(run.result.scenario_toml)], collapsed=True),
    ]
    return run_page(tomllib.loads(run.result.scenario_toml), run.result.seed, run.summary, sections, run.name).html()


def overlaid(runs: Sequence[FinishedRun], links: Sequence[str] = ()) -> Playback:
    """One playback of all runs on the first one's ground.

    Raises:
        ValueError: one line, if there are too many runs, or both trailers' and rovers'.
    """
    if len(runs) > MOST_RUNS:
        raise ValueError(f"{len(runs)} runs: a page shows at most {MOST_RUNS} at once; name fewer")
    if len({run.result.kind for run in runs}) > 1:
        raise ValueError("runs of trailers and of rovers can't be laid over each other")
    playbacks = [KINDS[run.result.kind].whole(run.result) for run in runs]
    most = max(playbacks, key=lambda playback: len(playback.charts))
    links = [*links, *[""] * (len(runs) - len(links))]
    played = [
        dataclasses.replace(playback.runs[0], name=run.name, pictures=run.pictures, link=link)
        for run, playback, link in zip(runs, playbacks, links, strict=True)
    ]
    played[1:] = [dataclasses.replace(run, lines=()) for run in played[1:]]  # the first one's ground
    return dataclasses.replace(
        playbacks[0],
        title=", ".join(run.name for run in runs),
        runs=tuple(played),
        charts=most.charts,
        readings=most.readings,
    )


def differences(runs: Sequence[FinishedRun]) -> page.Table:
    """Every number of the summaries, and how far the runs differ from the first one."""
    rows: list[page.Row] = []
    for group, listed in groups().items():
        lines = [_line(f"{group}.{name}", number, runs) for name, number in listed.numbers.items()]
        if known := [line for line in lines if line]:
            rows += [[listed.title], *known]
    return page.Table((page.Column("name"), *(page.Column("number", run.name) for run in runs)), rows)


def _line(path: str, number: Any, runs: Sequence[FinishedRun]) -> page.Row:
    values = [number_at(run.summary, path) for run in runs]
    if all(value is None for value in values):
        return []
    first = values[0]
    cells: list[str | page.Cell] = [number.label, number.text(first)]
    for value in values[1:]:
        apart = None if value is None or first is None else number.factor * (value - first)
        cells.append(number.text(value) + ("" if apart is None else f" ({apart:+z.{number.digits}f})"))
    return cells


def _facts(runs: Sequence[FinishedRun]) -> page.Table:
    rows: list[page.Row] = []
    for run in runs:
        scenario = tomllib.loads(run.result.scenario_toml)
        outcome = page.Cell(run.result.outcome, "good" if run.result.outcome == "completed" else "bad")
        facts = f"{scenario['name']} · {scenario_facts(scenario)} · seed {run.result.seed}"
        rows.append([run.name, outcome, facts, changes(scenario).removeprefix("Changed: ")])
    columns = (
        page.Column("name", "run"),
        page.Column("text", "outcome"),
        page.Column("text", "of"),
        page.Column("note", "changed keys"),
    )
    return page.Table(columns, rows)
