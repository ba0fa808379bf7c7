"""Signals of a trailer run, one row every 10 ms: motion, loads, steering, and off-tracking.

C. de Saxe, D. Cebon, "Estimation of trailer off-tracking using visual odometry", Vehicle System Dynamics, 2018.
"""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from itertools import pairwise

import numpy as np

from controllers.driver import DriverCommand
from controllers.trailer import SteerCommand
from estimators.calibration.corrections import SelfCalibratedMotion
from estimators.estimates import Health, Motion, OffTracking
from estimators.off_tracking import reference
from scenarios.results import metrics
from scenarios.results.log import HEALTH, MOTION, Column, Log, Row, Signal, columns_by_parts
from sensors.instruments.navigation import PERIOD, ReferenceUnit
from sensors.messages import BodyPose
from vehicle.clock import TICK
from vehicle.combination.description import Vehicle
from vehicle.combination.layout import wheels
from vehicle.combination.truth import Truth, plan_pose
from vehicle.frames import FloatArray, inverse, planar, rotation_zyx, transform


def motion_columns(signals: Mapping[str, FloatArray], vehicle: Vehicle) -> Iterator[Column]:
    """Articulations and accelerations from the time and the motions of all units; the rows are evenly spaced."""
    for k, (ahead, unit) in enumerate(pairwise(vehicle.units), start=1):
        meaning = f"yaw of {ahead.name} minus yaw of {unit.name}"
        yield Signal(f"articulation_{k}", "rad", meaning), signals[f"psi_{ahead.name}"] - signals[f"psi_{unit.name}"]
    for unit in vehicle.units:
        meaning = f"{unit.name}: of the centre of gravity along the ground, + left, without gravity"
        forward, left, yaw_rate = (signals[f"{quantity}_{unit.name}"] for quantity in ("v_x", "v_y", "yaw_rate"))
        values = _lateral_acceleration(signals["time"], forward, left, yaw_rate, unit.cg_x)
        yield Signal(f"lateral_acceleration_{unit.name}", "m/s2", meaning), values


def load_columns(truths: Sequence[Truth], vehicle: Vehicle) -> Iterator[Column]:
    """Load transfers and use of friction in some rows."""
    for k, unit in enumerate(vehicle.units):
        meaning = f"{unit.name}: right less left wheel loads over their sum; at 1 or -1 one side carries nothing"
        yield Signal(f"load_transfer_{unit.name}", "-", meaning), [truth.load_transfer[k] for truth in truths]
    yield from _friction_columns(truths, vehicle)


def _lateral_acceleration(
    times: FloatArray, forward: FloatArray, left: FloatArray, yaw_rate: FloatArray, x: float
) -> FloatArray:
    """Of a point (x, 0) of a unit whose origin has these velocities (n,), along the unit's y axis [m/s2]."""
    if len(times) < 2:
        return np.full(len(times), np.nan)
    acceleration: FloatArray = np.gradient(left + x * yaw_rate, times) + forward * yaw_rate
    return acceleration


def _friction_columns(truths: Sequence[Truth], vehicle: Vehicle) -> Iterator[Column]:
    """Share of the friction that each axle uses: of its wheels, in proportion to what they carry."""
    all_wheels = wheels(vehicle)
    loads, used = (
        np.array([getattr(truth, name) for truth in truths]).reshape(-1, len(all_wheels))
        for name in ("wheel_loads", "friction_used")
    )
    for i, unit in enumerate(vehicle.units):
        for k in range(len(unit.axles)):
            rows = [n for n, wheel in enumerate(all_wheels) if (wheel.unit, wheel.axle_in_unit) == (i, k)]
            carried = loads[:, rows].sum(axis=1)
            share = (loads[:, rows] * used[:, rows]).sum(axis=1) / np.maximum(carried, 1e-9)
            meaning = f"{unit.name}, axle {k + 1}: horizontal tyre forces over friction times vertical ones"
            yield Signal(f"friction_used_{unit.name}_{k + 1}", "-", meaning), share


_LATERAL, _FLOOR = 0.8, 1.2  # the unit stood off the middle of the trailer's floor; both distances are assumed [m]
_EVERY = 100  # every tenth message, at the rate of the cameras it is compared with [ticks]


