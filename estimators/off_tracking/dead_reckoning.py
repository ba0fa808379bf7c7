"""Dead reckoning of a trailer from wheel speed, articulation and gyros, with learnt errors and honest uncertainty.

As in ``estimators.off_tracking.kinematic``, the velocity of the tractor's rear axle is carried to its hitch by the
tractor's yaw rate, turned by the articulation into the next unit, and so on to the trailer's own hitch; its own gyro
measures its yaw rate. Unlike there, the tractor's rear axle slips and the sensors have errors. These are parameters,
which a Kalman filter learns from the camera (``estimators.off_tracking.signal_fusion``):

- the scale of the wheel speed, and its part in curves: the steered front wheels slip by an angle in proportion to the
  lateral acceleration a, and roll along the direction in which they point, not that in which they travel;
  gravity along the axles of a banked road counts as acceleration, as the trailer's accelerometer feels it;
- the slip angle of the tractor's rear axle: a slowly varying part, a constant part, which includes the bias of the
  articulation, and parts in proportion to a, to what the scrub of tyres causes by the data sheet
  (``estimators.off_tracking.tyre_scrub``), and to the articulation;
- the bias of every gyro.

The pose after a stretch of signals is a sum over the samples. So are its derivatives by the parameters, and its
covariance from their uncertainty, their random walk and the white noise of every sample. Errors within a stretch that
come from one wrong parameter are therefore fully correlated, as they are in truth.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from estimators.off_tracking.parity import ARTICULATION_NOISE, GYRO_BIAS, GYRO_NOISE, SPEED_NOISE, noise_level
from estimators.off_tracking.tyre_scrub import TyreScrub
from sensors.messages import CombinationSignals
from vehicle.clock import TICK
from vehicle.combination.description import Vehicle
from vehicle.frames import FloatArray, rotation_zyx, transform

_MARGIN = 400  # signals before and after a stretch that count [ticks]
_LONGEST_GAP = 300  # longest time without signals that is bridged by interpolation [ticks]
_LONGEST_AGE = 50  # signals at an end of a stretch may be that much older or newer [ticks]
_AT_REST = 0.03  # mean speed over five samples below which the vehicle stands: 3 sigma of their noise [m/s]
_MEAN_OF = 5  # samples
_BANK = -1  # column of the bank's pull
_SWAY = 2000  # time that it is averaged over: bodies sway, and trailers drift to the side as they turn in [ticks]
# Speed at which that drift (slip changes by 0.03 rad in the time) is as large as the usual bank of 2.5 %. There half of
# the mean is believed: least squares of a bank and its error [m/s].
_FAST = 12.0
# A vehicle that seems to stand may creep, and rocks on its tyres: white noise of every sample, 1 sigma. Of a start or a
# stop, 3 mm are missed within a tenth of a second; a standstill of ten seconds adds 30 mm.
_CREEP = np.array([0.001, 0.06, 0.02])  # yaw [rad/s], x and y [m/s]


class Prior(NamedTuple):
    """Prior of a parameter that is learnt: a first-order Gauss-Markov process."""

    mean: float
    std: float
    distance: float  # over which it is forgotten [m]
    time: float  # likewise [s]


_MOST_FORGOTTEN = 300.0  # beyond it nothing is left, and exp(-x) must not vanish [-]
_FOR_EVER = 1e6  # constant during a drive [m], [s]
# The spread of the slips, of their parts and of the scale is that over four combinations (two of them with two trailers
# or steered trailer axles) on friction of 0.3 to 0.8, at 5 to 88 km/h; no combination needed more than three of it.
_SCALE = Prior(0.0, 0.006, 60.0, _FOR_EVER)  # rolling radius known to 2.5 mm of 0.5 m, and what the next one leaves [-]
_SIDE = Prior(-0.03, 0.012, _FOR_EVER, _FOR_EVER)  # slip of steered truck tyres per a: 1/(4 g) [rad s2/m]
# What data sheets leave of the slip. With 4 mrad and 8 m, outages of 20 s have sigmas nearer to their errors. But in
# the closed loop the estimate is then 15 mm off after 2 s without images, not 9 mm, and states 6 mm.
_SLIP = Prior(0.0, 0.005, 12.0, _FOR_EVER)  # [rad]
_SLIP_PER_ACCELERATION = Prior(-0.02, 0.004, _FOR_EVER, _FOR_EVER)  # its mean is that of the data sheet [rad s2/m]
_SLIP_PER_SCRUB = Prior(0.9, 0.15, _FOR_EVER, _FOR_EVER)  # 1 if tyres are linear, 0.7 on friction of 0.3 [-]
_SLIP_PER_ARTICULATION = Prior(0.0, 0.005, _FOR_EVER, _FOR_EVER)
_SLIP_OFFSET = Prior(0.0, 0.002, _FOR_EVER, _FOR_EVER)  # an angle sensor is right to 0.1 deg [rad]
_GYRO_BIAS = Prior(0.0, GYRO_BIAS, _FOR_EVER, 3600.0)  # wanders by 15 deg/h within a minute [rad/s]


class Parameters(NamedTuple):
    """Parameters with their covariance."""

    mean: FloatArray  # (p,)
    covariance: FloatArray  # (p, p)


class Reckoned(NamedTuple):
    """Pose of the trailer at the end of a stretch in its frame at the beginning, by dead reckoning."""

    pose: FloatArray  # (3,) yaw [rad], x and y [m]
    covariance: FloatArray  # (3, 3)
    cross: FloatArray  # (p, 3) covariance of the parameters at the end with the pose
    distance: float  # [m]

    @property
    def X(self) -> FloatArray:
        """The pose (4, 4), without roll, pitch and heave."""
        yaw, x, y = self.pose.tolist()
        return transform(rotation_zyx(yaw, 0.0, 0.0), np.array([x, y, 0.0]))


class DeadReckoning:
    """Dead reckoning of one trailer."""

    def __init__(self, vehicle: Vehicle, unit: int) -> None:
        """For the ``unit`` of a vehicle.

        Raises:
            ValueError: if the unit is not towed.
        """
        if not 1 <= unit < len(vehicle.units):
            raise ValueError(f"unit = {unit} must be a towed unit of {vehicle.name}, 1 to {len(vehicle.units) - 1}")
        self._unit, self._scrub = unit, TyreScrub(vehicle, unit)
        self._hitches = [ahead.rear_hitch[0] for ahead in vehicle.units[:unit]]
        slips = [_SLIP, _SLIP_PER_ACCELERATION, _SLIP_PER_SCRUB, _SLIP_PER_ARTICULATION, _SLIP_OFFSET]
        slips[1] = slips[1]._replace(mean=self._scrub.per_acceleration())
        self._priors = [_SCALE, _SIDE, *slips, *[_GYRO_BIAS] * (unit + 1)]
        gyros = unit + 1
        self._noise = np.array([SPEED_NOISE, *[ARTICULATION_NOISE] * unit, *[GYRO_NOISE] * gyros, *[1.0] * 3])
        self._std = np.array([prior.std for prior in self._priors])
        self._mean = np.array([prior.mean for prior in self._priors])
        self._per_metre = np.array([1.0 / prior.distance for prior in self._priors])
        self._per_second = np.array([1.0 / prior.time for prior in self._priors])

    def prior(self) -> Parameters:
        """Parameters before anything is learnt."""
        return Parameters(self._mean, np.diag(self._std**2))

    def deviation(self, parameters: Parameters, history: FloatArray) -> float:
        """Largest difference of a parameter from its prior mean [standard deviations of the prior].

        Sensors that are noisier than assumed are expected to have larger constant errors as well.
        """
        return float(np.max(np.abs(parameters.mean - self._mean) / self._std)) / noise_level(history, self._unit)

    def noise_margin(self, history: FloatArray, parameters: Parameters, reckoned: Reckoned) -> FloatArray:
        """Covariance (3, 3) that the constant errors of noisy sensors add to a pose; 0 if they are as assumed."""
        level = noise_level(history, self._unit)
        if level == 1.0:
            return np.zeros((3, 3))
        by_parameters = reckoned.cross.T @ np.linalg.solve(parameters.covariance, reckoned.cross)
        margin: FloatArray = (level**2 - 1.0) * 0.5 * (by_parameters + by_parameters.T)
        return margin

    def forgotten(self, parameters: Parameters, distance: float, time: float) -> Parameters:
        """Parameters after ``distance`` [m] and ``time`` [s], drawn back to their prior."""
        kept = np.exp(-distance * self._per_metre - time * self._per_second)
        mean = self._mean + kept * (parameters.mean - self._mean)
        covariance = np.outer(kept, kept) * parameters.covariance + np.diag((1.0 - kept**2) * self._std**2)
        return Parameters(mean, covariance)

    def reckoned(self, history: FloatArray, since: int, until: int, parameters: Parameters) -> Reckoned | None:
        """Motion from the tick ``since`` to the tick ``until``; None if signals are missing for too long.

        ``history`` (n, columns) holds the `row` of every message, oldest first.
        """
        begin, longer, end = np.searchsorted(history[:, 0], [since - _MARGIN, since - _SWAY, until + _MARGIN]).tolist()
        ticks, table = history[begin:end, 0], history[begin:end, 1:]
        bank = _mean_before(history[longer:end, 0], history[longer:end, _BANK])[begin - longer :]
        nodes = np.concatenate([[since], ticks[(ticks > since) & (ticks < until)], [until]])
        if not _are_covered(nodes, ticks):
            return None
        at_rest = np.abs(_running_mean(table[:, 0])) < _AT_REST
        bank /= 1.0 + np.square(table[:, 0] / _FAST)
        table = np.column_stack([table[:, :_BANK], bank])
        columns = [np.interp(nodes, ticks, column) for column in (*table.T, at_rest)]
        moving = columns.pop() < 0.5
        kept = self._kept(nodes * TICK, columns[0] * moving)
        means = self._mean + kept * (parameters.mean - self._mean)
        rates, derivatives = self._rates(np.array(columns), means.T)
        rates, derivatives = rates * moving[:, None], derivatives * moving[:, None, None]
        creep = np.where(moving[:, None, None], 0.0, np.diag(_CREEP))
        derivatives[:, :, len(self._priors) :] *= noise_level(history, self._unit)
        derivatives = np.concatenate([derivatives, creep], axis=2)
        return self._summed(nodes * TICK, rates, derivatives, kept, parameters.covariance)

    def no_history(self) -> FloatArray:
        """A history without any message (0, columns)."""
        return np.empty((0, 6 + 2 * self._unit))

    def row(self, signals: CombinationSignals) -> FloatArray:
        """Tick, speed, steer angle, slip by scrub, articulations, yaw rates, and pull of the bank, of a message."""
        scrub, bank = self._scrub.slip(signals), self._scrub.bank(signals)
        ahead, rates = signals.articulation[: self._unit], signals.yaw_rates[: self._unit + 1]
        return np.array([signals.tick, signals.speed, signals.steer, scrub, *ahead, *rates, bank])

    def _kept(self, time: FloatArray, speed: FloatArray) -> FloatArray:
        """Share (n, p) of the parameters' deviation from their prior at the first sample that is kept at each one."""
        distance = _integral(np.diff(time), np.abs(speed))
        forgotten = np.outer(distance, self._per_metre) + np.outer(time - time[0], self._per_second)
        kept: FloatArray = np.exp(-np.minimum(forgotten, _MOST_FORGOTTEN))
        return kept

    def _rates(self, columns: FloatArray, mean: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Yaw rate and velocity of the hitch (n, 3) in the trailer, and their derivatives (n, 3, p + signals).

        ``mean`` (p, n) are the parameters.
        """
        unit, p = self._unit, len(self._priors)
        speed, steer, scrub, *readings, bank = columns
        gammas, gyros = np.array(readings[:unit]), np.array(readings[unit:]) - mean[-unit - 1 :]
        scale, side, varying, *per, constant = mean[:7]
        acceleration = speed * gyros[0] + bank
        rolling = acceleration * np.sin(steer) * np.cos(steer)
        v_x = speed * (1.0 - scale - side * rolling)
        pushes = np.array([acceleration, scrub, gammas[0]])
        slip = varying + constant + np.sign(v_x) * (np.array(per) * pushes).sum(axis=0)
        v_y = v_x * slip + gyros[0] * self._hitches[0]
        D = np.zeros((len(speed), 3, p + 2 * unit + 2))
        of_articulation, of_gyro = p + 1, p + 1 + unit
        D[:, 1, 0], D[:, 1, 1] = -speed, -speed * rolling
        D[:, 1, p] = 1.0 - scale - 2.0 * side * rolling
        D[:, 1, of_gyro] = -side * speed**2 * np.sin(steer) * np.cos(steer)
        D[:, 2] = slip[:, None] * D[:, 1]
        D[:, 2, 2], D[:, 2, 3:6], D[:, 2, 6] = v_x, (np.abs(v_x) * pushes).T, v_x
        D[:, 2, p] += np.abs(v_x) * per[0] * gyros[0]
        D[:, 2, of_gyro] += np.abs(v_x) * per[0] * speed + self._hitches[0]
        for k, gamma in enumerate(gammas):
            c, s = np.cos(gamma), np.sin(gamma)
            R = np.array([[c, -s], [s, c]]).transpose(2, 0, 1)
            v_x, v_y = c * v_x - s * v_y, s * v_x + c * v_y
            D[:, 1:] = R @ D[:, 1:]
            D[:, 1, of_articulation + k], D[:, 2, of_articulation + k] = -v_y, v_x
            if k + 1 < unit:
                v_y = v_y + gyros[k + 1] * self._hitches[k + 1]
                D[:, 2, of_gyro + k + 1] += self._hitches[k + 1]
        D[:, 0, of_gyro + unit] = 1.0
        D[:, :, p - unit - 1 : p] = -D[:, :, of_gyro:]
        return np.column_stack([gyros[unit], v_x, v_y]), D

    def _summed(
        self, time: FloatArray, rates: FloatArray, D: FloatArray, kept: FloatArray, known: FloatArray
    ) -> Reckoned:
        """Pose and covariance at the end, by the trapezoidal rule.

        ``kept`` (n, p) is the share of the parameters' error that is left at each sample, ``known`` (p, p) their
        covariance at the first one.
        """
        p, dt = len(self._priors), np.diff(time)
        weights = 0.5 * (np.append(dt, 0.0) + np.insert(dt, 0, 0.0))
        yaw = _integral(dt, rates[:, 0])
        c, s = np.cos(yaw), np.sin(yaw)
        R = np.array([[c, -s], [s, c]]).transpose(2, 0, 1)
        velocity = np.einsum("nij,nj->ni", R, rates[:, 1:])
        x, y = _integral(dt, velocity[:, 0]), _integral(dt, velocity[:, 1])
        G = weights[:, None, None] * D  # share of every sample in the derivatives of the pose at the end
        turn = G[:, 0]
        G[:, 1:] = R @ G[:, 1:]
        G[:, 1] -= (y[-1] - y)[:, None] * turn
        G[:, 2] += (x[-1] - x)[:, None] * turn
        step = np.hypot(np.diff(x), np.diff(y))
        walk = 2.0 * self._std**2 * (np.outer(step, self._per_metre) + np.outer(dt, self._per_second))  # (n - 1, p)
        # derivative by a change at the sample, which is forgotten from there on
        later = np.cumsum((G[:, :, :p] * kept[:, None])[::-1], axis=0)[::-1] / kept[:, None]
        after = later[1:]
        J, white = later[0], G[:, :, p:] * self._noise
        covariance = J @ known @ J.T
        covariance += np.einsum("nap,np,nbp->ab", after, walk, after) + np.einsum("nai,nbi->ab", white, white)
        cross = known @ J.T + np.einsum("np,nap->pa", walk, after)
        pose = np.array([yaw[-1], x[-1], y[-1]])
        return Reckoned(pose, covariance, cross, float(step.sum()))


def _integral(dt: FloatArray, values: FloatArray) -> FloatArray:
    """Integral (n,) from the first sample to every sample, by the trapezoidal rule."""
    return np.insert(np.cumsum(0.5 * dt * (values[1:] + values[:-1])), 0, 0.0)


def _mean_before(ticks: FloatArray, values: FloatArray) -> FloatArray:
    """Mean (n,) over the time `_SWAY` up to each sample; less than that is made up for by zeros."""
    sums = np.insert(np.cumsum(values), 0, 0.0)
    first = np.searchsorted(ticks, ticks - _SWAY, side="right")
    count = np.arange(1, len(ticks) + 1) - first
    period = np.diff(ticks).mean() if len(ticks) > 1 else _SWAY
    mean: FloatArray = (sums[1:] - sums[first]) / np.maximum(count, _SWAY / period)
    return mean


def _running_mean(values: FloatArray) -> FloatArray:
    """Mean of the last samples up to each one, of fewer at the beginning."""
    sums = np.cumsum(values)
    before = np.concatenate([np.zeros(min(_MEAN_OF, len(values))), sums[:-_MEAN_OF]])
    mean: FloatArray = (sums - before) / np.minimum(np.arange(1, len(values) + 1), _MEAN_OF)
    return mean


def _are_covered(nodes: FloatArray, ticks: FloatArray) -> bool:
    """True if there are signals around all nodes, without too long a gap between them."""
    if not len(ticks) or max(ticks[0] - nodes[0], nodes[-1] - ticks[-1]) > _LONGEST_AGE:
        return False
    first, last = np.searchsorted(ticks, [nodes[0], nodes[-1]])
    around = ticks[max(first - 1, 0) : last + 1]
    return bool(np.all(np.diff(around) <= _LONGEST_GAP))
