"""`offtrack estimate`: estimators on recorded images."""

import json
import math
import os
import sys
from contextlib import ExitStack, closing
from dataclasses import replace
from pathlib import Path
from typing import Annotated, Any

import typer

from estimators.context import RoverContext
from estimators.odometry.repeated_frames import NewViews
from offtrack.commands import console as ui
from offtrack.exchange.recordings.camera_files import MountingOptions, facing_named
from offtrack.exchange.recordings.estimation import (
    Chosen,
    agreement_numbers,
    estimate,
    estimate_live,
    off_tracking_source,
)
from offtrack.exchange.recordings.layouts.bag_topics import parsed_topics
from offtrack.exchange.recordings.layouts.found import unpacked
from offtrack.exchange.recordings.layouts.live import Streams
from offtrack.exchange.recordings.recording_page import write_estimation
from offtrack.exchange.recordings.slip_estimation import estimate_slip, write_slip_estimation
from offtrack.exchange.recordings.stereo_reader import Recording, live_recording, open_recording
from offtrack.exchange.recordings.stereo_sequence import Wanted
from offtrack.exchange.recordings.writers import open_rover_recording
from scenarios.catalogue import ODOMETRY, SLIP_ESTIMATOR, constructed, resolve
from scenarios.options.scenario import estimator_options, stream
from scenarios.progress import interrupted_code, postponed_interrupts
from scenarios.results.run_directory import results_directory
from vehicle.foundation.quantity import check_number

app = ui.command_group("Run estimators on recorded images.")

EXAMPLES = (
    "Examples: offtrack run constant-slip --record runs/images, then offtrack estimate off-tracking runs/images   "
    "offtrack estimate off-tracking kitti/sequences/00 --follow-distance 12   "
    "offtrack estimate off-tracking drive.mcap --topics left=/stereo/left/image_raw,right=/stereo/right/image_raw   "
    "offtrack estimate off-tracking photos --calibration rig.toml --rate 10 --facing rear --camera-height 4.2"
)
SLIP_EXAMPLES = (
    "Examples: offtrack run rover-slope --record runs/traces, then offtrack estimate slip runs/traces   "
    "offtrack estimate slip beach --rig webcam.toml --estimator ftrace"
)
_OFF_TRACKING_GROUPS = ("frames", "off_tracking", "odometry", "agreement", "kitti", "self_calibration", "timing")
_SLIP_GROUPS = ("frames", "slip", "timing")
_SHOWN = 5  # dropped frames listed on the terminal; the summary lists all
_OPENING = 10.0  # time until the first images of live sources [s]


