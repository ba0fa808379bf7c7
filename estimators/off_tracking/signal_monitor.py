"""Fault detection and isolation of a combination's own signals, and correction of the faulty signal.

Parity relations (``estimators.off_tracking.parity``) between the signals and an independent measurement of the
trailer's motion tell which one contradicts the others. A reading that cannot be true, because it jumps or repeats
itself exactly while others are noisy, is further evidence. A signal that is found at fault is corrected by the size of
its fault, which goes on being measured, and is trusted again when that is small. Without evidence against a single
signal none is distrusted: the reference then is the one to doubt.

Without a reference the size of a fault is not measured. A hitch angle that is at fault then goes on by the gyros and
by how the axles roll. The yaw rate of a gyro that is at fault is that of a trailer whose axles roll, as the others say.
The two may also contradict each other, and nothing tells which one is at fault: both are replaced in this way, from the
last comparison with a reference on. Wheels whose speed stays exactly the same for long, or after a jump, have the speed
of before, and in bends that with which the axles of the trailer roll as it turns.
"""

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import Final, NamedTuple

import numpy as np

from estimators.off_tracking.parity import (
    ARTICULATION_NOISE,
    FIRST,
    GYRO_NOISE,
    SPEED,
    SPEED_NOISE,
    STEER,
    STEER_NOISE,
    MotionReference,
    Parity,
    ParityRelations,
    misfit,
    noise_level,
    white_noise,
)
from estimators.off_tracking.tyre_scrub import TyreScrub
from sensors.messages import CombinationSignals
from vehicle.clock import TICK
from vehicle.combination.description import Vehicle
from vehicle.frames import FloatArray

STEER_ANGLE: Final = "steer angle"
_REPEATED: Final = 15  # equal values in a row of a sensor that is stuck
_STILL: Final = 50  # equal values in a row of a wheel speed that is stuck, and did not jump before
_VISIBLE: Final = 0.3  # noise of a gyro that tells that signals have noise at all [its assumed standard deviation]
_MEAN_OF: Final = 5  # values before a fault
_JUMP_SIGMAS: Final = 8.0  # of a sample's noise
_PULSES: Final = 1.5  # wheels that turn slower may read 0: a coil at a pole wheel needs 0.7 to 1.4 m/s. assumed
_VALUE, _SLOPE = 0.5, 0.1  # gains of an alpha-beta filter [-]
_AHEAD: Final = 0.3  # longest extrapolation of an error [s]
_ROLLING: Final = 0.5  # part of how axles roll in the yaw rate by which a hitch angle goes on; gyros drift by 0.2 deg/s
_TURNING: Final = 1000.0  # gain of a speed by the trailer's turning: within a second in bends of 30 m. assumed [m2/s]
_UNKNOWN_ACCELERATION: Final = 0.5  # without a wheel speed, 1 sigma: assumed, a driver who keeps going [m/s2]


class SignalError(NamedTuple):
    """Error of a signal and its rate, in units of the signal, tracked by an alpha-beta filter."""

    value: float = 0.0
    slope: float = 0.0  # [1/s]
    tick: int = -1  # of the last measurement; below 0: none yet
    small: int = 0  # comparisons in a row at which it was small
    exact: bool = False  # True: of a signal that is stuck, so that it is another one by now

    def measured(self, value: float, tick: int, *, exact: bool) -> "SignalError":
        """The error after a measurement; an ``exact`` one is taken as it is."""
        if self.tick < 0:
            return self._replace(value=value, tick=tick, exact=exact)
        interval = max(tick - self.tick, 1) * TICK
        expected = self.value + self.slope * interval
        change = value - expected
        slope = self.slope + _SLOPE * change / interval
        value = expected + (1.0 if exact or self.exact else _VALUE) * change
        return self._replace(value=value, slope=slope, tick=tick, exact=exact)

    def at(self, tick: int) -> float:
        """The error at a tick, extrapolated for some tenths of a second at most."""
        return self.value + self.slope * min((tick - self.tick) * TICK, _AHEAD) if self.tick >= 0 else 0.0


def _is_unknown(error: SignalError | None) -> bool:
    """True for a signal at fault that was not measured yet, or that is stuck: its error changes with the true value."""
    return error is not None and (error.tick < 0 or error.exact)