class ReferenceOffTracking:
    """Off-tracking by the reference unit on a run whose truths are shown to it part by part, in order.

    It is a GNSS-aided inertial unit, as in the field tests of de Saxe 2018, section 4.1.
    """

    def __init__(self, *, unit: int, follow_distance: float, path_height: float, rng: np.random.Generator) -> None:
        """Paths are those of points at ``path_height`` [m] in the body of a unit of the vehicle."""
        p_SU = np.array([-0.5 * follow_distance, _LATERAL, _FLOOR])
        self._sensor = ReferenceUnit(unit=unit, p_BU=p_SU, rng=rng)
        self._X_US = inverse(transform(np.eye(3), p_SU))
        self._source = reference.ReferenceOffTracking(follow_distance, path_height=path_height)
        self._memory = self._source.init()

    def values(self, truths: Sequence[Truth]) -> FloatArray:
        """Off-tracking [m] at the next truths (n,), NaN where the unit has none.

        The truths come at the unit's 100 Hz; the buffer takes every tenth message.
        """
        values = np.full(len(truths), np.nan)
        for row, truth in enumerate(truths):
            if truth.tick % PERIOD:
                continue
            if truth.tick % _EVERY:
                self._sensor.errors_at(truth.tick)
            else:
                message = self._sensor.sample(truth)
                X_WU = transform(rotation_zyx(message.heading, message.pitch, message.roll), message.p_WU)
                pose = BodyPose(tick=message.tick, X_WB=X_WU @ self._X_US)
                self._memory, estimate = self._source.step(self._memory, pose)
                if estimate is not None and estimate.health is not Health.LOST:
                    values[row] = estimate.value
        return values


_ESTIMATE = (
    Signal("off_tracking_estimate", "m", "estimated off-tracking, at the tick of capture"),
    Signal("off_tracking_std", "m", "its standard deviation"),
    Signal("health", "-", "health of the off-tracking: 0 ok, 1 degraded, 2 lost"),
    Signal("matches", "-", "features matched through all four images"),
    Signal("inliers", "-", "matches that agree with the motion"),
    Signal("odometry_health", "-", "health of the motion since the capture before: 0 ok, 1 degraded, 2 lost"),
    Signal("odometry_dx", "m", "estimated motion of the trailer since the capture before, along its x there"),
    Signal("odometry_dy", "m", "estimated motion along its y"),
    Signal("odometry_dpsi", "rad", "estimated change of its yaw"),
)
_OF_MOTION = 3  # first signal of the motion
_BRIDGED = Signal("bridged", "s", "time that the off-tracking is bridged by dead reckoning, without a camera motion")
_POSE = (  # of the hitch of a trailer, at the height of its path; not in the log
    Signal("hitch_x", "m", "position along the first heading"),
    Signal("hitch_y", "m", "position to the left of it"),
    Signal("hitch_psi", "rad", "heading"),
)
_REFERENCE = Signal("off_tracking_reference", "m", "off-tracking by a GNSS-aided inertial unit")
_ROTATIONS = ("roll about its optical axis", "yaw about its y (down)", "pitch about its x")


@dataclass(frozen=True, slots=True)
class Estimate:
    """An off-tracking estimate and, if cameras are used, the newest motion in it."""

    off_tracking: OffTracking
    motion: Motion | None = None


@dataclass(frozen=True, slots=True)
class CombinationRecord:
    """Commands of one step."""

    driver: DriverCommand
    steering: tuple[SteerCommand, ...]  # of every judged trailer, front to rear


TrailerRow = Row[Truth, CombinationRecord]


@dataclass(frozen=True, slots=True, kw_only=True)
class TrailerTrack:
    """A trailer whose off-tracking is judged, with its estimates in a run."""

    name: str
    unit: int  # the tractor is 0
    follow_distance: float  # hitch to follow point [m]
    path_height: float  # of the points that off-tracking is about, in its body [m]
    steers_ahead: int  # number of steered axles ahead of its own
    n_steered: int
    estimates: Iterable[Estimate]  # delivered ones, in order; captures coincide with rows
    X_SC: FloatArray | None  # pose of its left camera in its body (4, 4); None without cameras
    reference: ReferenceOffTracking | None = None  # a reference unit on it that has seen nothing yet
    fallback: FloatArray | None = None  # 1 in rows in which the fallback steers, 0 in others; None: not asked for
    distrusted: FloatArray | None = None  # number of signals at fault, as the guard holds, in each row; None: likewise
    axles_at_fault: FloatArray | None = None  # number of axles that do not follow their demands; None: likewise


