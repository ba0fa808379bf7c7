"""Estimates: value, uncertainty and health at the capture tick of the measurement, and a check of them."""

from __future__ import annotations

import math
from dataclasses import dataclass, field, fields, is_dataclass, replace
from enum import Enum
from functools import cache
from typing import Final

import numpy as np
from numpy.typing import NDArray

from estimators.rigid_motion import UncertainMotion, nothing_common
from vehicle.clock import TICK
from vehicle.frames import FloatArray


class Health(Enum):
    """Reliability of an estimate."""

    OK = "ok"
    DEGRADED = "degraded"  # usable, with a larger stated uncertainty
    LOST = "lost"  # no information: the value must not be used


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Anchor:
    """Older frame A that the current frame C was measured from directly."""

    tick: int  # capture of A
    X_AC: FloatArray  # (4, 4)
    covariance: FloatArray  # (6, 6) of (rotation vector [rad], translation [m]) of X_AC, along the axes of A
    common: FloatArray = field(default_factory=nothing_common)  # (6, 13) part of that error that motions share

    @property
    def uncertain(self) -> UncertainMotion:
        """X_AC with its errors."""
        return UncertainMotion(self.X_AC, self.covariance, self.common)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Motion:
    """Motion of the left camera from the previous frame P to the current frame C.

    A ``LOST`` motion carries the identity and an infinite covariance. The next motion may start at the same
    ``previous_tick`` again: the frame without information is skipped.

    Errors of motions without an anchor are independent and accumulate. If P and C were both measured from the same
    anchor, the errors between them do not accumulate: ``anchor`` then holds the pose error of C, and ``covariance`` is
    that of this single motion.
    """

    tick: int  # capture of the current frame
    previous_tick: int
    X_PC: FloatArray  # (4, 4) pose of the current camera in the previous one
    covariance: FloatArray  # (6, 6) of (rotation vector [rad], translation [m]) of X_PC, along the axes of P
    matches: int  # features matched through all four images
    inliers: int
    health: Health
    tracks: NDArray[np.float32]  # (inliers, 4) u, v in the previous and u, v in the current left image [px]
    anchor: Anchor | None = None  # None: C was measured from P
    # (3, 6) motion from one half of the features less that from the other, in standard deviations of independent
    # errors: left and right, near and far, of the newest keyframe and of older ones; NaN where there are no two halves.
    # None: unknown
    halves: FloatArray | None = None
    # (n, 4) u, v in the left and u, v in the right image of points in the current pair, as it was given to the
    # odometry, located to some hundredths of a pixel, the rows independently [px]; None: unknown
    pairs: NDArray[np.float32] | None = None
    common: FloatArray = field(default_factory=nothing_common)  # (6, 13) part of the error of X_PC that motions share

    @property
    def uncertain(self) -> UncertainMotion:
        """X_PC with its errors."""
        return UncertainMotion(self.X_PC, self.covariance, self.common)


