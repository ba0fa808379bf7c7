"""Parity relations between the signals of a combination and its measured motion, and assumed signal errors.

Each relation is zero, within a tolerance, while all that it relates are sound:

- A (one for each hitch): the articulation changes by the difference of the yaw rates on both sides of the hitch;
- K: the tractor turns as its speed and its steer angle say;
- S, Y, D: speed, yaw rate and direction of travel at the trailer's hitch are as the reference says;
- T: the reference's own direction of travel lets the trailer's axles roll along their planes.

Tyres that slide are no fault. Slip of the tractor's rear axle shows in D, and in K while the front tyres roll:
there it looks like a steer angle. Front tyres that slide show in K alone, and only make the tractor turn less.

A fault adds its signature to the relations: a vector in the space of their values, in proportion to the fault's size.
The generalised likelihood ratio test asks which signature explains the values that are not zero (J. Gertler, "Fault
Detection and Diagnosis in Engineering Systems", 1998). Values are over their tolerances.
"""

import math
from collections.abc import Iterator, Sequence
from typing import Final, NamedTuple

import numpy as np

from estimators.hitch_motion import HitchMotion, hitch_motions
from vehicle.clock import TICK
from vehicle.combination.description import Vehicle
from vehicle.frames import FloatArray

# White noise of every sample and constant error, 1 sigma: assumed, as of the sensors of a truck
# (``sensors.instruments.combination``).
SPEED_NOISE = 0.02  # [m/s]
STEER_NOISE = math.radians(0.1)  # [rad]
ARTICULATION_NOISE = math.radians(0.15)  # [rad]
GYRO_NOISE = math.radians(0.1)  # [rad/s]
GYRO_BIAS = math.radians(0.12)  # [rad/s]

SPEED, STEER, FIRST = 1, 2, 4  # columns of the speed, the steer angle and the first articulation
_LEVEL_OF, _LEAST = 50, 15  # samples that the noise is measured from: to 10 %, and to 20 %
_NOISIER = 1.5  # noise above which the assumed one is replaced by the measured one [its standard deviations]


def noise_level(history: FloatArray, unit: int) -> float:
    """White noise of articulations and gyros over the assumed one; 1 if it is about that or less.

    From second differences of the newest rows of ``history`` (n, columns): motion hardly has any within 40 ms. It is 1
    with few rows.
    """
    recent = history[-_LEVEL_OF:, FIRST : FIRST + 2 * unit + 1]
    if len(recent) < _LEAST:
        return 1.0
    measured = white_noise(recent).tolist()
    assumed = [ARTICULATION_NOISE] * unit + [GYRO_NOISE] * (unit + 1)
    level = sorted(one / usual for one, usual in zip(measured, assumed, strict=True))[unit]  # the median
    return level if level > _NOISIER else 1.0


def integral(dt: FloatArray, values: FloatArray) -> FloatArray:
    """Integral (n, ...) from the first of n samples to every sample, ``dt`` (n - 1,) apart, by the trapezoidal rule."""
    areas = (0.5 * dt * (values[1:] + values[:-1]).T).T
    return np.concatenate([np.zeros_like(values[:1]), areas.cumsum(axis=0)])


def acceleration(rows: FloatArray) -> float:
    """Acceleration along [m/s2] by the wheel speed of rows (n, columns): least squares."""
    time = (rows[:, 0] - rows[:, 0].mean()) * TICK
    return float(time @ rows[:, SPEED] / (time @ time)) if len(rows) > 1 else 0.0


def turned_otherwise(rows: FloatArray, unit: int) -> FloatArray:
    """Articulations (n, unit) [rad] of rows, without their change by the difference of two yaw rates."""
    rates = np.diff(rows[:, FIRST + unit : FIRST + 2 * unit + 1], axis=1)
    return np.unwrap(rows[:, FIRST : FIRST + unit], axis=0) + integral(np.diff(rows[:, 0] * TICK), rates)


def white_noise(columns: FloatArray) -> FloatArray:
    """Standard deviations (k,) of the white noise of columns (n, k), from second differences."""
    variance = np.mean(np.square(np.diff(columns, n=2, axis=0)), axis=0) / 6.0  # 1 + 4 + 1
    return np.asarray(np.sqrt(variance), dtype=np.float64)


