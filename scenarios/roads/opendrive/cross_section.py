"""Cross sections of a road that are not straight: shapes, and crossfall to either side."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from scenarios.roads.opendrive.cubics import Cubics
from vehicle.frames import FloatArray


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class CrossSections:
    """Heights of a road above the straight line across it that superelevation turns."""

    stations: FloatArray  # (n,) ascending, of the shapes [m]
    shapes: Sequence[Cubics]  # height by t at each station [m]
    left: Cubics  # crossfall by s, + falls away from the reference line [rad]
    right: Cubics

    def height(self, s: FloatArray, t: FloatArray) -> FloatArray:
        """Height [m] at s along the road and t to the left (n,) [m]: linear between shapes, constant beyond them."""
        fall = np.where(t > 0.0, self.left.at(s), self.right.at(s))
        height: FloatArray = -np.abs(t) * np.tan(fall)
        if not self.shapes:
            return height
        last = len(self.shapes) - 1
        before = np.clip(np.searchsorted(self.stations, s, side="right") - 1, 0, last)
        for k in np.unique(before).tolist():
            rows = before == k
            after = min(k + 1, last)
            span = self.stations[after] - self.stations[k]
            share = np.clip((s[rows] - self.stations[k]) / span, 0.0, 1.0) if span else 0.0
            first, second = (self.shapes[i].at(t[rows]) for i in (k, after))
            height[rows] += first + share * (second - first)
        return height