_KEPT: Final = 2500  # history [ticks]
_WINDOW: Final = 1500  # over which articulations are compared with yaw rates [ticks]
_ALONE: Final = 300  # time without a reference after which the signals are compared with each other alone [ticks]
_LONGEST: Final = 500  # duration of a motion to compare with [ticks]
_DETECTED: Final = 1.0  # value of a relation that is a contradiction [its tolerance]
_BETTER: Final = 0.6  # a fault explains a contradiction if it leaves this share of it at most
_APART: Final = math.radians(2.5)  # difference of the hitch angle from that of a trailer whose axles roll: slip
_PERSISTENT: Final = 3  # comparisons in a row, without evidence beside the relations
_SMALL: Final = 0.4  # effect of a fault that is over [tolerances]
_OVER: Final = 10  # comparisons in a row
_LEAST: Final = 15  # messages before which nothing is found
_RECENT: Final = 2500  # time for which a jump is evidence [ticks]
# Highest rates of change: full braking on dry road twice, a jackknife, and its beginning. assumed.
_RATES: Final = (20.0, math.radians(60.0), math.radians(60.0))  # [m/s2], [rad/s], [rad/s2]


class Finding(NamedTuple):
    """A signal that was found at fault, or sound again."""

    tick: int
    signal: str
    at_fault: bool


class MonitorMemory(NamedTuple):
    """Signals of the last seconds and what was found of them; signals in the order of `ParityRelations`."""

    history: FloatArray  # (n, columns), oldest first
    jumped: tuple[int, ...]  # tick of the last jump of each signal; far in the past: none
    errors: tuple[SignalError | None, ...]  # of each signal that is at fault; None: it is sound
    suspect: tuple[int, int] = (-1, 0)  # signal that explains the last contradictions, and their number in a row
    compared_at: int = 0  # tick of the last reference that they were compared with
    speed: float = 0.0  # of the wheels before they were found at fault [m/s]
    at_odds: bool = False  # the hitch angle and its gyro at the last comparison; once may be noise
    contradicted: bool = False  # True: nothing tells whether the hitch angle or its gyro is at fault
    towed: FloatArray | None = None  # newest row with what others say, while the size of a fault is not known
    findings: tuple[Finding, ...] = ()

    @property
    def distrusted(self) -> tuple[int, ...]:
        """Numbers of the signals at fault."""
        return tuple(k for k, error in enumerate(self.errors) if error is not None)


