"""Ground truth of a wheel's trace: course of its rut behind the wheel, and presence of an imprint."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from sensors.sand.wheels import Stand
from vehicle.frames import FloatArray, Pose2
from vehicle.rover.truth import RoverTruth

NEAREST, FARTHEST = 0.12, 0.60  # behind the wheel's centre: between the wheel and the far edge of the view [m]
_STEP: Final = 0.02  # [m]
_SHORTEST: Final = 0.004  # distance between remembered stands [m]
_KEPT: Final = 400  # remembered stands: more than the length of a view


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class TraceTruth:
    """Visible part of a wheel's own trace."""

    tick: int
    line: FloatArray  # (n, 2) middle of the rut in R behind the wheel, nearest first [m]
    there: NDArray[np.bool_]  # (n,) True where the ground took an imprint
    slip_angles: FloatArray  # (n,) of the wheel when it passed, + left [rad]
    wheel_slip: float  # of the wheel now, + left [rad]
    slip_angle: float  # of the body at R's origin now, + left [rad]

    @property
    def share(self) -> float:
        """Share of the visible length with an imprint."""
        return float(self.there.mean())

    @property
    def present(self) -> bool:
        """True if over half of the visible length has an imprint."""
        return self.share > 0.5


@dataclass(frozen=True, slots=True)
class WheelHistory:
    """History of a wheel: its last stands, oldest first."""

    stands: tuple[tuple[Stand, bool], ...] = ()  # with True where the wheel left an imprint

    def extended(self, stand: Stand, imprinted: bool) -> WheelHistory:
        """History with one more stand; the oldest are dropped."""
        if self.stands and math.dist(self.stands[-1][0].place, stand.place) < _SHORTEST:
            return self
        return WheelHistory((*self.stands[-_KEPT:], (stand, imprinted)))

    def seen_from(self, truth: RoverTruth, wheel: tuple[float, float], slip: float) -> TraceTruth:
        """Trace behind a wheel at a place in R [m] whose slip angle is ``slip`` [rad]."""
        stations = np.arange(NEAREST, FARTHEST + 1e-9, _STEP)
        places = np.array([stand.place for stand, _ in self.stands]).reshape(-1, 2)
        x, y = Pose2(*truth.pose.tolist()).inverse().apply(places).T
        behind = wheel[0] - x
        order = np.argsort(behind, kind="stable")
        there = np.array([imprinted for _, imprinted in self.stands], dtype=float)
        angles = np.array([stand.slip_angle for stand, _ in self.stands])
        offset, share, slips = (np.interp(stations, behind[order], value[order]) for value in (y, there, angles))
        reached = stations <= behind.max(initial=-1.0)
        return TraceTruth(
            tick=truth.tick,
            line=np.stack([wheel[0] - stations, offset], axis=-1),
            there=(share > 0.5) & reached,
            slip_angles=slips,
            wheel_slip=slip,
            slip_angle=truth.slip_angle,
        )
