"""Result of a rover run in memory: its signals, its summary, and the lines in its camera image."""

import math
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from typing import ClassVar, Final

import numpy as np

from controllers.path import Path
from estimators.estimates import Health, SlipAngle
from estimators.slip.rover_odometry import LaserSlip, RoverPose
from scenarios.results import metrics
from scenarios.results.log import HEALTH, LOST, MOTION, Column, Log, Row, Signal, columns_by_parts
from scenarios.results.run_summary import Numbers, Result, Summary, number, timing_numbers
from sensors.messages import RoverReadings
from sensors.sand.trace_rig import TraceRig
from vehicle.clock import TICK
from vehicle.frames import FloatArray
from vehicle.rover.command import RoverCommand
from vehicle.rover.truth import RoverTruth


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class TraceFrame:
    """A colour picture of the camera for reports and videos."""

    tick: int
    jpeg: bytes


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class RoverResult(Result):
    """The result of a rover's run."""

    kind: ClassVar[str] = "rover"

    rover: str
    path: FloatArray  # (n, 2) reference path [m]
    rig: TraceRig
    frames: tuple[TraceFrame, ...]

    @property
    def slip_error(self) -> FloatArray:
        """Estimated less true slip angle at the estimate's own time [rad] (n_rows,); NaN where there is none."""
        return self.log["slip_angle_estimate"] - self.log["slip_angle_true"]

    def summary(self) -> Summary:
        """The run in numbers, ready for JSON: null stands for numbers that do not apply or were not measured."""
        return {
            "outcome": self.outcome,
            "scenario": self.scenario,
            "seed": self.seed,
            "slip": _slip(self),
            "position": _position(self.log),
            "wheels": _wheels(self),
            "timing": timing_numbers(self.timing),
            **({"paced": self.paced.numbers()} if self.paced else {}),
            "warnings": list(self.all_warnings()),
        }


def _slip(result: RoverResult) -> Numbers:
    log, error = result.log, np.degrees(result.slip_error)
    lagged = np.degrees(log["slip_angle_lagged"] - log["slip_angle_true"])
    health = log["health"]
    captures = np.isfinite(health)
    return {
        "error_rms_deg": number(metrics.rms(error)),
        "error_max_deg": number(metrics.peak(error)),
        "valid_fraction": number(float(np.mean(health[captures] < LOST))) if captures.any() else None,
        "cross_track_rms_m": number(metrics.rms(log["cross_track_true"])),
        "cross_track_max_m": number(metrics.peak(log["cross_track_true"])),
        "cross_track_max_time_s": number(metrics.time_of_peak(log["cross_track_true"], log["time"])),
        "lagged_error_rms_deg": number(metrics.rms(lagged)),
        "within_2_5_sigma": number(metrics.within_sigmas(result.slip_error, log["slip_angle_std"])),
        "true_mean_deg": number(math.degrees(metrics.mean(log["slip_angle_true"]))),
        "reference_error_rms_deg": number(metrics.rms(np.degrees(_reference_error(log)))),
    }


def _reference_error(log: Log) -> FloatArray:
    """Slip angle by laser tracker and compass less the true one at the same time [rad]."""
    if not len(log):
        return np.empty(0)
    time, delay = log["time"], LaserSlip().delay()
    true_then = np.interp(time - delay, time, log["slip_angle_true"])
    error: FloatArray = np.where(time >= delay, log["slip_angle_laser"] - true_then, np.nan)
    return error


def _position(log: Log) -> Numbers:
    """Final position errors of the two dead reckonings, and the distance travelled."""
    if not len(log):
        return {}
    distance = float(np.sum(np.hypot(np.diff(log["x"]), np.diff(log["y"]))))
    return {
        "distance_m": number(distance),
        **{
            f"{name}_error_m": number(
                math.hypot(log[f"x_{name}"][-1] - log["x"][-1], log[f"y_{name}"][-1] - log["y"][-1])
            )
            for name in ("wheels", "corrected")
        },
    }


def _wheels(result: RoverResult) -> Numbers:
    ratios, sinkages = (
        np.array([result.log[f"{quantity}_{wheel.name}"] for wheel in result.rig.wheels])
        for quantity in ("slip_ratio", "sinkage")
    )
    return {
        "slip_ratio_mean": number(metrics.mean(ratios.ravel())),
        "sinkage_max_m": number(metrics.peak(sinkages.ravel())),
    }


_ESTIMATE: Final = (
    Signal("slip_angle_estimate", "rad", "estimated slip angle of the body, + left, at the tick of capture"),
    Signal("slip_angle_std", "rad", "its standard deviation"),
    Signal("health", "-", "health of the slip angle: 0 ok, 1 degraded, 2 lost"),
    Signal("wheel_slip_estimate", "rad", "estimated slip angle of the left rear wheel, + left"),
    Signal("trace_offset", "m", "lateral offset of the trace from the wheel's centre, + left"),
    Signal("trace_confidence", "-", "confidence that the trace is the wheel's own"),
)
_FALLBACK: Final = Signal(
    "fallback", "-", "1 while no new slip angle comes and the drift is carried on from the last one, else 0"
)
_LAGGED: Final = (
    Signal("slip_angle_lagged", "rad", "slip angle at this tick, estimated with later images, too"),
    Signal("slip_angle_lagged_std", "rad", "its standard deviation"),
)


