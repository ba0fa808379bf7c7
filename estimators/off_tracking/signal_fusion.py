"""Fusion of camera motions with the signals of the combination, which bridge outages of the camera.

An error-state Kalman filter whose memory is the path buffer. Its reference is the last pose that the camera measured
and that was believed. From there `DeadReckoning` gives the pose now, with its covariance and its covariance with the
parameters (slip, gyro biases, scale of the wheel speed). A camera motion is believed if it agrees with dead reckoning
(chi-square test on yaw, x and y); then it moves the reference, and the innovation corrects the parameters.

- A motion that is precise goes into the buffer as it is. One that is vague by its stated covariance is weighted with
  dead reckoning.
- Slip is what the camera measures, and no reason to refuse a motion. But a sudden one is not believed for three seconds
  if the axles of both units agree with each other against the camera.
- Where the axles of both units contradict the direction of travel of the camera alike, it may be turned: the
  estimate is degraded, and the angle counts as an error of the path's direction.
- Without a motion that is believed the path goes on by dead reckoning. The error of the off-tracking is that of dead
  reckoning from where the path passes the follow point, or from the reference if that is later. It stays finite for
  ever: parameters that change are forgotten over the distance.
- The first motion after an outage that starts at the reference replaces the bridge. If the odometry went on from a
  frame of the outage, its keyframe may still be older than the outage and serves the same purpose.
- What depends on a signal at fault (``estimators.off_tracking.signal_monitor``) is no evidence; outages are bridged
  with its corrected value, and what was bridged before it was found is reckoned again.
- A camera may be wrong for long. ``misfit`` is the running mean of the test; while it is large no motion is believed.
  Errors of sensors are learnt up to what they may be. Where wheels roll freely and the camera asks for more, its
  distances are in doubt: the estimate is degraded, and they count as an error of the path.
"""

import math
from collections.abc import Sequence
from dataclasses import replace
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from estimators.estimates import Health, OffTracking
from estimators.off_tracking import pose_chain
from estimators.off_tracking.buffer import BodyMotion, BufferMemory, OffTrackingBuffer, velocity
from estimators.off_tracking.dead_reckoning import OWN, SLIP_DISTANCE, DeadReckoning, Parameters, Reckoned
from estimators.off_tracking.parity import MotionReference
from estimators.off_tracking.signal_monitor import STEER_ANGLE, MonitorMemory, SignalMonitor
from estimators.rigid_motion import PLANAR, continued, planar_covariance, planar_pose, spatial_covariance, with_planar
from sensors.messages import CombinationSignals
from vehicle.clock import TICK
from vehicle.combination.description import Vehicle
from vehicle.frames import FloatArray, inverse

Signals = tuple[CombinationSignals, ...]
DIRECTION = "direction of the cameras"  # among the doubts of an estimate
# What dead reckoning leaves out, 1 sigma: roll and pitch of the body on an uneven road, and its heave.
_OUT_OF_PLANE = np.diag([0.01, 0.01, 0.0, 0.0, 0.0, 0.05]) ** 2  # [rad], [m]


class Comparison(NamedTuple):
    """Comparison of a camera motion with dead reckoning over the same stretch."""

    reckoned: Reckoned
    innovation: FloatArray  # (3,) yaw [rad], x and y [m]
    covariance: FloatArray  # (3, 3) of the innovation
    score: float  # chi-square, 3 degrees of freedom
    score_beyond: float  # the same if tyres may slip by any angle
    direction: float  # of travel by the camera less that by dead reckoning [rad]
    parameters: Parameters  # at the end of the motion, if it is believed


def from_reference(path: BufferMemory, motion: BodyMotion, reference: int) -> BodyMotion | None:
    """The motion from the reference instead, through a keyframe that is as old; None if there is none."""
    anchor = motion.anchor
    if motion.previous_tick == reference or anchor is None or anchor.tick > reference:
        return None
    X_OS = {sample.tick: sample.X_OS for sample in path.samples}
    if anchor.tick not in X_OS or reference not in X_OS:
        return None
    X_PA = inverse(X_OS[reference]) @ X_OS[anchor.tick]
    X_PC, covariance, common = continued(X_PA, anchor.uncertain)
    return replace(motion, previous_tick=reference, X_PC=X_PC, covariance=covariance, common=common)


