"""Top view of an episode, north up: 600 by 600 pixels around the tractor."""

from __future__ import annotations

from collections.abc import Sequence

import cv2
import numpy as np
from numpy.typing import NDArray

from scenarios.courses import Course
from scenarios.report.canvas import INK, SHIFT, SOFT, TRUE, Picture, blank, curve, fixed_point, write
from scenarios.results.swept_path import UnitOutline, placed, placed_wheels
from vehicle.combination.description import Vehicle
from vehicle.frames import FloatArray

_SIZE = 600  # [px]
_SCALE = 12.0  # [px/m]: 50 m, three combinations long
_ROAD, _BODY = (236, 239, 241), (250, 251, 252)
_BAY, _MARGIN = 6.0, 0.3  # length of a bay's lines, and its margin to either side [m]
_BACK = 6.0  # from the tractor's rear axle back to the picture's centre [m]


class TopView:
    """Top views of units on their courses."""

    def __init__(self, units: tuple[UnitOutline, ...], courses: Sequence[Course]) -> None:
        """For these outlines; every lane is on the first course until it begins."""
        self._units, self._courses = units, courses
        self._course: dict[int, int] = {}

    def begin(self, lanes: NDArray[np.intp], course: NDArray[np.intp]) -> None:
        """Set the courses of these lanes."""
        self._course.update(zip(lanes.tolist(), course.tolist(), strict=True))

    def picture(
        self,
        lane: int,
        poses: FloatArray,
        steer: tuple[FloatArray, ...],
        caption: str,
        *,
        goal: FloatArray | None = None,
    ) -> Picture:
        """Draw units at poses (N, 3) with their axles' angles [rad], and the last unit's ``goal`` x, y, psi."""
        course = self._courses[self._course.get(lane, 0)]
        picture = blank(_SIZE, _SIZE)
        x, y, psi = poses[0]
        centre = np.array([x - _BACK * np.cos(psi), y - _BACK * np.sin(psi)])
        width = round(2.0 * float(np.max(course.road_half_width)) * _SCALE)
        curve(picture, _pixels(course.centreline, centre), _ROAD, width)
        curve(picture, _pixels(course.path.points(0.5), centre), TRUE, 1)
        for unit, pose, angles in zip(self._units, poses, steer, strict=True):
            body = _pixels(placed(unit.corners, pose[None])[0], centre)
            cv2.fillConvexPoly(picture, fixed_point(body), _BODY, cv2.LINE_AA, SHIFT)
            for wheel in placed_wheels(unit, pose[None], angles[None])[0]:
                cv2.fillConvexPoly(picture, fixed_point(_pixels(wheel, centre)), INK, cv2.LINE_AA, SHIFT)
            curve(picture, body, INK, 1, closed=True)
        if goal is not None:
            self._goal(picture, goal, centre)
        write(picture, caption, (12, 10), colour=SOFT)
        return picture

    def _goal(self, picture: Picture, goal: FloatArray, centre: FloatArray) -> None:
        """Draw a bay around the last unit, its end at the goal."""
        last = self._units[-1]
        bay = np.array([[_BAY, 1.0], [0.0, 1.0], [0.0, -1.0], [_BAY, -1.0]]) * [1.0, 0.5 * last.width + _MARGIN]
        curve(picture, _pixels(placed(bay, goal[None])[0], centre), TRUE, 3)


def side_by_side(plan: Picture, view: Picture | None) -> Picture:
    """The top view next to the camera view, if there is one."""
    return plan if view is None else np.concatenate([plan, view], axis=1)


def _pixels(points: FloatArray, centre: FloatArray) -> FloatArray:
    pixels: FloatArray = 0.5 * _SIZE + _SCALE * np.array([1.0, -1.0]) * (points - centre)
    return pixels


def axle_angles(vehicle: Vehicle, steered: FloatArray) -> tuple[FloatArray, ...]:
    """Angles of each unit's axles [rad] from those of the steered axles, front to rear."""
    angles = iter(steered.tolist())
    return tuple(np.array([next(angles) if axle.steered else 0.0 for axle in unit.axles]) for unit in vehicle.units)