@dataclass(frozen=True, slots=True, kw_only=True)
class RoverRecord:
    """Readings, estimated poses and the command of one step."""

    readings: RoverReadings
    command: RoverCommand
    wheels_only: RoverPose  # dead reckoning without slip
    corrected: RoverPose  # dead reckoning with the slip angle
    navigated: RoverPose  # pose that the driver steers by
    laser_slip: float | None  # [rad], of LaserSlip.delay() ago


RoverRow = Row[RoverTruth, RoverRecord]


def path_coordinates(path: Path, truth: RoverTruth, last_station: float) -> tuple[float, float]:
    """Station of R's origin along the path [m], and its lateral offset from the path, + left [m].

    ``last_station`` [m] is the station of the step before.
    """
    x, y, _ = truth.pose.tolist()
    station = path.project(x, y, last_station)
    on_path = path.pose(station)
    return station, math.cos(on_path.psi) * (y - on_path.y) - math.sin(on_path.psi) * (x - on_path.x)


# largest slip angle at which forces of a wheel on soil are compared with measured ones
_MEASURED: Final = math.radians(45.0)
_CRAWLING: Final = 0.01  # below this speed a direction of travel means little [m/s]
_LONG: Final = 0.5  # [s]


def soil_warnings(log: Log) -> Iterator[str]:
    """A line if the watched wheel travels further across its heading than the forces of soil are known for."""
    moving = np.hypot(log["v_x"], log["v_y"]) > _CRAWLING
    slips = np.where(moving, np.abs(log["wheel_slip_true"]), 0.0)
    beyond = np.flatnonzero(slips > _MEASURED)
    seconds = len(beyond) * float(np.median(np.diff(log["time"]))) if len(beyond) else 0.0
    if seconds > _LONG:
        yield (
            f"soil: for {seconds:.1f} s, from {log['time'][beyond[0]]:.1f} s on, the left rear wheel travels more than "
            f"45° across its heading (at most {math.degrees(slips.max()):.0f}°); forces are compared with measured "
            "ones up to there"
        )


def rover_log(
    rig: TraceRig, rows: Sequence[RoverRow], estimates: Iterable[SlipAngle], path: Path, *, faults: bool = False
) -> Log:
    """The log of a run along a path; the rows are read once, in order, and few of them are in memory at a time.

    A run with ``faults`` also tells where the drift is carried on without a slip angle.
    """
    return Log.of(_columns(rig, rows, estimates, path, faults))


def _columns(
    rig: TraceRig, rows: Sequence[RoverRow], estimates: Iterable[SlipAngle], path: Path, faults: bool
) -> Iterator[Column]:
    (columns,) = columns_by_parts(rows, partial(_true_columns, rig, _Along(path)))
    yield from (column for column in columns if faults or column[0] is not _FALLBACK)
    (ticks,) = (values for signal, values in columns if signal.name == "tick")
    yield from _estimate_columns(ticks, estimates)


