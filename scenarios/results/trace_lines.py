"""Lines in a rover's camera image: the wheel's trace, were it left in the true or the estimated direction."""

from __future__ import annotations

import math

import numpy as np

from scenarios.results.rover import RoverResult
from sensors.sand.trace_rig import TraceRig
from vehicle.frames import FloatArray

_NEAR, _FAR, _POINTS = 0.12, 0.66, 12  # ends of the line, behind the wheel's centre [m]


def trace_lines(result: RoverResult, tick: int) -> tuple[FloatArray, FloatArray | None]:
    """Pixels (n, 2) of the true line and of the estimated one at a tick; None without an estimate."""
    log, rig = result.log, result.rig
    row = int(np.searchsorted(log["tick"], tick))
    pointed = float(log[f"steer_{rig.wheels[rig.watched].name}"][row])
    true = trace_line(rig, pointed + float(log["wheel_slip_true"][row]), 0.0)
    estimate = float(log["wheel_slip_estimate"][row])
    if not math.isfinite(estimate):
        return true, None
    return true, trace_line(rig, pointed + estimate, float(log["trace_offset"][row]))


def trace_line(rig: TraceRig, direction: float, offset: float) -> FloatArray:
    """Pixels (n, 2) of the trace of a wheel that travels in ``direction`` relative to the body [rad], + left.

    ``offset`` is the trace's lateral distance from the wheel's centre [m], + left.
    """
    behind = np.linspace(_NEAR, _FAR, _POINTS)
    ground = np.column_stack(
        [rig.wheel[0] - behind, rig.wheel[1] + offset - behind * math.tan(direction), np.zeros(_POINTS)]
    )
    R_RC, p_RC = rig.X_RC[:3, :3], rig.X_RC[:3, 3]
    return rig.camera.project((ground - p_RC) @ R_RC)
