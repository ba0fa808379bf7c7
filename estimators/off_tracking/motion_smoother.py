"""Smoothing of a trailer's planar motion by a fixed-lag Kalman smoother, and detection of its standstill.

de Saxe 2018 asks for a Kalman filter that smooths the off-tracking. Successive values of it share all but two of their
motions. Their errors are a random walk over the distance, forgotten after the trailer's length, so a filter that
assumes white noise on them is wrong. The errors of the motions are white, so the motions are filtered: velocities (yaw,
x, y) in the axes of the trailer, at constant acceleration with white jerk. Past velocities are re-estimated with every
later motion (Rauch-Tung-Striebel smoother), so the path at the follow point is smoothed from both sides. The newest
pose is filtered, which has no lag at constant acceleration.

State: offset of the pose from the measured one, velocity, acceleration; three components each. With measurements from
frame to frame the measured pose drifts: a motion's error is process noise of the offset. With measurements from a
keyframe each pose has its own error: the offset is then the measurement.

A motion far from its prediction gets almost no weight, unless the next one is far off as well.

At standstill the noise of an odometry from frame to frame would move the trailer off its path. Motions that are not
significant, singly and in sum, are withheld. As soon as some of them together are significant, the trailer has moved,
and they are released as one motion. So a slow start loses nothing, and a standstill adds no motion and no uncertainty.
"""

import math
from collections.abc import Sequence
from functools import reduce
from itertools import accumulate
from typing import NamedTuple

import numpy as np

from estimators.rigid_motion import (
    PLANAR,
    UncertainMotion,
    chained,
    composed,
    planar_covariance,
    planar_pose,
    with_planar,
)
from vehicle.frames import FloatArray

_LAG = 8  # motions that are re-estimated; at 10 Hz later ones add no information
# White jerk as a density, along yaw [rad/s3/sqrt(Hz)], x and y [m/s3/sqrt(Hz)].
_JERK = np.array([0.05, 1.5, 0.4])
_START = np.array([0.3, 3.0, 1.0])  # initial standard deviation of the acceleration [rad/s2], [m/s2]
_GATE = 16.27  # squared normalised innovation of three components: 99.9 %
_DISBELIEVED = 1e4  # factor on the covariance of an outlier
_LEAST = np.diag([1e-7, 1e-6, 1e-6]) ** 2  # of motions with zero covariance: rounding [rad, m]


class _Measured(NamedTuple):
    """A motion as measured."""

    tick: int  # of its end
    X_PC: FloatArray  # (4, 4)
    span: float  # [s]
    error: FloatArray  # (3, 3) covariance of its yaw, x and y
    anchored: bool  # measured from a keyframe


class Moment(NamedTuple):
    """One motion, the predicted and the corrected state at its end, and the pose there."""

    measured: _Measured
    X_OS: FloatArray  # (4, 4) newest estimate
    predicted: FloatArray  # (9,)
    predicted_covariance: FloatArray  # (9, 9)
    state: FloatArray  # (9,)
    covariance: FloatArray  # (9, 9)
    outlier: bool
    score: float  # squared normalised innovation


Moments = tuple[Moment, ...]  # newest last; the pose of the first one is final


def started(tick: int, X_OS: FloatArray, motion: UncertainMotion, span: float) -> Moments:
    """Filter after its first motion, which took ``span`` [s] and ended at the pose X_OS (4, 4)."""
    error = planar_covariance(motion.covariance) + _LEAST
    state = np.concatenate([np.zeros(3), _moved(motion.X) / span, np.zeros(3)])
    covariance = np.zeros((9, 9))
    covariance[3:6, 3:6], covariance[6:, 6:] = error / span**2, np.diag(_START**2)
    covariance[:3, :3] = _LEAST
    measured = _Measured(tick, motion.X, span, error, False)
    return (Moment(measured, X_OS, state, covariance, state, covariance, False, 0.0),)


def updated(moments: Moments, tick: int, motion: UncertainMotion, span: float, *, anchored: bool) -> Moments:
    """Filter after one more motion of ``span`` [s] that ended at ``tick``, with re-estimated poses.

    ``anchored`` motions are measured from a keyframe.
    """
    measured = _Measured(tick, motion.X, span, planar_covariance(motion.covariance) + _LEAST, anchored)
    last = moments[-1]
    moment = _filtered(last, measured, measured.error)
    if moment.score > _GATE and last.outlier:  # two in a row are a manoeuvre: both are accepted
        last = _filtered(moments[-2], last.measured, last.measured.error)
        moments = (*moments[:-1], last)
        moment = _filtered(last, measured, measured.error)
    elif moment.score > _GATE:
        doubted = _filtered(last, measured, _DISBELIEVED * measured.error)
        moment = doubted._replace(outlier=True, score=moment.score)
    return _smoothed((*moments, moment)[-_LAG - 1 :])


