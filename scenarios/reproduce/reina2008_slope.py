"""Fig. 8 of Reina 2008: slip angle of a rover that drives straight onto a sandy slope of 5 degrees.

Reina 2008: G. Reina, G. Ishigami, K. Nagatani, K. Yoshida, "Vision-based estimation of slip angle for mobile robots
and planetary rovers", ICRA 2008. In the paper the rover travels 7 m: 60 s without lateral drift, then with drift. Here
the ground is level for the first 60 s, and then becomes a side slope. The drift follows from terramechanics; the wheels
of the same run make the trace in the camera images.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Final

import numpy as np
from matplotlib.figure import Figure

from estimators.estimates import Health, SlipAngle
from estimators.slip.reference import LaserSlip
from estimators.slip.wheel_trace.ftrace import FTrace
from scenarios.progress import Progress
from scenarios.randomness import stream
from scenarios.report.plots import ESTIMATED, GREY, TRUE
from scenarios.reproduce.figure import Reproduction, compared
from scenarios.results.log import Log, Signal
from sensors.instruments.rover_navigation import LaserTracker
from sensors.sand.rig import nominal_rig
from sensors.sand.sequence import recorded
from vehicle.clock import TICK, Schedule
from vehicle.frames import FloatArray, Pose2
from vehicle.rover.command import RoverCommand
from vehicle.rover.description import Rover, load_rover
from vehicle.rover.height_map import HeightMap
from vehicle.rover.plant import RoverPlant
from vehicle.rover.soil import load_soil
from vehicle.rover.terrain import Terrain
from vehicle.rover.truth import RoverTruth

_SPEED: Final = 0.08  # (section III) [m/s]
_LENGTH: Final = 7.0  # total distance (section III) [m]
_CALM: Final = 60.0  # before the sideslip begins (section III) [s]
_SLOPE: Final = math.tan(math.radians(5.0))  # (section III)
_EASING: Final = 0.8  # length of the transition from level ground to slope, a little over the wheelbase; assumed [m]
_RATE: Final = 5.0  # of the camera (section III) [Hz]
_LEAD: Final = 9.0  # driven before the first image, on level sand, until the trace fills the view [s]
_SPACING: Final = 0.1  # of the height map [m]
_SEED: Final = 1
_SIGNALS: Final = (
    Signal("time", "s", "time since the first image"),
    Signal("slip_angle_true", "rad", "true slip angle of the body, + left"),
    Signal("slip_angle_ftrace", "rad", "slip angle by FTrace and eq. 2; NaN: no trace detected"),
    Signal(
        "slip_angle_laser", "rad", "slip angle by laser tracker and compass, eqs 5 and 6, delayed by half their span"
    ),
    Signal("x", "m", "x of R's origin in W"),
    Signal("y", "m", "y of R's origin in W"),
)


def fig8(quick: bool, progress: Progress) -> Reproduction:
    """Slip angle by FTrace and by the laser tracker, and the true one."""
    calm, length = (12.0, 2.4) if quick else (_CALM, _LENGTH)
    rows = np.array(list(_driven(calm, length, progress)))
    time, true, ftrace, laser = rows[:, :4].T
    return Reproduction(
        name="reina2008-fig8",
        title="Fig. 8: slip angle on a sandy slope of 5 degrees, driven straight ahead",
        source="Reina et al., ICRA 2008",
        comparisons=[
            compared("RMS against laser and compass", "< 2", _rms(ftrace, laser), "deg"),
            compared("RMS against the truth", "1.4", _rms(ftrace, true), "deg"),
            compared("images with an estimate", "> 98", 100.0 * np.isfinite(ftrace).mean(), "%"),
            compared("largest true slip angle", "", _largest(true), "deg"),
            compared("true slip in the first stage, RMS", "0", _calm(time, true, calm), "deg"),
            compared("lateral drift from the initial heading line", "", abs(float(rows[-1, 5])), "m"),
        ],
        notes=(
            "The paper does not explain why there is no drift in the first 60 s; here the ground is level until then.",
            "Laser and compass are evaluated over the last 4 s, so their slip angle is delayed by 2 s. It is compared "
            "with FTrace's estimate from the same image, which is a mean over some 7 s of travel.",
        ),
        data=Log(_SIGNALS, rows),
        draw=lambda: _draw(rows, calm),
    )


def _driven(calm: float, length: float, progress: Progress) -> Iterator[list[float]]:
    """Drive, estimate, and yield a row of the table for every image."""
    rover = load_rover("el_dorado_ii")
    terrain = _ground(calm * _SPEED + 0.5 * rover.wheelbase, length)
    truths = _truths(RoverPlant(rover, terrain, load_soil("beach_sand")), rover, length)
    lead = round(_LEAD * _RATE)
    ftrace, laser = FTrace(nominal_rig(rover)), LaserSlip()
    memory, fixes = ftrace.init(), laser.init()
    tracker = LaserTracker(rng=stream(_SEED, "laser tracker"))
    sequence = recorded(truths, "uniform", rng=stream(_SEED, "sand"), rover=rover, terrain=terrain, lead=lead)
    for k, (view, truth, _) in enumerate(sequence):
        progress(k, len(truths) - lead, f"image {k + 1}")
        memory, estimate = ftrace.step(memory, view)
        fixes, reference = laser.step(fixes, tracker.sample(truth), view.heading)
        time = (truth.tick - truths[lead].tick) * TICK
        at = [math.nan if reference is None else reference, *truth.pose[:2].tolist()]
        yield [time, truth.slip_angle, _value(estimate), *at]
    progress(len(truths) - lead, len(truths) - lead, "")


def _value(estimate: SlipAngle) -> float:
    return math.nan if estimate.health is Health.LOST else estimate.value


def _ground(begin: float, length: float) -> Terrain:
    """Level sand that becomes a side slope, rising to the left, ``begin`` [m] after the position of the first image."""
    x = np.arange(-2.0, length + 3.0, _SPACING)
    y = np.arange(-3.0, 3.0, _SPACING)
    part = np.clip((x - begin) / _EASING, 0.0, 1.0)
    eased = part * part * (3.0 - 2.0 * part)
    return Terrain(
        height_map=HeightMap(heights=_SLOPE * y[:, None] * eased, spacing=_SPACING, x=float(x[0]), y=float(y[0]))
    )


def _truths(plant: RoverPlant, rover: Rover, length: float) -> list[RoverTruth]:
    """Truth at every image, wheels straight at a constant speed, until the distance is covered or time is up."""
    period, n = Schedule.at_rate(_RATE).period, len(rover.wheels)
    command = RoverCommand(wheel_speed=(_SPEED / rover.radius,) * n, steer=(0.0,) * n)
    state = plant.initial_state(Pose2(-_LEAD * _SPEED, 0.0, 0.0), _SPEED)
    truths = [plant.observe(state, 0)]
    while truths[-1].pose[0] < length and truths[-1].tick * TICK < 2.0 * length / _SPEED + _LEAD:
        state = plant.step(state, command, period)
        truths.append(plant.observe(state, truths[-1].tick + period))
    return truths


def _rms(a: FloatArray, b: FloatArray) -> float:
    both = np.isfinite(a) & np.isfinite(b)
    return math.degrees(float(np.sqrt(np.mean((a - b)[both] ** 2)))) if both.any() else math.nan


def _largest(slip: FloatArray) -> float:
    return math.degrees(float(np.abs(slip).max()))


def _calm(time: FloatArray, slip: FloatArray, until: float) -> float:
    return math.degrees(float(np.sqrt(np.mean(slip[time < until - 5.0] ** 2))))


def _draw(rows: FloatArray, calm: float) -> Figure:
    figure = Figure(figsize=(9.6, 3.6), layout="constrained")
    ax = figure.subplots()
    time, (true, ftrace, laser) = rows[:, 0], np.degrees(rows[:, 1:4].T)
    ax.axvline(calm, color=GREY, linewidth=0.8, linestyle=":")
    ax.plot(time, laser, color=GREY, linewidth=1.0, label="laser and compass, eqs 5 and 6")
    ax.plot(time, ftrace, ".", color=ESTIMATED, markersize=3.0, label="FTrace, eq. 2")
    ax.plot(time, true, color=TRUE, label="true")
    ax.set(xlabel="time [s]", ylabel="slip angle [°], + left")
    ax.legend(loc="best")
    return figure
