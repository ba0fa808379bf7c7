"""Steering actuators: fault detection, grip of the axles, and demands that make up for faults.

The data sheet's model predicts each angle from the demands that were sent. Its difference from the measured one is
tested by a two-sided CUSUM of log likelihood ratios (E. S. Page, "Continuous inspection schemes", Biometrika 1954)
against a shift by ``_SHIFT`` standard deviations. These contain what the model does not know, in proportion to the
rate: the lag, and when a demand arrives. Such errors last as long as the lag, so that one lag counts as one sample. By
Lorden's bound the mean time between false alarms is then at least ``exp(threshold)`` lags ("Procedures for reacting to
a change in distribution", Annals of Mathematical Statistics 1971), which gives the threshold.

After an alarm the kinds of faults are compared since the shift began, as long as the fault lasts. It is over
when a sound actuator explains the last quarter of a second, and the one at fault does not.

Each hypothesis is the model of a sound actuator with other numbers: it moves to ``gain * demand + offset`` with the
known lag, at a rate limit of its own, some time after the demand was sent. All start from the measured angle at the
beginning of a window. The likeliest explains it; a free number has to gain more than noise would give it (Akaike's
criterion).

While there are faults, other demands are sent than those that are wanted:

- where an axle stands beside its demand, the measured offset is subtracted;
- where an axle does not answer, or slowly, the others take over the steer moment that it lacks or has too much, as far
  as its tyres do not slide; none is steered beyond the slip at which its own side force is largest (`AxleGrip`);
- an axle that does not answer gets the demand of the others, so that it joins them when it answers again.

Where no axle moves, nothing can be taken over: the path is then that of a trailer with fixed axles.

About the hitch the side forces of the tyres balance the inertia of the trailer, which the accelerometer above its axles
measures. The tyres' laws give the forces of the measured slip for a given friction; a Kalman filter finds the friction
that explains them (``controllers.trailer_steering.mpc.observer``). It is only known where tyres slide enough for it to
matter; until then the higher value is assumed, one standard deviation more.

The largest side force is reached at a slip in proportion to the friction. Beyond it an axle only brakes.
"""

import math
from collections.abc import Sequence
from typing import Final, Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from controllers.equations import settle
from controllers.trailer import Actuation, Combination, TrailerGeometry
from controllers.trailer_steering.kinematics import AxleGroup, TractorMotion, reachable
from controllers.trailer_steering.mpc.observer import FrictionMemory, updated
from estimators.off_tracking.parity import STEER_NOISE
from sensors.messages import CombinationSignals
from vehicle.clock import TICK
from vehicle.combination.description import GRAVITY
from vehicle.combination.loads import static_axle_loads
from vehicle.combination.roll import roll_gradients
from vehicle.frames import FloatArray
from vehicle.tyres import Planar

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
        if not all(map(math.isfinite, angles.tolist())) or (last is not None and tick <= last[0]):
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
        kept = memory.history[memory.history[:, 0].searchsorted(tick - _KEPT) :]
        row = np.concatenate([(tick,), sent, angles, std])
        scores, quiet_at = self._scored(memory, tick, (angles - expected) / std, elapsed)
        memory = memory._replace(
            history=np.concatenate([kept, row[None]]), expected=expected, pace=pace, scores=scores, quiet_at=quiet_at
        )
        return self._with_faults(memory, tick) if self._has_alarm(memory) else memory

    def max_rates(self, memory: ActuatorMemory) -> FloatArray:
        """Rate limits (m,) of the actuators as far as they are known [rad/s]; 0: it does not answer."""
        sound = self._trailer.max_steer_rate
        return np.array([sound if fault is None else _answering(fault.hypothesis, sound) for fault in memory.faults])

    def _scored(
        self, memory: ActuatorMemory, tick: int, z: FloatArray, elapsed: float
    ) -> tuple[FloatArray, FloatArray]:
        """Scores (2, m) and quiet ticks (m,) after a step of the test, with residuals z (m,) in standard deviations."""
        samples = elapsed / self._memory
        ratios = _SHIFT * (np.array((z, -z)) - 0.5 * _SHIFT) * samples
        scores = np.maximum(0.0, memory.scores + ratios)
        return scores, np.where(scores[0] + scores[1] > 0.0, memory.quiet_at, float(tick))

    def _has_alarm(self, memory: ActuatorMemory) -> bool:
        return bool(memory.scores.max() > self._limit) or memory.at_fault

    def _with_faults(self, memory: ActuatorMemory, tick: int) -> ActuatorMemory:
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