def _true_columns(rig: TraceRig, path: "_Along", rows: Sequence[RoverRow]) -> Iterator[Column]:
    """Truth, commands and readings of some rows, which come in order."""
    truths, records = [row.truth for row in rows], [row.record for row in rows]
    yield Signal("tick", "ms", "time in whole ticks"), [truth.tick for truth in truths]
    yield Signal("time", "s", "time"), [truth.tick * TICK for truth in truths]
    motion = np.array([(*truth.pose, *truth.velocity) for truth in truths]).reshape(-1, len(MOTION))
    yield from ((Signal(*signal), values) for signal, values in zip(MOTION, motion.T, strict=True))
    direction = "direction of travel against the body's x axis, + left"
    yield Signal("slip_angle_true", "rad", direction), [truth.slip_angle for truth in truths]
    direction = "direction of travel of the left rear wheel against its heading, + left"
    yield Signal("wheel_slip_true", "rad", direction), [truth.slip_angles[rig.watched] for truth in truths]
    along = path.coordinates(truths)
    yield Signal("station", "m", "distance along the path"), along[:, 0]
    for k, wheel in enumerate(place.name for place in rig.wheels):
        for name, unit, meaning, values in (
            (f"slip_ratio_{wheel}", "-", "longitudinal slip", [truth.slip_ratios[k] for truth in truths]),
            (f"sinkage_{wheel}", "m", "sinkage", [truth.sinkages[k] for truth in truths]),
            (f"load_{wheel}", "N", "load normal to the ground", [truth.loads[k] for truth in truths]),
            (f"steer_{wheel}", "rad", "steer angle against the body, + left", [truth.steer[k] for truth in truths]),
            (f"steer_{wheel}_command", "rad", "its demand", [one.command.steer[k] for one in records]),
            (f"wheel_speed_{wheel}", "rad/s", "speed of rotation", [truth.wheel_speeds[k] for truth in truths]),
            (f"wheel_speed_{wheel}_command", "rad/s", "its demand", [one.command.wheel_speed[k] for one in records]),
        ):
            yield Signal(name, unit, meaning), values
    yield Signal("compass", "rad", "heading by the compass, wrapped"), [one.readings.heading for one in records]
    for name, meaning, poses in (
        ("wheels", "by encoders and compass", [one.wheels_only for one in records]),
        ("corrected", "by encoders, compass and slip angle", [one.corrected for one in records]),
    ):
        yield Signal(f"x_{name}", "m", f"position along the first heading, {meaning}"), [pose.x for pose in poses]
        yield (
            Signal(f"y_{name}", "m", f"position to the left of the first heading, {meaning}"),
            [pose.y for pose in poses],
        )
    drift = Signal("drift_navigated", "rad", "slip angle that the driver compensates, + left")
    yield drift, [one.navigated.drift for one in records]
    laser = Signal("slip_angle_laser", "rad", "slip angle by laser tracker and compass, some seconds old")
    yield laser, [math.nan if one.laser_slip is None else one.laser_slip for one in records]
    yield _FALLBACK, [float(one.corrected.carried) for one in records]
    yield Signal("cross_track_true", "m", "lateral offset of R's origin from the path, + left"), along[:, 1]


class _Along:
    """A rover's way along its path, whose truths come part by part, in order."""

    def __init__(self, path: Path) -> None:
        self._path, self._station = path, 0.0

    def coordinates(self, truths: Sequence[RoverTruth]) -> FloatArray:
        """Station and lateral offset at the next truths, (n, 2) [m]."""
        coordinates = []
        for truth in truths:
            self._station, offset = path_coordinates(self._path, truth, self._station)
            coordinates.append((self._station, offset))
        return np.array(coordinates).reshape(-1, 2)


def _estimate_columns(ticks: FloatArray, estimates: Iterable[SlipAngle]) -> Iterator[Column]:
    """Estimates in the rows of their captures; NaN in the others."""
    index = {tick: row for row, tick in enumerate(ticks.tolist())}
    table = np.full((len(ticks), len(_ESTIMATE) + len(_LAGGED)), np.nan)
    for estimate in estimates:
        if estimate.tick in index:
            table[index[estimate.tick], : len(_ESTIMATE)] = list(_estimate_values(estimate))
        if estimate.lagged_tick in index:
            table[index[estimate.lagged_tick], len(_ESTIMATE) :] = estimate.lagged_value, estimate.lagged_std
    yield from zip((*_ESTIMATE, *_LAGGED), table.T, strict=True)


def _estimate_values(estimate: SlipAngle) -> Iterator[float]:
    lost = estimate.health is Health.LOST
    yield np.nan if lost else estimate.value
    yield np.nan if lost else estimate.std
    yield HEALTH[estimate.health]
    yield np.nan if lost else estimate.wheel_slip
    yield np.nan if lost else estimate.trace_offset
    yield estimate.confidence


_NEAR, _FAR, _POINTS = 0.12, 0.66, 12  # ends of the line, behind the wheel's centre [m]


def trace_lines(result: RoverResult, tick: int) -> tuple[FloatArray, FloatArray | None]:
    """Pixels (n, 2) of the true line and of the estimated one at a tick; None without an estimate."""
    log, rig = result.log, result.rig
    row = int(np.searchsorted(log["tick"], tick))
    pointed = float(log[f"steer_{rig.wheels[rig.watched].name}"][row])
    true = trace_line(rig, pointed + float(log["wheel_slip_true"][row]), 0.0)
    estimate = float(log["wheel_slip_estimate"][row])
    if not math.isfinite(estimate):
        return true, None
    return true, trace_line(rig, pointed + estimate, float(log["trace_offset"][row]))


def trace_line(rig: TraceRig, direction: float, offset: float) -> FloatArray:
    """Pixels (n, 2) of the trace of a wheel that travels in ``direction`` relative to the body [rad], + left.

    ``offset`` is the trace's lateral distance from the wheel's centre [m], + left.
    """
    behind = np.linspace(_NEAR, _FAR, _POINTS)
    ground = np.column_stack(
        [rig.wheel[0] - behind, rig.wheel[1] + offset - behind * math.tan(direction), np.zeros(_POINTS)]
    )
    R_RC, p_RC = rig.X_RC[:3, :3], rig.X_RC[:3, 3]
    return rig.camera.project((ground - p_RC) @ R_RC)