def _filtered(last: Moment, measured: _Measured, error: FloatArray) -> Moment:
    """Moment after a motion, taken to have this covariance (3, 3) of yaw, x and y."""
    _, X_PC, span, _, anchored = measured
    F = _transition(span)
    Q = np.kron(_jerk(span), np.diag(_JERK**2))
    own = 0.5 * error if anchored else _LEAST  # half for each of the two poses of a motion
    if not anchored:
        Q[:3, :3] += error
    predicted = F @ last.state
    predicted[:3] -= _moved(X_PC)
    P = F @ last.covariance @ F.T + Q
    S = P[:3, :3] + own
    gain = np.linalg.solve(S, P[:3]).T
    covariance = P - gain @ P[:3]
    return Moment(
        measured,
        chained(last.X_OS, X_PC),
        predicted=predicted,
        predicted_covariance=P,
        state=predicted - gain @ predicted[:3],
        covariance=0.5 * (covariance + covariance.T),
        outlier=False,
        score=float(predicted[:3] @ np.linalg.solve(S, predicted[:3])),
    )


def _smoothed(moments: Moments) -> Moments:
    """Moments with smoothed poses, except the first one."""
    state, motions = moments[-1].state, []
    for before, moment in zip(moments[-2::-1], moments[:0:-1], strict=True):
        t = moment.measured.span
        gain = np.linalg.solve(moment.predicted_covariance, _transition(t) @ before.covariance).T
        older = before.state + gain @ (state - moment.predicted)
        # from the cubic with these velocities and accelerations at its ends
        moved = 0.5 * t * (older[3:6] + state[3:6]) + t**2 / 12.0 * (older[6:] - state[6:])
        motions.append(_replaced(moment.measured.X_PC, moved))
        state = older
    poses = accumulate(reversed(motions), chained, initial=moments[0].X_OS)
    return tuple(moment._replace(X_OS=X_OS) for moment, X_OS in zip(moments, poses, strict=True))


def _transition(t: float) -> FloatArray:
    """State transition (9, 9) over ``t`` [s] at constant acceleration."""
    return np.kron(np.array([[1.0, t, 0.5 * t**2], [0.0, 1.0, t], [0.0, 0.0, 1.0]]), np.eye(3))


def _jerk(t: float) -> FloatArray:
    """Covariance (3, 3) of distance, velocity and acceleration from white jerk of density 1 over ``t`` [s]."""
    across, ahead, along = t**4 / 8.0, t**3 / 6.0, t**2 / 2.0
    return np.array([[t**5 / 20.0, across, ahead], [across, t**3 / 3.0, along], [ahead, along, t]])


def _moved(X_PC: FloatArray) -> FloatArray:
    """Yaw [rad], x and y [m] (3,) of a motion, along the axes halfway between P and C."""
    yaw, x, y = planar_pose(X_PC).tolist()
    c, s = math.cos(0.5 * yaw), math.sin(0.5 * yaw)
    return np.array([yaw, c * x + s * y, c * y - s * x])


def _replaced(X_PC: FloatArray, moved: FloatArray) -> FloatArray:
    """Motion with its yaw, x and y replaced."""
    yaw, x, y = moved.tolist()
    c, s = math.cos(0.5 * yaw), math.sin(0.5 * yaw)
    return with_planar(X_PC, np.array([yaw, c * x - s * y, s * x + c * y]))


_WINDOW = 15  # consecutive motions that are tested together; detects a creep of a third of a sigma
_STILL_GATE = 25.0  # largest squared normalised motion (yaw, x, y) at standstill: noise exceeds it once in 60 000 times
_STILL_LEAST = np.diag([1e-6, 1e-5, 1e-5]) ** 2  # of motions with zero covariance: rounding [rad, m]
_MOST = np.array([0.003, 0.02, 0.02])  # largest motion that can be noise: a tenth of a second at walking pace [rad, m]


class Step(NamedTuple):
    """Motion, and the tick of the keyframe it was measured from, if any."""

    motion: UncertainMotion
    keyframe: int | None


Withheld = tuple[Step, ...]  # oldest first


def released(withheld: Withheld, step: Step) -> tuple[Withheld, UncertainMotion | None]:
    """Withheld motions after one more, and the released motion; None: the trailer stands."""
    moved, std = planar_pose(step.motion.X), np.sqrt(np.diag(step.motion.covariance)[PLANAR])
    noise_alone = bool(np.all(np.abs(moved) < _MOST) and np.all(std < _MOST))
    if not (noise_alone or withheld):
        return (), step.motion
    steps = (*withheld, step)[-_WINDOW:]
    sums = list(accumulate((s.motion for s in reversed(steps)), lambda newer, older: composed(older, newer)))
    scores = [_score(steps[-k:], total) for k, total in enumerate(sums, start=1)]
    if noise_alone and max(scores) < _STILL_GATE:
        return steps, None
    return (), sums[int(np.argmax(scores))]


def _score(steps: Sequence[Step], total: UncertainMotion) -> float:
    """Squared normalised planar motion of some steps in total; errors from one keyframe do not accumulate."""
    moved, covariance = planar_pose(total.X), total.covariance
    if steps[0].keyframe is not None and all(step.keyframe == steps[0].keyframe for step in steps):
        covariance = reduce(np.add, (step.motion.covariance for step in steps)) / len(steps)
    return float(moved @ np.linalg.solve(planar_covariance(covariance) + _STILL_LEAST, moved))
