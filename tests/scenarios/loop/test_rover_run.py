"""The rover's closed loop: what it does with its slip, and what it leaves behind."""

import csv
import json
import math
import shutil
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from offtrack.commands.cli import app
from offtrack.exchange.recordings.writers import open_rover_recording, recording_in
from scenarios.loop.runner import run
from scenarios.options.scenario import RoverScenario, load_any_scenario
from scenarios.results.log import read_log
from scenarios.results.rover_result import RoverResult
from scenarios.results.run_summary import number_at

SLOPE = ("surface.slope_from=0.5", "surface.slope_over=0.3", "course.length=3")
SHORT = ("course.length=0.5", "surface.slope_from=0", "slip_estimator=ftrace")  # 34 images


@cache
def driven(name: str, *settings: str, seed: int = 1) -> RoverResult:
    scenario = load_any_scenario(name, settings)
    assert isinstance(scenario, RoverScenario)
    return run(scenario, seed)


def aside(result: RoverResult) -> float:
    """How far beside its path the rover ended [m]."""
    return abs(float(result.log["cross_track_true"][-1]))


@pytest.mark.slow
def test_a_slope_carries_an_uncompensated_rover_off_its_path() -> None:
    """2.3 m of a 5 degree side slope at some 4 degrees of slip: 2.3 m tan(4 deg) = 0.16 m; half of it is asked for."""
    result = driven("rover-slope", *SLOPE, "slip_estimator=truth", "slip_compensation=none")
    assert result.outcome == "completed"
    assert aside(result) > 0.08
    assert result.log["slip_angle_true"][-1] < math.radians(-2.0)  # down the slope, to the right


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "compensation"), [("rover-slope", "crab"), ("rover-slope", "heading"), ("rover-uphill", "heading")]
)
def test_a_known_slip_is_made_up_for(name: str, compensation: str) -> None:
    """There remain the compass's residual deviation, 0.3 degrees over 3 m, and the onset: 15 mm and some."""
    settings = (*SLOPE, "slip_estimator=truth", f"slip_compensation={compensation}")
    assert aside(driven(name, *settings)) < 0.03


def test_crab_keeps_the_body_along_the_path_and_heading_turns_it() -> None:
    """Two ways to go straight across a slope: wheels aside and body straight, or the whole body aside."""
    crab = driven("rover-slope", *SLOPE, "slip_estimator=truth", "slip_compensation=crab").log
    heading = driven("rover-slope", *SLOPE, "slip_estimator=truth", "slip_compensation=heading").log
    last = slice(-40, None)  # the last two seconds
    assert abs(np.degrees(crab["psi"][last].mean())) < 1.0
    assert np.degrees(crab["steer_rear_left"][last].mean()) > 2.0
    assert np.degrees(heading["psi"][last].mean()) > 2.0
    assert abs(np.degrees(heading["slip_angle_true"][last].mean() + heading["psi"][last].mean())) < 1.0


def test_the_slip_angle_corrects_dead_reckoning_across_the_slope() -> None:
    """By its wheels the rover went straight; with the slip angle it knows that it did not. Compass errors remain."""
    log = driven("rover-slope", *SLOPE, "slip_estimator=truth", "slip_compensation=none", "signals.noise=0").log
    assert abs(log["y_wheels"][-1] - log["y"][-1]) > 0.08
    assert abs(log["y_corrected"][-1] - log["y"][-1]) < 0.02  # the 3 s until a new slip is believed


def test_the_paper_s_ground_truth_agrees_with_the_exact_slip() -> None:
    """Laser tracker and compass (Reina 2008, eqs 5 and 6): 3 mm over 0.3 m and 0.35 degrees: within 1 degree RMS."""
    result = driven("rover-slope", *SLOPE, "slip_estimator=truth", "slip_compensation=none")
    summary = result.summary()
    error = number_at(summary, "slip.reference_error_rms_deg")
    assert error is not None
    assert 0.1 < error < 1.0
    assert number_at(summary, "slip.valid_fraction") == 1.0
    assert number_at(summary, "slip.lagged_error_rms_deg") is None  # an exact slip is not estimated anew
    assert "fallback" not in result.log  # without faults


def test_errors_of_later_estimates_are_against_the_truth_at_their_tick() -> None:
    """Every other one is a degree off, the others do not exist."""
    result = driven("rover-slope", *SLOPE, "slip_estimator=truth", "slip_compensation=none")
    rows = result.log.rows.copy()
    off = np.where(np.arange(len(rows)) % 2, np.nan, math.radians(1.0))
    rows[:, result.log.names.index("slip_angle_lagged")] = result.log["slip_angle_true"] + off
    changed = replace(result, log=replace(result.log, rows=rows))
    assert number_at(changed.summary(), "slip.lagged_error_rms_deg") == pytest.approx(1.0)


