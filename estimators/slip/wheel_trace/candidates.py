"""Candidates for the trace: midlines between two edges that may be the walls of a rut.

Reina 2008 models the trace by its centre line and does not state how it is derived from edges. An edge lies half a rut
beside it. So a candidate here is the midline of two lines of the Hough transform that are about parallel on the ground
and about a rut apart.
"""

from __future__ import annotations

import math
from typing import Final, NamedTuple

import numpy as np

from estimators.slip.wheel_trace.poses import GroundLines
from sensors.sand.trace_rig import TraceRig
from vehicle.frames import FloatArray

_PARALLEL: Final = math.radians(5.0)  # largest angle between the walls of one rut: it widens along the view by 0.05 m
_NARROWER: Final = 0.02  # than the wheel, for edges on the inner side of a rut's walls [m]
_WIDER: Final = 0.07  # than the wheel: a wheel that slips sideways sweeps more, and berms of 0.03 m have edges too [m]


class Candidates(NamedTuple):
    """Midlines, sorted by votes."""

    image: FloatArray  # (m, 2) rho [px], phi [rad]
    ground: FloatArray  # (m, 3) d [m], theta [rad], Y [m]
    votes: FloatArray  # (m,) edge pixels on both edges
    edges: FloatArray  # (m, 2, 2) rho [px], phi [rad] of either edge


def midlines(lines: FloatArray, view: GroundLines, rig: TraceRig, n: int) -> Candidates:
    """The n midlines with the most votes, from lines (m, 3) of rho, phi and votes."""
    ground = view.ground(lines)
    first, second = np.triu_indices(len(lines), 1)
    theta = 0.5 * (ground[first, 1] + ground[second, 1])
    apart = np.abs(ground[first, 2] - ground[second, 2]) * np.cos(theta)
    width = rig.wheel_width
    fits = (np.abs(ground[first, 1] - ground[second, 1]) < _PARALLEL) & (apart > width - _NARROWER)
    fits &= apart < width + _WIDER
    votes = lines[first, 2] + lines[second, 2]
    chosen = np.flatnonzero(fits)[np.argsort(-votes[fits], kind="stable")][:n]
    first, second, theta = first[chosen], second[chosen], theta[chosen]
    image = view.image(theta, 0.5 * (ground[first, 2] + ground[second, 2]))
    edges = np.stack([lines[first, :2], lines[second, :2]], axis=1)
    return Candidates(image, view.ground(image), votes[chosen], edges)
