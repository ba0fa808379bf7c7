"""Dead reckoning of a trailer from wheel speed, articulation and gyros, with learnt errors and honest uncertainty.

As in ``estimators.off_tracking.kinematic``, the velocity of the tractor's rear axle is carried to its hitch by the
tractor's yaw rate, turned by the articulation into the next unit, and so on to the trailer's own hitch; its own gyro
measures its yaw rate. Unlike there, the tractor's rear axle slips and the sensors have errors. These are parameters,
which a Kalman filter learns from the camera (``estimators.off_tracking.signal_fusion``):

- the scale of the wheel speed, and the slip of braked wheels per deceleration. Steered front wheels roll along their
  planes whatever their tyres do, so the speed follows from their angle and the tractor's yaw rate, also on ice;
- the slip angle of the tractor's rear axle: a slowly varying part, a constant part, which includes the bias of the
  articulation, and parts in proportion to a, to what the scrub of tyres causes by the data sheet
  (``estimators.off_tracking.tyre_scrub``), and to the articulation; gravity along the axles of a banked road counts as
  acceleration, as the trailer's accelerometer feels it;
- the slip angle of the trailer's own axles, which tell the direction of travel at its hitch once more;
- the bias of every gyro.

Slips that vary change by as much as they are large: tyres that slide do not stop at once. Without a camera the two
directions of travel, by the tractor and by the trailer's own axles, are weighted by their variances. Where they
contradict each other tyres slide: mostly the lightly loaded ones of the tractor, and the trailer's by a part of it.

The pose after a stretch of signals is a sum over the samples. So are its derivatives by the parameters, and its
covariance from their uncertainty, their random walk and the white noise of every sample. Errors within a stretch that
come from one wrong parameter are therefore fully correlated, as they are in truth.
"""

import math
from typing import NamedTuple

import numpy as np

from estimators.off_tracking.parity import (
    ARTICULATION_NOISE,
    GYRO_BIAS,
    GYRO_NOISE,
    SPEED_NOISE,
    acceleration,
    integral,
    noise_level,
    turned_otherwise,
)
from estimators.off_tracking.tyre_scrub import TyreScrub
from sensors.messages import CombinationSignals
from vehicle.clock import TICK
from vehicle.combination.description import Vehicle
from vehicle.frames import FloatArray

_MARGIN = 400  # signals before and after a stretch that count [ticks]
_LONGEST_GAP = 300  # longest time without signals that is bridged by interpolation [ticks]
_LONGEST_AGE = 50  # signals at an end of a stretch may be that much older or newer [ticks]
_AT_REST, _LOOK = 0.03, 100  # speed of a vehicle at rest: 3 sigma of noise [m/s], and the time of its mean [ticks]
_MEAN_OF = 5  # samples
_BANK = -1  # column of the bank's pull
_LATELY = 25  # samples of the last half second
_SWAY = 2000  # time that it is averaged over: bodies sway, and trailers drift to the side as they turn in [ticks]
# Speed at which that drift (slip changes by 0.03 rad in the time) is as large as the usual bank of 2.5 %. There half of
# the mean is believed: least squares of a bank and its error [m/s].
_FAST = 12.0
# A vehicle that seems to stand may creep, and rocks on its tyres: white noise of every sample, 1 sigma. Of a start or a
# stop, 3 mm are missed within a tenth of a second; a standstill of ten seconds adds 30 mm.
_CREEP = np.array([0.001, 0.06, 0.02])  # yaw [rad/s], x and y [m/s]
# As it pulls away, driven wheels that spin are pushed to the side: by some 20 mm on ice.
_PULLING, _PULLED = 0.8, np.array([0.0, 0.0, 0.1])  # speed below which it counts, and white noise [rad/s], [m/s]
# A vehicle that turns about a nearer point than steering allows slides, and its wheels do not show the speed: that
# radius [m], and white noise of every sample; it adds up to 0.2 m within a tenth of a second [rad/s], [m/s].
_TIGHTEST, _SLIPPED = 2.0, np.array([0.0, 5.0, 5.0])


class Prior(NamedTuple):
    """Prior of a parameter that is learnt: a first-order Gauss-Markov process."""

    mean: float
    std: float
    distance: float  # over which it is forgotten [m]
    time: float  # likewise [s]