@pytest.mark.slow
def test_a_bend_is_not_taken_for_slip(tmp_path: Path) -> None:
    """On 2 m radius, down a slope on which wheels slip less than on the level: error and sigma as on a straight."""
    turn = np.arange(0.0, 1.6, 0.05)
    arc = 2.0 * np.column_stack([np.sin(turn), np.cos(turn) - 1.0])
    points = np.concatenate([[(-0.5, 0.0), (-0.25, 0.0)], arc])
    (tmp_path / "arc.csv").write_text("\n".join(["x,y", *(f"{x:.6f},{y:.6f}" for x, y in points)]))
    course = ("course.kind=path", f"course.file={tmp_path / 'arc.csv'}")
    log = driven("rover-figure-of-eight", *course, "surface.cross_fall=0.07", seed=2).log
    seen = np.isfinite(log["health"]) & (log["time"] > 8.0)
    assert (log["health"][seen] == 0.0).mean() > 0.97
    error = (log["slip_angle_estimate"] - log["slip_angle_true"])[seen]
    within = np.abs(error) < 2.5 * log["slip_angle_std"][seen]
    assert np.degrees(np.sqrt(np.nanmean(error**2))) < 1.0
    assert within[np.isfinite(error)].mean() > 0.97


@pytest.mark.parametrize(
    ("number", "outcome"),
    [
        ("sinkage_limit = 0.005", "entrapped"),  # below what this sand lets it sink in
        ("stall_torque = 0.02", "timed out"),  # sand asks for more than 0.02 N m at the wheel: it comes to rest
    ],
)
def test_a_rover_that_can_not_go_on_says_why(tmp_path: Path, number: str, outcome: str) -> None:
    source = Path("vehicle/rovers/el_dorado_ii.toml").read_text()
    name = number.partition(" ")[0]
    lines = [number if line.startswith(name) else line for line in source.splitlines()]
    (tmp_path / "own.toml").write_text("\n".join(lines))
    settings = ("slip_estimator=truth", f"vehicle={tmp_path / 'own.toml'}", "course.length=0.5")
    assert driven("rover-slope", *settings).outcome == outcome


@pytest.fixture(scope="module")
def recorded(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path]:
    """Directories of a short run with the camera in the loop, and of its recording."""
    folder = tmp_path_factory.mktemp("rover")
    settings = [part for setting in SHORT for part in ("--set", setting)]
    arguments = ["run", "rover-slope", *settings, "--out", str(folder / "run"), "--record", str(folder / "images")]
    result = CliRunner().invoke(app, [*arguments, "--json"])
    assert result.exit_code == 0, result.stderr
    assert json.loads(result.stdout)["slip"]["valid_fraction"] is not None
    return folder / "run", folder / "images"


@pytest.mark.slow
def test_a_run_leaves_its_directory(recorded: tuple[Path, Path]) -> None:
    """The same files as a trailer's run; the resolved scenario runs again to the bit, images and signals."""
    run, _ = recorded
    names = {path.name for path in run.iterdir()}
    assert {"scenario.toml", "manifest.json", "signals.parquet", "summary.json", "report.html"} < names
    manifest = json.loads((run / "manifest.json").read_text())
    again = driven(str(run / "scenario.toml"))
    assert again.log.sha256() == manifest["signals_sha256"]
    assert again.manifest["frames_sha256"] == manifest["frames_sha256"]


@pytest.mark.slow
def test_a_recording_gives_the_estimates_of_the_run(recorded: tuple[Path, Path], tmp_path: Path) -> None:
    run, images = recorded
    arguments = ["estimate", "slip", str(images), "--estimator", "ftrace", "--json", "--out", str(tmp_path / "out")]
    result = CliRunner().invoke(app, arguments)
    assert result.exit_code == 0, result.stderr
    log = read_log(run / "signals.parquet")
    captured = np.isfinite(log["health"])
    again = read_log(tmp_path / "out" / "slip.parquet")
    known = int(captured.sum())  # images whose estimates were still under way at the end are in the recording, too
    np.testing.assert_allclose(again["slip_angle"][:known], log["slip_angle_estimate"][captured], atol=1e-6)


def test_a_broken_image_is_dropped_and_told(recorded: tuple[Path, Path], tmp_path: Path) -> None:
    copy = shutil.copytree(recorded[1], tmp_path / "copy")
    (copy / "images" / "000003.png").write_bytes(b"no image")
    arguments = ["estimate", "slip", str(copy), "--estimator", "ftrace", "--no-video", "--out", str(tmp_path / "out")]
    result = CliRunner().invoke(app, arguments)
    assert result.exit_code == 0, result.stderr
    assert f"Image 3 dropped: {copy}/images/000003.png is corrupt or not an image" in result.stdout
    rows = list(csv.DictReader((tmp_path / "out" / "slip.csv").read_text().splitlines()))
    assert rows[3]["health"] == "dropped"


