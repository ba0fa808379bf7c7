"""Piecewise cubic polynomials along a road: elevation, superelevation, lane offset, lane width."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from vehicle.frames import FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class Cubics:
    """a + b d + c d^2 + d d^3 with the distance d from the begin of each piece; zero without pieces."""

    begins: FloatArray  # (n,) ascending [m]
    coefficients: FloatArray  # (n, 4) a, b, c, d

    def at(self, s: FloatArray) -> FloatArray:
        """Values at the distances s (m,) [m]; before the first piece that piece's."""
        if not len(self.begins):
            return np.zeros(len(s))
        k = np.clip(np.searchsorted(self.begins, s, side="right") - 1, 0, len(self.begins) - 1)
        a, b, c, d = self.coefficients[k].T
        along = s - self.begins[k]
        return np.asarray(a + along * (b + along * (c + along * d)), dtype=np.float64)