_SLOWEST: Final = 1.0  # below this speed directions of travel are noise [m/s]
_SLIPS: Final = np.arange(0.01, 1.0, 0.01)  # at which side forces are compared [rad]
_ENOUGH: Final = 0.95  # of the largest side force; the rest would take half as much slip again [-]
_MOTION_ERROR: Final = 0.01  # of directions of travel by the signals, 1 sigma [rad]
_STEP: Final = 0.05  # of the log of the friction, for derivatives


class GripMemory(NamedTuple):
    """Estimated friction, and the directions in which the steered axles travel."""

    friction: FrictionMemory = FrictionMemory()
    travel: FloatArray | None = None  # (n_steered,) directions in which the steered axles travel [rad]; None: unknown


class AxleGrip:
    """Grip of the axles of one trailer."""

    def __init__(self, combination: Combination) -> None:
        """For the signals of the combination's steered trailer."""
        vehicle = combination.vehicle
        unit = vehicle.led_unit(combination.unit)
        self._tractor = TractorMotion(combination)
        self._tyres = [axle.tyre for axle in unit.axles]
        self._x = np.array([axle.x for axle in unit.axles])
        self._steered = np.array([axle.steered for axle in unit.axles])
        self._loads = np.array(static_axle_loads(vehicle)[combination.unit])[-len(unit.axles) :]
        self._share = self._x * self._loads / float(self._x @ self._loads)  # of the moment about the hitch [-]
        self._lean = 1.0 + GRAVITY * roll_gradients(vehicle)[combination.unit]
        self._stiffness = float(self._forces(np.full(len(self._x), 1e-3), 1.0) @ self._share) / 1e-3
        self._slip = self._slip_of_enough()

    def measured(self, memory: GripMemory, signals: CombinationSignals, elapsed: float) -> GripMemory:
        """Memory with new signals, ``elapsed`` [s] after those before."""
        motion = self._tractor.of_hitch(signals)
        if motion.v_x < _SLOWEST:
            return memory._replace(travel=None)
        travel = np.arctan((motion.v_y + self._x * motion.yaw_rate) / motion.v_x)
        angles = np.zeros(len(travel))
        angles[self._steered] = signals.angles
        friction = memory.friction
        lever = self._share * np.cos(angles)
        now, more = (
            float(lever @ self._forces(angles - travel, friction.friction * math.exp(step))) for step in (0.0, _STEP)
        )
        surplus = now - friction.disturbance - signals.lateral_acceleration / (self._lean * GRAVITY)
        friction = updated(
            friction, surplus, (more - now) / _STEP, motion.v_x * elapsed, self._stiffness * _MOTION_ERROR
        )
        return GripMemory(friction, travel[self._steered])

    def limited(self, memory: GripMemory, angles: FloatArray) -> FloatArray:
        """The angles (n_steered,) [rad], as far as the side force of their axles grows."""
        if memory.travel is None:
            return angles
        friction = memory.friction.friction * math.exp(math.sqrt(memory.friction.variance[0]))
        slip = friction * self._slip
        return np.clip(angles, memory.travel - slip, memory.travel + slip)

    def _forces(self, slip: FloatArray, friction: float) -> FloatArray:
        """Side forces (n_axles,) over loads, + left, of axles that point left of their travel by ``slip`` [rad]."""
        tangents = np.tan(slip).tolist()
        return np.array(
            [
                float(tyre.steady_force(Planar(0.0, tangent), 0.5 * load, friction).y) / (0.5 * load)
                for tyre, load, tangent in zip(self._tyres, self._loads.tolist(), tangents, strict=True)
            ]
        )

    def _slip_of_enough(self) -> float:
        """Slip at which nearly the largest side force is reached, over the friction [rad]."""
        forces = np.array([self._forces(np.full(len(self._x), slip), 1.0) @ self._share for slip in _SLIPS])
        return float(_SLIPS[np.argmax(forces >= _ENOUGH * forces.max())])


# Slip by the linear law beyond which side force of a faulty axle is not counted on: tyres on ice, 0.14/4.6 [rad]. What
# is taken over too little, the law's feedback adds.
_SLIDING: Final = 0.03