# Tolerances. assumed: several times the errors of the sensors, and what slipping tyres cause on a slippery road.
_A_SIGMAS: Final = 3.5  # of the noise of angle sensors and the bias of gyros; sound drives reach 2.9
_SHORT: Final = 500  # time over which a drift of 2 deg/s per second shows first [ticks]
_ENDS: Final = 5  # samples at both ends that an articulation is the mean of
_K: Final = (math.radians(3.0), 0.3)  # [rad/s], and share of the yaw rate: understeer
_S: Final = (0.3, 0.1)  # [m/s], and share of the speed
_Y: Final = math.radians(1.0)  # [rad/s]
_D: Final = (0.04, 0.04)  # [rad], and for each m/s2 of lateral acceleration: slip of the tractor's rear axle
_T: Final = (0.03, 0.05)  # the same: slip of the trailer's axles
_BEND: Final = 0.3  # acceleration up to which front tyres roll [m/s2]
# In the place of a signal and the part of its fault: slip of the tractor's axles.
_REAR_SLIP, _FRONT_SLIP = (-1, 0), (-1, 1)
_PLOUGHING: Final = 0.2  # steer angle from which on front tyres may slide straight ahead [rad]
_NOISY: Final = 4.0  # noise above which the tolerances grow with it [its assumed standard deviation]
_FASTEST: Final = 5.0  # at which a turn shows the speed: a higher rate adds nothing, and exp must not overflow [1/s]
_SLOW: Final = 0.5  # slower than this, directions of travel are noise [m/s]


class MotionReference(NamedTuple):
    """Motion of the trailer at its hitch, along its own axes, that no signal of the combination has a part in.

    Means from ``previous_tick`` to ``tick``.
    """

    tick: int
    previous_tick: int
    v_x: float  # [m/s]
    v_y: float  # + left [m/s]
    yaw_rate: float  # [rad/s]


_Relation = tuple[float, dict[tuple[int, int], float], tuple[float, float, float]]  # value, signatures, reference's


class Parity:
    """Values of relations over their tolerances (m,), and the signatures of faults, made where they are asked for."""

    def __init__(self, relations: Sequence[_Relation], *, rolls: bool) -> None:
        """For m relations; ``rolls``: the reference's own motion lets the trailer's axles roll."""
        self.values = np.array([value for value, _, _ in relations])
        self._relations, self._rolls = relations, rolls
        self.slip = self._columns(_REAR_SLIP, _FRONT_SLIP)  # signatures (m, 2) of slip of the tractor's axles

    def signature(self, signal: int) -> FloatArray:
        """Signature (m, q) of a fault of a signal, in its unit; q: degrees of freedom of its fault."""
        both = self._columns((signal, 0), (signal, 1))
        return both if both[:, 1].any() else both[:, :1]

    @property
    def excuses(self) -> tuple[FloatArray, ...]:
        """Signatures (m, q) of what is no fault: a reference wrong in one way, or in all, and slip of the tractor."""
        own = np.array([own for _, _, own in self._relations])
        wrong = (own[:, :1], own[:, 1:2], own[:, 2:], *(() if self._rolls else (own,)))
        return *wrong, self.slip

    def _columns(self, *places: tuple[int, int]) -> FloatArray:
        return np.array([[row.get(place, 0.0) for place in places] for _, row, _ in self._relations])