_MOST_FORGOTTEN = 300.0  # beyond it nothing is left, and exp(-x) must not vanish [-]
_LARGEST_ERROR = 3.0  # of a sensor that the camera may ask for; the rest is slip, or the camera is wrong [its std]
_FOR_EVER = 1e6  # constant during a drive [m], [s]
_ROLLING = 0.3  # slower than this, directions of travel are noise [m/s]
# The spread of the slips, of their parts and of the scale is that over four combinations (two of them with two trailers
# or steered trailer axles) on friction of 0.3 to 0.8, at 5 to 88 km/h; no combination needed more than three of it.
_SCALE = Prior(0.0, 0.006, 60.0, _FOR_EVER)  # rolling radius known to 2.5 mm of 0.5 m, and what the next one leaves [-]
_SLIDING = 1.3  # deceleration that slows a wheel as rolling resistance does at a slip angle of 1 rad [m/s2]
# Slip of braked wheels per deceleration: 0.008 on dry road, some 0.1 where the ABS acts on ice [s2/m].
_SLIP_PER_BRAKING = Prior(0.01, 0.03, 30.0, _FOR_EVER)
# What data sheets leave of the slip. With 4 mrad and 8 m, outages of 20 s have sigmas nearer to their errors. But in
# the closed loop the estimate is then 15 mm off after 2 s without images, not 9 mm, and states 6 mm.
SLIP_DISTANCE = 12.0  # over which the slip that varies is alike [m]
_SLIP = Prior(0.0, 0.005, SLIP_DISTANCE, _FOR_EVER)  # [rad]
_SLIP_PER_ACCELERATION = Prior(-0.02, 0.004, _FOR_EVER, _FOR_EVER)  # its mean is that of the data sheet [rad s2/m]
_SLIP_PER_SCRUB = Prior(0.9, 0.15, _FOR_EVER, _FOR_EVER)  # 1 if tyres are linear, 0.7 on friction of 0.3 [-]
_SLIP_PER_ARTICULATION = Prior(0.0, 0.005, _FOR_EVER, _FOR_EVER)
_SLIP_OFFSET = Prior(0.0, 0.002, _FOR_EVER, _FOR_EVER)  # an angle sensor is right to 0.1 deg [rad]
# Slip of the trailer's axles beyond that of the data sheet, and its spread per lateral acceleration.
_OWN_SLIP = Prior(0.0, 0.02, 6.0, _FOR_EVER)  # [rad]
_OWN_SPREAD = 0.02  # [rad s2/m]
# Spread of slips to the side per acceleration along: drive and brakes use the grip that holds an axle [rad s2/m].
_TORQUE_SPREAD = 0.015
_UNUSUAL = 2.0  # contradiction of the two directions from which on the tractor slides [sigma of the trailer's slip]
_SHOWN = 1.25  # slip of the tractor's rear axle over what the steer angle shows of it, at most
_OWN_SHARE = 0.25  # of a slip that shows in the contradiction of the two directions, the part that is the trailer's
# Direction of travel by which the camera may differ from the axles of both units alike [rad], for each m/s2, and for
# each rad of slip by scrub beyond 9 mrad. That of a steered axle at its limit is several times as large on ice.
_TURNED, _SCRUBS = (0.03, 0.05, 6.0), 0.009
_LETS_GO, _SLIDES = 0.8, 0.12  # acceleration and slip from which on tyres slide by any angle, on ice [m/s2], [rad]
_COASTING = 0.2  # acceleration along up to which driven and braked wheels roll freely, on ice [m/s2]
_GYRO_BIAS = Prior(0.0, GYRO_BIAS, _FOR_EVER, 3600.0)  # wanders by 15 deg/h within a minute [rad/s]

_SCALE_OF, _BRAKING, _VARYING, _CONSTANT, OWN, _GYROS = 0, 1, 2, 6, 7, 8  # places among the parameters


class Parameters(NamedTuple):
    """Parameters with their covariance."""

    mean: FloatArray  # (p,)
    covariance: FloatArray  # (p, p)