class SupervisionMemory(NamedTuple):
    """State between two steps."""

    monitor: ActuatorMemory
    sent: tuple[float, ...]  # last demands [rad]
    differs: bool  # True if they were not the wanted ones
    grip: GripMemory  # of the axles, while there is a fault
    at_grip: NDArray[np.bool_]  # (n_steered,) True for axles that could not be steered as far as wanted


class ActuatorSupervision:
    """Demands for actuators that may not follow them."""

    def __init__(self, trailer: TrailerGeometry, combination: Combination) -> None:
        """For a trailer with steered axles."""
        self._trailer = trailer
        self._monitor, self._axles = ActuatorMonitor(trailer), AxleGroup.of(trailer)
        self._grip = AxleGrip(combination)
        self._all = np.ones(len(trailer.steered_distances), dtype=bool)

    def init(self) -> SupervisionMemory:
        """Memory of a new run: all actuators sound, wheels straight."""
        return SupervisionMemory(self._monitor.init(), self._trailer.straight, False, GripMemory(), ~self._all)

    def measured(self, memory: SupervisionMemory, signals: CombinationSignals) -> SupervisionMemory:
        """Memory with new readings of the steer angles."""
        angles = self._trailer.actuator_angles(signals.angles)
        return memory._replace(monitor=self._monitor.measured(memory.monitor, signals.tick, angles))

    def actuation(self, memory: SupervisionMemory, angles: FloatArray) -> Actuation:
        """State of the actuators, with the axles at ``angles`` (n_steered,) [rad]."""
        sent, monitor = np.array(memory.sent), memory.monitor
        if not monitor.at_fault:
            return Actuation(goal=sent, able=self._all)
        able = self._of_axles(self._monitor.max_rates(monitor) > 0.0)
        goal = np.where(able | ~able.any(), sent + self._trailer.axle_angles(monitor.offsets), angles)
        return Actuation(goal=goal, able=able, at_grip=memory.at_grip)

    def sent(
        self, memory: SupervisionMemory, wanted: FloatArray, signals: CombinationSignals, elapsed: float
    ) -> tuple[SupervisionMemory, FloatArray]:
        """Memory and demands (n_steered,) [rad] for the ``wanted`` angles, ``elapsed`` [s] after those before."""
        monitor, demand, grip, at_grip = memory.monitor, wanted, GripMemory(), ~self._all
        if memory.differs or monitor.at_fault:
            grip = self._grip.measured(memory.grip, signals, elapsed)
            target, at_grip = self._allocated(monitor, grip, wanted, signals.angles)
            demand = reachable(self._trailer, np.array(memory.sent), target, elapsed)
        differs = demand is not wanted and not np.array_equal(demand, wanted)
        monitor = self._monitor.sent(monitor, self._trailer.actuator_angles(demand))
        return SupervisionMemory(monitor, tuple(demand.tolist()), differs, grip, at_grip), demand

    def _allocated(
        self, monitor: ActuatorMemory, grip: GripMemory, wanted: FloatArray, angles: FloatArray
    ) -> tuple[FloatArray, NDArray[np.bool_]]:
        """Demands (n_steered,) [rad] for the angles wanted, by what is known of actuators and grip.

        The mask has the axles that are steered less far than would be wanted, as their side force does not grow.
        """
        trailer, rates = self._trailer, self._monitor.max_rates(monitor)
        able, sound = (self._of_axles(mask) for mask in (rates > 0.0, rates == trailer.max_steer_rate))
        lacking = _SLIDING * np.tanh((np.tan(wanted) - np.tan(angles)) / _SLIDING)
        missing = float(self._axles.steered @ np.where(sound, 0.0, lacking))
        target = self._axles.with_moment(wanted, missing, sound)
        gripping = self._axles.linked(self._grip.limited(grip, target))
        at_grip = sound & (gripping != target) & ~sound.all()
        target = np.where(at_grip, gripping, target)
        if able.any() and not able.all():
            like_others = trailer.axle_angles(np.full(len(rates), trailer.actuator_angles(target)[rates > 0.0].mean()))
            target = np.where(able, target, like_others)
        return target - trailer.axle_angles(monitor.offsets), at_grip

    def _of_axles(self, actuators: NDArray[np.bool_]) -> NDArray[np.bool_]:
        """Mask (n_steered,) of the axles of these actuators."""
        mask = np.zeros(len(self._trailer.steered_distances), dtype=bool)
        for is_in, group in zip(actuators, self._trailer.groups, strict=True):
            mask[list(group)] = is_in
        return mask
