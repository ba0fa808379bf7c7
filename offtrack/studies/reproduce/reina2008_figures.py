"""Figs 6 and 8 and Table II of Reina 2008: FTrace on one image, and on a drive onto a sandy slope.

Reina 2008: G. Reina, G. Ishigami, K. Nagatani, K. Yoshida, "Vision-based estimation of slip angle for mobile robots
and planetary rovers", ICRA 2008. In the paper the rover travels 7 m: 60 s without lateral drift, then with drift. Here
the ground is level for the first 60 s, and then becomes a side slope. The drift follows from terramechanics; the wheels
of the same run make the trace in the camera images.
"""

import math
from collections.abc import Iterator, Sequence
from typing import Final

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from estimators.estimates import Health
from estimators.slip.rover_odometry import LaserSlip
from estimators.slip.wheel_trace.ftrace import CANDIDATES, Explanation, FTrace
from offtrack.reports.plots import ESTIMATED, GREY, TRUE
from offtrack.studies.reproduce.reproduction import Comparison, Reproduction, printed, reproduced
from offtrack.studies.reproduce.trace_tables import bars
from scenarios.options.scenario import stream
from scenarios.progress import Progress
from scenarios.results import metrics
from scenarios.results.log import Log, Signal
from sensors.instruments.navigation import LaserTracker
from sensors.sand.rover_pass import labelled_sequence, recorded
from sensors.sand.trace_rig import nominal_rig
from vehicle.clock import TICK, Schedule
from vehicle.frames import FloatArray, Pose2
from vehicle.rover.command import RoverCommand
from vehicle.rover.description import Rover, load_rover, load_soil
from vehicle.rover.plant import RoverPlant
from vehicle.rover.terrain import HeightMap, Terrain
from vehicle.rover.truth import RoverTruth

_KIND, _SEED = "uniform", 1  # a clearly defined imprint without slip, as in Fig. 6
_FRAME: Final = 30  # number of the image that is shown; FTrace needs the poses of earlier ones


def table2(quick: bool, progress: Progress) -> Reproduction:
    """Confidences of the candidates in one image."""
    explanation, ground = _explained(quick, progress)
    own = np.full(CANDIDATES, math.nan)
    own[: len(explanation.confidences)] = 100.0 * np.sort(explanation.confidences)[::-1]
    published = sorted(printed("reina2008")["table2"]["confidences"], reverse=True)
    pairs = zip(published, own.tolist(), strict=True)
    return reproduced(
        "reina2008-table2",
        [Comparison(f"candidate {k}", f"{paper:.1f}", ours, "%") for k, (paper, ours) in enumerate(pairs, start=1)],
        _data(explanation, ground),
        lambda: _ranking(published, own.tolist()),
    )


def fig6(quick: bool, progress: Progress) -> Reproduction:
    """Stages from an image to the trace."""
    explanation, ground = _explained(quick, progress)
    best = 100.0 * float(explanation.confidences.max(initial=0.0))
    d, theta, offset = ground[explanation.best].tolist() if explanation.best is not None else (math.nan,) * 3
    return reproduced(
        "reina2008-fig6",
        [
            Comparison("candidates", "10", len(explanation.confidences), "-"),
            Comparison("confidence of the trace", "87", best, "%"),
            Comparison("angle of the trace", "0 (no slip)", math.degrees(theta), "deg"),
            Comparison("distance of the trace from G", "", d, "m"),
            Comparison("distance of the trace from the wheel's centre", "", offset, "m"),
        ],
        _data(explanation, ground),
        lambda: _panels(explanation, ground),
    )


def _explained(quick: bool, progress: Progress) -> tuple[Explanation, FloatArray]:
    """Explanation of the sample image by FTrace, and d [m], theta [rad] and Y [m] of the candidates."""
    frames = _FRAME // 3 if quick else _FRAME
    rover = load_rover("el_dorado_ii")
    ftrace = FTrace(nominal_rig(rover))
    memory = ftrace.init()
    before = memory
    for k, (view, _, _) in enumerate(
        labelled_sequence(_KIND, seed=_SEED, frames=frames, rover=rover, profile="none", bare=0.0)
    ):
        progress(k, frames, f"image {k + 1}")
        before, last = memory, view
        memory, _ = ftrace.step(memory, view)
    progress(frames, frames, "")
    explanation = ftrace.explain(before, last)
    return explanation, explanation.candidates.ground


def _data(explanation: Explanation, ground: FloatArray) -> Log:
    signals = (
        Signal("rho", "px", "distance of the candidate from the first pixel"),
        Signal("phi", "rad", "direction of the candidate's normal in the image"),
        Signal("d", "m", "distance on the ground from R's origin, + left"),
        Signal("theta", "rad", "direction on the ground, + left"),
        Signal("Y", "m", "lateral offset from the wheel's centre, + left"),
        Signal("votes", "-", "edge pixels on both edges"),
        Signal("confidence", "-", "confidence that the candidate is the trace"),
    )
    columns = (explanation.candidates.image, ground, explanation.candidates.votes, explanation.confidences)
    return Log(signals, np.column_stack(columns))


def _ranking(published: Sequence[float], own: Sequence[float]) -> Figure:
    figure = Figure(figsize=(9.6, 3.2), layout="constrained")
    ax = figure.subplots()
    names = [str(k) for k in range(1, CANDIDATES + 1)]
    bars(ax, names, {"published, sorted": (GREY, published), "own, sorted": (ESTIMATED, own)})
    ax.set(xlabel="candidate", ylabel="confidence match [%]")
    ax.legend()
    return figure


