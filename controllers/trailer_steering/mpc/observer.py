"""Observer of the present motion of trailer and hitch, and of the friction of the trailer's tyres.

The off-tracking estimate is 0.1 s old or more; gyros and wheel speeds are current. The hitch's direction of travel over
ground turns with the unit ahead and changes with the roll of that unit's fixed axles. Their lateral slip is not
measured by gyros. The estimates show it, and its rate between two estimates is extrapolated.

About the hitch the side forces of the tyres balance m c times the specific force at the centre of percussion, close to
the axles of a loaded semitrailer. A tyre model on the measured motion predicts the side forces for a given friction.
The difference is due to friction where the tyres slide enough for it to matter, and otherwise to an unknown moment,
which is kept so that the prediction has no offset. An extended Kalman filter estimates both. An unexpected direction of
the hitch's travel looks like a loss of friction; ``uncertainty`` tells the filter.
"""

import math
from typing import Final, NamedTuple

import numpy as np

from controllers.trailer import Combination
from estimators.estimates import OffTracking
from sensors.messages import CombinationSignals
from vehicle.clock import TICK
from vehicle.frames import FloatArray, Pose2

_KEPT: Final = 3000  # age of the records: that of an estimate and the hold, with margin for slow cameras [ticks]
_DIRECTION_TIME: Final = 0.1  # of the direction's correction: about one estimate [s]
_SLIDE_SHARE: Final = 0.3  # of a correction that goes into the slide rate: about critically damped
_SLIDE_TIME: Final = 0.5  # decay of a slide of the unit ahead: tyres grip again [s]
_BIAS_TIME: Final = 5.0  # of the gyro bias and the scale of the speed [s]
_GAP: Final = 0.5  # between estimates, with some missing; after a longer one they start anew [s]
_UNOBSERVED: Final = 0.02  # growth of the direction's uncertainty without estimates [rad/s]
_LEAST_SPEED: Final = 0.5  # a direction of travel is not defined at rest [m/s]


class Record(NamedTuple):
    """Motion at one tick."""

    tick: int
    speed: float  # of the hitch [m/s]
    yaw_rate: float  # of the trailer [rad/s]
    lead_yaw_rate: float  # of the unit ahead [rad/s]
    hitch_direction: float  # of the hitch's travel in the trailer's frame, + left [rad]


class ObserverMemory(NamedTuple):
    """State of the observer between two steps."""

    records: tuple[Record, ...] = ()  # oldest first
    speed_scale: float = 1.0  # speed of the hitch over that from wheels and yaw of the combination [-]
    bias: float = 0.0  # of the trailer's gyro [rad/s]
    slide: float = 0.0  # rate of the hitch's direction due to slip of the unit ahead [rad/s]
    uncertainty: float = 0.0  # of the hitch's direction [rad]
    corrected_at: int | None = None  # last correction [ticks]

    @property
    def now(self) -> Record:
        """The newest record."""
        return self.records[-1]


class Observer:
    """The motion of one trailer of a combination."""

    def __init__(self, combination: Combination) -> None:
        ahead = combination.vehicle.units[combination.unit - 1]
        fixed = [axle.x for axle in ahead.axles if not axle.steered] or [axle.x for axle in ahead.axles]
        self._lever = ahead.rear_hitch[0] - sum(fixed) / len(fixed)  # of the hitch, ahead of the fixed axles [m]
        self._unit = combination.unit

    def with_signals(self, memory: ObserverMemory, signals: CombinationSignals) -> ObserverMemory:
        """Memory with new signals."""
        lead = float(signals.yaw_rates[self._unit - 1])
        own = float(signals.yaw_rates[self._unit]) - memory.bias
        speed = memory.speed_scale * math.hypot(signals.speed, self._lever * lead)
        direction, slide, uncertainty = self._drift(speed, lead), memory.slide, memory.uncertainty
        if memory.records:
            last = memory.now
            span = (signals.tick - last.tick) * TICK
            turned = 0.5 * (lead + last.lead_yaw_rate - own - last.yaw_rate) + slide
            direction += last.hitch_direction - self._drift(last.speed, last.lead_yaw_rate) + turned * span
            slide *= math.exp(-span / _SLIDE_TIME)
            if memory.corrected_at is not None and (signals.tick - memory.corrected_at) * TICK > _GAP:
                uncertainty += _UNOBSERVED * span
        else:
            direction += float(signals.articulation[self._unit - 1])
        kept = tuple(record for record in memory.records if record.tick >= signals.tick - _KEPT)
        records = (*kept, Record(signals.tick, speed, own, lead, direction))
        return memory._replace(records=records, slide=slide, uncertainty=uncertainty)

    def corrected(self, memory: ObserverMemory, estimate: OffTracking, interval: float) -> ObserverMemory:
        """Memory corrected by an estimate ``interval`` [s] after the one before.

        After a gap the averaging time of an estimate's velocities is unknown; it only starts a new series.
        """
        memory = memory._replace(corrected_at=memory.now.tick)
        if interval > _GAP:
            return memory
        middle = record_at(memory.records, estimate.tick - round(0.5 * interval / TICK))  # its velocities are means
        speed = math.hypot(estimate.v_x, estimate.v_y)
        if min(estimate.v_x, middle.speed) < _LEAST_SPEED:
            return memory
        slow, quick = (1.0 - math.exp(-interval / time) for time in (_BIAS_TIME, _DIRECTION_TIME))
        error = math.atan2(estimate.v_y, estimate.v_x) - middle.hitch_direction
        turn = quick * error
        return ObserverMemory(
            records=tuple(record._replace(hitch_direction=record.hitch_direction + turn) for record in memory.records),
            speed_scale=memory.speed_scale * (1.0 + slow * (speed / middle.speed - 1.0)),
            bias=memory.bias + slow * (middle.yaw_rate - estimate.yaw_rate),
            slide=memory.slide + _SLIDE_SHARE * turn / interval,
            uncertainty=max(memory.uncertainty * math.exp(-interval / _SLIDE_TIME), abs(error)),
            corrected_at=memory.corrected_at,
        )

    def _drift(self, speed: float, lead: float) -> float:
        """Direction [rad] of the hitch's travel in the frame of the unit ahead, whose fixed axles do not slip."""
        return math.atan(self._lever * lead / max(speed, _LEAST_SPEED))


