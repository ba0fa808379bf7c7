"""From the history of slip to the message that says so, and the other way what a view says of the rover's motion."""

from __future__ import annotations

import math
from typing import Final

import numpy as np

from estimators.estimates import Health, SlipAngle
from estimators.slip.trace_tracker import path_line
from estimators.slip.trace_tracker.histories import Histories
from sensors.messages import RoverView
from sensors.sand.trace_rig import TraceRig
from vehicle.clock import TICK

_LAG: Final = 2.0  # of the second, better estimate [s]
# Of errors against what the filter believes: it allows for slip that changes quickly, and for shadows, at any moment.
_OF_BELIEVED: Final = 0.85
_CERTAIN: Final = (0.3, 0.7)  # likeness of sand without a trace, and of clear traces


def slip_angle(rig: TraceRig, histories: Histories, steer: float, tick: int, score: float) -> SlipAngle:
    """The message of a trace seen with a likeness ``score`` behind a wheel at an angle ``steer`` [rad]."""
    path = histories.together
    before = path.ticks <= tick - _LAG / TICK
    piece = int(np.argmax(before))
    known = bool(before[piece])
    slip, variance = path_line.slip_at(path, 0)
    lagged, lagged_variance = path_line.slip_at(path, piece)
    value = slip + path.steered
    return SlipAngle(
        tick=tick,
        value=value,
        std=_OF_BELIEVED * math.sqrt(variance),
        health=Health.OK,
        wheel_slip=wheel_direction(rig, value, path_line.bend(path, 0)) - steer,
        trace_offset=path.offset,
        confidence=float(np.interp(score, _CERTAIN, (0.0, 1.0))),
        lagged_tick=int(path.ticks[piece]) if known else None,
        lagged_value=lagged + float(path.steer[[max(piece - 1, 0), piece]].mean()) if known else 0.0,
        lagged_std=_OF_BELIEVED * math.sqrt(lagged_variance) if known else math.inf,
    )


def wheel_direction(rig: TraceRig, slip: float, rate: float) -> float:
    """Travel of the wheel against the body [rad], after eq. 2, from the slip angle at R's origin [rad].

    ``rate`` is the yaw by the middle's way [rad/m]: the rigid body carries the velocity of one place to the other.
    """
    x, y = rig.wheel
    return math.atan2(math.sin(slip) + rate * x, math.cos(slip) - rate * y)


def steered_to(view: RoverView) -> float:
    """Direction against the body that the middle goes to if no wheel slips aside [rad]."""
    return math.atan(float(np.tan(view.steer).mean()))