def _panels(explanation: Explanation, ground: FloatArray) -> Figure:
    """Draw (a) image, (b) edges, (c) candidates, (d) trace."""
    figure = Figure(figsize=(9.6, 7.6), layout="constrained")
    axes = figure.subplots(2, 2).ravel()
    titles = ("(a) original scene", "(b) Canny's edges", "(c) candidates", "(d) trace")
    for ax, title, picture in zip(
        axes, titles, (explanation.image, explanation.edges, explanation.image, explanation.image), strict=True
    ):
        ax.imshow(picture, cmap="gray", vmin=0, vmax=255, interpolation="antialiased")
        ax.set(title=title, xticks=[], yticks=[], xlim=(0, picture.shape[1] - 1), ylim=(picture.shape[0] - 1, 0))
    for k, (line, certain) in enumerate(zip(explanation.candidates.image, explanation.confidences, strict=True)):
        _line(axes[2], line, ESTIMATED, 1.0)
        position = _at_row(line, 20.0 + 42.0 * k)
        axes[2].text(*position, f"{100.0 * certain:.0f} %", color="white", fontsize=8, clip_on=True)
    if explanation.best is not None:
        for edge in explanation.candidates.edges[explanation.best]:
            _line(axes[3], edge, TRUE, 1.0)
        _line(axes[3], explanation.candidates.image[explanation.best], ESTIMATED, 2.5)
        d, theta, _ = ground[explanation.best].tolist()
        text = f"$d_t$ = {d:.3f} m, $\\theta_t$ = {math.degrees(theta):.1f}°"
        axes[3].text(12.0, 30.0, text, color="white", fontsize=11)
    return figure


def _line(ax: Axes, line: FloatArray, colour: str, width: float) -> None:
    (u0, v0), (u1, v1) = _at_row(line, 0.0), _at_row(line, 479.0)
    ax.plot([u0, u1], [v0, v1], color=colour, linewidth=width)


def _at_row(line: FloatArray, v: float) -> tuple[float, float]:
    """Point where a line crosses an image row [px]."""
    rho, phi = float(line[0]), float(line[1])
    return (rho - v * math.sin(phi)) / math.cos(phi), v


_SPEED: Final = 0.08  # (section III) [m/s]
_LENGTH: Final = 7.0  # total distance (section III) [m]
_CALM: Final = 60.0  # before the sideslip begins (section III) [s]
_SLOPE: Final = math.tan(math.radians(5.0))  # (section III)
_EASING: Final = 0.8  # length of the transition from level ground to slope, a little over the wheelbase; assumed [m]
_RATE: Final = 5.0  # of the camera (section III) [Hz]
_LEAD: Final = 9.0  # driven before the first image, on level sand, until the trace fills the view [s]
_SPACING: Final = 0.1  # of the height map [m]
_SLOPE_SEED: Final = 1
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
    return reproduced(
        "reina2008-fig8",
        [
            Comparison("RMS against laser and compass", "< 2", _rms(ftrace - laser), "deg"),
            Comparison("RMS against the truth", "1.4", _rms(ftrace - true), "deg"),
            Comparison("images with an estimate", "> 98", 100.0 * np.isfinite(ftrace).mean(), "%"),
            Comparison("largest true slip angle", "", math.degrees(float(np.abs(true).max())), "deg"),
            Comparison("true slip in the first stage, RMS", "0", _rms(true[time < calm - 5.0]), "deg"),
            Comparison("lateral drift from the initial heading line", "", abs(float(rows[-1, 5])), "m"),
        ],
        Log(_SIGNALS, rows),
        lambda: _draw(rows, calm),
    )


def _driven(calm: float, length: float, progress: Progress) -> Iterator[list[float]]:
    """Drive, estimate, and yield a row of the table for every image."""
    rover = load_rover("el_dorado_ii")
    terrain = _ground(calm * _SPEED + 0.5 * rover.wheelbase, length)
    truths = _truths(RoverPlant(rover, terrain, load_soil("beach_sand")), rover, length)
    lead = round(_LEAD * _RATE)
    ftrace, laser = FTrace(nominal_rig(rover)), LaserSlip()
    memory, fixes = ftrace.init(), laser.init()
    tracker = LaserTracker(rng=stream(_SLOPE_SEED, "laser tracker"))
    sequence = recorded(truths, "uniform", rng=stream(_SLOPE_SEED, "sand"), rover=rover, terrain=terrain, lead=lead)
    for k, (view, truth, _) in enumerate(sequence):
        progress(k, len(truths) - lead, f"image {k + 1}")
        memory, estimate = ftrace.step(memory, view)
        fixes, reference = laser.step(fixes, tracker.sample(truth), view.heading)
        time = (truth.tick - truths[lead].tick) * TICK
        at = [math.nan if reference is None else reference, *truth.pose[:2].tolist()]
        slip_angle = math.nan if estimate.health is Health.LOST else estimate.value
        yield [time, truth.slip_angle, slip_angle, *at]
    progress(len(truths) - lead, len(truths) - lead, "")


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


def _rms(angles: FloatArray) -> float:
    """RMS of the angles that are known [deg]."""
    return math.degrees(metrics.rms(angles))


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
