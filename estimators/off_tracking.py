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

from estimators.estimates import Health, OffTracking
from estimators.hitch_path import Crossing, chord_lengths, crossing, tangent
from estimators.rigid_motion import UncertainMotion, composed, rotation_vector, stretched
from vehicle.clock import TICK
from vehicle.frames import FloatArray, inverse, so3_exp

_STEP = 0.02  # points closer than this to the next older one are dropped when the next arrives [m]
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


class Sample(NamedTuple):
    """The body at one tick, and the increment that starts there and ends at the next newer sample."""

    tick: int
    X_OS: FloatArray  # (4, 4)
    to_next: FloatArray  # (6, 6) covariance of the increment to the next newer sample; zero for the newest
    doubtful: bool  # whether that increment is degraded or bridged


class BufferMemory(NamedTuple):
    """Samples of the body, newest first, and the newest motion that was not lost."""

    samples: tuple[Sample, ...] = ()
    last: BodyMotion | None = None