@app.command("off-tracking", epilog=ui.lines(EXAMPLES))
def off_tracking(
    directory: Annotated[
        Path | None,
        typer.Argument(
            metavar="DIR",
            show_default=False,
            help="Folder with two folders of images, a calibration and times, as from KITTI, EuRoC or `offtrack run "
            "--record` (see --probe). If it contains poses.txt, estimates are compared with these poses. Or a ROS bag: "
            "a folder, or a file .mcap, .db3 or .bag. Or a video with both images side by side, or a folder with "
            "left.mp4 and right.mp4.",
        ),
    ] = None,
    live: Annotated[
        tuple[str, str] | None,
        typer.Option(
            metavar="LEFT RIGHT",
            help="Two cameras or streams (numbers of devices, or addresses) instead of DIR: a line of JSON for each "
            "estimate, until interrupted. Needs --calibration.",
            show_default=False,
        ),
    ] = None,
    topics: Annotated[
        str,
        typer.Option(
            metavar="left=/TOPIC,right=/TOPIC",
            help="Topics of a bag's images, and left_info=, right_info= of their calibrations.",
            show_default="found by their names",
        ),
    ] = "",
    calibration: Annotated[
        Path | None,
        typer.Option(
            help="Calibration to use instead of the folder's: a calib.txt for rectified images; for raw ones a TOML "
            "file from `offtrack calibrate`, or YAML or XML of Kalibr, EuRoC, ROS or OpenCV."
        ),
    ] = None,
    rate: Annotated[float | None, typer.Option(help="Frame rate, used instead of times.txt [Hz].")] = None,
    follow_distance: Annotated[
        float | None, typer.Option(help="Distance from the hitch back to the trailer's follow point [m].")
    ] = None,
    facing: Annotated[
        str | None,
        typer.Option(help="Viewing direction of the cameras: rear, left, right, front or down.", show_default=False),
    ] = None,
    camera_x: Annotated[
        float | None,
        typer.Option(help="Position of the cameras ahead of the hitch; negative behind it [m].", show_default=False),
    ] = None,
    camera_y: Annotated[
        float | None, typer.Option(help="Position of the cameras left of the trailer's centre line [m].")
    ] = None,
    camera_height: Annotated[float | None, typer.Option(help="Height of the cameras above the ground [m].")] = None,
    direction_std: Annotated[
        float | None,
        typer.Option(
            help="Standard deviation of the cameras' direction in the trailer: of their mount and calibration [deg].",
            show_default=False,
        ),
    ] = None,
    odometry: Annotated[
        str | None,
        typer.Option(
            help="Name of an odometry (see: offtrack parts), or package.module:Name.", show_default="as in runs"
        ),
    ] = None,
    self_calibration: Annotated[
        bool,
        typer.Option(
            "--self-calibration/--no-self-calibration",
            help="Estimate the rotation of the right camera and correct its images; without it, a rotation is only "
            "watched, and degrades the estimates.",
        ),
    ] = True,
    estimator: Annotated[
        str, typer.Option(help="Off-tracking estimator: viso_ot, or package.module:Name of your own.")
    ] = "viso_ot",
    settings: Annotated[
        list[str] | None,
        typer.Option("--set", metavar="KEY=VALUE", help="Option of the estimator, such as viso_ot.smoothing=true."),
    ] = None,
    vehicle: Annotated[
        str | None,
        typer.Option(
            help="Vehicle whose data sheet an estimator of your own receives.", show_default="uk_longer_semitrailer"
        ),
    ] = None,
    agreement: Annotated[
        bool,
        typer.Option(
            "--agreement",
            help="Compare the odometry with itself: left and right halves of the images, and backwards in time. It "
            "takes four times as long.",
        ),
    ] = False,
    folders: Annotated[
        str | None,
        typer.Option(
            metavar="LEFT,RIGHT", help="Folders of left and right images in DIR.", show_default="found by their names"
        ),
    ] = None,
    probe: Annotated[
        bool,
        typer.Option("--probe", help="Say what was recognised and what would be assumed; estimate nothing."),
    ] = False,
    exchange: Annotated[
        bool,
        typer.Option("--exchange", help="Take the right images for left ones: the folders or topics are exchanged."),
    ] = False,
    upside_down: Annotated[
        bool, typer.Option("--upside-down", help="The pair is mounted upside down: turned by 180 deg about its view.")
    ] = False,
    out: Annotated[Path | None, ui.new_directory("runs/DIR-N")] = None,
    video: Annotated[bool, typer.Option(help="Write a video (a GIF if the extra 'video' is not installed).")] = True,
    quiet: ui.Quiet = False,
    as_json: ui.AsJson = False,
) -> None:
    """Estimate a trailer's off-tracking from recorded stereo images.

    Writes trajectory_tum.txt, trajectory_kitti.txt, off_tracking.csv and .parquet, report.html, a video and
    summary.json. Missing and corrupt frames are dropped and reported. The pose of the cameras on the trailer comes from
    options, else from rig.toml; otherwise it is assumed, and the assumptions are reported.
    """
    check_number("--camera-x", camera_x, -100.0, 100.0, "m")
    check_number("--camera-y", camera_y, -10.0, 10.0, "m")
    check_number("--direction-std", direction_std, 0.0, 10.0, "deg")
    options = MountingOptions(
        follow_distance=follow_distance,
        facing=facing_named(facing) if facing else None,
        x=camera_x,
        y=camera_y,
        direction_std=None if direction_std is None else math.radians(direction_std),
        z=camera_height,
        upside_down=upside_down,
    )
    chosen = Chosen(
        estimator=estimator,
        self_calibration=self_calibration,
        vehicle=vehicle,
        options=estimator_options(settings or (), estimator),
    )
    if odometry is not None:
        chosen = chosen._replace(odometry=odometry)
    if live is not None:
        _estimate_live(live, calibration, options, chosen, exchange=exchange)
        return
    if directory is None:
        raise ValueError("DIR is missing: name the folder, bag or video of a recording, or --live LEFT RIGHT")
    with (
        results_directory(out, os.path.basename(os.path.realpath(directory))) as results,
        ExitStack() as cleanup,
    ):
        wanted = Wanted(parsed_topics(topics), exchange, calibration is not None)
        with ui.progress_display(shown=not (quiet or as_json)) as display:
            bar = ui.progress_bar(display, "unpacking")
            folder, noticed = cleanup.enter_context(unpacked(directory, wanted, bar))
        recording = open_recording(
            folder,
            calibration_file=calibration,
            rate_hz=rate,
            options=options,
            folders=_pair_of(folders),
            exchange=exchange,
        )
        recording = replace(recording, source=str(directory), notes=(*noticed, *recording.notes))
        if probe:
            _show_probe(recording, as_json=as_json)
            raise typer.Exit
        source, recording = off_tracking_source(recording, chosen)
        name = chosen.odometry
        with ui.progress_display(shown=not (quiet or as_json)) as display, postponed_interrupts() as checked:
            estimation = estimate(recording, source, checked(ui.progress_bar(display, "off-tracking")))
            compared = agreement_numbers(estimation, resolve("--odometry", name, ODOMETRY)) if agreement else None
            numbers = write_estimation(
                estimation,
                name,
                results,
                estimator=estimator,
                video=video and estimation.outcome == "completed",
                agreement=compared,
                progress=checked(ui.progress_bar(display, "video")),
            )
    _finish(numbers, results, _OFF_TRACKING_GROUPS, quiet=quiet, as_json=as_json)


