"""Off-tracking buffer: the past path of the hitch in the trailer frame, compared with the follow point.

In de Saxe 2018 the trailer's frame has x to the right, y forward and psi clockwise; here, with S as in
``vehicle.frames`` (x forward, y left, psi anticlockwise),

    x = y_paper,  y = -x_paper,  psi = -psi_paper,  value = -e_tr,  follow_distance = a + b.

Eqs (1) and (2), camera to hitch, are a rigid change of frame, applied before (``estimators.off_tracking.viso_ot``).
Eqs (3) to (5), rotations and positions of the past hitch in the current frame, are replaced by one chain of 3-D poses
X_OS (O: frame in which the buffer starts), transformed into the current S at the end. Body roll and pitch then affect
only the plane of the final projection. An increment belongs to the frame it starts from. The sum of eq. (5) runs over
the increments between the past frame and now; as printed its summand does not depend on its index.

The path is the track of the hitch during forward travel. In reverse the part ahead of the hitch is removed, and the
off-tracking remains the offset of the rest of the path at the follow point. For that, some path is kept behind the
follow point. In forward travel the path continues from the hitch. Standstill is detected in
``estimators.off_tracking.motion_smoother``.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from estimators.estimates import Anchor, Health, OffTracking
from estimators.off_tracking import pose_chain
from estimators.off_tracking.hitch_path import Crossing, Tangent, crossing, tangent
from estimators.off_tracking.motion_smoother import Moments, Step, Withheld, released, started, updated
from estimators.off_tracking.pose_chain import Sample
from estimators.rigid_motion import UncertainMotion, inverted, nothing_common, rotation_vector, stretched
from vehicle.clock import TICK
from vehicle.frames import FloatArray, arc_length, inverse, so3_exp

REVERSING = 20.0  # longest reversing manoeuvre that keeps its path: into a yard, or another attempt [m]
_BEYOND = 1.0  # path kept behind the follow point, for the tangent there [m]
_FIT = 1.5  # path behind the hitch that its direction is fitted to [m]
_LONGEST = 3.0  # path kept [follow distances]; half a circle that just reaches the follow point has pi / 2
_UNKNOWN_ACCELERATION = 2.0  # of a truck while the odometry is lost, 1 sigma: firm braking [m/s2]
_UNKNOWN_YAW_ACCELERATION = 0.3  # of its trailer, 1 sigma: 15 deg/s within 0.9 s [rad/s2]
_LONGEST_GAP = 1000  # after a longer loss the speed is unknown, and the buffer restarts [ticks]
_LONGEST_REST = 5000  # the same for a trailer at standstill before and after the loss [ticks]
# A trailer at standstill before and after T seconds may have moved by 0.2 m/s2 T^2 (pulling away at 0.5 m/s2, then
# braking). Of halts of a minute a share T / 60 s ends in that time.
_SHIFTED, _HALT = 0.2, 60.0  # [m/s2], [s]
_SHARPEST = 10.0  # least radius of such a move [m]
_ROLLING = 0.3  # below it the last motion does not give the direction of travel [m/s]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class BodyMotion:
    """Motion of the trailer body S from a previous frame P to the current frame C."""

    tick: int
    previous_tick: int
    X_PC: FloatArray  # (4, 4) pose of the current body in the previous one
    covariance: FloatArray  # (6, 6) of (rotation vector [rad], translation [m]) of X_PC, along the axes of P
    health: Health
    anchor: Anchor | None = None  # as in ``estimates.Motion``, for the body
    common: FloatArray = field(default_factory=nothing_common)  # likewise

    @property
    def uncertain(self) -> UncertainMotion:
        """X_PC with its covariance."""
        return UncertainMotion(self.X_PC, self.covariance, self.common)

    @classmethod
    def lost(cls, tick: int, previous_tick: int) -> "BodyMotion":
        """Motion without information."""
        unknown = np.diag(np.full(6, np.inf))
        return cls(tick=tick, previous_tick=previous_tick, X_PC=np.eye(4), covariance=unknown, health=Health.LOST)


class BufferMemory(NamedTuple):
    """Samples of the path and the state of standstill detection and smoother."""

    samples: tuple[Sample, ...] = ()  # of the body, newest first
    last: BodyMotion | None = None  # newest that was not lost
    withheld: Withheld = ()  # motions at standstill
    moments: Moments = ()  # of the smoother; empty: it starts with the next motion
    reckoned: bool = False  # True: the newest samples are dead-reckoned


class OffTrackingBuffer:
    """Off-tracking of a trailer from the motions of its body."""

    def __init__(
        self, follow_distance: float, *, reversing_distance: float = REVERSING, smoothing: bool = False
    ) -> None:
        """A buffer for a follow point ``follow_distance`` [m] behind the hitch, on the trailer's axis.

        The path is kept for reversing over ``reversing_distance`` [m]. ``smoothing`` turns on a Kalman filter of the
        motions (``estimators.off_tracking.motion_smoother``).

        Raises:
            ValueError: if ``follow_distance`` is not positive, or ``reversing_distance`` negative.
        """
        if not follow_distance > 0.0:
            raise ValueError(f"follow_distance = {follow_distance} m must be positive")
        if not reversing_distance >= 0.0:
            raise ValueError(f"reversing_distance = {reversing_distance} m must not be negative")
        self._follow_distance, self._reversing_distance = follow_distance, reversing_distance
        self._smoothing = smoothing

    def init(self) -> BufferMemory:
        """An empty buffer."""
        return BufferMemory()

    def step(self, memory: BufferMemory, motion: BodyMotion) -> tuple[BufferMemory, OffTracking]:
        """Buffer with the motion in it, and the off-tracking at its end.

        A lost motion is bridged at the last known velocity. A later motion that starts at the same ``previous_tick``
        replaces the bridge. A motion from a tick that is not in the buffer starts a new path.
        """
        if motion.health is not Health.LOST:
            memory = _with_motion(memory, motion)
            memory = _smoothed(memory, motion) if self._smoothing and not memory.withheld else memory
            motion = memory.last or motion
        elif memory.last is not None and motion.tick - memory.last.tick <= (
            _LONGEST_REST if memory.withheld else _LONGEST_GAP
        ):
            motion = _bridge(memory.last, motion)
            # its start is kept for a motion that replaces the bridge
            start = pose_chain.up_to(memory.samples, motion.previous_tick)
            samples = pose_chain.extended(start, motion.tick, motion.uncertain, doubtful=True, keep_start=True)
            memory = memory._replace(samples=samples)
        else:
            memory = BufferMemory((pose_chain.first_sample(motion.tick),))
        return self._estimated(memory, motion)

    def reckon(
        self, memory: BufferMemory, motion: BodyMotion, since: int, spread: Callable[[int], FloatArray | None]
    ) -> tuple[BufferMemory, OffTracking]:
        """Buffer with a dead-reckoned motion from its newest sample, and the off-tracking at its end.

        The path is dead-reckoned since a tick. Its errors are correlated from step to step, so the newest sample counts
        as measured from where the path passes the follow point, or from that tick if it is later: ``spread(tick)`` is
        the covariance (6, 6) of dead reckoning from a tick to the motion's end, along the axes of the body at that
        tick; None if it is not known. A later measured motion from a sample before it replaces its end and corrects the
        path between.
        """
        start = pose_chain.up_to(memory.samples, motion.previous_tick)
        samples = pose_chain.extended(start, motion.tick, motion.uncertain, doubtful=True, keep_start=False, kept=since)
        hitch_path = self._hitch_path(samples)
        passed = samples[-1 if hitch_path.passed is None else hitch_path.indices[hitch_path.passed.beyond]]
        for sample in reversed([sample for sample in samples[1:] if sample.tick >= max(since, passed.tick)]):
            covariance = spread(sample.tick)
            if covariance is not None:
                samples = pose_chain.measured_from(samples, sample.tick, covariance)
                break
        return self._estimated(BufferMemory(samples, motion, reckoned=True), motion)

    def closed(self, memory: BufferMemory, index: int, X_CK: UncertainMotion) -> tuple[BufferMemory, OffTracking]:
        """Buffer and off-tracking after the sample at ``index`` was measured at X_CK in the newest one."""
        assert memory.last is not None
        samples = pose_chain.closed(memory.samples, index, X_CK.X)
        measured = pose_chain.measured_from(samples, samples[index].tick, inverted(X_CK).covariance)
        _, estimate = self._estimated(memory._replace(samples=measured), memory.last)
        return memory._replace(samples=samples), estimate  # neighbours keep their own links, which are more precise

    def _estimated(self, memory: BufferMemory, motion: BodyMotion) -> tuple[BufferMemory, OffTracking]:
        """Buffer without the samples that are not needed any more, and the off-tracking at its end."""
        hitch_path = self._hitch_path(memory.samples)
        estimate = _estimate(memory.samples, hitch_path, motion)
        return memory._replace(samples=memory.samples[: hitch_path.kept]), estimate

    def _hitch_path(self, samples: tuple[Sample, ...]) -> "_HitchPath":
        """Hitch path as far back as the follow point and the tangent there need it."""
        R_OS, all_positions = pose_chain.levelled(samples)
        indices = np.flatnonzero([sample.on_path for sample in samples])
        positions = all_positions[indices]
        s = arc_length(positions[:, :2])
        passed = crossing(positions[:, :2], s, -self._follow_distance)
        reach = _LONGEST * self._follow_distance if passed is None else passed.s + _BEYOND
        needed = 2 + int(np.searchsorted(s, reach))  # one more point for the cubic
        kept = 2 + int(np.searchsorted(s, reach if passed is None else reach + self._reversing_distance))
        return _HitchPath(
            R_OS=R_OS,
            positions=all_positions,
            indices=indices[:needed],
            s=s[:needed],
            passed=passed,
            kept=int(indices[kept]) if kept < len(indices) else len(samples),
        )


class _HitchPath(NamedTuple):
    """Hitch path in the newest S."""

    R_OS: FloatArray  # (3, 3) axes of the newest S, levelled
    positions: FloatArray  # (m, 3) of all samples along these axes, newest first [m]
    indices: NDArray[np.intp]  # (n,) indices of the samples on the path
    s: FloatArray  # (n,) length of the chords from the newest point back [m]
    passed: Crossing | None  # crossing of the follow point's x
    kept: int  # number of samples that can still be needed


def _estimate(samples: tuple[Sample, ...], hitch_path: _HitchPath, motion: BodyMotion) -> OffTracking:
    path, passed = hitch_path.positions[hitch_path.indices, :2], hitch_path.passed
    value, std, health, path_tangent = 0.0, math.inf, Health.LOST, 0.0
    if passed is not None:
        path_tangent = tangent(path, hitch_path.s, passed.s, 0.5 * _FIT).direction
        if motion.health is not Health.LOST:
            crossed = passed._replace(beyond=int(hitch_path.indices[passed.beyond]))
            links = pose_chain.links_between(samples, crossed.beyond)
            positions, R_OS = hitch_path.positions, hitch_path.R_OS
            std = math.hypot(
                pose_chain.lateral_std(samples, links, positions, R_OS, crossed, path_tangent),
                pose_chain.level_std(samples[0].X_OS, R_OS, positions[crossed.beyond]),
            )
            value = passed.y
            doubtful = any(samples[end].doubtful for ends in links for end in ends)
            health = Health.DEGRADED if doubtful else Health.OK
    v_x, v_y, yaw_rate = velocity(motion)
    joined = [samples[index].joined for index in hitch_path.indices.tolist()]
    at_hitch = _hitch_tangent(path, hitch_path.s, joined, v_x, v_y)
    return OffTracking(
        tick=motion.tick,
        value=value,
        std=std,
        health=health,
        path=path,
        hitch_direction=at_hitch.direction,
        hitch_direction_rate=at_hitch.curvature * math.copysign(math.hypot(v_x, v_y), v_x) - yaw_rate,
        path_tangent=path_tangent,
        v_x=v_x,
        v_y=v_y,
        yaw_rate=yaw_rate,
    )


def _hitch_tangent(path: FloatArray, s: FloatArray, joined: list[bool], v_x: float, v_y: float) -> Tangent:
    """Direction of travel of the hitch and its curvature, from the path since it was last cut."""
    fresh = joined.index(True) + 1 if True in joined else len(joined)
    if s[fresh - 1] >= _FIT or math.hypot(v_x, v_y) < _ROLLING:
        fresh = len(joined)
    elif s[fresh - 1] < 0.5 * _FIT and fresh < len(joined):
        kept = tangent(path, s, 0.0, _FIT).curvature
        return Tangent(math.atan2(math.copysign(1.0, v_x) * v_y, abs(v_x)), kept)
    return tangent(path[:fresh], s[:fresh], 0.0, _FIT)


def _with_motion(memory: BufferMemory, motion: BodyMotion) -> BufferMemory:
    """Memory with the samples up to the motion's start, and its end."""
    keyframe = None if motion.anchor is None else motion.anchor.tick
    doubtful = motion.health is not Health.OK
    seamless = memory.last is not None and memory.last.tick == motion.previous_tick
    withheld, moved = released(memory.withheld if seamless else (), Step(motion.uncertain, keyframe))
    start = pose_chain.up_to(memory.samples, motion.previous_tick)
    if not seamless and memory.withheld and memory.last is not None:
        start = _after_rest(memory.samples, memory.last.tick, motion.previous_tick, stands=moved is None)
    if moved is None:
        samples = pose_chain.rested(start, motion.tick, np.zeros((6, 6)), doubtful, keyframe)
        return BufferMemory(samples, replace(motion, X_PC=np.eye(4)), withheld)
    samples = pose_chain.extended(start, motion.tick, moved, doubtful, keep_start=False, anchor=motion.anchor)
    if memory.reckoned:
        samples = pose_chain.with_bridge(samples, memory.samples, motion.previous_tick)
    moments = memory.moments if seamless and not memory.withheld else ()
    return BufferMemory(samples, motion, moments=moments)