class SignalMonitor:
    """Monitor of the signals for the steering of one trailer."""

    def __init__(self, vehicle: Vehicle, unit: int) -> None:
        """For the ``unit`` of a vehicle."""
        names = [one.name for one in vehicle.units[: unit + 1]]
        angles, gyros = [f"hitch angle of {name}" for name in names[1:]], [f"gyro of {name}" for name in names]
        self.names = ("wheel speed", *angles, *gyros, STEER_ANGLE)
        self._either = f"{self.names[unit]} or its gyro"
        self._unit, self._scrub = unit, TyreScrub(vehicle, unit)
        self._relations = ParityRelations(vehicle, unit, self._scrub.axle_distance)
        self._noise = np.array([SPEED_NOISE, *[ARTICULATION_NOISE] * unit, *[GYRO_NOISE] * (unit + 1), STEER_NOISE])
        self._rates = np.array([_RATES[0], *[_RATES[1]] * unit, *[_RATES[2]] * (unit + 1), _RATES[1]])
        self._least_jump = _JUMP_SIGMAS * self._noise
        self._columns = [SPEED, *range(FIRST, FIRST + 2 * unit + 1), STEER]

    def init(self) -> MonitorMemory:
        """Memory before the first message: all signals are sound."""
        n = len(self.names)
        return MonitorMemory(np.empty((0, FIRST + n - 1)), (-_RECENT,) * n, (None,) * n)

    def received(self, memory: MonitorMemory, signals: CombinationSignals) -> MonitorMemory:
        """Memory with a message; those without a number, or out of order, are passed over.

        Signals of a vehicle without a hitch do not check each other: all are passed over.
        """
        if self._unit == 0:
            return memory
        row, history = self._row(signals), memory.history
        if not all(map(math.isfinite, row.tolist())) or (len(history) and signals.tick <= history[-1, 0]):
            return memory
        jumped = self._jumped(memory, row) if len(history) >= _LEAST else memory.jumped
        towed = self._towed(memory, row, memory.towed)
        kept = history[history[:, 0].searchsorted(signals.tick - _KEPT) :]
        memory = memory._replace(history=np.concatenate([kept, row[None]]), jumped=jumped, towed=towed)
        if signals.tick - memory.compared_at > _ALONE and signals.tick % 100 == 0:
            return self._compared(memory, None, signals.tick)
        return memory

    def compared(self, memory: MonitorMemory, reference: MotionReference) -> MonitorMemory:
        """Memory after the comparison with an independent measurement, which is older than the newest signals.

        One over a long time, as after an outage, is passed over: its motion is not constant.
        """
        ticks, span = memory.history[:, 0], reference.tick - reference.previous_tick
        if not len(ticks) or ticks[0] > reference.previous_tick or ticks[-1] < reference.tick or span > _LONGEST:
            return memory
        return self._compared(memory._replace(compared_at=reference.tick), reference, reference.tick)

    def corrected(self, memory: MonitorMemory, signals: CombinationSignals) -> CombinationSignals:
        """The newest message with corrected values of signals at fault; the same object if there are none."""
        if not (memory.contradicted or memory.distrusted):
            return signals
        row = self._without_errors(memory, self._row(signals))
        if memory.towed is not None:
            replaced = self._replaced(memory)
            row[replaced] = memory.towed[replaced]
        articulation, yaw_rates, n = signals.articulation.copy(), signals.yaw_rates.copy(), self._unit
        articulation[:n], yaw_rates[: n + 1] = row[FIRST : FIRST + n], row[FIRST + n : FIRST + 2 * n + 1]
        steer = float(row[STEER]) if memory.errors[-1] is None else 0.0  # front wheels that do not slip need no angle
        return replace(signals, speed=float(row[SPEED]), steer=steer, articulation=articulation, yaw_rates=yaw_rates)

    def corrected_again(
        self, memory: MonitorMemory, messages: Sequence[CombinationSignals]
    ) -> tuple[CombinationSignals, ...]:
        """Past messages, oldest first, corrected by what is known now; the first one is of before the fault."""
        memory, corrected = memory._replace(towed=None), []
        for message in messages:
            row = self._row(message)
            if all(map(math.isfinite, row.tolist())):
                memory = memory._replace(towed=self._towed(memory, row, memory.towed))
            corrected.append(self.corrected(memory, message))
        return tuple(corrected)

    def speed_std(self, memory: MonitorMemory, rows: FloatArray) -> float:
        """Standard deviation [m/s] of the mean speed over some rows, if none was measured since they began."""
        is_made = _is_unknown(memory.errors[0])
        return _UNKNOWN_ACCELERATION * self._relations.unknown_time(rows, _TURNING) if is_made else 0.0

    def doubts(self, memory: MonitorMemory) -> tuple[str, ...]:
        """Names of the signals at fault, or of the two that contradict each other."""
        contradicting = (self._either,) if memory.contradicted else ()
        return (*contradicting, *(self.names[k] for k in memory.distrusted))

    def _compared(self, memory: MonitorMemory, reference: MotionReference | None, tick: int) -> MonitorMemory:
        if len(memory.history) < _LEAST:
            return memory
        level = noise_level(memory.history, self._unit)
        parity = self._relations.parity(memory.history, _WINDOW, level, reference, tick)
        known = [parity.signature(k) for k in memory.distrusted]
        left, _ = misfit(parity.values, known)
        if left > _DETECTED:
            memory = self._suspected(memory, parity, left, is_alone=reference is None)
        else:
            memory = memory._replace(suspect=(-1, 0))
        if 0 not in memory.distrusted and self._no_speed(memory):
            memory = self._distrusted(memory, 0)
        of_hitch = abs(float(parity.values[self._unit - 1])) > _DETECTED  # the relation A of the trailer's own hitch
        is_suspect = memory.suspect[0] >= 0 and not memory.contradicted  # a contradiction lasts until one is found
        unexplained = left > _DETECTED and not is_suspect and not memory.distrusted
        alive = unexplained and bool(np.median(np.ptp(memory.history[-_REPEATED:, self._columns], axis=0)) > 0.0)
        at_odds = (of_hitch or memory.contradicted) and alive
        memory = self._doubted(memory, at_odds or (reference is None and self._lasts(memory)))
        return memory if reference is None else self._measured(memory, parity, tick)

    def _suspected(self, memory: MonitorMemory, parity: Parity, left: float, *, is_alone: bool) -> MonitorMemory:
        """Memory after a contradiction that the known faults do not explain."""
        known = [parity.signature(k) for k in memory.distrusted]

        def explains(other: FloatArray) -> bool:
            return misfit(parity.values, [*known, other])[0] <= min(_DETECTED, _BETTER * left)

        others = [k for k in range(len(self.names)) if k not in memory.distrusted]
        fitting = [k for k in others if explains(parity.signature(k))]
        is_evident = self._evident(memory)
        evident = [k for k in fitting if is_evident[k]]
        doubtful = not is_alone and any(map(explains, parity.excuses))
        if len(evident) == 1:
            return self._distrusted(memory, evident[0])
        if len(fitting) != 1 or doubtful or is_alone:
            return memory._replace(suspect=(-1, 0))
        (signal,) = fitting
        count = 1 + (memory.suspect[1] if memory.suspect[0] == signal else 0)
        memory = memory._replace(suspect=(signal, count))
        return self._distrusted(memory, signal) if count >= _PERSISTENT else memory

    def _lasts(self, memory: MonitorMemory) -> bool:
        """True for a contradiction that the relations forget, as a jump, while the angle is not as the others say."""
        angle, found = FIRST + self._unit - 1, {self._unit, 1 + 2 * self._unit} & {*memory.distrusted}
        if not memory.contradicted or memory.towed is None or found:
            return False
        return abs(float(memory.history[-1, angle] - memory.towed[angle])) > _APART

    def _doubted(self, memory: MonitorMemory, at_odds: bool) -> MonitorMemory:
        """Memory with the contradiction between the hitch angle and the gyro of the trailer, or without."""
        contradicted, memory = at_odds and memory.at_odds, memory._replace(at_odds=at_odds)
        if contradicted == memory.contradicted:
            return memory
        findings = (*memory.findings, Finding(int(memory.history[-1, 0]), self._either, contradicted))
        return self._with_towed(memory._replace(contradicted=contradicted, findings=findings))

    def _replaced(self, memory: MonitorMemory) -> list[int]:
        """Columns of speed, hitch angles and the trailer's yaw rate that are at fault by an amount not known."""
        n = self._unit
        unknown = [_is_unknown(error) for error in memory.errors]
        if memory.contradicted:
            unknown[n] = unknown[1 + 2 * n] = True
        return [self._columns[k] for k in (*range(1 + n), 1 + 2 * n) if unknown[k]]

    def _with_towed(self, memory: MonitorMemory) -> MonitorMemory:
        """Memory with the trailer by other signals, since the last comparison with a reference if that is known."""
        if memory.towed is not None and memory.compared_at < memory.history[0, 0]:
            return memory
        towed = None
        for row in memory.history[memory.history[:, 0].searchsorted(memory.compared_at) :]:
            towed = self._towed(memory, row, towed)
        return memory._replace(towed=towed)

    def _towed(self, memory: MonitorMemory, row: FloatArray, before: FloatArray | None) -> FloatArray | None:
        """A row with what is not known made of the other signals, and of the row ``before``, from which angles go on.

        Without one the angles are the measured ones. None if all is known.
        """
        replaced, n = self._replaced(memory), self._unit
        if not replaced:
            return None
        row = self._without_errors(memory, row)
        if before is not None:
            interval = float(row[0] - before[0]) * TICK
            if SPEED in replaced:
                row[SPEED] = before[SPEED]
                if set(replaced).isdisjoint(range(FIRST, FIRST + n)):  # an angle made of the speed does not show it
                    row[SPEED] = self._relations.with_rolling_speed(before, _TURNING * interval)
            gyros = 0.5 * (before + row)[FIRST + n : FIRST + 2 * n + 1]
            rolls = before[SPEED] > 0.0 and FIRST + n - 1 in replaced  # in reverse the angle would diverge
            gyros[-1] = before[FIRST + 2 * n]
            gyros[-1] += _ROLLING * (self._relations.rolling_rate(before) - gyros[-1]) if rolls else 0.0
            turned = -np.diff(gyros) * interval
            for k in set(replaced) - {SPEED, FIRST + 2 * n}:
                row[k] = before[k] + turned[k - FIRST]
        if FIRST + 2 * n in replaced:
            row[FIRST + 2 * n] = self._relations.rolling_rate(row)
        return row

    def _without_errors(self, memory: MonitorMemory, row: FloatArray) -> FloatArray:
        """A row without the known errors of signals at fault."""
        row, of_speed = row.copy(), memory.errors[0]
        row[self._columns] -= [0.0 if error is None else error.at(int(row[0])) for error in memory.errors]
        if of_speed is not None and of_speed.tick < 0:
            row[SPEED] = memory.speed
        return row

    def _distrusted(self, memory: MonitorMemory, signal: int) -> MonitorMemory:
        errors = (*memory.errors[:signal], SignalError(), *memory.errors[signal + 1 :])
        finding = Finding(int(memory.history[-1, 0]), self.names[signal], True)
        if signal == 0:
            before = memory.history[memory.history[:, 0] < memory.jumped[0], SPEED]
            last = before if len(before) else memory.history[:, SPEED]  # it did not jump
            memory = memory._replace(speed=float(last[-_MEAN_OF:].mean()))
        return self._with_towed(memory._replace(errors=errors, suspect=(-1, 0), findings=(*memory.findings, finding)))

    def _measured(self, memory: MonitorMemory, parity: Parity, tick: int) -> MonitorMemory:
        """Memory with the sizes of the known faults measured anew, and without those that are over."""
        distrusted = memory.distrusted
        if not distrusted:
            return memory
        known = [parity.signature(k) for k in distrusted]
        left, sizes = misfit(parity.values, known)
        shows_slip = np.abs(parity.values[parity.slip.any(axis=1)]) > _DETECTED
        slips = left > _DETECTED and bool(shows_slip.any())
        if slips:
            left, sizes = misfit(parity.values, [*known, parity.slip])  # like every fault but that of the speed
        if left > _DETECTED:
            return memory  # something else is wrong, too
        first = np.cumsum([0, *(signature.shape[1] for signature in known)])
        errors, findings = list(memory.errors), memory.findings
        evident, repeats = self._evident(memory), self._stuck(memory)
        for number, k in enumerate(distrusted):
            signature, size = known[number][:, 0], float(sizes[first[number]])
            error = errors[k]
            if error is None or not signature.any() or (slips and k > 0):
                continue  # not measurable now
            is_small = float(np.max(np.abs(signature * size))) < _SMALL and not evident[k]
            small = error.small + 1 if is_small else 0
            errors[k] = error.measured(size, tick, exact=repeats[k])._replace(small=small)
            if small >= _OVER:
                errors[k] = None
                findings = (*findings, Finding(int(memory.history[-1, 0]), self.names[k], False))
        memory = memory._replace(errors=tuple(errors), findings=findings)
        is_known = all(error is None or error.tick == tick or not _is_unknown(error) for error in errors)
        return self._with_towed(memory) if is_known else memory

    def _evident(self, memory: MonitorMemory) -> list[bool]:
        """Signals that cannot be true by themselves: they jumped, or are stuck."""
        jumped = memory.history[-1, 0] - np.array(memory.jumped) < _RECENT
        return [bool(one) for one in jumped | self._stuck(memory)]

    def _stuck(self, memory: MonitorMemory) -> list[bool]:
        """Signals that repeat themselves exactly in the newest messages while most others are noisy."""
        recent = memory.history[-_REPEATED:, self._columns]
        repeats = (np.ptp(recent, axis=0) == 0.0) & (len(recent) == _REPEATED)
        return [bool(one) and 2 * int(np.sum(repeats)) <= len(repeats) for one in repeats]

    def _no_speed(self, memory: MonitorMemory) -> bool:
        """True if the wheel speed stays the same after a jump, or for a second and is not 0 as of wheels that stand."""
        if memory.history[-1, 0] - memory.jumped[0] < _RECENT:
            return self._stuck(memory)[0]
        newest = memory.history[-_STILL:]
        if len(newest) < _STILL or newest[-1, SPEED] == 0.0 or np.ptp(newest[:, SPEED]) > 0.0:
            return False
        noise = white_noise(newest[:, FIRST + self._unit : FIRST + 2 * self._unit + 1])
        return float(np.median(noise)) > _VISIBLE * GYRO_NOISE

    def _jumped(self, memory: MonitorMemory, row: FloatArray) -> tuple[int, ...]:
        """Tick of the last jump of each signal: a step beyond its highest rate and its noise."""
        change = row - memory.history[-1]
        change[SPEED] *= max(abs(row[SPEED]), abs(memory.history[-1, SPEED])) > _PULSES
        beyond = np.abs(change[self._columns]) - self._rates * change[0] * TICK
        if not (beyond > self._least_jump).any():  # more noise only hides more
            return memory.jumped
        jumps = beyond > _JUMP_SIGMAS * noise_level(memory.history, self._unit) * self._noise
        return tuple(int(row[0]) if one else before for one, before in zip(jumps, memory.jumped, strict=True))

    def _row(self, signals: CombinationSignals) -> FloatArray:
        n, own = self._unit, (signals.tick, signals.speed, signals.steer, self._scrub.rolling(signals))
        readings = (*signals.articulation[:n].tolist(), *signals.yaw_rates[: n + 1].tolist())
        return np.array((*own, *readings, signals.lateral_acceleration))
