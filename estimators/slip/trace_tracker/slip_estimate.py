"""Conversions between path states, views and slip angle messages."""

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

_LAG: Final = 2.0  # of the delayed, more accurate estimate [s]
# Ratio of the errors to the filter's standard deviation, which allows for fast slip changes and shadows at any time.
_OF_FILTER: Final = 0.85
_CERTAIN: Final = (0.3, 0.7)  # rut score of sand without a trace, and of clear traces


def slip_angle(rig: TraceRig, histories: Histories, steer: float, tick: int, score: float) -> SlipAngle:
    """Slip angle message for a trace with the rut score ``score`` behind a wheel at the angle ``steer`` [rad]."""
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
        std=_OF_FILTER * math.sqrt(variance),
        health=Health.OK,
        wheel_slip=wheel_direction(rig, value, path_line.bend(path, 0)) - steer,
        trace_offset=path.offset,
        confidence=float(np.interp(score, _CERTAIN, (0.0, 1.0))),
        lagged_tick=int(path.ticks[piece]) if known else None,
        lagged_value=lagged + float(path.steer[[max(piece - 1, 0), piece]].mean()) if known else 0.0,
        lagged_std=_OF_FILTER * math.sqrt(lagged_variance) if known else math.inf,
    )


def wheel_direction(rig: TraceRig, slip: float, rate: float) -> float:
    """Direction of the wheel's travel relative to the body [rad], from the slip angle at R's origin [rad] (eq. 2).

    ``rate`` is the yaw change per distance of the centre [rad/m].
    """
    x, y = rig.wheel
    return math.atan2(math.sin(slip) + rate * x, math.cos(slip) - rate * y)


def steered_to(view: RoverView) -> float:
    """Direction of the centre's travel relative to the body without sideslip [rad]."""
    return math.atan(float(np.tan(view.steer).mean()))