def _smoothed(memory: BufferMemory, motion: BodyMotion) -> BufferMemory:
    """Memory with smoothed samples and newest motion of a trailer that moves."""
    span = (motion.tick - motion.previous_tick) * TICK
    if not memory.moments:
        return memory._replace(moments=started(motion.tick, memory.samples[0].X_OS, motion.uncertain, span))
    moments = updated(memory.moments, motion.tick, motion.uncertain, span, anchored=motion.anchor is not None)
    X_OS = {moment.measured.tick: moment.X_OS for moment in moments}
    samples = tuple(sample._replace(X_OS=X_OS.get(sample.tick, sample.X_OS)) for sample in memory.samples)
    X_PC = inverse(moments[-2].X_OS) @ moments[-1].X_OS
    return memory._replace(samples=samples, last=replace(motion, X_PC=X_PC), moments=moments)


def _after_rest(samples: tuple[Sample, ...], since: int, until: int, stands: bool) -> tuple[Sample, ...]:
    """Samples of a trailer that stood at the tick ``since`` and was lost from then to the tick ``until``."""
    if not stands:
        return pose_chain.up_to(samples, until) if until - since <= _LONGEST_GAP else (pose_chain.first_sample(until),)
    blind = (until - since) * TICK
    shift = _SHIFTED * blind**2 * math.sqrt(blind / _HALT)
    covariance = np.diag([(shift / _SHARPEST) ** 2] * 3 + [shift**2] * 3)
    return pose_chain.rested(pose_chain.up_to(samples, since), until, covariance, doubtful=True, keyframe=None)


def _bridge(last: BodyMotion, lost: BodyMotion) -> BodyMotion:
    """Motion at the velocity of the last one in place of a lost motion, with the uncertainty of that guess."""
    span = (lost.tick - lost.previous_tick) * TICK
    since = (lost.tick - last.tick) * TICK
    ratio = (lost.tick - lost.previous_tick) / (last.tick - last.previous_tick)
    rotation, translation = _UNKNOWN_YAW_ACCELERATION * since * span, _UNKNOWN_ACCELERATION * since * span
    covariance = np.diag([rotation**2] * 3 + [translation**2] * 3)
    return replace(lost, X_PC=stretched(last.X_PC, ratio), covariance=covariance)


def velocity(motion: BodyMotion) -> tuple[float, float, float]:
    """v_x, v_y [m/s] along the axes of S and yaw rate [rad/s], constant over the motion."""
    span = (motion.tick - motion.previous_tick) * TICK
    turn = rotation_vector(motion.X_PC[:3, :3])
    v = so3_exp(-0.5 * turn) @ motion.X_PC[:3, 3] / span  # the chord is halfway between the axes of P and C
    return float(v[0]), float(v[1]), float(turn[2] / span)