def run_log(rows: Sequence[TrailerRow], trailers: Sequence[TrailerTrack], vehicle: Vehicle) -> Log:
    """The log of a run with the true off-tracking; each estimate is in the row of its capture.

    Every signal of a trailer ends with its name. The last trailer's signals appear a second time without it. The rows
    are read once, in order; few of them are in memory at a time.

    Args:
        rows: one every log period, in order.
        trailers: trailers that are judged, front to rear; the last is the last unit.
        vehicle: the vehicle.
    """
    return Log.of(_columns(rows, trailers, vehicle))


def _columns(rows: Sequence[TrailerRow], trailers: Sequence[TrailerTrack], vehicle: Vehicle) -> Iterator[Column]:
    common, loads, *of_trailers = columns_by_parts(
        rows,
        partial(_common_columns, vehicle=vehicle),
        lambda part: load_columns([row.truth for row in part], vehicle),
        *(partial(_trailer_columns, place, trailer) for place, trailer in enumerate(trailers)),
    )
    yield from common
    signals = {signal.name: values for signal, values in common}
    index = {tick: row for row, tick in enumerate(signals["tick"].tolist())}
    for trailer, by_rows in zip(trailers, of_trailers, strict=True):
        columns = list(_all_trailer_columns(trailer, by_rows, index))
        yield from ((_of(trailer.name, signal), values) for signal, values in columns)
        if trailer is trailers[-1]:
            yield from columns
    yield from motion_columns(signals, vehicle)
    yield from loads


def _of(trailer: str, signal: Signal) -> Signal:
    return Signal(f"{signal.name}_{trailer}", signal.unit, f"{trailer}: {signal.description}")


def unit_columns(truths: Sequence[Truth], unit: int, name: str) -> Iterator[Column]:
    """Pose, velocity, roll and pitch of a unit over time."""
    motion = np.array([(*truth.poses[unit], *truth.velocities[unit]) for truth in truths]).reshape(-1, len(MOTION))
    for (quantity, dimension, meaning), values in zip(MOTION, motion.T, strict=True):
        yield Signal(f"{quantity}_{name}", dimension, f"{name}: {meaning}"), values
    axes = np.array([truth.bodies[unit, 2, :3] for truth in truths]).reshape(-1, 3)  # of the body along W's z
    yield Signal(f"roll_{name}", "rad", f"{name}: roll of the body in W"), np.arctan2(axes[:, 1], axes[:, 2])
    yield Signal(f"pitch_{name}", "rad", f"{name}: pitch of the body in W"), -np.arcsin(axes[:, 0])


def tyre_columns(truths: Sequence[Truth]) -> Iterator[Column]:
    """Largest use of friction and smallest load of all wheels over time."""
    used = Signal("friction_used_max", "-", "largest share of the available friction that any tyre uses")
    yield used, [truth.friction_used.max() for truth in truths]
    yield Signal("wheel_load_min", "N", "smallest vertical load of any wheel"), [t.wheel_loads.min() for t in truths]


def _common_columns(rows: Sequence[TrailerRow], vehicle: Vehicle) -> Iterator[Column]:
    truths, drivers = [row.truth for row in rows], [row.record.driver for row in rows]
    yield Signal("tick", "ms", "time in whole ticks"), [truth.tick for truth in truths]
    yield Signal("time", "s", "time"), [truth.tick * TICK for truth in truths]
    for k, unit in enumerate(vehicle.units):
        yield from unit_columns(truths, k, unit.name)
    for k in range(vehicle.units[0].n_by_driver):
        ending, axle = (f"_{k + 1}", f"steered axle {k + 1}") if k else ("", "the foremost axle")
        steer = Signal(f"steer_tractor{ending}", "rad", f"tractor: road-wheel angle of {axle}, + left")
        yield steer, [truth.steer[k] for truth in truths]
    demand = Signal("steer_tractor_command", "rad", "the driver's demand for the foremost axle")
    yield demand, [driver.steer for driver in drivers]
    meaning = "the driver's demand: above 0 drives in the direction of the gear, below 0 brakes"
    yield Signal("acceleration_command", "m/s2", meaning), [driver.acceleration for driver in drivers]
    yield Signal("gear", "-", "+1 forward, -1 backward"), [driver.gear for driver in drivers]
    yield from tyre_columns(truths)


