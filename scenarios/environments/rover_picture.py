"""Top view of a rover on its path, north up: 600 by 600 pixels around it."""

from __future__ import annotations

import math

import cv2
import numpy as np

from controllers.path import Path
from scenarios.report.canvas import INK, SHIFT, SOFT, TRUE, Picture, blank, curve, fixed_point, write
from vehicle.frames import FloatArray, Pose2
from vehicle.rover.description import Rover
from vehicle.rover.truth import RoverTruth

_SIZE, _SCALE = 600, 150.0  # [px], [px/m]: 4 m
_SAND = (244, 238, 226)


def rover_picture(rover: Rover, truth: RoverTruth, path: Path, time: float) -> Picture:
    """Draw the rover at this time [s]."""
    picture = blank(_SIZE, _SIZE)
    picture[:] = _SAND
    pose = Pose2(*truth.pose.tolist())
    curve(picture, _pixels(path.points(0.05), pose), TRUE, 2)
    a, b = 0.4 * rover.wheelbase, 0.4 * rover.tread
    body = np.array([[a, b], [a, -b], [-a, -b], [-a, b]])
    cv2.fillConvexPoly(picture, fixed_point(_pixels(pose.apply(body), pose)), SOFT, cv2.LINE_AA, SHIFT)
    tread = np.array([[1.0, 1.0], [1.0, -1.0], [-1.0, -1.0], [-1.0, 1.0]]) * [rover.radius, 0.5 * rover.width]
    for place in rover.wheel_places:
        cv2.fillConvexPoly(picture, fixed_point(_pixels(pose.apply(place + tread), pose)), INK, cv2.LINE_AA, SHIFT)
    write(picture, f"{time:.1f} s, slip angle {math.degrees(truth.slip_angle):+.1f} deg", (12, 10), colour=INK)
    return picture


def _pixels(points: FloatArray, pose: Pose2) -> FloatArray:
    pixels: FloatArray = 0.5 * _SIZE + _SCALE * np.array([1.0, -1.0]) * (points - [pose.x, pose.y])
    return pixels