def _estimate_live(
    live: tuple[str, str], calibration: Path | None, options: MountingOptions, chosen: Chosen, *, exchange: bool
) -> None:
    """Print a line per estimate, and a summary on standard error at the end."""
    if calibration is None:
        raise ValueError("--live: needs --calibration FILE, as there is no folder with one")
    with closing(Streams(*(live[::-1] if exchange else live))) as streams:
        first = streams.read(_OPENING)
        if isinstance(first, str):
            raise ValueError(f"--live {' '.join(live)}: {first}: are device and address right?")
        height, width = first[0].shape
        recording = live_recording(calibration, (width, height), options)
        source, recording = off_tracking_source(recording, chosen)
        for line in recording.assumed:
            ui.remark(f"assumed: {line}")
        numbers = estimate_live(streams, recording, source, sys.stdout)
    ui.remark(", ".join(f"{name} {value}" for name, value in numbers.items()))


def _pair_of(folders: str | None) -> tuple[str, str] | None:
    """Names of the folders of left and right images."""
    if folders is None:
        return None
    names = [name.strip() for name in folders.split(",")]
    if len(names) != 2 or not all(names):
        raise ValueError(f"--folders {folders}: expected LEFT,RIGHT, for example cam_a,cam_b")
    return names[0], names[1]


def _show_probe(recording: Recording, *, as_json: bool) -> None:
    """Print what a recording was recognised as."""
    found = recording.probe()
    if as_json:
        typer.echo(json.dumps(found, indent=2))
        return
    ui.PlainConsole().print(ui.summary_table(f"{recording.source}: recognised", found["recording"]))
    for line in _remarks(found):
        ui.PlainConsole().print(line, soft_wrap=True)


