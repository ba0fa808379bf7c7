"""Judge of a trailer's run: the end of its course or recorded drive, a mishap, or a vehicle that is stuck."""

from __future__ import annotations

import math

import numpy as np

from scenarios.assembly.trailer import LOG_PERIOD, Assembly
from scenarios.loop.recorded_drive import RecordedDrive
from scenarios.loop.referee import Referee
from vehicle.clock import TICK
from vehicle.combination.truth import Truth
from vehicle.frames import Pose2

_PATIENCE = 1.5  # longest duration of a run over the planned one; beyond it the vehicle is stuck
_GRACE = 10.0  # added for a start on a slope [s]


class CourseJudge:
    """Ends a run at the end of its course or recorded drive, at a mishap, or when the vehicle is stuck."""

    def __init__(self, parts: Assembly) -> None:
        road = None if parts.trace else parts.course.centreline  # the road of a recorded drive is unknown
        self._referee = Referee(parts.vehicle, road, parts.course.road_half_width)
        self._memory = self._referee.init()
        tractor = parts.vehicle.units[0]
        # A tractor on another part of the road, after a crossing or the wrong exit, is not on its course any more. On
        # the right part of the road every point of the tractor is nearer to the path than this.
        self._astray = float(np.max(parts.course.road_half_width)) + tractor.front_x - tractor.rear_x  # [m]
        self._recorded = RecordedDrive(parts.trace) if parts.trace else None
        self._parts = parts
        self._station = 0.0  # of the guided point along the course [m]
        self._elapsed = 0.0  # [s]

    @property
    def progress(self) -> float:
        """Share of the course, or of a recorded drive, that is done, 0 to 1."""
        parts = self._parts
        done = self._elapsed / parts.duration if parts.trace else self._station / parts.course.length
        return min(1.0, done)

    def outcome(self, truth: Truth) -> str | None:
        """Outcome of the run; None if it continues."""
        self._elapsed = (truth.tick + LOG_PERIOD) * TICK
        self._memory, mishap = self._referee.step(self._memory, truth)
        if mishap is not None:
            return mishap
        parts, course = self._parts, self._parts.course
        if self._recorded:
            ends = self._elapsed >= parts.duration
            return self._recorded.outcome(truth, ends=ends) or ("completed" if ends else None)
        point = Pose2(*truth.poses[0]) @ Pose2(*course.reference, 0.0)
        self._station = course.path.project(point.x, point.y, self._station)
        on_path = course.path.pose(self._station)
        if math.hypot(point.x - on_path.x, point.y - on_path.y) > self._astray:
            return "left the road"
        if self._station >= course.length - 1e-6:
            return "completed"
        return "timed out" if self._elapsed > _GRACE + _PATIENCE * parts.duration else None