class ParityRelations:
    """The relations of one trailer. Signals: speed, ``unit`` articulations, ``unit + 1`` yaw rates, steer angle.

    Rows of a history are tick, speed, steer angle, tangent of the direction in which the trailer's axles roll,
    articulations, yaw rates, lateral acceleration.
    """

    def __init__(self, vehicle: Vehicle, unit: int, axle_distance: float) -> None:
        """For the ``unit`` of a vehicle whose axles let the point ``axle_distance`` [m] behind its hitch roll."""
        tractor = vehicle.units[0]
        fixed = [axle.x for axle in tractor.axles if not axle.steered] or [axle.x for axle in tractor.axles]
        self._wheelbase = tractor.steered_axles[0].x - sum(fixed) / len(fixed) if tractor.steered_axles else math.inf
        self._front = tractor.steered_axles[0].x if tractor.steered_axles else 0.0
        self._levers = vehicle.hitch_levers(unit)
        self._unit, self._axle_distance = unit, axle_distance
        self._gyro, self._rate = FIRST + unit, 1 + unit  # column and signal of the tractor's yaw rate

    def parity(
        self, history: FloatArray, window: int, level: float, reference: MotionReference | None, until: int
    ) -> Parity:
        """Relations at the tick ``until``, those of articulations over a ``window`` [ticks] before it.

        ``level`` is the noise of the signals over the assumed one. Without a reference the relations to it are left
        out, as are directions of travel at walking pace.
        """
        first, end = np.searchsorted(history[:, 0], [until - window, until + 1])
        recent = history[first:end]
        since = until - 100 if reference is None else reference.previous_tick
        mean = recent[np.searchsorted(recent[:-1, 0], since) :].mean(axis=0)
        relations = [*self._articulations(recent, level), self._tractor(mean, level)]
        rolls = False  # as the reference says
        if reference is not None:
            relations += self._to_reference(mean, reference, max(1.0, level / _NOISY))
            rolls = reference.v_x >= _SLOW and abs(relations[-1][0]) <= 1.0
            turning = max(abs(reference.yaw_rate), abs(float(mean[self._gyro])))
            if math.hypot(reference.v_x * turning, acceleration(recent)) <= _BEND and abs(mean[STEER]) < _PLOUGHING:
                relations[self._unit][1].pop(_FRONT_SLIP, None)
        return Parity(relations, rolls=rolls)

    def _articulations(self, recent: FloatArray, level: float) -> Iterator[_Relation]:
        """A, of each hitch: over the whole time or the end of it, where a drift shows before bias hides it."""
        time, rest = recent[:, 0] * TICK, turned_otherwise(recent, self._unit)
        late = int(recent[:, 0].searchsorted(recent[-1, 0] - _SHORT))
        for k in range(self._unit):
            over = [_change(time[first:], rest[first:, k], level) for first in (0, late)]
            value, limit = max(over, key=lambda one: abs(one[0]))
            # What a fault adds here depends on its past; what it is now, the other relations show.
            row = {(1 + k, 1): 1.0 / limit, (self._rate + k, 1): -1.0 / limit, (self._rate + k + 1, 1): 1.0 / limit}
            yield value, row, (0.0, 0.0, 0.0)

    def _tractor(self, mean: FloatArray, level: float) -> _Relation:
        """K."""
        per_speed = math.tan(mean[STEER]) / self._wheelbase
        turning, measured = per_speed * mean[SPEED], mean[self._gyro]
        limit = max(1.0, level / _NOISY) * _K[0] + _K[1] * max(abs(turning), abs(measured))
        per_angle = float(mean[SPEED]) / (self._wheelbase * math.cos(mean[STEER]) ** 2)
        row = {
            (0, 0): per_speed / limit,
            (self._rate, 0): -1.0 / limit,
            (self._rate + self._unit + 1, 0): per_angle / limit,
            _REAR_SLIP: -float(mean[SPEED]) / (self._wheelbase * limit),
        }
        if abs(measured) - abs(turning) < limit:
            row[_FRONT_SLIP] = 1.0 / limit
        return (turning - measured) / limit, row, (0.0, 0.0, 0.0)

    def _to_reference(self, mean: FloatArray, reference: MotionReference, scale: float) -> Iterator[_Relation]:
        """S, Y, D and T."""
        v_x, v_y, own = self._at_hitch(mean)
        turned = sum(mean[FIRST : self._gyro].tolist())
        # front wheels that slide to the side turn slower; rolling along their planes they tell how fast they travel
        travelled = self._at_hitch(mean, rolling=True).v_x
        v_x = min(max(reference.v_x, min(v_x, travelled)), max(v_x, travelled))
        limit = scale * (_S[0] + _S[1] * max(abs(v_x), abs(reference.v_x)))
        yield (v_x - reference.v_x) / limit, {(0, 0): math.cos(turned) / limit}, (-1.0 / limit, 0.0, 0.0)
        limit, rate = scale * _Y, self._rate + self._unit
        yield (own - reference.yaw_rate) / limit, {(rate, 0): 1.0 / limit}, (0.0, -1.0 / limit, 0.0)
        if reference.v_x < _SLOW:
            return
        sideways = max(reference.v_x * abs(reference.yaw_rate), abs(float(mean[-1])))  # on a bank, too
        direction = math.atan2(reference.v_y, reference.v_x)
        if v_x > _SLOW:
            limit = scale * (_D[0] + _D[1] * sideways)
            row = {(1 + k, 0): 1.0 / limit for k in range(self._unit)} | {_REAR_SLIP: 1.0 / limit}
            row |= {(self._rate + k, 0): lever / (v_x * limit) for k, lever in enumerate(self._levers)}
            yield (math.atan2(v_y, v_x) - direction) / limit, row, (0.0, 0.0, -1.0 / limit)
        limit = scale * (_T[0] + _T[1] * sideways)
        tangent = float(mean[3]) + self._axle_distance * reference.yaw_rate / reference.v_x
        per_rate = self._axle_distance / (reference.v_x * (1.0 + tangent**2) * limit)
        wrong = (per_rate * reference.yaw_rate / reference.v_x, -per_rate, 1.0 / limit)
        yield (direction - math.atan(tangent)) / limit, {}, wrong

    def rolling_rate(self, row: FloatArray) -> float:
        """Yaw rate [rad/s] of the trailer if its axles roll along their planes, by the other signals of a row."""
        v_x, v_y, _ = self._at_hitch(row, rolling=True)
        return (v_y - float(row[3]) * v_x) / self._axle_distance

    def with_rolling_speed(self, row: FloatArray, gain: float) -> float:
        """Speed [m/s] of a row, corrected by the yaw rate of a trailer whose axles roll: least squares.

        The weight of the yaw rate is a ``gain`` [m2] times its square for each m/s.
        """
        faster, rate = row.copy(), self.rolling_rate(row)
        faster[SPEED] += 1.0
        per_speed, lack = self.rolling_rate(faster) - rate, float(row[self._gyro + self._unit]) - rate
        return float(row[SPEED]) + gain * per_speed * lack / (1.0 + gain * per_speed**2)

    def unknown_time(self, rows: FloatArray, gain: float) -> float:
        """Mean time [s] for which the speed has been unknown in rows (n, columns): since a turn has shown it.

        As in `with_rolling_speed`, with a ``gain`` for each second [m2/s].
        """
        dt = np.diff(rows[:, 0]) * TICK
        per_speed = rows[1:, self._gyro + self._unit] / np.maximum(np.abs(rows[1:, SPEED]), _SLOW)
        shown = np.cumsum(np.minimum(gain * np.square(per_speed), _FASTEST) * dt)
        times = np.exp(-shown) * np.cumsum(dt * np.exp(shown))
        return float(times @ dt / dt.sum()) if len(dt) else 0.0

    def _at_hitch(self, mean: FloatArray, *, rolling: bool = False) -> HitchMotion:
        """Motion of the trailer's hitch; ``rolling``: by front wheels that roll along their planes."""
        speed, c, s = float(mean[SPEED]), math.cos(mean[STEER]), math.sin(mean[STEER])
        if rolling:
            speed = float(mean[SPEED] - self._front * mean[self._gyro] * s * c) / (c * c)
        gyros = mean[self._gyro : self._gyro + self._unit + 1].tolist()
        return hitch_motions(speed, 0.0, self._levers, gyros, mean[FIRST : self._gyro].tolist())[-1]


def _change(time: FloatArray, rest: FloatArray, level: float) -> tuple[float, float]:
    """Change of an angle (n,) that gyros do not explain, in its tolerance, and that [rad]."""
    count = min(_ENDS, max(1, len(time) // 2))
    noise, span = ARTICULATION_NOISE / math.sqrt(count), float(time[-1] - time[0])
    limit = level * _A_SIGMAS * math.sqrt(2.0) * math.hypot(noise, GYRO_BIAS * span)
    return float(rest[-count:].mean() - rest[:count].mean()) / limit, limit


def misfit(values: FloatArray, signatures: Sequence[FloatArray]) -> tuple[float, FloatArray]:
    """Largest value (m,) that faults of these signatures (m, q) leave, and their sizes by least squares."""
    if not signatures:
        return float(np.max(np.abs(values))), np.empty(0)
    columns = np.hstack(signatures)
    sizes = np.asarray(np.linalg.lstsq(columns, values, rcond=None)[0], dtype=np.float64)
    return float(np.max(np.abs(values - columns @ sizes))), sizes
