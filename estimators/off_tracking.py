"""The off-tracking buffer: the hitch's past path in the frame of the trailer, compared with the follow point.

de Saxe 2018: C. de Saxe, D. Cebon, "Estimation of trailer off-tracking using visual odometry", Vehicle System
Dynamics, 2018. The paper's trailer frame has x to the right, y forward and psi clockwise; here, with S as in
``vehicle.frames`` (x forward, y left, psi anticlockwise),

    x = y_paper,  y = -x_paper,  psi = -psi_paper,  value = -e_tr,  follow_distance = a + b.

Eqs (1) and (2), camera to hitch, are a rigid change of frame done before (``estimators.viso_ot``). Eqs (3) to (5),
rotations and positions of the past hitch in the current frame, are here one chain of 3-D poses X_OS (O: wherever the
buffer began), brought into the current S at the end: body roll and pitch then tilt nothing but the plane that the
path is finally projected on. An increment belongs to the frame it starts from, and the sum of eq. (5) runs over the
increments between the past frame and now; as printed its summand does not depend on its index.

The path is that of a trailer that moves forwards: reversing over the path is not modelled.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from estimators.estimates import Anchor, Health, OffTracking
from estimators.hitch_path import Crossing, chord_lengths, crossing, tangent
from estimators.lateral_uncertainty import lateral_std
from estimators.pose_chain import Sample, extended, first_sample, links_between, positions_now, up_to
from estimators.rigid_motion import UncertainMotion, rotation_vector, stretched
from vehicle.clock import TICK
from vehicle.frames import FloatArray, so3_exp

_BEYOND = 1.0  # path kept behind the follow point, for the fit of its tangent [m]
_FIT = 1.5  # path behind the hitch whose fit gives the hitch's direction [m]
_LONGEST = 3.0  # path kept, in follow distances; half a circle that just reaches the follow point has pi / 2
_UNKNOWN_ACCELERATION = 2.0  # of a truck while the odometry is lost, 1 sigma: firm braking [m/s2]
_UNKNOWN_YAW_ACCELERATION = 0.3  # of its trailer: 15 deg/s within 0.9 s [rad/s2]
_LONGEST_GAP = 1000  # lost for longer, the speed itself is unknown, and the buffer starts again [ticks]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class BodyMotion:
    """Motion of the trailer body S from a previous frame P to the current frame C."""

    tick: int
    previous_tick: int
    X_PC: FloatArray  # (4, 4) pose of the current body in the previous one
    covariance: FloatArray  # (6, 6) of (rotation vector [rad], translation [m]) of X_PC, along the axes of P
    health: Health
    anchor: Anchor | None = None  # as ``estimates.Motion`` has it, for the body


class BufferMemory(NamedTuple):
    """Samples of the body, newest first, and the newest motion that was not lost."""

    samples: tuple[Sample, ...] = ()
    last: BodyMotion | None = None


class OffTrackingBuffer:
    """Off-tracking of a trailer from the motion of its body since the hitch passed the follow point."""

    def __init__(self, follow_distance: float) -> None:
        """A buffer for a follow point ``follow_distance`` [m] behind the hitch, on the trailer's axis.

        Raises:
            ValueError: if ``follow_distance`` is not positive.
        """
        if not follow_distance > 0.0:
            raise ValueError(f"follow_distance = {follow_distance} m must be positive")
        self._follow_distance = follow_distance

    def init(self) -> BufferMemory:
        """An empty buffer."""
        return BufferMemory()

    def step(self, memory: BufferMemory, motion: BodyMotion) -> tuple[BufferMemory, OffTracking]:
        """Buffer with the motion in it, and the off-tracking at its end.

        A lost motion is bridged at the last known velocity. If a later motion starts again at the same
        ``previous_tick``, it takes the place of the bridge. A motion from a tick that is not in the buffer begins
        a new path.
        """
        lost = motion.health is Health.LOST
        if not lost:
            samples, last = _with_motion(memory.samples, motion), motion
        elif memory.last is not None and motion.tick - memory.last.tick <= _LONGEST_GAP:
            motion, last = _bridge(memory.last, motion), memory.last
            samples = _with_motion(memory.samples, motion)
        else:
            samples, last = (first_sample(motion.tick),), None
        line = self._line(samples)
        samples = samples[: len(line.s)]
        return BufferMemory(samples, last), _estimate(samples, line, motion, lost)

    def _line(self, samples: tuple[Sample, ...]) -> _Line:
        """The hitch path as far back as the follow point and the fit of the tangent there can still need it."""
        positions = positions_now(samples)
        s = chord_lengths(positions[:, :2])
        passed = crossing(positions[:, :2], s, -self._follow_distance)
        reach = _LONGEST * self._follow_distance if passed is None else passed.s + _BEYOND
        needed = 2 + int(np.searchsorted(s, reach))  # one more beyond for the cubic
        return _Line(positions[:needed], s[:needed], passed)


class _Line(NamedTuple):
    """The hitch path in the newest S."""

    positions: FloatArray  # (n, 3) newest first [m]
    s: FloatArray  # (n,) length of the chords from the newest point back [m]
    passed: Crossing | None  # where it passes the follow point


def _estimate(samples: tuple[Sample, ...], line: _Line, motion: BodyMotion, lost: bool) -> OffTracking:
    path, passed = line.positions[:, :2], line.passed
    value, std, health, path_tangent = 0.0, math.inf, Health.LOST, 0.0
    if passed is not None:
        path_tangent = tangent(path, line.s, passed.s, 0.5 * _FIT).direction
        if not lost:
            links = links_between(samples, passed.beyond)
            value, std = passed.y, lateral_std(samples, links, line.positions, passed, path_tangent)
            doubtful = any(samples[link.end].doubtful for link in links)
            health = Health.DEGRADED if doubtful else Health.OK
    at_hitch = tangent(path, line.s, 0.0, _FIT)
    v_x, v_y, yaw_rate = _velocity(motion)
    return OffTracking(
        tick=motion.tick,
        value=value,
        std=std,
        health=health,
        path=path,
        hitch_direction=at_hitch.direction,
        hitch_direction_rate=at_hitch.curvature * math.hypot(v_x, v_y) - yaw_rate,
        path_tangent=path_tangent,
        v_x=v_x,
        v_y=v_y,
        yaw_rate=yaw_rate,
    )


def _with_motion(samples: tuple[Sample, ...], motion: BodyMotion) -> tuple[Sample, ...]:
    """The samples up to the motion's start, and its end; a lost one keeps its start, which may be needed again."""
    start = up_to(samples, motion.previous_tick)
    increment = UncertainMotion(motion.X_PC, motion.covariance)
    doubtful, lost = motion.health is not Health.OK, motion.health is Health.LOST
    return extended(start, motion.tick, increment, doubtful, keep_start=lost, anchor=motion.anchor)


