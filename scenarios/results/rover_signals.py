"""Signals of a rover run, one row every 50 ms; each estimate is in the row of its capture."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from controllers.path import Path
from estimators.estimates import Health, SlipAngle
from estimators.slip.rover_odometry import RoverPose
from scenarios.results.log import HEALTH, Log, Row, Signal
from sensors.messages import RoverReadings
from sensors.sand.trace_rig import TraceRig
from vehicle.clock import TICK
from vehicle.rover.command import RoverCommand
from vehicle.rover.truth import RoverTruth

_ESTIMATE: Final = (
    Signal("slip_angle_estimate", "rad", "estimated slip angle of the body, + left, at the tick of capture"),
    Signal("slip_angle_std", "rad", "its standard deviation"),
    Signal("health", "-", "health of the slip angle: 0 ok, 1 degraded, 2 lost"),
    Signal("wheel_slip_estimate", "rad", "estimated slip angle of the left rear wheel, + left"),
    Signal("trace_offset", "m", "lateral offset of the trace from the wheel's centre, + left"),
    Signal("trace_confidence", "-", "confidence that the trace is the wheel's own"),
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


def rover_log(rig: TraceRig, rows: Sequence[RoverRow], estimates: Sequence[SlipAngle], path: Path) -> Log:
    """The log of a run along a path."""
    index = {row.truth.tick: k for k, row in enumerate(rows)}
    estimated = np.full((len(rows), len(_ESTIMATE) + len(_LAGGED)), np.nan)
    for estimate in estimates:
        if estimate.tick in index:
            estimated[index[estimate.tick], : len(_ESTIMATE)] = list(_estimate_values(estimate))
        if estimate.lagged_tick in index:
            estimated[index[estimate.lagged_tick], len(_ESTIMATE) :] = estimate.lagged_value, estimate.lagged_std
    signals, values, station = tuple(_signals(rig)), [], 0.0
    for row in rows:
        station, cross_track = path_coordinates(path, row.truth, station)
        values.append([*_values(rig, row, station), cross_track])
    lateral = Signal("cross_track_true", "m", "lateral offset of R's origin from the path, + left")
    table = np.array(values).reshape(len(rows), len(signals) + 1)
    return Log((*signals, lateral, *_ESTIMATE, *_LAGGED), np.hstack([table, estimated]))


def _signals(rig: TraceRig) -> Iterator[Signal]:
    yield Signal("tick", "ms", "time in whole ticks")
    yield Signal("time", "s", "time")
    for name, unit, meaning in (
        ("x", "m", "position east"),
        ("y", "m", "position north"),
        ("psi", "rad", "yaw, continuous"),
        ("v_x", "m/s", "forward speed"),
        ("v_y", "m/s", "lateral speed, + left"),
        ("yaw_rate", "rad/s", "yaw rate"),
    ):
        yield Signal(name, unit, meaning)
    yield Signal("slip_angle_true", "rad", "direction of travel against the body's x axis, + left")
    yield Signal("wheel_slip_true", "rad", "direction of travel of the left rear wheel against its heading, + left")
    yield Signal("station", "m", "distance along the path")
    for wheel in (place.name for place in rig.wheels):
        yield Signal(f"slip_ratio_{wheel}", "-", "longitudinal slip")
        yield Signal(f"sinkage_{wheel}", "m", "sinkage")
        yield Signal(f"load_{wheel}", "N", "load normal to the ground")
        yield Signal(f"steer_{wheel}", "rad", "steer angle against the body, + left")
        yield Signal(f"steer_{wheel}_command", "rad", "its demand")
        yield Signal(f"wheel_speed_{wheel}", "rad/s", "speed of rotation")
        yield Signal(f"wheel_speed_{wheel}_command", "rad/s", "its demand")
    yield Signal("compass", "rad", "heading by the compass, wrapped")
    for name, meaning in (("wheels", "by encoders and compass"), ("corrected", "by encoders, compass and slip angle")):
        yield Signal(f"x_{name}", "m", f"position east, {meaning}")
        yield Signal(f"y_{name}", "m", f"position north, {meaning}")
    yield Signal("drift_navigated", "rad", "slip angle that the driver compensates, + left")
    yield Signal("slip_angle_laser", "rad", "slip angle by laser tracker and compass, some seconds old")


def _values(rig: TraceRig, row: RoverRow, station: float) -> Iterator[float]:
    truth, record, command = row.truth, row.record, row.record.command
    yield truth.tick
    yield truth.tick * TICK
    yield from truth.pose
    yield from truth.velocity
    yield truth.slip_angle
    yield truth.slip_angles[rig.watched]
    yield station
    for k in range(len(rig.wheels)):
        yield truth.slip_ratios[k]
        yield truth.sinkages[k]
        yield truth.loads[k]
        yield truth.steer[k]
        yield command.steer[k]
        yield truth.wheel_speeds[k]
        yield command.wheel_speed[k]
    yield record.readings.heading
    for pose in (record.wheels_only, record.corrected):
        yield pose.x
        yield pose.y
    yield record.navigated.drift
    yield np.nan if record.laser_slip is None else record.laser_slip


def _estimate_values(estimate: SlipAngle) -> Iterator[float]:
    lost = estimate.health is Health.LOST
    yield np.nan if lost else estimate.value
    yield np.nan if lost else estimate.std
    yield HEALTH[estimate.health]
    yield np.nan if lost else estimate.wheel_slip
    yield np.nan if lost else estimate.trace_offset
    yield estimate.confidence
