"""Warnings of sustained oscillation, of steering at its limits, and of signals and actuators at fault."""

import math
from typing import ClassVar

import numpy as np
import pytest

from controllers.trailer import SteerCommand, SteeringLaw, TrailerGeometry
from controllers.trailer_steering.actuators import ActuatorFinding
from estimators.estimates import OffTracking
from estimators.off_tracking.signal_monitor import Finding
from scenarios.courses import Turn, roundabout, turns
from scenarios.loop.runner import run
from scenarios.options.scenario import load_scenario
from scenarios.results.log import Log, Signal
from scenarios.results.run_warnings import SteeredAxle, actuator_warnings, signal_warnings, steer_warnings
from sensors.messages import CombinationSignals
from vehicle.clock import TICK
from vehicle.frames import FloatArray

AXLE = SteeredAxle(
    signal="steer_trailer_1_trailer", name="trailer, axle 1", limit=math.radians(30.0), rate_limit=math.radians(20.0)
)
TIME: FloatArray = 0.02 * np.arange(1500, dtype=np.float64)  # 30 s
STRAIGHT = np.column_stack([np.arange(0.0, 100.0, 0.5), np.zeros(200)])
ON_STRAIGHT = np.column_stack([2.8 * TIME, 0.0 * TIME])


def warnings(angle: FloatArray, road: FloatArray = STRAIGHT, tractor: FloatArray = ON_STRAIGHT) -> tuple[str, ...]:
    columns = [(Signal("time", "s", "time"), TIME), (Signal(AXLE.signal, "rad", "angle"), angle)]
    return steer_warnings(Log.of(columns), [AXLE], road, tractor)


def wave(amplitude_deg: float, hertz: float, start: float = 5.0, decay: float = 0.0) -> FloatArray:
    """From ``start`` on, with a decay rate [1/s]."""
    since = np.maximum(TIME - start, 0.0)
    angle: FloatArray = math.radians(amplitude_deg) * np.exp(-decay * since) * np.sin(math.tau * hertz * since)
    return angle


@pytest.mark.parametrize("hertz", [0.3, 0.8, 1.25])
def test_an_oscillation_that_stays_is_named(hertz: float) -> None:
    """As the weaving of a short trailer: 6.6 deg from side to side. Place, size and period are told."""
    (line,) = warnings(wave(3.3, hertz))
    assert line.startswith("trailer, axle 1: its steer oscillates from 5.")
    assert "6.6 deg from side to side" in line
    assert f"period of {1.0 / hertz:.2f} s" in line
    assert 29.9 - 0.5 / hertz < float(line.partition(" to ")[2].partition(" s")[0]) < 30.0  # its last swing


@pytest.mark.parametrize("angle", [wave(3.3, 1.25, decay=0.3), wave(0.6, 1.25), wave(10.0, 0.1)])
def test_transients_noise_and_slow_turns_are_none(angle: FloatArray) -> None:
    """An oscillation that dies out within some periods; one of 1.2 deg; ten seconds from turn to turn."""
    assert warnings(angle) == ()


def test_a_rough_road_is_none() -> None:
    """Random steer of half a degree to two degrees RMS, low-passed at 2 Hz: its swings differ in size and duration."""
    for seed in range(40):
        noise = np.random.default_rng(seed).normal(size=len(TIME))
        smooth = np.convolve(noise, np.exp(-0.25 * np.arange(40)), mode="same")
        assert not any(
            "oscillates" in line for line in warnings(math.radians(0.5 + 0.04 * seed) * smooth / smooth.std())
        )


def test_a_slalom_is_none() -> None:
    """The road swings as often as the steer."""
    sequence = [Turn("left" if k % 2 else "right", 15.0, 0.5, 0.5) for k in range(16)]
    course = turns(front_x=5.2, width=2.5, sequence=sequence, entry=20.0)
    station = np.minimum(6.0 * TIME, course.length)
    tractor = np.column_stack(
        [
            np.interp(station, np.linspace(-40.0, course.length + 40.0, len(course.centreline)), c)
            for c in course.centreline.T
        ]
    )
    bends = np.array([course.path.curvature(float(s)) for s in station])
    assert warnings(2.0 * bends, course.centreline, tractor) == ()
    assert warnings(2.0 * bends) != ()  # the same steer on a straight is an oscillation