def weighted(motion: BodyMotion, test: Comparison) -> BodyMotion:
    """The motion, degraded, with its yaw, x and y weighted with those of dead reckoning by their variances.

    The path adds motions as if their errors were independent. Those of dead reckoning are alike over a distance.
    """
    P = test.reckoned.covariance
    gain = np.linalg.solve(test.covariance, P).T
    X_PC = with_planar(motion.X_PC, test.reckoned.pose + gain @ test.innovation)
    alike = max(1.0, SLIP_DISTANCE / max(test.reckoned.distance, _SHORTEST_STEP))
    rest = np.eye(3) - gain
    planar = gain @ planar_covariance(motion.covariance) @ gain.T + alike * rest @ P @ rest.T
    covariance, common = spatial_covariance(planar, np.diag(np.diag(motion.covariance))), motion.common.copy()
    common[PLANAR] = gain @ common[PLANAR]
    return replace(motion, X_PC=X_PC, covariance=covariance, common=common, health=Health.DEGRADED, anchor=None)


REMEMBERED = 20_000  # signals are kept for motions that span an outage of this length [ticks]
_LOOKED_AT = 25  # newest messages
_BEFORE = 2000  # signals kept before the reference, to interpolate and to compare them with each other [ticks]


def extended_history(history: FloatArray, arrived: Sequence[FloatArray], reference: int, tick: int) -> FloatArray:
    """Rows (n, columns) of signals, oldest first, that are needed for motions from the tick ``reference`` on.

    The first column is the tick. A sensor that is frozen repeats its last values under a new time. Its messages are
    left out: working sensors have noise, and do not measure the same twice. Ideal ones without noise do.
    """
    oldest = max(tick - REMEMBERED, reference - _BEFORE)
    kept = history[np.searchsorted(history[:, 0], oldest) :]
    rows = list(history[-1:])
    repeats = np.any(np.diff(kept[-_LOOKED_AT:, 1:], axis=0) == 0.0, axis=0)
    may_repeat = bool(2 * np.sum(repeats) > len(repeats))  # most signals have measured the same twice lately
    for row in arrived:
        last = rows[-1] if rows else None
        later = last is None or (row[0] > last[0] and (may_repeat or not np.array_equal(row[1:], last[1:])))
        if later and np.all(np.isfinite(row)):
            rows.append(row)
    return np.vstack([kept, *rows[len(history[-1:]) :]])


# A correction of 0.1 m over this time moves the axles at 4 deg/s with a law of 0.77 rad/m. Longer would keep a known
# error, shorter would be felt [s].
_DURATION = 1.0
# A shorter bridge, such as that of a late frame, ends in a correction of some millimetres: it is made at once [ticks].
_SHORTEST = 400


class Correction(NamedTuple):
    """A correction that is being made."""

    tick: int  # at which it began
    offset: float  # value before it minus value after it [m]


def corrected(
    before: Correction | None, bridged: OffTracking, measured: OffTracking, since: int, follow_distance: float
) -> Correction | None:
    """Correction at the end of a bridge that began at the tick ``since``, from its estimate to the measured one."""
    if Health.LOST in (bridged.health, measured.health) or measured.tick - since < _SHORTEST:
        return before
    shown = blended(bridged, before, follow_distance)
    return Correction(measured.tick, shown.value - measured.value)


def blended(estimate: OffTracking, correction: Correction | None, follow_distance: float) -> OffTracking:
    """The estimate with the part of the correction that is still to be made.

    What is held back is an error, and adds to the standard deviation.
    """
    if correction is None or estimate.health is Health.LOST:
        return estimate
    left = 1.0 - (estimate.tick - correction.tick) * TICK / _DURATION
    if not 0.0 < left <= 1.0:
        return estimate
    offset = left * correction.offset
    return replace(estimate.sheared(offset, follow_distance), std=math.hypot(estimate.std, offset))