class Reckoned(NamedTuple):
    """Pose of the trailer at the end of a stretch in its frame at the beginning, by dead reckoning."""

    pose: FloatArray  # (3,) yaw [rad], x and y [m]
    covariance: FloatArray  # (3, 3)
    parameters: Parameters  # at the end
    cross: FloatArray  # (p, 3) covariance of these with the pose
    distance: float  # [m]
    by_slip: FloatArray  # (3, 2) derivatives by slips that last: of the tractor's rear axle, and of braked wheels
    by_signals: FloatArray  # (3, k) the same by errors of speed, articulations and yaw rates
    own_slip: float  # of the trailer's axles if the pose is right, mean [rad]; NaN at walking pace
    level: float  # noise of the signals over the assumed one


class _Rates(NamedTuple):
    """Motion at n samples of signals."""

    rates: FloatArray  # (n, 3) yaw rate and velocity of the hitch, in the trailer
    derivatives: FloatArray  # (n, 3, p + signals)
    spread: FloatArray  # (n, p) of the parameters in the long run
    unknown: FloatArray  # (n, 3) white noise of the rates of a vehicle that stands, pulls away or slides, 1 sigma
    own_slip: float  # as in ``Reckoned``


class DeadReckoning:
    """Dead reckoning of one trailer."""

    def __init__(self, vehicle: Vehicle, unit: int) -> None:
        """For the ``unit`` of a vehicle.

        Raises:
            ValueError: if the unit is not towed.
        """
        vehicle.check_towed(unit)
        self._unit, self._scrub = unit, TyreScrub(vehicle, unit)
        self._levers = vehicle.hitch_levers(unit)
        self._front = vehicle.units[0].steered_axles[0].x
        self._axle_distance, self._own_push = self._scrub.axle_distance, self._scrub.trailer_per_acceleration()
        slips = [_SLIP, _SLIP_PER_ACCELERATION, _SLIP_PER_SCRUB, _SLIP_PER_ARTICULATION, _SLIP_OFFSET, _OWN_SLIP]
        slips[1] = slips[1]._replace(mean=self._scrub.per_acceleration())
        gyros = unit + 1
        priors = [_SCALE, _SLIP_PER_BRAKING, *slips, *[_GYRO_BIAS] * gyros]
        self._noise = np.array([SPEED_NOISE, *[ARTICULATION_NOISE] * unit, *[GYRO_NOISE] * gyros, *[1.0] * 3])
        self._mean, self._std, distances, times = np.array(priors).T
        self._per_metre, self._per_second = 1.0 / distances, 1.0 / times
        of_sensors = np.isin(np.arange(len(priors)), [_SCALE_OF, *range(_GYROS, len(priors))])
        self._largest = np.where(of_sensors, _LARGEST_ERROR * self._std, np.inf)

    def prior(self) -> Parameters:
        """Parameters before anything is learnt."""
        return Parameters(self._mean, np.diag(self._std**2))

    def possible(self, parameters: Parameters, level: float) -> Parameters:
        """Parameters with errors of sensors that are not larger than they may be; slips have no limit.

        Sensors that are noisier than assumed, by their ``level``, are expected to have larger constant errors as well.
        """
        most = level * self._largest
        return parameters._replace(mean=np.clip(parameters.mean, self._mean - most, self._mean + most))

    def contradictions(self, parameters: Parameters, history: FloatArray) -> tuple[float, float, float]:
        """Angle [rad] between the camera and the axles of both units, its limit [rad], and the error of distances [-].

        The limit is what slip of the tyres explains; it is infinite where they slide. The camera's distances are
        compared with those of wheels that roll freely; the error is 0 if it is not larger than that of a sound wheel.
        """
        tractor, own = float(parameters.mean[_VARYING] + parameters.mean[_CONSTANT]), float(parameters.mean[OWN])
        alike = math.copysign(max(0.0, min(abs(tractor), abs(own)) - abs(tractor - own)), own)
        recent, slides = history[-_LATELY:], max(abs(tractor), abs(own)) > _SLIDES
        if len(recent) < _LATELY or slides:
            return alike, math.inf, 0.0
        along, scale = acceleration(recent), abs(float(parameters.mean[_SCALE_OF]))
        stretched = scale if abs(along) < _COASTING and scale >= self._largest[_SCALE_OF] else 0.0
        aside = float(np.mean(recent[:, 1] * recent[:, 4 + 2 * self._unit] + recent[:, _BANK]))
        push, scrub = math.hypot(aside, along), abs(float(np.mean(recent[:, 3])))  # drive and brakes use the same grip
        usual = _TURNED[0] + _TURNED[1] * push + _TURNED[2] * max(0.0, scrub - _SCRUBS)
        return alike, math.inf if push > _LETS_GO else usual, stretched

    def forgotten(self, parameters: Parameters, distance: float, time: float) -> Parameters:
        """Parameters after ``distance`` [m] and ``time`` [s], drawn back to their prior."""
        kept = np.exp(-distance * self._per_metre - time * self._per_second)
        mean = self._mean + kept * (parameters.mean - self._mean)
        spread = self._spread(parameters)
        covariance = np.outer(kept, kept) * parameters.covariance + np.diag((1.0 - kept**2) * spread**2)
        return Parameters(mean, covariance)

    def with_own_slip(self, parameters: Parameters, slip: float, std: float) -> Parameters:
        """Parameters with a measured slip [rad] of the trailer's axles."""
        if not math.isfinite(slip + std):
            return parameters
        across = parameters.covariance[:, OWN]
        gain = across / (across[OWN] + std**2)
        mean = parameters.mean + gain * (slip - parameters.mean[OWN])
        return Parameters(mean, parameters.covariance - np.outer(gain, across))

    def reckoned(
        self, history: FloatArray, since: int, until: int, parameters: Parameters, *, by_trailer: bool = False
    ) -> Reckoned | None:
        """Motion from the tick ``since`` to the tick ``until``; None if signals are missing for too long.

        ``history`` (n, columns) holds the `row` of every message, oldest first. Directions of travel are those by the
        tractor's axles, and ``by_trailer`` by those of the trailer, too.
        """
        begin, longer, end = np.searchsorted(history[:, 0], [since - _MARGIN, since - _SWAY, until + _MARGIN]).tolist()
        ticks, table = history[begin:end, 0], history[begin:end, 1:]
        bank = _mean_before(history[longer:end, 0], history[longer:end, _BANK], _SWAY)[begin - longer :]
        nodes = np.concatenate([[since], ticks[(ticks > since) & (ticks < until)], [until]])
        if not _are_covered(nodes, ticks):
            return None
        level, speed_and_gyros = noise_level(history, self._unit), [0, *range(3 + self._unit, 4 + 2 * self._unit)]
        speed, *turning = np.abs(_mean_before(ticks, table[:, speed_and_gyros], _LOOK)).T
        slides = _TIGHTEST * np.max(turning, axis=0) > speed + level * _AT_REST
        at_rest = (speed < _AT_REST) & ~slides
        bank /= 1.0 + np.square(table[:, 0] / _FAST)
        before = np.interp(ticks - _MARGIN, ticks, table[:, 0])
        gained = (np.abs(table[:, 0]) - np.abs(before)) / (_MARGIN * TICK)  # below 0 if the wheels slow down [m/s2]
        table = np.column_stack([table[:, :_BANK], bank, gained, slides, at_rest])
        columns = np.array([np.interp(nodes, ticks, column) for column in table.T])
        kept = self._kept(nodes * TICK, columns[0] * (columns[-1] < 0.5))
        return self._summed(nodes * TICK, self._rates(columns, kept, parameters, by_trailer), level, kept, parameters)

    def contradicted(self, known: Reckoned, history: FloatArray, since: int, start: Parameters) -> Reckoned:
        """The pose since a tick, with what hitches and gyros disagree by since then: any of them may be wrong by it.

        Their disagreement is all that shows a fault that has begun. Its square less that of its noise counts.
        """
        earlier, span = history[:, 0] <= since, float(history[-1, 0] - since) * TICK
        if not earlier.any() or not span > 0.0:
            return known
        rest, apart = turned_otherwise(history, self._unit), np.diff(np.eye(self._unit + 1), axis=0)
        before = rest[earlier][-_LATELY:]
        change = rest[-_MEAN_OF:].mean(axis=0) - before.mean(axis=0) - apart @ start.mean[_GYROS:] * span
        white = (known.level * ARTICULATION_NOISE) ** 2 * (1.0 / _MEAN_OF + 1.0 / len(before))
        noise = white + np.diag(apart @ start.covariance[_GYROS:, _GYROS:] @ apart.T) * span**2
        angles = np.sqrt(np.maximum(0.0, change**2 - noise))
        by_angle, by_rate = known.by_signals[:, 1 : 1 + self._unit], known.by_signals[:, 1 + self._unit :] / span
        errors = np.hstack([by_angle, by_rate[:, :-1], by_rate[:, 1:]]) * np.tile(angles, 3)
        return known._replace(covariance=known.covariance + errors @ errors.T)

    def no_history(self) -> FloatArray:
        """A history without any message (0, columns)."""
        return np.empty((0, 7 + 2 * self._unit))

    def row(self, signals: CombinationSignals) -> FloatArray:
        """Tick, speed, steer angle, scrub, articulations, yaw rates, tangent of the axles, pull of the bank."""
        scrub, gammas, rates = self._scrub, signals.articulation[: self._unit], signals.yaw_rates[: self._unit + 1]
        own = signals.tick, signals.speed, signals.steer, scrub.slip(signals), *gammas, *rates
        return np.array([*own, scrub.rolling(signals), scrub.bank(signals)])

    def _spread(self, parameters: Parameters) -> FloatArray:
        """Standard deviations (p,) of the parameters in the long run; a slip that is large may change as much."""
        spread: FloatArray = self._std.copy()
        for place in (_VARYING, OWN):
            spread[place] = max(spread[place], abs(float(parameters.mean[place])))
        return spread

    def _kept(self, time: FloatArray, speed: FloatArray) -> FloatArray:
        """Share (n, p) of the parameters' deviation from their prior at the first sample that is kept at each one."""
        distance = integral(np.diff(time), np.abs(speed))
        forgotten = np.outer(distance, self._per_metre) + np.outer(time - time[0], self._per_second)
        return np.asarray(np.exp(-np.minimum(forgotten, _MOST_FORGOTTEN)), dtype=np.float64)

    def _rates(self, columns: FloatArray, kept: FloatArray, parameters: Parameters, by_trailer: bool) -> _Rates:
        """Yaw rate and velocity of the hitch in the trailer at every sample, with their derivatives.

        ``kept`` (n, p) is the share of the parameters' deviation from their prior that is left at each sample.
        """
        unit, p = self._unit, len(self._mean)
        mean = (self._mean + kept * (parameters.mean - self._mean)).T
        speed, steer, scrub, *readings, rolling, bank, gained, slides, at_rest = columns
        gammas, gyros = np.array(readings[:unit]), np.array(readings[unit:]) - mean[_GYROS:]
        scale, per_braking, varying, *per, constant, own = mean[:_GYROS]
        pushes, forward = np.array([speed * gyros[0] + bank, scrub, gammas[0]]), np.sign(speed)
        slip = varying + constant + forward * (np.array(per) * pushes).sum(axis=0)
        of_articulation, of_gyro = p + 1, p + 1 + unit
        by_slip = np.zeros((len(speed), p + 2 * unit + 2))
        by_slip[:, [_VARYING, _CONSTANT]], by_slip[:, _VARYING + 1 : _CONSTANT] = 1.0, (forward * pushes).T
        by_slip[:, p], by_slip[:, of_gyro] = forward * per[0] * gyros[0], forward * per[0] * speed

        aside = np.sin(steer) * np.cos(steer)  # share of the front axle's lateral velocity in the wheel speed

        def at_axle(rolled: FloatArray, slip: FloatArray) -> FloatArray:
            v_x: FloatArray = (rolled - self._front * gyros[0] * aside) / (np.cos(steer) ** 2 + slip * aside)
            return v_x

        # rolling resistance slows a tyre that slides to the side: it has little grip left along its plane
        front_slip = slip + self._front * gyros[0] / _away_from_zero(at_axle(speed, slip)) - np.tan(steer)
        braking = np.maximum(-gained, 0.0) + _SLIDING * np.abs(front_slip)
        rolled = speed * (1.0 - scale + per_braking * braking)
        spread = np.tile(self._spread(parameters), (len(speed), 1))
        at_tractor = at_axle(rolled, slip)
        carried = self._carried(at_tractor, slip, gammas, gyros)
        v_x, v_y, _ = carried[-1]
        # slip of the trailer's axles beyond the usual one, and its change by the yaw rate; unknown at walking pace
        is_known, per_speed, push = np.abs(v_x) > _ROLLING, 1.0 / _away_from_zero(v_x), v_x * gyros[unit] + bank
        rolling_direction = np.arctan(rolling + self._axle_distance * gyros[unit] * per_speed)
        own_slip = np.arctan(v_y * per_speed) - rolling_direction - np.sign(v_x) * self._own_push * push
        per_rate = self._axle_distance * per_speed
        spread[:, _VARYING] += _TORQUE_SPREAD * np.abs(gained)
        spread[:, OWN] += _OWN_SPREAD * np.abs(push) + _TORQUE_SPREAD * np.maximum(-gained, 0.0)
        if by_trailer:
            apart = np.where(is_known, own_slip - own, 0.0)
            variance = kept**2 * np.diag(parameters.covariance) + (1.0 - kept**2) * spread**2
            by_tractor = np.sum(np.square(by_slip[:, :p]) * variance, axis=1)
            by_axles = variance[:, OWN] + np.square(per_rate * GYRO_BIAS)
            shown = _SHOWN * (front_slip - forward * per[0] * pushes[0])  # front tyres slip, or the rear ones do
            excess = np.maximum(apart**2 - by_tractor - _UNUSUAL**2 * by_axles, 0.0)
            sliding, hidden = np.minimum(excess, shown**2), _OWN_SHARE**2 * excess
            spread[:, [_VARYING, OWN]] = np.sqrt(spread[:, [_VARYING, OWN]] ** 2 + hidden[:, None])
            by_tractor, by_axles = by_tractor + sliding, by_axles + hidden
            share = np.where(is_known, by_tractor / (by_tractor + by_axles), 0.0)
            slip = slip - share * apart
            by_slip *= (1.0 - share)[:, None]
            by_slip[:, OWN], by_slip[:, of_gyro + unit] = share, share * per_rate
            at_tractor = at_axle(rolled, slip)
            carried = self._carried(at_tractor, slip, gammas, gyros)
        along = np.cos(steer) ** 2 + slip * aside
        D = np.zeros((len(speed), 3, p + 2 * unit + 2))
        D[:, 1, _SCALE_OF], D[:, 1, _BRAKING], D[:, 1, p] = -speed, speed * braking, 1.0 - scale
        sliding = speed * per_braking * _SLIDING * np.sign(front_slip)  # derivative of the rolled speed by that slip
        D[:, 1, of_gyro] = self._front * (sliding / _away_from_zero(at_tractor) - aside)
        D[:, 1] = (D[:, 1] + (sliding - at_tractor * aside)[:, None] * by_slip) / along[:, None]
        D[:, 2] = slip[:, None] * D[:, 1] + at_tractor[:, None] * by_slip
        for k, (v_x, v_y, R) in enumerate(carried):
            D[:, 2, of_gyro + k] += self._levers[k]
            D[:, 1:] = R @ D[:, 1:]
            D[:, 1, of_articulation + k], D[:, 2, of_articulation + k] = -v_y, v_x
        D[:, 0, of_gyro + unit] = 1.0
        D[:, :, _GYROS:p] = -D[:, :, of_gyro:]
        mean_slip = float(np.mean(own_slip[is_known])) if is_known.any() else math.nan
        slow, moving = np.where((np.abs(v_x) < _PULLING)[:, None], _PULLED, 0.0), at_rest[:, None] < 0.5
        unknown = np.where(moving, np.where(slides[:, None] > 0.5, _SLIPPED, slow), _CREEP)
        rates = np.column_stack([gyros[unit], v_x, v_y]) * moving
        return _Rates(rates, D * moving[:, :, None], spread, unknown, mean_slip)

    def _carried(
        self, v_x: FloatArray, slip: FloatArray, gammas: FloatArray, gyros: FloatArray
    ) -> list[tuple[FloatArray, FloatArray, FloatArray]]:
        """Velocity at every hitch along the axes of the unit behind, and the rotation (n, 2, 2) into these axes."""
        v_y, carried = v_x * slip, []
        for lever, gamma, rate in zip(self._levers, gammas, gyros, strict=False):
            R = _rotations(gamma)
            (c, s), v_y = R[:, :, 0].T, v_y + rate * lever
            v_x, v_y = c * v_x - s * v_y, s * v_x + c * v_y
            carried.append((v_x, v_y, R))
        return carried

    def _summed(self, time: FloatArray, of: _Rates, level: float, kept: FloatArray, start: Parameters) -> Reckoned:
        """Pose and covariance at the end, by the trapezoidal rule.

        ``kept`` (n, p) is the share of the error of the parameters at the ``start`` that is left at each sample,
        ``level`` the noise of the signals over the assumed one.
        """
        mean, known = start
        p, dt = len(self._mean), np.diff(time)
        rates, D = of.rates, of.derivatives
        D[:, :, p:] *= level
        D = np.concatenate([D, of.unknown[:, :, None] * np.eye(3)], axis=2)
        weights = 0.5 * (np.append(dt, 0.0) + np.insert(dt, 0, 0.0))
        yaw = integral(dt, rates[:, 0])
        R = _rotations(yaw)
        velocity = np.einsum("nij,nj->ni", R, rates[:, 1:])
        x, y = integral(dt, velocity[:, 0]), integral(dt, velocity[:, 1])
        G = weights[:, None, None] * D  # share of every sample in the derivatives of the pose at the end
        turn = G[:, 0]
        G[:, 1:] = R @ G[:, 1:]
        G[:, 1] -= (y[-1] - y)[:, None] * turn
        G[:, 2] += (x[-1] - x)[:, None] * turn
        step = np.hypot(np.diff(x), np.diff(y))
        walk = 2.0 * of.spread[1:] ** 2 * (np.outer(step, self._per_metre) + np.outer(dt, self._per_second))
        # derivative by a change at the sample, which is forgotten from there on
        later = np.cumsum((G[:, :, :p] * kept[:, None])[::-1], axis=0)[::-1] / kept[:, None]
        after = later[1:]
        J, white = later[0], G[:, :, p:] * self._noise
        covariance = J @ known @ J.T
        covariance += np.einsum("nap,np,nbp->ab", after, walk, after) + np.einsum("nai,nbi->ab", white, white)
        left = kept[-1] / kept  # at the end, of a deviation at a sample
        cross = left[0][:, None] * (known @ J.T) + np.einsum("np,nap->pa", walk * left[1:], after)
        pose = np.array([yaw[-1], x[-1], y[-1]])
        known = np.outer(left[0], left[0]) * known + np.diag(np.sum(walk * left[1:] ** 2, axis=0))
        at_end = Parameters(self._mean + kept[-1] * (mean - self._mean), known)
        lasting = G.sum(axis=0)
        by_slip, by_signals = lasting[:, [_VARYING, _BRAKING]], lasting[:, p:-3] / level
        return Reckoned(pose, covariance, at_end, cross, float(step.sum()), by_slip, by_signals, of.own_slip, level)