@pytest.mark.parametrize(
    ("spoil", "said"),
    [
        (lambda d: (d / "images" / "000001.png").unlink(), "33 images and 34 rows in readings.csv"),
        (
            lambda d: (d / "slip.csv").write_text("time_s,slip_deg\n0,200\n"),
            "slip_deg = 200 must be within -180 to 180 deg",
        ),
        (lambda d: (d / "slip.csv").write_text("time_s,slip_deg\n1e300,0\n"), "time_s = 1e+300 must be within"),
    ],
)
def test_a_recording_that_does_not_fit_is_one_line(
    recorded: tuple[Path, Path], tmp_path: Path, spoil: object, said: str
) -> None:
    copy = shutil.copytree(recorded[1], tmp_path / "copy")
    spoil(copy)  # type: ignore[operator]  # a function of the table above
    result = CliRunner().invoke(app, ["estimate", "slip", str(copy), "--out", str(tmp_path / "out")])
    assert result.exit_code == 2
    assert said in result.stderr
    assert result.stderr.count("\n") == 1


def test_a_frozen_camera_is_lost_and_the_drift_carried_on() -> None:
    """From the first repeated image on; 0.1 m later, after 1.25 s, the rover no longer counts on a slip angle."""
    log = driven("rover-slope", *SHORT, "course.length=0.7", "faults=freeze@5+2").log
    time, seen = log["time"], np.isfinite(log["health"])
    frozen = seen & (time >= 5.0) & (time < 7.0)
    assert (log["health"][frozen] == 2.0).all()
    assert (log["health"][seen & (time >= 7.0)] < 2.0).all()
    assert log["fallback"][(time > 6.5) & (time < 7.0)].all()
    assert not log["fallback"][time > 7.5].any()


def test_messages_that_do_not_come_are_noticed() -> None:
    """Not even a lost slip angle comes; 0.1 m are 1.25 s."""
    log = driven("rover-slope", "course.length=1", "slip_estimator=truth", "faults=dropout:1@4+4").log
    time, fallback = log["time"], log["fallback"]
    assert 1.0 <= time[np.argmax(fallback)] - 4.0 <= 1.3  # the last reading came 0.2 s before that
    assert not fallback[time > 8.5].any()


# Six wheels


SIX = ("vehicle=six_wheel_rover", "surface.slope_from=0.5", "surface.slope_over=0.3")


def on_six_wheels(*settings: str, record: Path | None = None) -> RoverResult:
    scenario = load_any_scenario("rover-slope", (*SIX, *settings))
    assert isinstance(scenario, RoverScenario)
    return run(scenario, 1, record=recording_in(record) if record else None)


@pytest.mark.slow
@pytest.mark.parametrize("compensation", ["crab", "heading"])
def test_it_holds_its_path_across_a_slope(compensation: str) -> None:
    """With a known slip the residual compass deviation of 0.3 degrees is left over 3 m, as with four wheels."""
    result = on_six_wheels("course.length=3", "slip_estimator=truth", f"slip_compensation={compensation}")
    assert result.outcome == "completed"
    assert abs(float(result.log["cross_track_true"][-1])) < 0.03
    loads = sum(result.log[f"load_{wheel.name}"] for wheel in result.rig.wheels)
    assert loads == pytest.approx(np.full(len(result.log), 42.6 * 9.81), rel=0.005)  # cos(5 deg) = 0.996


@pytest.mark.slow
def test_the_trace_of_three_wheels_in_line_shows_the_slip(tmp_path: Path) -> None:
    """Heading compensation lets the body slip by some 4 degrees; FTrace+ sees it within its 1.4 degrees of accuracy.

    From the recording, whose rig names six wheels, the estimates are the same but for rounding of degrees.
    """
    result = on_six_wheels("course.length=1.2", "slip_compensation=heading", record=tmp_path / "recording")
    assert np.degrees(np.sqrt(np.nanmean(result.slip_error**2))) < 1.4
    assert result.log["slip_angle_true"].min() < math.radians(-2.0)
    recording = open_rover_recording(tmp_path / "recording")
    assert recording.rig.wheels == result.rig.wheels
    assert recording.rig.watched == result.rig.watched
    assert recording.readings.shape[1] == 2 + 2 * 6
    done = CliRunner().invoke(
        app, ["estimate", "slip", str(tmp_path / "recording"), "--no-video", "--out", str(tmp_path / "again")]
    )
    assert done.exit_code == 0, done.stderr
    captured = np.isfinite(result.log["health"])
    again = read_log(tmp_path / "again" / "slip.parquet")["slip_angle"][: int(captured.sum())]
    np.testing.assert_allclose(again, result.log["slip_angle_estimate"][captured], atol=1e-6)