def lost_motion(tick: int, previous_tick: int, matches: int = 0) -> Motion:
    """Motion without information."""
    return Motion(
        tick=tick,
        previous_tick=previous_tick,
        X_PC=np.eye(4),
        covariance=np.diag(np.full(6, np.inf)),
        matches=matches,
        inliers=0,
        health=Health.LOST,
        tracks=np.empty((0, 4), dtype=np.float32),
    )


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class OffTracking:
    """Off-tracking of a trailer and the hitch path it comes from, in the trailer frame S at ``tick``.

    If it is ``LOST`` (the buffer does not reach back to the follow point yet, or the odometry failed), the value is 0,
    its standard deviation is infinite, and the path ends where the buffer ends.
    """

    tick: int
    value: float  # lateral distance of the hitch path from the follow point, + when the path lies left [m]
    std: float  # [m]
    health: Health
    path: FloatArray  # (n, 2) past hitch positions in S, newest first, starting at the hitch itself (0, 0) [m]
    hitch_direction: float  # direction of the hitch's travel in S, + left; in reverse the opposite one [rad]
    hitch_direction_rate: float  # its rate of change in S [rad/s]
    path_tangent: float  # direction of the hitch path, in the sense of forward travel, at the follow point, in S [rad]
    v_x: float  # velocity of the hitch along the axes of S, from the last motions [m/s]
    v_y: float  # [m/s]
    yaw_rate: float  # of the trailer [rad/s]
    bridged: float = 0.0  # time since the last motion that was measured and believed, by dead reckoning [s]
    doubts: tuple[str, ...] = ()  # sensors that contradict the others now, by name

    def age(self, tick: int) -> float:
        """Age of the measurement at ``tick`` [s]."""
        return (tick - self.tick) * TICK

    def sheared(self, offset: float, follow_distance: float) -> OffTracking:
        """The estimate with its path sheared: where it was at the hitch, and ``offset`` [m] more at the follow point.

        The follow point is ``follow_distance`` [m] behind the hitch.
        """
        x, y = self.path.T
        return replace(
            self,
            value=self.value + offset,
            path=np.column_stack([x, y - x * offset / follow_distance]),
            path_tangent=math.atan(math.tan(self.path_tangent) - offset / follow_distance),
        )


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class CameraOffTracking:
    """Off-tracking and the camera motion that arrived with it, believed or not."""

    off_tracking: OffTracking
    motion: Motion | None  # None: no frame arrived


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class SlipAngle:
    """Slip angle of a rover from the trace of its left rear wheel, at ``tick``.

    If it is ``LOST`` (no trace is visible), the values are 0 and their standard deviations infinite.
    """

    tick: int
    value: float  # beta of the body at R's origin, + left (Reina 2008, eq. 2) [rad]
    std: float  # [rad]
    health: Health
    wheel_slip: float  # alpha_r of the wheel: direction of travel minus heading, + left [rad]
    trace_offset: float  # lateral distance of the trace from the wheel centre B, + left [m]
    confidence: float  # 0 to 1 that the trace is the wheel's own
    averaged_over: float = 0.0  # the values are means over this last distance: length of the visible trace [m]
    lagged_tick: int | None = None  # tick of a delayed, more accurate estimate; None: there is none
    lagged_value: float = 0.0  # beta at that tick [rad]
    lagged_std: float = np.inf  # [rad]


def lost_slip(tick: int) -> SlipAngle:
    """Estimate without information: no trace is visible."""
    return SlipAngle(
        tick=tick,
        value=0.0,
        std=math.inf,
        health=Health.LOST,
        wheel_slip=0.0,
        trace_offset=0.0,
        confidence=0.0,
    )


_TYPES: Final[dict[object, tuple[type, ...]]] = {
    "int": (int, np.integer),
    "float": (float, int, np.floating, np.integer),
    "Health": (Health,),
}


def check_estimate(estimate: object, kinds: tuple[type, ...]) -> None:
    """Refuse anything but an estimate of these kinds with numbers in its numeric fields; NaN is a number.

    Raises:
        TypeError: one line with the wrong value.
    """
    if not isinstance(estimate, kinds):
        raise TypeError(f"returned {estimate!r}, not {' or '.join(kind.__name__ for kind in kinds)}")
    _check_fields(estimate)


def _check_fields(estimate: object) -> None:
    kind: type = type(estimate)
    for name, annotation, types in _fields_of(kind):
        value = getattr(estimate, name)
        if types and not isinstance(value, types):
            raise TypeError(f"returned {kind.__name__}.{name} = {value!r}, not {annotation}")
        _check_fields(value)


@cache
def _fields_of(kind: type) -> tuple[tuple[str, object, tuple[type, ...]], ...]:
    """Name, annotation and permitted classes, if only some are, of the fields of a dataclass; none of other classes."""
    return tuple((one.name, one.type, _TYPES.get(one.type, ())) for one in fields(kind)) if is_dataclass(kind) else ()