# A healthy motion exceeds it once in three million times if errors are Gaussian: chi-square with 3 degrees of freedom.
# The largest of 3000 healthy motions on roads of class A to E, forwards and backwards, was 30.
_GATE = 33.0
_MEMORY = 0.25  # weight of a motion in the running mean of the test: the last four motions
# The running mean, per component, is 1 at most if all errors are as stated. Above the first limit no motion is
# believed, until the mean is below the second: four to eight motions in a row agree.
_DISTRUSTED, _TRUSTED_AGAIN = 4.0, 1.5
_CORRECTED = 9.0  # covariance of dead reckoning with a corrected signal over that with sound ones; assumed
_ANY_SLIP = np.diag([0.3, 0.3]) ** 2  # of the tractor's rear axle [rad], and of braked wheels per deceleration [s2/m]
# Errors of a signal at fault [m/s], [rad], [rad/s]: what depends on it is no evidence.
_ANY_SPEED, _ANY_ANGLE, _ANY_RATE = 10.0, 1.0, 1.0
_SUDDEN = 30  # motions in a row that are refused since all axles contradict their direction of travel alike
_ALIKE = 0.3  # share of such a contradiction by which those of tractor and trailer differ at most
_TURNED_MEMORY = 8.0  # distance of the running means of that angle and of the error of distances [m]
_TURNED_FOR_LONG = 0.385  # allowed mean share of the limit; 416 of 419 sound drives stay below it [-]
_SHORTEST_LOOK = 0.1  # motion whose direction counts [m]
_STILL_TURNED, _LEVEL = 0.25, 0.04  # such mean below which the doubt is over, where tyres explain no more than [rad]
_STRETCHED, _LEVER = 0.009, 0.5  # mean error of distances from which they are in doubt [-], and its lever [L]
# Standard deviations of a motion over those of dead reckoning from which on the two are weighted: errors of these are
# alike from motion to motion, those of the camera mostly not.
_VAGUE = 5.0
_SHORTEST_STEP = 0.05  # [m]
_ROLLING_STD = 0.003  # of the direction in which the trailer's axles roll, between two frames [rad]
# Rocking of the body on its tyres and springs between two frames, 1 sigma: on rough roads, at a stop and when the
# driver steers fast. It returns, so it does not add up; dead reckoning knows nothing of it.
_ROCKING = np.diag([0.0004, 0.004, 0.005]) ** 2  # yaw [rad], x and y [m]


class Known(NamedTuple):
    """Pose of the path, and the parameters of dead reckoning from there."""

    tick: int  # below 0: nothing was received yet
    parameters: Parameters


class FusionMemory(NamedTuple):
    """Signals, the reference, and the state of the mutual check."""

    history: FloatArray  # (n, columns) `DeadReckoning.row` of the signals since the reference, oldest first
    monitor: MonitorMemory  # of the signals
    reference: Known  # last pose that was measured and believed
    recent: Signals = ()  # as received since the reference, and one before it; not older than `REMEMBERED`
    misfit: float = 1.0
    distrusted: bool = False  # True: the camera has disagreed for long
    sudden: int = 0  # motions in a row that were refused since all axles contradict them alike
    alike: float = 0.0  # running mean of the angle by which all axles contradict the camera alike [share of its limit]
    turned: float = 0.0  # largest such angle while it is more than tyres explain: the camera may be turned by it [rad]
    stretched: float = 0.0  # running mean of the share by which the camera's distances contradict free wheels
    correction: Correction | None = None  # of the off-tracking after the last bridge


