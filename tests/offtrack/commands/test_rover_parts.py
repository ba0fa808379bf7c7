"""Rovers take drivers, sensors and faults of one's own, and are compared like trailers."""

import json
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from offtrack.commands.cli import app
from scenarios.loop.runner import run
from scenarios.options.scenario import RoverScenario, load_any_scenario
from scenarios.results.rover_result import RoverResult

SHORT = ("slip_estimator=truth", "course.length=0.6", "surface.slope_from=0.1")
PARTS = '''
import math
from dataclasses import replace
from vehicle.rover.command import RoverCommand
from sensors.instruments.navigation import ExactSlip


class Veering:
    """Drives a circle, whatever the path is."""

    def __init__(self, context):
        self.wheels = context.rover.places().tolist()
        self.speed = context.speed / context.rover.wheel_radius

    @classmethod
    def of(cls, context):
        return cls(context)

    def init(self):
        return None

    def step(self, memory, pose):
        speeds = tuple(self.speed * (1.0 - math.copysign(0.3, y)) for _, y in self.wheels)
        return None, RoverCommand(wheel_speed=speeds, steer=tuple(math.copysign(0.3, x) for x, _ in self.wheels))


class Broken(Veering):
    """Demands nothing that a wheel could do."""

    def step(self, memory, pose):
        return None, super().step(memory, pose)[1]._replace(steer=(math.nan,) * len(self.wheels))


class Instrument:
    """Reads the slip exactly, with a bias."""

    @classmethod
    def of(cls, context):
        return cls(context.rig.watched, float(context.options.get("bias", 0.0)))

    def __init__(self, wheel, bias):
        self.exact, self.bias = ExactSlip(wheel), bias

    def sample(self, truth):
        reading = self.exact.sample(truth)
        return replace(reading, slip_angle=reading.slip_angle + self.bias)
'''


@pytest.fixture
def own_parts(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "rover_parts.py").write_text(PARTS, encoding="utf-8")
    monkeypatch.syspath_prepend(str(tmp_path))


def driven(*settings: str) -> RoverResult:
    scenario = load_any_scenario("rover-slope", (*SHORT, *settings))
    assert isinstance(scenario, RoverScenario)
    return run(scenario, 1)


@pytest.mark.usefixtures("own_parts")
def test_a_rover_that_leaves_its_path_does_not_complete() -> None:
    """A driver of one's own turns in a circle: the run ends a metre off the path, not at the path's end."""
    result = driven("driver=rover_parts:Veering", "course.length=20")
    assert result.outcome == "left the path"
    assert 1.0 < abs(result.log["cross_track_true"][-1]) < 1.02
    before = replace(result, log=replace(result.log, rows=result.log.rows[:0]))
    assert before.summary()["outcome"] == "left the path"  # without a row there are no numbers, but a summary


@pytest.mark.usefixtures("own_parts")
def test_a_driver_of_ones_own_that_commands_no_number_ends_in_one_line() -> None:
    line = r"failed: driver = rover_parts:Broken: at tick 0 \(0 s\) it returned steer.* = nan"
    line += r" \(.*rover_parts\.py, line \d+\)"
    assert re.fullmatch(line, driven("driver=rover_parts:Broken").outcome)


@pytest.mark.usefixtures("own_parts")
def test_a_sensor_of_ones_own_feeds_the_slip_estimator() -> None:
    result = driven("sensor=rover_parts:Instrument", "sensing.bias=0.1")
    error = result.slip_error[np.isfinite(result.slip_error)]
    assert len(error) > 10
    np.testing.assert_allclose(error, 0.1, atol=1e-12)


def test_messages_of_a_rovers_sensor_can_be_lost() -> None:
    sound, faulty = driven(), driven("faults=dropout:0.5")
    count = [int(np.isfinite(result.log["health"]).sum()) for result in (sound, faulty)]
    assert faulty.outcome == "completed"
    assert 0.2 * count[0] < count[1] < 0.8 * count[0]
    with pytest.raises(ValueError, match="desync"):
        driven("faults=desync:0.02")


@pytest.mark.usefixtures("runs_here")
def test_slip_compensations_are_compared(tmp_path: Path) -> None:
    settings = [part for setting in SHORT[1:] for part in ("--set", setting)]
    arguments = ["compare", "rover-slope", "--controllers", "none,crab", *settings, "--jobs", "1", "--json"]
    result = CliRunner().invoke(app, [*arguments, "--out", str(tmp_path / "study")])
    assert result.exit_code == 0, result.stderr
    rows = json.loads(result.stdout)
    assert [row["axes"]["slip_compensation"] for row in rows] == ["none", "crab"]
    assert all(row["completed"] == 1 and row["slip.cross_track_rms_m"] is not None for row in rows)
