"""Candidates for the trace: midlines between two edges that may be the walls of a rut.

Reina 2008 models the trace by its centre line and does not say how it comes from edges. An edge itself lies half a
rut beside it; so a candidate here is the midline of two lines of Hough's transform that are about parallel on the
ground and about a rut apart.
"""

from __future__ import annotations

import math
from typing import Final, NamedTuple

import numpy as np

from estimators.slip.wheel_trace.poses import GroundLines
from sensors.sand.trace_rig import TraceRig
from vehicle.frames import FloatArray

_PARALLEL: Final = math.radians(5.0)  # walls of one rut; a rut that widens along the view by 0.05 m
_NARROWER: Final = 0.02  # than the wheel, of the edges on the inner side of a rut's walls [m]
_WIDER: Final = 0.07  # than the wheel: one that slips aside sweeps more, and berms of 0.03 m have edges, too [m]


class Candidates(NamedTuple):
    """Midlines, those with the most votes first."""

    image: FloatArray  # (m, 2) rho [px], phi [rad]
    ground: FloatArray  # (m, 3) d [m], theta [rad], Y [m]
    votes: FloatArray  # (m,) edge pixels on both edges
    edges: FloatArray  # (m, 2, 2) rho [px], phi [rad] of either edge


def midlines(lines: FloatArray, view: GroundLines, rig: TraceRig, n: int) -> Candidates:
    """The n midlines with the most votes among lines (m, 3) of rho, phi and votes."""
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