class SignalFusion:
    """Path of one trailer from camera motions and the signals of the combination."""

    def __init__(self, vehicle: Vehicle, unit: int, follow_distance: float, buffer: OffTrackingBuffer) -> None:
        """For the towed ``unit`` of a vehicle with its follow point ``follow_distance`` [m] behind its hitch."""
        self._reckoning, self._unit = DeadReckoning(vehicle, unit), unit
        self._follow_distance, self._buffer = follow_distance, buffer
        self._any_error = np.array([_ANY_SPEED, *[_ANY_ANGLE] * unit, *[_ANY_RATE] * (unit + 1)])
        self._monitor = SignalMonitor(vehicle, unit)

    def init(self) -> FusionMemory:
        """Memory before the first message."""
        return FusionMemory(self._reckoning.no_history(), self._monitor.init(), Known(-1, self._reckoning.prior()))

    def step(
        self, memory: FusionMemory, path: BufferMemory, tick: int, motion: BodyMotion | None, signals: Signals
    ) -> tuple[FusionMemory, BufferMemory, OffTracking | None]:
        """Memory, path and off-tracking at ``tick``, with the motion that arrived, if any, and the new signals.

        The motion may end before ``tick``; dead reckoning adds the rest.
        """
        start = memory.reference
        if start.tick < 0:
            start = start._replace(tick=tick if motion is None else motion.previous_tick)
        monitor_before = memory.monitor
        memory, corrected_signals = self._monitored(memory._replace(reference=start), motion, signals)
        rows = [self._reckoning.row(one) for one in corrected_signals]
        memory = memory._replace(history=extended_history(memory.history, rows, start.tick, tick))
        if memory.monitor.findings != monitor_before.findings:
            memory, path = self._reckoned_again(memory, path)
        estimate = None
        if motion is not None and motion.health is not Health.LOST:
            before = memory
            memory, believed = self._believed(memory, path, motion)
            if believed is not None:
                # the closing error of a bridge is that of its end at the motion's
                bridge = self._bridged(before, path, motion.tick) if path.reckoned else None
                if bridge is not None and all(one.tick != believed.previous_tick for one in bridge[0].samples):
                    bridge = None  # so slow that the sample where the motion starts was too near to its neighbours
                path, estimate = self._buffer.step(path if bridge is None else bridge[0], believed)
                if bridge is not None:
                    since, correction = believed.previous_tick, memory.correction
                    correction = corrected(correction, bridge[1], estimate, since, self._follow_distance)
                    memory = memory._replace(correction=correction)
        if estimate is None or estimate.tick < tick:
            path, estimate = self._bridged(memory, path, tick) or (path, estimate)
        if estimate is None and path.samples:
            path, estimate = self._buffer.step(path, BodyMotion.lost(tick, path.samples[0].tick))
            estimate = replace(estimate, bridged=(tick - memory.reference.tick) * TICK)
        if estimate is None:
            return memory, path, None
        doubts = self._monitor.doubts(memory.monitor)
        stretched = memory.stretched if memory.stretched > _STRETCHED else 0.0
        by_cameras = self._follow_distance * math.hypot(memory.turned, _LEVER * stretched)
        health = Health.DEGRADED if by_cameras > 0.0 and estimate.health is Health.OK else estimate.health
        doubts = (*doubts, DIRECTION) if memory.turned > 0.0 else doubts
        estimate = replace(estimate, std=math.hypot(estimate.std, by_cameras), health=health, doubts=doubts)
        return memory, path, blended(estimate, memory.correction, self._follow_distance)

    def _monitored(
        self, memory: FusionMemory, motion: BodyMotion | None, signals: Signals
    ) -> tuple[FusionMemory, Signals]:
        """Memory with the signals compared with the camera, and signals in which one at fault is corrected."""
        before = monitor = memory.monitor
        for message in signals:
            monitor = self._monitor.received(monitor, message)
        if motion is not None and motion.health is Health.OK:
            reference = MotionReference(motion.tick, motion.previous_tick, *velocity(motion))
            monitor = self._monitor.compared(monitor, reference)
        newest = signals[-1].tick if signals else 0
        since = max(memory.reference.tick, newest - REMEMBERED)
        known = [one for one in memory.recent if one.tick <= since][-1:]
        recent = (*known, *(one for one in (*memory.recent, *signals) if one.tick > since))
        memory = memory._replace(monitor=monitor, recent=recent)
        if monitor.distrusted != before.distrusted:
            memory = memory._replace(misfit=1.0, distrusted=False)  # the camera was judged by signals at fault
        return memory, tuple(self._monitor.corrected(monitor, one) for one in signals)

    def _reckoned_again(self, memory: FusionMemory, path: BufferMemory) -> tuple[FusionMemory, BufferMemory]:
        """Memory and path with all since the reference as the signals say by what is known of them now."""
        since, newest = memory.reference.tick, path.samples[0].tick if path.samples else -1
        rows = [self._reckoning.row(one) for one in self._monitor.corrected_again(memory.monitor, memory.recent)]
        history = memory.history[: np.searchsorted(memory.history[:, 0], since, side="right")]
        memory = memory._replace(history=extended_history(history, rows, since, newest))
        ticks = [sample.tick for sample in reversed(path.samples) if sample.tick >= since]
        if not path.reckoned or since not in ticks or newest - since > REMEMBERED:
            return memory, path
        path = path._replace(samples=pose_chain.up_to(path.samples, since))
        for tick in ticks[1:]:
            path, _ = self._bridged(memory, path, tick) or (path, None)
        return memory, path

    def _bridged(self, memory: FusionMemory, path: BufferMemory, tick: int) -> tuple[BufferMemory, OffTracking] | None:
        """Path extended to ``tick`` by dead reckoning; None without signals."""
        reference, history = memory.reference, memory.history
        newest = path.samples[0].tick if path.samples else reference.tick
        misleading = set(self._monitor.doubts(memory.monitor)) - {STEER_ANGLE}
        speed_std = self._monitor.speed_std(memory.monitor, history[history[:, 0].searchsorted(reference.tick) :])

        def reckoned(since: int) -> Reckoned | None:
            parameters = self._since(reference, path, since)
            known = self._reckoning.reckoned(history, since, tick, parameters, by_trailer=True)
            if known is None or not misleading:
                return known and self._reckoning.contradicted(known, history, since, parameters)
            by_speed = speed_std * known.by_signals[:, 0]
            return known._replace(covariance=_CORRECTED * known.covariance + np.outer(by_speed, by_speed))

        def spread(since: int) -> FloatArray | None:
            whole = reckoned(since) if tick - since <= REMEMBERED else None
            return None if whole is None else spatial_covariance(whole.covariance, _OUT_OF_PLANE)

        step = reckoned(newest)
        if step is None or tick <= newest:
            return None
        X_PC, covariance = with_planar(np.eye(4), step.pose), spatial_covariance(step.covariance, _OUT_OF_PLANE)
        motion = BodyMotion(tick=tick, previous_tick=newest, X_PC=X_PC, covariance=covariance, health=Health.DEGRADED)
        path, estimate = self._buffer.reckon(path, motion, reference.tick, spread)
        return path, replace(estimate, bridged=(tick - reference.tick) * TICK)

    def _since(self, reference: Known, path: BufferMemory, tick: int) -> Parameters:
        """Parameters at a tick after the reference, without a measurement since."""
        places = [s.X_OS[:2, 3] for s in path.samples if reference.tick <= s.tick <= tick]
        distance = sum(float(np.hypot(*(a - b))) for a, b in pairwise(places))
        return self._reckoning.forgotten(reference.parameters, distance, max(0, tick - reference.tick) * TICK)

    def _believed(
        self, memory: FusionMemory, path: BufferMemory, motion: BodyMotion
    ) -> tuple[FusionMemory, BodyMotion | None]:
        """Memory with the parameters corrected, and the motion as the path gets it; None: it is not believed."""
        reference = memory.reference
        continues = not path.samples or any(sample.tick == motion.previous_tick for sample in path.samples)
        longer, test = from_reference(path, motion, reference.tick), self._tested(memory, motion)
        if test is None:  # no signals
            motion, continues = (motion, continues) if longer is None else (longer, True)
            known = Known(motion.tick, reference.parameters)
            return (memory._replace(reference=known), motion) if continues else (memory, None)
        misfit = memory.misfit + _MEMORY * (min(test.score_beyond, _GATE) / 3.0 - memory.misfit)
        distrusted = misfit > (_TRUSTED_AGAIN if memory.distrusted else _DISTRUSTED)
        apart = abs(test.reckoned.own_slip - test.reckoned.parameters.mean[OWN])  # of tractor and trailer
        sudden = memory.sudden + 1 if test.score > _GATE and apart < _ALIKE * abs(test.direction) else 0
        memory = memory._replace(misfit=misfit, distrusted=distrusted, sudden=sudden)
        if distrusted or test.score_beyond > _GATE or 0 < sudden <= _SUDDEN:
            return memory, None
        spanning = None if longer is None else self._tested(memory, longer)
        if longer is not None and spanning is not None and spanning.score_beyond <= _GATE:
            test, motion, continues = spanning, longer, True
        if not continues:
            return memory, None
        variances = np.diag(motion.covariance) + (_VAGUE**2 - 1.0) * np.sum(np.square(motion.common), axis=1)
        if np.any(variances[PLANAR] > _VAGUE**2 * np.diag(test.reckoned.covariance + _ROCKING)):
            motion = weighted(motion, test)
        return self._doubted(memory._replace(reference=Known(motion.tick, test.parameters)), test), motion

    def _doubted(self, memory: FusionMemory, test: Comparison) -> FusionMemory:
        """Memory after a motion that is believed, with what may be wrong of the camera's direction and distances."""
        distance = test.reckoned.distance
        if distance < _SHORTEST_LOOK:
            return memory  # at walking pace directions of travel are noise
        share = min(1.0, distance / _TURNED_MEMORY)
        now, usual, stretched = self._reckoning.contradictions(test.parameters, memory.history)
        if stretched > 0.0:
            stretched += abs(float(test.innovation[1])) / distance  # what the error of the wheels leaves
        memory = memory._replace(stretched=memory.stretched + share * (stretched - memory.stretched))
        if memory.sudden:  # it is believed since it lasts
            alike, turned = math.copysign(1.0, test.direction), max(memory.turned, abs(test.direction))
            return memory._replace(alike=alike, turned=turned)
        if math.isinf(usual):
            return memory
        alike = memory.alike + share * (now / usual - memory.alike)
        size = max(abs(now), abs(alike) * usual)
        begins = abs(now) > usual or abs(alike) > _TURNED_FOR_LONG
        is_turned = begins or (memory.turned > 0.0 and (abs(alike) > _STILL_TURNED or usual > _LEVEL))
        return memory._replace(alike=alike, turned=max(memory.turned, size) if is_turned else 0.0)

    def _tested(self, memory: FusionMemory, motion: BodyMotion) -> Comparison | None:
        """Comparison of the motion with dead reckoning; None without signals."""
        parameters = memory.reference.parameters
        reckoned = self._reckoning.reckoned(memory.history, motion.previous_tick, motion.tick, parameters)
        if reckoned is None:
            return None
        innovation = planar_pose(motion.X_PC) - reckoned.pose
        S = reckoned.covariance + planar_covariance(motion.covariance)
        faulty = [k for k in memory.monitor.distrusted if k < len(self._any_error)]
        by_faulty = reckoned.by_signals[:, faulty] * self._any_error[faulty]
        S += by_faulty @ by_faulty.T
        gain = np.asarray(np.linalg.solve(S, reckoned.cross.T).T, dtype=np.float64)
        expected = S + _ROCKING
        any_slip = expected + reckoned.by_slip @ _ANY_SLIP @ reckoned.by_slip.T
        distance = math.copysign(max(reckoned.distance, _SHORTEST_STEP), reckoned.pose[1])
        direction = float(innovation[2]) / distance
        # slip of the trailer's axles, by the camera
        own_slip, own_std = reckoned.own_slip + direction, math.sqrt(motion.covariance[4, 4]) / distance
        mean, covariance = reckoned.parameters
        corrected = Parameters(mean + gain @ innovation, covariance - gain @ S @ gain.T)
        corrected = self._reckoning.possible(corrected, reckoned.level)
        return Comparison(
            reckoned,
            innovation,
            S,
            score=float(innovation @ np.linalg.solve(expected, innovation)),
            score_beyond=float(innovation @ np.linalg.solve(any_slip, innovation)),
            direction=direction,
            parameters=self._reckoning.with_own_slip(corrected, own_slip, math.hypot(own_std, _ROLLING_STD)),
        )
