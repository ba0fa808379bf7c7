"""How well a candidate matches the trace model: the fuzzy rules of Reina 2008, Table I.

Every input is an absolute difference that is "small" or "large" to a degree. The membership functions are triangles
(Fig. 5) whose breakpoints were published in that figure only, without numbers. They are chosen here by what the inputs
mean, see ``Breakpoints``. The rules are Mamdani's: a rule holds as far as the least of its conditions does, and of
rules with the same conclusion the strongest counts. A number comes of it by the height method (each conclusion pulls
at the peak of its triangle with its own strength): with centroids of triangles no confidence could be as low as the
1.1 % of Table II. Where no rule says anything the confidence is 0.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np

from vehicle.frames import FloatArray

# Of the conditions S(mall) and L(arge) on rho, phi, d, theta, Y, and the peak of the conclusion (Reina 2008, Table I).
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
    """Differences that are not small at all any more; small falls to there from 1 at 0, large is the rest.

    The image and the ground say the same of a line, so their breakpoints belong together: a direction may be off by
    as much as slip can be from one sight of the trace to the next, when it was lost in between (16 deg is about the
    largest slip of a rover that still gets anywhere; from image to image it is 2 deg at most), and a place by as much
    as a line so turned about the wheel lies off in the middle of the view. Beside the wheel's centre a line must pass
    within a third of a wheel's width: the rut of the front wheel, 0.05 m beside that of the rear one at a slip of
    5 deg, is the nearest that can be taken for the trace.

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
        """All of them times a factor."""
        return Breakpoints(
            rho=factor * self.rho,
            phi=factor * self.phi,
            d=factor * self.d,
            theta=factor * self.theta,
            Y=factor * self.Y,
        )

    def as_array(self) -> FloatArray:
        """In the order of the rules' conditions, (5,)."""
        return np.array([self.rho, self.phi, self.d, self.theta, self.Y])


def small(differences: FloatArray, breakpoints: Breakpoints) -> FloatArray:
    """To what degree differences (n, 5) are small, (n, 5): triangles with their peak at 0."""
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
