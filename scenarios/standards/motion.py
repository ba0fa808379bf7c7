"""Accelerations, paths, damping and amplification, computed from the log of a drive."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from scenarios.results.log import Log
from scenarios.results.swept_path import placed
from vehicle.frames import FloatArray

_NOISE = 1e-3  # over the largest extreme; smaller extremes are not counted


def poses(log: Log, unit: str) -> FloatArray:
    """x [m], y [m], psi [rad] of a unit over time, shape (n, 3)."""
    return np.column_stack([log[f"{quantity}_{unit}"] for quantity in ("x", "y", "psi")])


def point_path(log: Log, unit: str, x: float, y: float = 0.0) -> FloatArray:
    """Path of a unit's point at x, y [m] in its frame, shape (n, 2) in the world."""
    return placed(np.array([[x, y]]), poses(log, unit))[:, 0]


def lateral_acceleration(log: Log, unit: str, x: float) -> FloatArray:
    """Lateral acceleration of a unit at x [m] on its axis [m/s2], + left, shape (n,).

    Of the motion over the ground, as in ISO 14791: without gravity and body roll.
    """
    lateral = log[f"v_y_{unit}"] + x * log[f"yaw_rate_{unit}"]
    along = log[f"v_x_{unit}"] * log[f"yaw_rate_{unit}"]
    acceleration: FloatArray = np.gradient(lateral, log["time"]) + along
    return acceleration


def articulation(log: Log, ahead: str, behind: str) -> FloatArray:
    """Yaw of the unit ahead minus yaw of the unit behind [rad], + in a left turn, shape (n,)."""
    angle: FloatArray = log[f"psi_{ahead}"] - log[f"psi_{behind}"]
    return angle


def amplification(behind: FloatArray, ahead: FloatArray) -> float:
    """Rearward amplification: largest magnitude of the unit behind over that of the unit ahead [-]."""
    return float(np.max(np.abs(behind)) / np.max(np.abs(ahead)))


def damping(values: FloatArray) -> float:
    """Damping ratio of a freely decaying oscillation about zero, from its extremes; 1 if it hardly oscillates.

    With a damping ratio D, consecutive extremes on opposite sides differ by the factor exp(pi D / sqrt(1 - D^2)).
    ISO 14791 averages these factors. The first extreme still depends on the excitation; it is omitted if there are more
    than two. Extremes below a thousandth of the largest are not counted.
    """
    heights = _extremes(values)
    heights = heights[heights > _NOISE * heights.max()] if heights.size else heights
    heights = heights[1:] if heights.size > 2 else heights
    if heights.size < 2:
        return 1.0
    decrement = math.log(float(np.mean(heights[:-1] / heights[1:])))
    return decrement / math.hypot(math.pi, decrement)


def _extremes(values: FloatArray) -> FloatArray:
    """Largest magnitude between consecutive changes of sign; the last, unfinished stretch is omitted."""
    crossings: NDArray[np.intp] = np.flatnonzero(np.diff(np.sign(values)) != 0.0) + 1
    return np.array([float(np.abs(stretch).max()) for stretch in np.split(values, crossings)[:-1]])


def overshoot(behind: FloatArray, ahead: FloatArray) -> float:
    """Largest distance [m] of a path (n, 2) along x to the left of another one; at least zero.

    In a lane change to the left this is the transient off-tracking of the last axle from the first.
    """
    lateral = behind[:, 1] - np.interp(behind[:, 0], ahead[:, 0], ahead[:, 1])
    return max(0.0, float(np.max(lateral)))