@app.command("slip", epilog=ui.lines(SLIP_EXAMPLES))
def slip(
    directory: Annotated[
        Path,
        typer.Argument(
            metavar="DIR",
            help="Folder with images/, readings.csv (time_s, heading_deg, wheel speeds in rad/s, steer angles in deg) "
            "and rig.toml, as from `offtrack run rover-slope --record`. If it contains slip.csv, estimates are "
            "compared with it.",
        ),
    ],
    rig: Annotated[Path | None, typer.Option(help="Rig file to use instead of the folder's rig.toml.")] = None,
    estimator: Annotated[
        str, typer.Option(help="Slip estimator: ftrace, ftrace_plus or package.module:Name.", show_default=True)
    ] = "ftrace_plus",
    upside_down: Annotated[
        bool, typer.Option("--upside-down", help="The camera is mounted upside down: turned by 180 deg about its view.")
    ] = False,
    out: Annotated[Path | None, ui.new_directory("runs/DIR-N")] = None,
    video: Annotated[bool, typer.Option(help="Write a video (a GIF if the extra 'video' is not installed).")] = True,
    quiet: ui.Quiet = False,
    as_json: ui.AsJson = False,
) -> None:
    """Estimate a rover's slip angle from images of its wheel trace.

    Writes slip.csv and .parquet, report.html, a video and summary.json. Missing and corrupt images are dropped and
    reported.
    """
    with results_directory(out, os.path.basename(os.path.realpath(directory))) as results:
        if estimator == "truth":
            raise ValueError("--estimator truth: a recording does not contain the truth; use ftrace or ftrace_plus")
        part = resolve("--estimator", estimator, SLIP_ESTIMATOR, in_scenario=False)
        recording = open_rover_recording(directory, rig, upside_down=upside_down)
        context = RoverContext(rover=None, rig=recording.rig, rng=stream(0, "slip estimator"), options={})
        source = constructed("--estimator", estimator, lambda: part.of(context))
        with ui.progress_display(shown=not (quiet or as_json)) as display, postponed_interrupts() as checked:
            watched = NewViews(source, recording.rig.wheel_radius)
            estimation = estimate_slip(recording, estimator, watched, checked(ui.progress_bar(display, "slip angle")))
            numbers = write_slip_estimation(
                estimation,
                results,
                video=video and estimation.outcome == "completed",
                progress=checked(ui.progress_bar(display, "video")),
            )
    _finish(numbers, results, _SLIP_GROUPS, quiet=quiet, as_json=as_json)


def _finish(numbers: dict[str, Any], directory: Path, groups: tuple[str, ...], *, quiet: bool, as_json: bool) -> None:
    """Print the summary; raise the exit code of an interrupt."""
    ui.answer(numbers, lambda: _print(numbers, directory, groups), quiet=quiet, as_json=as_json)
    if numbers["outcome"] == "interrupted":
        ui.remark(f"interrupted; what was estimated until then is in {directory}")
        raise typer.Exit(interrupted_code())


def _print(numbers: dict[str, Any], directory: Path, groups: tuple[str, ...]) -> None:
    console = ui.PlainConsole()
    shown = {
        group: {name: value for name, value in numbers[group].items() if value not in (None, [])} for group in groups
    }
    console.print(ui.summary_table(f"{numbers['recording']}: {numbers['outcome']}", shown))
    for line in (*_remarks(numbers), f"Report: {directory / 'report.html'}"):
        console.print(line, soft_wrap=True)


def _remarks(numbers: dict[str, Any]) -> list[str]:
    """Warnings, assumptions, notes and the first dropped images, one line each."""
    frames = numbers.get("dropped_frames", [])
    dropped = [f"Frame {entry['frame']} dropped: {entry['reason']}" for entry in frames]
    dropped += [f"Image {entry['image']} dropped: {entry['reason']}" for entry in numbers.get("dropped_images", [])]
    more = [f"... and {len(dropped) - _SHOWN} more, see summary.json"] if len(dropped) > _SHOWN else []
    assumed = [f"Assumed: {line}" for line in numbers.get("assumed", [])]
    warnings = [f"Warning: {line}" for line in numbers.get("warnings", [])]
    return [*warnings, *assumed, *(f"Note: {line}" for line in numbers.get("notes", [])), *dropped[:_SHOWN], *more]