def test_a_roundabout_is_none() -> None:
    course = roundabout(front_x=5.2, width=2.5)
    station = 4.0 * TIME
    tractor = np.array([course.path.pose(float(s))[:2] for s in station])
    angle = np.array([course.path.curvature(float(s)) for s in station]) * 5.0
    assert warnings(angle, course.centreline, tractor) == ()


def test_an_angle_at_its_limit_for_seconds_is_named() -> None:
    """Four seconds at 30 deg; two are a short turn."""
    ramp = np.clip(0.3 * np.minimum(TIME - 5.0, 12.5 - TIME), 0.0, AXLE.limit)
    (line,) = warnings(ramp)
    assert "at the limit of 30 deg from 6.7 to 10.8 s" in line
    assert warnings(np.clip(0.3 * np.minimum(TIME - 5.0, 10.5 - TIME), 0.0, AXLE.limit)) == ()


def test_a_rate_at_its_limit_for_seconds_is_named() -> None:
    """A triangle of 20 deg/s, 0.2 s a side: swings of 4 deg, half of them too quick for the actuator."""
    triangle = AXLE.rate_limit * np.abs((TIME % 0.4) - 0.2)
    lines = warnings(triangle)
    assert any("rate limit of 20 deg/s" in line for line in lines)


def test_a_run_of_no_time_has_no_warnings() -> None:
    columns = [(Signal("time", "s", "time"), TIME[:1]), (Signal(AXLE.signal, "rad", "angle"), TIME[:1])]
    assert steer_warnings(Log.of(columns), [AXLE], STRAIGHT, ON_STRAIGHT[:1]) == ()


class Swaying(SteeringLaw[None]):
    """Steers to and fro, whatever the path."""

    uses_off_tracking: ClassVar[bool] = False

    def __init__(self, trailer: TrailerGeometry) -> None:
        """For the trailer."""
        self._n = sum(trailer.steered)

    def init(self) -> None:
        """Nothing to remember."""

    def step(
        self, memory: None, tick: int, off_tracking: OffTracking | None, signals: CombinationSignals
    ) -> tuple[None, SteerCommand]:
        """A sine of 0.5 Hz and 4 deg."""
        angle = math.radians(4.0) * math.sin(math.pi * tick * TICK)
        return memory, SteerCommand(angles=np.full(self._n, angle))


@pytest.mark.slow
def test_a_run_that_completes_swaying_says_so() -> None:
    settings = (
        "course.kind=straight",
        "course.length=45",
        "off_tracking=truth",
        f"trailer_steering={__name__}:Swaying",
    )
    result = run(load_scenario("turn-90", settings), 1)
    assert result.outcome == "completed"
    assert [line.partition(":")[0] for line in result.warnings] == ["semitrailer, axle 2", "semitrailer, axle 3"]
    assert all("oscillates" in line for line in result.warnings)


# Signals and actuators at fault


def test_each_signal_has_a_line_with_its_times() -> None:
    findings = [
        Finding(1200, "wheel speed", True),
        Finding(3000, "wheel speed", False),
        Finding(4000, "steer angle", True),
        Finding(5000, "wheel speed", True),
    ]
    assert list(signal_warnings(findings)) == [
        "wheel speed distrusted from 1.2 s to 3.0 s, from 5.0 s: it contradicts the other signals; corrected",
        "steer angle distrusted from 4.0 s: it contradicts the other signals; corrected",
    ]


def test_a_line_for_every_actuator_with_periods_and_kinds() -> None:
    """A kind that was corrected while the fault went on is not told."""
    findings = (
        ActuatorFinding(1200, (2,), "slow"),
        ActuatorFinding(1500, (2,), "stuck"),
        ActuatorFinding(3000, (2,), "sound"),
        ActuatorFinding(4000, (1, 3), "offset"),
        ActuatorFinding(5000, (2,), "dead"),
    )
    assert list(actuator_warnings(findings)) == [
        "axle 2: does not follow its demand from 1.2 s to 3.0 s (stuck); "
        "from 5.0 s (it returned to straight, without power)",
        "axles 1 and 3: do not follow their demand from 4.0 s (an offset; corrected)",
    ]
