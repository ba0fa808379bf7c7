"""Confidence that a candidate is the trace: the fuzzy rules of Reina 2008, Table I.

Every input is an absolute difference with a degree of membership in "small" and "large". The membership functions are
triangles (Fig. 5); the paper gives no numbers for their breakpoints. They are chosen here by the meaning of the inputs,
see ``Breakpoints``. The rules are of Mamdani type: the strength of a rule is the minimum of its conditions, and rules
with the same conclusion combine by the maximum. Defuzzification is by the height method (mean of the peaks, weighted
with the strengths): with centroids of triangles no confidence could be as low as the 1.1 % of Table II. If no rule
applies the confidence is 0.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np

from vehicle.frames import FloatArray

# Conditions S(mall) and L(arge) on rho, phi, d, theta, Y, and the peak of the conclusion (Reina 2008, Table I).
LOW, MEDIUM, HIGH = 0.0, 0.5, 1.0
RULES: Final = (
    ("SSSSS", HIGH),
    ("SLSLS", MEDIUM),
    ("LSLSL", LOW),
    ("LLLLL", LOW),
    ("LLSSL", LOW),
    ("SSLLS", MEDIUM),
)


@dataclass(frozen=True, slots=True, kw_only=True)
class Breakpoints:
    """Differences at which the membership in "small" reaches 0, from 1 at 0; "large" is the complement.

    Image and ground describe the same line, so their breakpoints correspond. A direction may differ by the largest
    slip between two detections of the trace with a loss in between (16 deg is about the largest slip of a rover that
    still moves; from image to image it is at most 2 deg). A position may differ by the resulting offset in the middle
    of the view. At the wheel's centre a line must pass within a third of the wheel's width: the nearest line that can
    be mistaken for the trace is the front wheel's rut, 0.05 m beside that of the rear wheel at a slip of 5 deg.

    Raises:
        ValueError: if one is not positive.
    """

    rho: float  # [px]
    phi: float  # [rad]
    d: float  # [m]
    theta: float  # [rad]
    Y: float  # [m]

    def __post_init__(self) -> None:
        for name in ("rho", "phi", "d", "theta", "Y"):
            if not getattr(self, name) > 0.0:
                raise ValueError(f"breakpoint {name} = {getattr(self, name)} must be positive")

    def scaled(self, factor: float) -> Breakpoints:
        """Breakpoints times a factor."""
        return Breakpoints(
            rho=factor * self.rho,
            phi=factor * self.phi,
            d=factor * self.d,
            theta=factor * self.theta,
            Y=factor * self.Y,
        )

    def as_array(self) -> FloatArray:
        """Array (5,) in the order of the rules' conditions."""
        return np.array([self.rho, self.phi, self.d, self.theta, self.Y])


def small(differences: FloatArray, breakpoints: Breakpoints) -> FloatArray:
    """Membership (n, 5) of differences (n, 5) in "small": triangles with their peak at 0."""
    degree: FloatArray = np.clip(1.0 - differences / breakpoints.as_array(), 0.0, 1.0)
    return degree


def confidence(differences: FloatArray, breakpoints: Breakpoints) -> FloatArray:
    """Confidence (n,), 0 to 1, of candidates with differences (n, 5) in rho, phi, d, theta and Y."""
    s = small(differences, breakpoints)
    strength = {HIGH: np.zeros(len(s)), MEDIUM: np.zeros(len(s)), LOW: np.zeros(len(s))}
    for conditions, conclusion in RULES:
        chosen = np.where(np.array(list(conditions)) == "S", s, 1.0 - s)
        strength[conclusion] = np.maximum(strength[conclusion], chosen.min(axis=1))
    total = sum(strength.values())
    pulled = sum(peak * degree for peak, degree in strength.items())
    result: FloatArray = pulled / np.maximum(total, 1e-12)
    return result