class Reckoned(NamedTuple):
    """The trailer's motion since some tick, in its frame S at that tick."""

    frame: Pose2  # S now
    hitch_path: FloatArray  # (n, 2) positions of the hitch since, newest first [m]


def record_at(records: tuple[Record, ...], tick: int) -> Record:
    """The newest record up to a tick, or the oldest one."""
    return next((record for record in reversed(records) if record.tick <= tick), records[0])


def reckoned(records: tuple[Record, ...], since: int) -> Reckoned:
    """The motion since a tick, by the trapezoidal rule."""
    x = y = psi = 0.0
    before, tick, path = record_at(records, since), since, []
    for record in records:
        if record.tick <= since:
            continue
        span = (record.tick - tick) * TICK
        turn = 0.5 * span * (before.yaw_rate + record.yaw_rate)
        course = psi + 0.5 * (turn + before.hitch_direction + record.hitch_direction)
        distance = 0.5 * span * (before.speed + record.speed)
        x, y, psi = x + distance * math.cos(course), y + distance * math.sin(course), psi + turn
        path.append((x, y))
        before, tick = record, record.tick
    return Reckoned(Pose2(x, y, psi), np.array(path[::-1]).reshape(-1, 2))


_FIRST: Final = 0.45  # friction before any measurement: between a dry road and packed snow [-]
_SPREAD: Final = 0.5  # standard deviation of its log at most: 2 sigma reach from 0.17 to 1.2
_RANGE: Final = (math.log(0.12), math.log(1.0))  # of its log: wet ice, dry asphalt
_FRICTION_WALK: Final = 0.15  # random walk of its log per root metre: detects a change within a trailer's length
_MOMENT_SPREAD: Final = 0.03  # standard deviation of the disturbance [-]: tyre stiffness known to 10 or 20 %
_MOMENT_LENGTH: Final = 20.0  # over which it decays; otherwise it and the friction would drift apart [m]
_NOISE: Final = 0.04  # of a measurement over a metre [-]: accelerometer, load transfer, stiffness of the tyres


class FrictionMemory(NamedTuple):
    """The estimate."""

    log_friction: float = math.log(_FIRST)
    disturbance: float = 0.0  # unknown yaw moment over the load moment, + left [-]
    variance: tuple[float, float, float] = (_SPREAD**2, 0.0, _MOMENT_SPREAD**2)  # of both: 11, 12, 22

    @property
    def friction(self) -> float:
        """The friction coefficient [-]."""
        return math.exp(self.log_friction)


def updated(
    memory: FrictionMemory, surplus: float, by_friction: float, distance: float, uncertainty: float
) -> FrictionMemory:
    """The estimate after a ``distance`` [m].

    Args:
        memory: the estimate before.
        surplus: moment of the model's tyres less the disturbance and the moment measured, over the load moment [-].
        by_friction: derivative of the tyres' moment by the log of the friction [-].
        distance: travelled since the estimate before [m].
        uncertainty: standard deviation of the model's moment due to the tyres' motion [-].
    """
    if distance <= 0.0:
        return memory
    a, b, c = memory.variance
    kept = math.exp(-distance / _MOMENT_LENGTH)
    a, c = min(a + _FRICTION_WALK**2 * distance, _SPREAD**2), _MOMENT_SPREAD**2 + (c - _MOMENT_SPREAD**2) * kept**2
    P: FloatArray = np.array([[a, b * kept], [b * kept, c]])
    h = np.array([by_friction, -1.0])
    gain = P @ h / (h @ P @ h + (_NOISE**2 + uncertainty**2) / distance)
    P = P - np.outer(gain, h @ P)
    log_friction = memory.log_friction - float(gain[0]) * surplus
    return FrictionMemory(
        log_friction=max(_RANGE[0], min(_RANGE[1], log_friction)),
        disturbance=memory.disturbance * kept - float(gain[1]) * surplus,
        variance=(float(P[0, 0]), float(P[0, 1]), float(P[1, 1])),
    )
