"""How a combination moved: accelerations, paths, damping, amplification, as pure functions of its log."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from scenarios.results.log import Log
from scenarios.results.swept_path import placed
from vehicle.frames import FloatArray

_NOISE = 1e-3  # of the largest extreme: what is smaller is the end of the settling, not an oscillation


def poses(log: Log, unit: str) -> FloatArray:
    """x [m], y [m], psi [rad] of a unit over time, shape (n, 3)."""
    return np.column_stack([log[f"{quantity}_{unit}"] for quantity in ("x", "y", "psi")])


def point_path(log: Log, unit: str, x: float, y: float = 0.0) -> FloatArray:
    """Way of a unit's point at x, y [m] in its frame, shape (n, 2) in the world."""
    return placed(np.array([[x, y]]), poses(log, unit))[:, 0]


def lateral_acceleration(log: Log, unit: str, x: float) -> FloatArray:
    """Acceleration across a unit at the place x [m] on its axis [m/s2], + left, shape (n,).

    Of the motion over the ground, as ISO 14791 has it: free of gravity and of what the body's roll adds.
    """
    lateral = log[f"v_y_{unit}"] + x * log[f"yaw_rate_{unit}"]
    along = log[f"v_x_{unit}"] * log[f"yaw_rate_{unit}"]
    felt: FloatArray = np.gradient(lateral, log["time"]) + along
    return felt


def articulation(log: Log, ahead: str, behind: str) -> FloatArray:
    """Yaw of the unit ahead less that of the one behind [rad], + in a left turn, shape (n,)."""
    angle: FloatArray = log[f"psi_{ahead}"] - log[f"psi_{behind}"]
    return angle


def amplification(behind: FloatArray, ahead: FloatArray) -> float:
    """Rearward amplification: largest magnitude at a unit behind over that ahead, each in its own time [-]."""
    return float(np.max(np.abs(behind)) / np.max(np.abs(ahead)))


def damping(values: FloatArray) -> float:
    """Damping ratio of a freely decaying oscillation about zero, from its extremes; 1 if it hardly swings at all.

    A decaying oscillation of the ratio D loses the factor exp(pi D / sqrt(1 - D^2)) from one extreme to the next, on
    the other side. ISO 14791 averages these factors. The first extreme still belongs to what set it going, and is
    passed over unless there are but two. Below a thousandth of the largest nothing is counted.
    """
    heights = _extremes(values)
    heights = heights[heights > _NOISE * heights.max()] if heights.size else heights
    heights = heights[1:] if heights.size > 2 else heights
    if heights.size < 2:
        return 1.0
    decrement = math.log(float(np.mean(heights[:-1] / heights[1:])))
    return decrement / math.hypot(math.pi, decrement)


def _extremes(values: FloatArray) -> FloatArray:
    """Magnitude of the largest value of every stretch without a change of sign; what comes last may still grow."""
    crossings: NDArray[np.intp] = np.flatnonzero(np.diff(np.sign(values)) != 0.0) + 1
    return np.array([float(np.abs(stretch).max()) for stretch in np.split(values, crossings)[:-1]])


def overshoot(behind: FloatArray, ahead: FloatArray) -> float:
    """How far a path (n, 2) along x runs to the left of another one [m], at most; zero if it never does.

    The transient off-tracking of a lane change to the left: what the last axle needs beyond the path of the first.
    """
    lateral = behind[:, 1] - np.interp(behind[:, 0], ahead[:, 0], ahead[:, 1])
    return max(0.0, float(np.max(lateral)))