def _bridge(last: BodyMotion, lost: BodyMotion) -> BodyMotion:
    """What the lost motion was if the velocity has not changed since the last one, as uncertain as that is."""
    span = (lost.tick - lost.previous_tick) * TICK
    since = (lost.tick - last.tick) * TICK
    ratio = (lost.tick - lost.previous_tick) / (last.tick - last.previous_tick)
    rotation, translation = _UNKNOWN_YAW_ACCELERATION * since * span, _UNKNOWN_ACCELERATION * since * span
    return BodyMotion(
        tick=lost.tick,
        previous_tick=lost.previous_tick,
        X_PC=stretched(last.X_PC, ratio),
        covariance=np.diag([rotation**2] * 3 + [translation**2] * 3),
        health=Health.LOST,
    )


def _velocity(motion: BodyMotion) -> tuple[float, float, float]:
    """v_x, v_y [m/s] along the axes of S and yaw rate [rad/s], constant over the motion."""
    span = (motion.tick - motion.previous_tick) * TICK
    turn = rotation_vector(motion.X_PC[:3, :3])
    v = so3_exp(-0.5 * turn) @ motion.X_PC[:3, 3] / span  # the chord lies half-way between the axes of P and C
    return float(v[0]), float(v[1]), float(turn[2] / span)
