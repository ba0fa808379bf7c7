"""Fault detection and isolation of steering actuators, and the kinds of their faults.

The data sheet's model predicts each angle from the demands that were sent. Its difference from the measured one is
tested by a two-sided CUSUM of log likelihood ratios (E. S. Page, "Continuous inspection schemes", Biometrika 1954)
against a shift by ``_SHIFT`` standard deviations. These contain what the model does not know, in proportion to the
rate: the lag, and when a demand arrives. Such errors last as long as the lag, so that one lag counts as one sample. By
Lorden's bound the mean time between false alarms is then at least ``exp(threshold)`` lags ("Procedures for reacting to
a change in distribution", Annals of Mathematical Statistics 1971), which gives the threshold.

After an alarm the kinds of ``actuator_faults`` are compared since the shift began, as long as the fault lasts. It is
over when a sound actuator explains the last quarter of a second, and the one at fault does not.

Each hypothesis is the model of a sound actuator with other numbers: it moves to ``gain * demand + offset`` with the
known lag, at a rate limit of its own, some time after the demand was sent. All start from the measured angle at the
beginning of a window. The likeliest explains it; a free number has to gain more than noise would give it (Akaike's
criterion).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Final, Literal, NamedTuple

import numpy as np

from controllers.equations import settle
from controllers.trailer import TrailerGeometry
from estimators.off_tracking.parity import STEER_NOISE
from vehicle.clock import TICK
from vehicle.frames import FloatArray

Kind = Literal["sound", "stuck", "dead", "slow", "offset", "late"]

_STILL: Final = 1e-9  # rate of an actuator that does not move [rad/s]
_CENTRING: Final = tuple(np.radians([1.0, 2.0, 3.0, 5.0, 8.0, 12.0, 20.0]).tolist())  # rates of dead actuators [rad/s]
_SHARES: Final = (0.02, 0.05, 0.1, 0.15, 0.2, 0.3, 0.4, 0.5, 0.7)  # rate limits of slow ones over their own [-]
_DELAYS: Final = (0.1, 0.15, 0.2, 0.3, 0.4, 0.6, 0.8)  # of demands that come late [s]
_GROWN: Final = (0.9, 1.0, 1.1, 1.3, 1.7, 2.5)  # an offset over the newest residual, which may still grow


class Hypothesis(NamedTuple):
    """An actuator that may be at fault."""

    kind: Kind
    rate: float  # limit [rad/s]
    gain: float = 1.0  # of the demand [-]
    offset: float = 0.0  # [rad]
    delay: float = 0.0  # [s]

    @property
    def is_free(self) -> bool:
        """True if a number of it is fitted."""
        return self.kind not in ("sound", "stuck")


class Window(NamedTuple):
    """Demands of one actuator and what it did over a short time; oldest first."""

    ticks: FloatArray  # (n,)
    sent: FloatArray  # (n,) demands, each until the next [rad]
    angles: FloatArray  # (n,) measured [rad]
    std: FloatArray  # (n,) of the difference between a sound actuator and its model [rad]


def candidates(residual: float, rate: float) -> list[Hypothesis]:
    """Hypotheses for a ``residual`` [rad] of an actuator with this rate limit [rad/s]; the sound one comes first."""
    return [
        Hypothesis("sound", rate),
        Hypothesis("stuck", _STILL),
        *(Hypothesis("dead", centring, gain=0.0) for centring in _CENTRING),
        *(Hypothesis("slow", share * rate) for share in _SHARES),
        *(Hypothesis("offset", rate, offset=grown * residual) for grown in _GROWN),
        *(Hypothesis("late", rate, delay=delay) for delay in _DELAYS),
    ]


def misfits(
    window: Window, hypotheses: Sequence[Hypothesis], *, start: float, lag: float, limit: float, memory: float
) -> FloatArray:
    """Twice the negative log likelihood (k,) of each hypothesis, up to a constant, and 2 for a free number.

    Args:
        window: demands and angles; those before ``start`` are only demands that may come late.
        hypotheses: the actuators to compare.
        start: tick at which all of them have the measured angle.
        lag: time constant of the actuator [s].
        limit: of its angle [rad].
        memory: time in which the residual's errors are correlated [s].
    """
    first = min(int(np.searchsorted(window.ticks, start)), len(window.ticks) - 1)
    rate, gain, offset, delay = (
        np.array([getattr(one, name) for one in hypotheses]) for name in ("rate", "gain", "offset", "delay")
    )
    late = window.ticks[:, None] - delay / TICK
    sent = window.sent[np.maximum(np.searchsorted(window.ticks, late, side="right") - 1, 0)]  # (n, k)
    targets = np.clip(gain * sent + offset, -limit, limit)
    angle, total = np.full(len(hypotheses), window.angles[first]), np.zeros(len(hypotheses))
    for k in range(first, len(window.ticks) - 1):
        span = float(window.ticks[k + 1] - window.ticks[k]) * TICK
        angle = settle(angle, targets[k], span, lag=lag, max_rate=rate)
        total += ((window.angles[k + 1] - angle) / window.std[k + 1]) ** 2 * (span / memory)
    return total + 2.0 * np.array([one.is_free for one in hypotheses])


_CONTROL_ERROR: Final = math.radians(0.2)  # assumed: of a sound actuator at rest, 1 sigma
_LAG_DOUBT: Final = 0.3  # assumed: 1 sigma of the lag over that of the data sheet [-]
_MESSAGE_TIME: Final = 0.03  # assumed: 1 sigma of the time that a demand is under way [s]
_SHIFT: Final = 6.0  # of the residual, that the test finds soonest [its standard deviations]
_BETWEEN_ALARMS: Final = 3.6e7  # mean time between false alarms of an actuator: 10 000 h [s]
_LEAST_LAG: Final = 0.05  # for which errors are correlated: of messages, if the actuator has none [s]
_KEPT: Final = 3000  # history [ticks]
_FITTED: Final = 2000  # window in which kinds are compared [ticks]
_RECENT: Final = 250  # window in which a sound actuator shows that it is [ticks]
_COMPARED_EVERY: Final = 100  # [ticks]
_SURE: Final = 10.0  # twice the log of a likelihood ratio that decides between two hypotheses
_FITS: Final = 2.0  # mean square of the residuals of a hypothesis that is true, at most [-]
_GAP: Final = 500  # without readings, after which the model starts anew [ticks]
_OFFSET_TIME: Final = 0.2  # low-pass of a known offset [s]


class ActuatorFault(NamedTuple):
    """A fault of an actuator, as far as it is known."""

    hypothesis: Hypothesis
    since: int  # begin of the shift [ticks]
    offset: float  # measured offset from the demand [rad]; 0 unless it is of that kind
    compared_at: int  # last comparison of kinds [ticks]


class ActuatorFinding(NamedTuple):
    """A change of what is known of an actuator."""

    tick: int
    axles: tuple[int, ...]  # of the vehicle unit, from 1
    kind: Kind


class ActuatorMemory(NamedTuple):
    """Demands and angles of the last seconds, and what was found; m actuators."""

    history: FloatArray  # (n, 1 + 3 m): tick, demands sent then [rad], angles [rad], standard deviations [rad]
    expected: FloatArray  # (m,) angles of sound actuators now [rad]
    pace: FloatArray  # (m,) their rates, which fade with the lag [rad/s]
    scores: FloatArray  # (2, m) of the CUSUM to either side
    quiet_at: FloatArray  # (m,) last tick without any score
    faults: tuple[ActuatorFault | None, ...]
    findings: tuple[ActuatorFinding, ...]

    @property
    def at_fault(self) -> bool:
        """True if an actuator is."""
        return any(fault is not None for fault in self.faults)

    @property
    def offsets(self) -> FloatArray:
        """Known offsets (m,) of the actuators from their demands [rad]."""
        return np.array([0.0 if fault is None else fault.offset for fault in self.faults])


class ActuatorMonitor:
    """Monitor of the steering actuators of one trailer."""

    def __init__(self, trailer: TrailerGeometry, *, between_alarms: float = _BETWEEN_ALARMS) -> None:
        """For a trailer with steered axles; ``between_alarms`` [s]: mean time between false ones, at least."""
        self._trailer, self._lag = trailer, trailer.actuator_lag
        steered = [k for k, is_steered in enumerate(trailer.steered, start=1) if is_steered]
        self._axles = [tuple(steered[axle] for axle in group) for group in trailer.groups]
        self._memory = max(self._lag, _LEAST_LAG)  # of the residual's errors [s]
        self._time_doubt = math.hypot(_LAG_DOUBT * self._lag, _MESSAGE_TIME)
        self._limit = math.log(2.0 * between_alarms / self._memory)  # two sides

    def init(self) -> ActuatorMemory:
        """Memory before the first reading: all actuators are sound."""
        m = len(self._axles)
        return ActuatorMemory(
            history=np.empty((0, 1 + 3 * m)),
            expected=np.zeros(m),
            pace=np.zeros(m),
            scores=np.zeros((2, m)),
            quiet_at=np.zeros(m),
            faults=(None,) * m,
            findings=(),
        )

    def sent(self, memory: ActuatorMemory, demand: FloatArray) -> ActuatorMemory:
        """Memory with the actuators' demands (m,) [rad] since the last reading."""
        if not len(memory.history):
            return memory
        history = memory.history.copy()
        history[-1, 1 : 1 + len(demand)] = demand
        return memory._replace(history=history)

    def measured(self, memory: ActuatorMemory, tick: int, angles: FloatArray) -> ActuatorMemory:
        """Memory with a reading of the actuators' angles (m,) [rad]; one that is no number is passed over."""
        last, m = memory.history[-1] if len(memory.history) else None, len(angles)
        if not np.isfinite(angles).all() or (last is not None and tick <= last[0]):
            return memory
        if last is None or tick - last[0] > _GAP:
            row = np.concatenate([[tick], angles, angles, np.full(m, self._std(0.0))])
            quiet = np.full(m, float(tick))
            return memory._replace(
                history=row[None], expected=angles, pace=np.zeros(m), scores=np.zeros((2, m)), quiet_at=quiet
            )
        elapsed, sent = (tick - float(last[0])) * TICK, last[1 : 1 + m]
        expected = self._settled(memory.expected, sent, elapsed)
        pace = np.maximum(np.abs(expected - memory.expected) / elapsed, memory.pace * math.exp(-elapsed / self._memory))
        std = self._std(pace)
        kept = memory.history[np.searchsorted(memory.history[:, 0], tick - _KEPT) :]
        row = np.concatenate([[tick], sent, angles, std])
        memory = memory._replace(history=np.vstack([kept, row]), expected=expected, pace=pace)
        memory = self._scored(memory, tick, (angles - expected) / std, elapsed)
        return self._judged(memory, tick) if self._needs_judgement(memory) else memory

    def max_rates(self, memory: ActuatorMemory) -> FloatArray:
        """Rate limits (m,) of the actuators as far as they are known [rad/s]; 0: it does not answer."""
        sound = self._trailer.max_steer_rate
        return np.array([sound if fault is None else _answering(fault.hypothesis, sound) for fault in memory.faults])

    def _scored(self, memory: ActuatorMemory, tick: int, z: FloatArray, elapsed: float) -> ActuatorMemory:
        """Memory after one step of the test, with residuals z (m,) in standard deviations."""
        samples = elapsed / self._memory
        ratios = _SHIFT * (np.stack([z, -z]) - 0.5 * _SHIFT) * samples
        scores = np.maximum(0.0, memory.scores + ratios)
        quiet = np.where((scores > 0.0).any(axis=0), memory.quiet_at, float(tick))
        return memory._replace(scores=scores, quiet_at=quiet)

    def _needs_judgement(self, memory: ActuatorMemory) -> bool:
        return bool(memory.scores.max() > self._limit) or memory.at_fault

    def _judged(self, memory: ActuatorMemory, tick: int) -> ActuatorMemory:
        """Memory with the actuators whose score is too high at fault, and with known faults looked at anew."""
        for k, fault in enumerate(memory.faults):
            if fault is not None:
                memory = self._followed(memory, k, fault, tick)
            elif memory.scores[:, k].max() > self._limit:
                memory = self._found(memory, k, tick)
        return memory

    def _found(self, memory: ActuatorMemory, k: int, tick: int) -> ActuatorMemory:
        since = int(memory.quiet_at[k])
        best, _, _ = self._explained(memory, k, since)
        return self._with(memory, k, ActuatorFault(best, since, best.offset, tick), tick)

    def _followed(self, memory: ActuatorMemory, k: int, fault: ActuatorFault, tick: int) -> ActuatorMemory:
        """Memory with a known fault measured anew: its offset at every reading, its kind at times."""
        fault = fault._replace(offset=self._offset(memory, k, fault))
        if tick - fault.compared_at < _COMPARED_EVERY:
            return self._with(memory, k, fault, tick)
        fault = fault._replace(compared_at=tick)
        if self._is_over(memory, k, fault, tick):
            return self._with(memory, k, None, tick)
        start = max(fault.since, tick - _FITTED)
        best, misfit, gain = self._explained(memory, k, start, fault.hypothesis)
        if best.kind == fault.hypothesis.kind or (gain > _SURE and misfit < _FITS * self._samples(start, tick)):
            offset = fault.offset if best.kind == fault.hypothesis.kind else best.offset
            fault = fault._replace(hypothesis=best, offset=offset)
        return self._with(memory, k, fault, tick)

    def _is_over(self, memory: ActuatorMemory, k: int, fault: ActuatorFault, tick: int) -> bool:
        """True if the last readings are those of a sound actuator, and not those of the fault."""
        start = max(fault.since, tick - _RECENT)
        sound = Hypothesis("sound", self._trailer.max_steer_rate)
        is_sound, is_faulty = self._misfits(memory, k, start, [sound, fault.hypothesis])
        return bool(is_sound < _FITS * self._samples(start, tick) and is_faulty - is_sound > _SURE)

    def _samples(self, start: int, tick: int) -> float:
        """Number of independent residuals between two ticks."""
        return (tick - start) * TICK / self._memory

    def _explained(
        self, memory: ActuatorMemory, k: int, start: int, known: Hypothesis | None = None
    ) -> tuple[Hypothesis, float, float]:
        """Best fault for actuator ``k`` since a tick, its misfit, and how much larger that of the ``known`` one is."""
        residual = float(memory.history[-1, 1 + len(self._axles) + k] - memory.expected[k])
        faults = candidates(residual, self._trailer.max_steer_rate)[1:]
        if known is not None:
            faults.append(known)
        values = self._misfits(memory, k, start, faults)
        best = int(np.argmin(values))
        return faults[best], float(values[best]), float(values[-1] - values[best])

    def _misfits(self, memory: ActuatorMemory, k: int, start: int, hypotheses: list[Hypothesis]) -> FloatArray:
        m = len(self._axles)
        window = Window(memory.history[:, 0], *(memory.history[:, 1 + part * m + k] for part in range(3)))
        limit = self._trailer.max_steer
        return misfits(window, hypotheses, start=start, lag=self._lag, limit=limit, memory=self._memory)

    def _offset(self, memory: ActuatorMemory, k: int, fault: ActuatorFault) -> float:
        """Offset [rad] of the angle from the demand after a reading: an observer of a constant input disturbance."""
        if fault.hypothesis.kind != "offset":
            return 0.0
        m, (before, now) = len(self._axles), memory.history[-2:]
        elapsed = float(now[0] - before[0]) * TICK
        limit = self._trailer.max_steer
        target = max(-limit, min(limit, float(before[1 + k]) + fault.offset))
        predicted = self._settled(before[1 + m + k], target, elapsed)
        by_offset = 1.0 - math.exp(-elapsed / self._memory)
        share = 1.0 - math.exp(-elapsed / _OFFSET_TIME)
        return max(-limit, min(limit, fault.offset + share / by_offset * float(now[1 + m + k] - predicted)))

    def _with(self, memory: ActuatorMemory, k: int, fault: ActuatorFault | None, tick: int) -> ActuatorMemory:
        """Memory with what is known now of actuator ``k``."""
        before, findings = memory.faults[k], memory.findings
        kinds = tuple("sound" if one is None else one.hypothesis.kind for one in (before, fault))
        if kinds[0] != kinds[1]:
            findings = (*findings, ActuatorFinding(tick, self._axles[k], kinds[1]))
        faults = (*memory.faults[:k], fault, *memory.faults[k + 1 :])
        if fault is not None:
            return memory._replace(faults=faults, findings=findings)
        m, scores, expected = len(self._axles), memory.scores.copy(), memory.expected.copy()
        scores[:, k], expected[k] = 0.0, memory.history[-1, 1 + m + k]  # it starts anew
        return memory._replace(faults=faults, findings=findings, scores=scores, expected=expected)

    def _settled(self, angle: FloatArray | float, demand: FloatArray | float, elapsed: float) -> FloatArray:
        return settle(angle, demand, elapsed, lag=self._lag, max_rate=self._trailer.max_steer_rate)

    def _std(self, pace: FloatArray | float) -> FloatArray | float:
        """Standard deviation [rad] of a sound actuator's residual at this pace [rad/s]."""
        return np.sqrt(STEER_NOISE**2 + _CONTROL_ERROR**2 + (self._time_doubt * pace) ** 2)


def _answering(hypothesis: Hypothesis, sound: float) -> float:
    """Rate limit [rad/s] at which an actuator answers to demands."""
    return {"stuck": 0.0, "dead": 0.0, "slow": hypothesis.rate}.get(hypothesis.kind, sound)
