"""What a run writes down: its signals, and one row of them every 10 ms."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from controllers.driver import DriverCommand
from controllers.trailer import SteerCommand
from estimators.calibration.self_calibration import SelfCalibratedMotion
from estimators.estimates import Health, Motion, OffTracking
from scenarios.results import metrics
from scenarios.results.log import HEALTH, Log, Signal
from vehicle.clock import TICK
from vehicle.combination.truth import Truth
from vehicle.frames import FloatArray, inverse, planar

_POSE = (("x", "m", "position east"), ("y", "m", "position north"), ("psi", "rad", "yaw, continuous"))
_VELOCITY = (
    ("v_x", "m/s", "forward speed"),
    ("v_y", "m/s", "lateral speed, + left"),
    ("yaw_rate", "rad/s", "yaw rate"),
)
_ATTITUDE = (("roll", "rad", "roll of the body in W"), ("pitch", "rad", "pitch of the body in W"))
_ESTIMATE = (
    Signal("off_tracking_estimate", "m", "estimated off-tracking, at the tick of capture"),
    Signal("off_tracking_std", "m", "its standard deviation"),
    Signal("health", "-", "of the off-tracking: 0 ok, 1 degraded, 2 lost"),
    Signal("matches", "-", "features matched through all four images"),
    Signal("inliers", "-", "of them those the motion agrees with"),
    Signal("odometry_health", "-", "of the motion since the capture before: 0 ok, 1 degraded, 2 lost"),
    Signal("odometry_dx", "m", "estimated motion of the trailer since the capture before, along its x there"),
    Signal("odometry_dy", "m", "the same along its y"),
    Signal("odometry_dpsi", "rad", "estimated change of its yaw"),
)
_TURNED = ("roll about its optical axis", "yaw about its y (down)", "pitch about its x")


@dataclass(frozen=True, slots=True)
class Row:
    """What was so and what was demanded at one tick."""

    truth: Truth
    driver: DriverCommand
    steering: tuple[SteerCommand, ...]  # of every watched trailer, front to rear


@dataclass(frozen=True, slots=True)
class Estimate:
    """An off-tracking estimate and, if cameras are behind it, the newest motion it rests on."""

    off_tracking: OffTracking
    motion: Motion | None = None


def run_log(
    rows: Sequence[Row],
    estimates: Sequence[Estimate],
    *,
    units: Sequence[str],
    trailer_unit: int,
    follow_distance: float,
    steers_ahead: int,
    X_SC: FloatArray | None,
) -> Log:
    """The log of a run; estimates stand in the row of their capture, the true off-tracking is computed here.

    Args:
        rows: one every log period, in order.
        estimates: those delivered, in order; captures fall on rows.
        units: names of the units, tractor first.
        trailer_unit: which of them is the last trailer that is watched.
        follow_distance: hitch to follow point of that trailer [m].
        steers_ahead: number of steered axles in front of the watched trailer's.
        X_SC: pose of the left camera in the trailer body (4, 4), if there are cameras.
    """
    n_steered = len(rows[0].steering[-1].angles) if rows else 0
    signals = tuple(_signals(units, n_steered))
    table = np.full((len(rows), len(signals)), np.nan)
    for line, row in zip(table, rows, strict=True):
        line[: -len(_ESTIMATE)] = list(_values(row, steers_ahead))
    index = {row.truth.tick: k for k, row in enumerate(rows)}
    for estimate in estimates:
        if estimate.off_tracking.tick in index:
            table[index[estimate.off_tracking.tick], -len(_ESTIMATE) :] = _estimate_values(estimate, X_SC)
    log = _with_rotation(Log(signals, table), index, estimates)
    return _with_truth(log, units[trailer_unit], follow_distance, "off_tracking_true")


def with_trailer_ahead(
    log: Log,
    rows: Sequence[Row],
    estimates: Sequence[Estimate],
    *,
    place: int,
    unit: str,
    follow_distance: float,
    steers_ahead: int,
) -> Log:
    """The log with what there is to know of a watched trailer in front of the last; its name ends every signal's.

    Args:
        log: of the same rows.
        rows: one every log period, in order.
        estimates: those delivered of this trailer's off-tracking, in order.
        place: the trailer's among the watched ones.
        unit: its name.
        follow_distance: its hitch to its follow point [m].
        steers_ahead: number of steered axles in front of its own.
    """
    for k in range(len(rows[0].steering[place].angles) if rows else 0):
        angles = np.array([row.truth.steer[steers_ahead + k] for row in rows])
        asked = np.array([row.steering[place].angles[k] for row in rows])
        name = f"steer_trailer_{k + 1}"
        log = log.with_signal(Signal(f"{name}_{unit}", "rad", f"{unit}: angle of steered axle {k + 1}, + left"), angles)
        log = log.with_signal(Signal(f"{name}_command_{unit}", "rad", "the controller's demand for it"), asked)
    told = np.full((len(rows), 3), np.nan)
    index = {row.truth.tick: k for k, row in enumerate(rows)}
    for estimate in estimates:
        if estimate.off_tracking.tick in index:
            told[index[estimate.off_tracking.tick]] = _estimate_values(estimate, None)[:3]
    for column, signal in zip(told.T, _ESTIMATE, strict=False):
        log = log.with_signal(Signal(f"{signal.name}_{unit}", signal.unit, f"{unit}: {signal.description}"), column)
    return _with_truth(log, unit, follow_distance, f"off_tracking_true_{unit}")


def _with_truth(log: Log, unit: str, follow_distance: float, name: str) -> Log:
    true = metrics.true_off_tracking(log[f"x_{unit}"], log[f"y_{unit}"], np.unwrap(log[f"psi_{unit}"]), follow_distance)
    return log.with_signal(Signal(name, "m", "lateral distance of the hitch's path, + left"), true)


def _with_rotation(log: Log, index: dict[int, int], estimates: Sequence[Estimate]) -> Log:
    """The log with how the right camera was believed to be turned, if the rig calibrates itself."""
    table, watched = np.full((len(index), 6), np.nan), False
    for estimate in estimates:
        motion = estimate.motion
        if isinstance(motion, SelfCalibratedMotion) and motion.tick in index:
            table[index[motion.tick]], watched = (*motion.right_rotation, *motion.right_rotation_std), True
    if not watched:
        return log
    for k, meaning in enumerate(_TURNED):
        name = f"right_camera_{meaning.split()[0]}"
        log = log.with_signal(Signal(name, "rad", f"right camera, since its calibration: {meaning}"), table[:, k])
        log = log.with_signal(Signal(f"{name}_std", "rad", "its standard deviation"), table[:, 3 + k])
    return log


def _signals(units: Sequence[str], n_steered: int) -> Iterator[Signal]:
    yield Signal("tick", "ms", "time in whole ticks")
    yield Signal("time", "s", "time")
    for unit in units:
        for name, dimension, meaning in (*_POSE, *_VELOCITY, *_ATTITUDE):
            yield Signal(f"{name}_{unit}", dimension, f"{unit}: {meaning}")
    yield Signal("steer_tractor", "rad", "tractor: road-wheel angle, + left")
    yield Signal("steer_tractor_command", "rad", "the driver's demand for it")
    for k in range(1, n_steered + 1):
        yield Signal(f"steer_trailer_{k}", "rad", f"trailer: road-wheel angle of steered axle {k}, + left")
    for k in range(1, n_steered + 1):
        yield Signal(f"steer_trailer_{k}_command", "rad", "the controller's demand for it")
    yield Signal("acceleration_command", "m/s2", "the driver's demand: drive the way of the gear, below 0 brakes")
    yield Signal("gear", "-", "+1 forward, -1 backward")
    yield Signal("friction_used_max", "-", "largest share of the available friction that any tyre uses")
    yield Signal("wheel_load_min", "N", "smallest vertical load of any wheel")
    yield from _ESTIMATE


def _values(row: Row, steers_ahead: int) -> Iterator[float]:
    truth = row.truth
    yield truth.tick
    yield truth.tick * TICK
    for pose, velocity, X_WB in zip(truth.poses, truth.velocities, truth.bodies, strict=True):
        yield from pose
        yield from velocity
        yield float(np.arctan2(X_WB[2, 1], X_WB[2, 2]))
        yield float(-np.arcsin(X_WB[2, 0]))
    yield truth.steer[0]
    yield row.driver.steer
    yield from truth.steer[steers_ahead : steers_ahead + len(row.steering[-1].angles)]
    yield from row.steering[-1].angles
    yield row.driver.acceleration
    yield row.driver.gear
    yield float(truth.friction_used.max())
    yield float(truth.wheel_loads.min())


def _estimate_values(estimate: Estimate, X_SC: FloatArray | None) -> tuple[float, ...]:
    e, motion = estimate.off_tracking, estimate.motion
    value = e.value if e.health is not Health.LOST else np.nan
    std = e.std if e.health is not Health.LOST else np.nan
    if motion is None or X_SC is None:
        return (value, std, HEALTH[e.health], *[np.nan] * (len(_ESTIMATE) - 3))
    moved = planar(X_SC @ motion.X_PC @ inverse(X_SC))
    return (value, std, HEALTH[e.health], motion.matches, motion.inliers, HEALTH[motion.health], *moved)