def _rotations(angles: FloatArray) -> FloatArray:
    """Rotations (n, 2, 2) by angles (n,) [rad]."""
    c, s = np.cos(angles), np.sin(angles)
    return np.array([[c, -s], [s, c]]).transpose(2, 0, 1)


def _away_from_zero(speed: FloatArray) -> FloatArray:
    """Speed [m/s] to divide by, at least walking pace."""
    return np.copysign(np.maximum(np.abs(speed), _ROLLING), speed)


def _mean_before(ticks: FloatArray, values: FloatArray, span: int) -> FloatArray:
    """Mean (n, ...) over a ``span`` [ticks] up to each sample; less than that is made up for by zeros."""
    sums = np.concatenate([np.zeros_like(values[:1]), values.cumsum(axis=0)])
    first = np.searchsorted(ticks, ticks - span, side="right")
    count = np.arange(1, len(ticks) + 1) - first
    period = np.diff(ticks).mean() if len(ticks) > 1 else span
    return np.asarray(((sums[1:] - sums[first]).T / np.maximum(count, span / period)).T, dtype=np.float64)


def _are_covered(nodes: FloatArray, ticks: FloatArray) -> bool:
    """True if there are signals around all nodes, without too long a gap between them."""
    if not len(ticks) or max(ticks[0] - nodes[0], nodes[-1] - ticks[-1]) > _LONGEST_AGE:
        return False
    first, last = np.searchsorted(ticks, [nodes[0], nodes[-1]])
    around = ticks[max(first - 1, 0) : last + 1]
    return bool(np.all(np.diff(around) <= _LONGEST_GAP))