def _trailer_columns(place: int, trailer: TrailerTrack, rows: Sequence[TrailerRow]) -> Iterator[Column]:
    """Columns of a trailer in some rows: of steering, of the reference unit, and where it is."""
    truths = [row.truth for row in rows]
    bodies = np.array([truth.bodies[trailer.unit] for truth in truths]).reshape(-1, 4, 4)
    yield from zip(_POSE, plan_pose(bodies, trailer.path_height).T, strict=True)
    if trailer.reference is not None:
        yield _REFERENCE, trailer.reference.values(truths)
    for k in range(trailer.n_steered):
        angles = np.array([row.truth.steer[trailer.steers_ahead + k] for row in rows])
        demands = np.array([row.record.steering[place].angles[k] for row in rows])
        name = f"steer_trailer_{k + 1}"
        yield Signal(name, "rad", f"road-wheel angle of steered axle {k + 1}, + left"), angles
        yield Signal(f"{name}_command", "rad", "the controller's demand for that angle"), demands


def _all_trailer_columns(
    trailer: TrailerTrack, by_rows: Sequence[tuple[Signal, FloatArray]], index: Mapping[float, int]
) -> Iterator[Column]:
    """Columns of a trailer over the whole run, from those of its rows and its estimates."""
    pose = [values for _, values in by_rows[: len(_POSE)]]
    reference = [column for column in by_rows if column[0] is _REFERENCE]
    yield from by_rows[len(_POSE) + len(reference) :]
    if trailer.fallback is not None:
        yield Signal("fallback", "-", "1 while the fallback steers in place of the law, else 0"), trailer.fallback
    if trailer.distrusted is not None:
        meaning = "number of signals of the combination that the guard holds to be at fault"
        yield Signal("distrusted", "-", meaning), trailer.distrusted
    if trailer.axles_at_fault is not None:
        meaning = "number of axles that do not follow their demands, as the supervision of the actuators holds"
        yield Signal("axles_at_fault", "-", meaning), trailer.axles_at_fault
    yield from _estimate_columns(index, trailer)
    x, y, psi = pose
    true = metrics.true_off_tracking(x, y, np.unwrap(psi), trailer.follow_distance)
    yield Signal("off_tracking_true", "m", "lateral distance from the follow point to the hitch's path, + left"), true
    yield from reference


def _estimate_columns(index: Mapping[float, int], trailer: TrailerTrack) -> Iterator[Column]:
    table, bridged = np.full((len(index), len(_ESTIMATE)), np.nan), np.full(len(index), np.nan)
    rotations, delays, calibrated = np.full((len(index), 6), np.nan), np.full((len(index), 2), np.nan), False
    for estimate in trailer.estimates:
        off_tracking, motion = estimate.off_tracking, estimate.motion
        if off_tracking.tick in index:
            row = index[off_tracking.tick]
            table[row, :_OF_MOTION], bridged[row] = _off_tracking_values(off_tracking), off_tracking.bridged
        if motion is not None and trailer.X_SC is not None and motion.tick in index:
            table[index[motion.tick], _OF_MOTION:] = _motion_values(motion, trailer.X_SC)
        if isinstance(motion, SelfCalibratedMotion) and motion.tick in index:
            rotations[index[motion.tick]], calibrated = (*motion.right_rotation, *motion.right_rotation_std), True
            delays[index[motion.tick]] = motion.right_delay, motion.right_delay_std
    yield from zip(_ESTIMATE, table.T, strict=True)
    yield _BRIDGED, bridged
    for k, meaning in enumerate(_ROTATIONS) if calibrated else ():
        name = f"right_camera_{meaning.split()[0]}"
        yield Signal(name, "rad", f"right camera, since its calibration: {meaning}"), rotations[:, k]
        yield Signal(f"{name}_std", "rad", "its standard deviation"), rotations[:, 3 + k]
    if calibrated:
        yield Signal("right_camera_delay", "s", "right camera: exposure after the left one"), delays[:, 0]
        yield Signal("right_camera_delay_std", "s", "its standard deviation"), delays[:, 1]


def _off_tracking_values(e: OffTracking) -> tuple[float, ...]:
    value, std = (e.value, e.std) if e.health is not Health.LOST else (np.nan, np.nan)
    return (value, std, HEALTH[e.health])


def _motion_values(motion: Motion, X_SC: FloatArray) -> tuple[float, ...]:
    moved = planar(X_SC @ motion.X_PC @ inverse(X_SC))
    return (motion.matches, motion.inliers, HEALTH[motion.health], *moved)
