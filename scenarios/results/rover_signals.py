"""What a rover's run writes down, one row every 50 ms; estimates stand in the row of their capture."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Final

import numpy as np

from estimators.estimates import Health, SlipAngle
from scenarios.loop.rover_session import RoverRow
from scenarios.results.log import HEALTH, Log, Signal
from sensors.sand.trace_rig import TraceRig
from vehicle.clock import TICK

_ESTIMATE: Final = (
    Signal("slip_angle_estimate", "rad", "estimated slip angle of the body, + left, at the tick of capture"),
    Signal("slip_angle_std", "rad", "its standard deviation"),
    Signal("health", "-", "of the slip angle: 0 ok, 1 degraded, 2 lost"),
    Signal("wheel_slip_estimate", "rad", "estimated slip angle of the left rear wheel, + left"),
    Signal("trace_offset", "m", "of the trace beside the wheel's centre, + left"),
    Signal("trace_confidence", "-", "that the trace is the wheel's own"),
)
_LAGGED: Final = (
    Signal("slip_angle_lagged", "rad", "slip angle at this tick, estimated from what was seen later, too"),
    Signal("slip_angle_lagged_std", "rad", "its standard deviation"),
)


def rover_log(
    rig: TraceRig, rows: Sequence[RoverRow], cross_track: Sequence[float], estimates: Sequence[SlipAngle]
) -> Log:
    """The log of a run of the rover with this rig."""
    index = {row.truth.tick: k for k, row in enumerate(rows)}
    estimated = np.full((len(rows), len(_ESTIMATE) + len(_LAGGED)), np.nan)
    for estimate in estimates:
        if estimate.tick in index:
            estimated[index[estimate.tick], : len(_ESTIMATE)] = list(_estimate_values(estimate))
        if estimate.lagged_tick in index:
            estimated[index[estimate.lagged_tick], len(_ESTIMATE) :] = estimate.lagged_value, estimate.lagged_std
    signals = tuple(_signals(rig))
    values = np.array([list(_values(rig, row)) for row in rows]).reshape(len(rows), len(signals))
    aside = np.asarray(cross_track, dtype=np.float64)[:, None]
    told = (Signal("cross_track_true", "m", "of R's origin beside the path, + left"), *_ESTIMATE, *_LAGGED)
    return Log((*signals, *told), np.hstack([values, aside, estimated]))


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
    yield Signal("wheel_slip_true", "rad", "the same of the left rear wheel against its heading")
    yield Signal("station", "m", "along the path")
    for wheel in (place.name for place in rig.wheels):
        yield Signal(f"slip_ratio_{wheel}", "-", "longitudinal slip")
        yield Signal(f"sinkage_{wheel}", "m", "sinkage")
        yield Signal(f"load_{wheel}", "N", "load normal to the ground")
        yield Signal(f"steer_{wheel}", "rad", "angle against the body, + left")
        yield Signal(f"steer_{wheel}_command", "rad", "its demand")
        yield Signal(f"wheel_speed_{wheel}", "rad/s", "speed of rotation")
        yield Signal(f"wheel_speed_{wheel}_command", "rad/s", "its demand")
    yield Signal("compass", "rad", "heading by the compass, wrapped")
    for name, meaning in (("wheels", "by encoders and compass"), ("corrected", "the same with the slip angle")):
        yield Signal(f"x_{name}", "m", f"position east, {meaning}")
        yield Signal(f"y_{name}", "m", f"position north, {meaning}")
    yield Signal("drift_navigated", "rad", "slip that the driver reckons with, + left")
    yield Signal("slip_angle_laser", "rad", "slip angle by laser tracker and compass, of some seconds ago")


def _values(rig: TraceRig, row: RoverRow) -> Iterator[float]:
    truth, command = row.truth, row.command
    yield truth.tick
    yield truth.tick * TICK
    yield from truth.pose
    yield from truth.velocity
    yield truth.slip_angle
    yield truth.slip_angles[rig.watched]
    yield row.station
    for k in range(len(rig.wheels)):
        yield truth.slip_ratios[k]
        yield truth.sinkages[k]
        yield truth.loads[k]
        yield truth.steer[k]
        yield command.steer[k]
        yield truth.wheel_speeds[k]
        yield command.wheel_speed[k]
    yield row.readings.heading
    for pose in (row.wheels_only, row.corrected):
        yield pose.x
        yield pose.y
    yield row.navigated.drift
    yield np.nan if row.laser_slip is None else row.laser_slip


def _estimate_values(estimate: SlipAngle) -> Iterator[float]:
    lost = estimate.health is Health.LOST
    yield np.nan if lost else estimate.value
    yield np.nan if lost else estimate.std
    yield HEALTH[estimate.health]
    yield np.nan if lost else estimate.wheel_slip
    yield np.nan if lost else estimate.trace_offset
    yield estimate.confidence
