"""The run from above, as a panel of a video picture."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from scenarios.report.canvas import (
    ESTIMATED,
    INK,
    PAPER,
    SHIFT,
    SOFT,
    TRUE,
    Picture,
    blank,
    curve,
    fixed_point,
    scale_bar,
    write,
)
from scenarios.results.swept_path import UnitOutline, placed, placed_wheels
from vehicle.frames import FloatArray
from vehicle.polyline import arc_length

_ROAD, _SWEPT, _BODY = (236, 239, 241), (207, 224, 241), (250, 251, 252)
_KEY = 36  # [px] height of the key at the top
_FOLLOW_SCALE = 9.0  # [px/m] a 16.5 m combination is then 150 px long
_LEAST_SCALE = 5.5  # [px/m] below this the vehicle is too small to see in a view of the whole course


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class PlanView:
    """The run from above, north up: the whole course if it fits, else the surroundings of the vehicle."""

    width: int  # [px]
    height: int  # [px]
    units: tuple[UnitOutline, ...]
    poses: tuple[FloatArray, ...]  # of each unit, (n_rows, 3)
    steer: tuple[FloatArray, ...]  # of each unit's axles, (n_rows, n_axles) [rad]
    hitch: FloatArray  # (n_rows, 2) [m]
    follow: FloatArray  # (n_rows, 2) [m]
    road: FloatArray  # (n, 2) [m]
    road_half_width: float  # [m]
    scale: float  # [px/m]
    centre: FloatArray | None  # (2,) of the view [m]; None: it moves with the vehicle

    @classmethod
    def of_course(
        cls,
        size: tuple[int, int],
        *,
        units: tuple[UnitOutline, ...],
        poses: tuple[FloatArray, ...],
        steer: tuple[FloatArray, ...],
        follow_distance: float,
        road: FloatArray,
        road_half_width: float,
    ) -> PlanView:
        """The view of this width and height that suits the course; hitch and follow point are the last unit's."""
        ends = [placed(unit.corners, pose).reshape(-1, 2) for unit, pose in zip(units, poses, strict=True)]
        low, high = np.min([e.min(axis=0) for e in ends], axis=0), np.max([e.max(axis=0) for e in ends], axis=0)
        whole = float(np.min((np.array(size) - [0, _KEY]) / (high - low + 6.0)))
        fits = whole >= _LEAST_SCALE
        return cls(
            width=size[0],
            height=size[1],
            units=units,
            poses=poses,
            steer=steer,
            hitch=poses[-1][:, :2],
            follow=placed(np.array([[-follow_distance, 0.0]]), poses[-1])[:, 0],
            road=road,
            road_half_width=road_half_width,
            scale=min(whole, 2.0 * _FOLLOW_SCALE) if fits else _FOLLOW_SCALE,
            centre=0.5 * (low + high) if fits else None,
        )

    def draw(self, row: int) -> Picture:
        """The view at a row of the log."""
        picture = blank(self.width, self.height)
        centre = self.centre if self.centre is not None else placed(np.array([[-2.0, 0.0]]), self.poses[0][[row]])[0, 0]
        self._road(picture, centre)
        past = self._rows(row)
        self._swept(picture, centre, past)
        curve(picture, self._pixels(self.hitch[past], centre), TRUE, 2)
        curve(picture, self._pixels(self.follow[past], centre), ESTIMATED, 2)
        self._vehicle(picture, centre, row)
        self._key(picture)
        return picture

    def _pixels(self, points: FloatArray, centre: FloatArray) -> FloatArray:
        middle = 0.5 * np.array([self.width - 1, self.height - 1 + _KEY])
        pixels: FloatArray = middle + self.scale * np.array([1.0, -1.0]) * (points - centre)
        return pixels

    def _rows(self, row: int) -> NDArray[np.intp]:
        """Rows up to this one at which the vehicle is drawn as it was: about 0.3 m of travel apart, in view."""
        reach = (self.width + self.height) / self.scale
        along = arc_length(self.poses[0][: row + 1, :2])
        first = 0.0 if self.centre is not None else max(0.0, along[-1] - reach)
        rows = np.searchsorted(along, np.arange(first, along[-1], 0.3))
        return np.append(rows, row)

    def _road(self, picture: Picture, centre: FloatArray) -> None:
        near = np.hypot(*(self.road - centre).T) < (self.width + self.height) / self.scale
        for leg in np.split(self.road, np.flatnonzero(np.diff(near.astype(np.int8))) + 1):
            pixels = self._pixels(leg, centre)
            if len(leg) > 1 and np.hypot(*(leg - centre).T).min() < (self.width + self.height) / self.scale:
                curve(picture, pixels, _ROAD, max(1, round(2.0 * self.road_half_width * self.scale)))

    def _swept(self, picture: Picture, centre: FloatArray, rows: NDArray[np.intp]) -> None:
        for unit, poses in zip(self.units, self.poses, strict=True):
            for body in fixed_point(self._pixels(placed(unit.corners, poses[rows]), centre)):
                cv2.fillConvexPoly(picture, body, _SWEPT, cv2.LINE_8, SHIFT)

    def _vehicle(self, picture: Picture, centre: FloatArray, row: int) -> None:
        for unit, poses, steer in zip(self.units, self.poses, self.steer, strict=True):
            body = self._pixels(placed(unit.corners, poses[[row]])[0], centre)
            cv2.fillConvexPoly(picture, fixed_point(body), _BODY, cv2.LINE_AA, SHIFT)
            for wheel in placed_wheels(unit, poses[[row]], steer[[row]])[0]:
                cv2.fillConvexPoly(picture, fixed_point(self._pixels(wheel, centre)), INK, cv2.LINE_AA, SHIFT)
            curve(picture, body, INK, 1, closed=True)
        for point, colour in ((self.hitch[row], TRUE), (self.follow[row], ESTIMATED)):
            at = fixed_point(self._pixels(point, centre))
            cv2.circle(picture, (int(at[0]), int(at[1])), 5 << SHIFT, PAPER, -1, cv2.LINE_AA, SHIFT)
            cv2.circle(picture, (int(at[0]), int(at[1])), 4 << SHIFT, colour, -1, cv2.LINE_AA, SHIFT)

    def _key(self, picture: Picture) -> None:
        for k, (text, colour) in enumerate((("hitch and its path", TRUE), ("follow point and its path", ESTIMATED))):
            at = (20 + 150 * k, 21)
            cv2.circle(picture, at, 5, colour, -1, cv2.LINE_AA)
            write(picture, text, (at[0] + 10, at[1] - 10), size=14, colour=SOFT)
        scale_bar(picture, self.scale, 10.0)
