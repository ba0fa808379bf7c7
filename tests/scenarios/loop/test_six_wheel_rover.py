"""A six-wheeled rover in the closed loop, with its camera behind three wheels that share a rut."""

from __future__ import annotations

import math
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

SIX = ("vehicle=six_wheel_rover", "surface.slope_from=0.5", "surface.slope_over=0.3")


def driven(*settings: str, record: Path | None = None) -> RoverResult:
    scenario = load_any_scenario("rover-slope", (*SIX, *settings))
    assert isinstance(scenario, RoverScenario)
    return run(scenario, 1, record=recording_in(record) if record else None)


@pytest.mark.slow
@pytest.mark.parametrize("compensation", ["crab", "heading"])
def test_it_holds_its_path_across_a_slope(compensation: str) -> None:
    """With a known slip the residual compass deviation of 0.3 degrees is left over 3 m, as with four wheels."""
    result = driven("course.length=3", "slip_estimator=truth", f"slip_compensation={compensation}")
    assert result.outcome == "completed"
    assert abs(float(result.log["cross_track_true"][-1])) < 0.03
    loads = sum(result.log[f"load_{wheel.name}"] for wheel in result.rig.wheels)
    assert loads == pytest.approx(np.full(len(result.log), 42.6 * 9.81), rel=0.005)  # cos(5 deg) = 0.996


@pytest.mark.slow
def test_the_trace_of_three_wheels_in_line_shows_the_slip(tmp_path: Path) -> None:
    """Heading compensation lets the body slip by some 4 degrees; FTrace+ sees it within its 1.4 degrees of accuracy.

    From the recording, whose rig names six wheels, the estimates are the same but for nine digits of readings.
    """
    result = driven("course.length=1.2", "slip_compensation=heading", record=tmp_path / "recording")
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
