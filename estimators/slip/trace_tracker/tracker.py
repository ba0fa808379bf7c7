"""Slip from the curved trace behind the wheel, tracked from image to image.

FTrace (Reina 2008) fits a straight line to the edges of one image. This tracker follows the whole rut, its lug marks
and both walls along the wheel's path, which records the slip of the last seconds. The estimated quantities are those of
Reina et al. (2008), "Vision-based estimation of slip angle for mobile robots and planetary rovers"; the method is this
project's own.

A match need not be the trace: the rover's own shadow has two straight edges like the walls of a rut, and moves with the
rover. The lug marks in several images distinguish them; one image is not always enough.
"""

from __future__ import annotations

import math
from typing import ClassVar, Final, NamedTuple, Self

import numpy as np

from estimators.context import RoverContext
from estimators.estimates import SlipAngle, lost_slip
from estimators.rover_geometry import wheel_places
from estimators.slip.rover_odometry import wheel_motion
from estimators.slip.trace_tracker import histories, path_line
from estimators.slip.trace_tracker.acquisition import Find, best_straight
from estimators.slip.trace_tracker.channels import channels
from estimators.slip.trace_tracker.following import Ground, matched, with_sun
from estimators.slip.trace_tracker.ground_patch import GroundPatch
from estimators.slip.trace_tracker.histories import Histories
from estimators.slip.trace_tracker.matching import expected, lit, probable, unknown_sun
from estimators.slip.trace_tracker.path_state import SHORTEST, moved, with_compass
from estimators.slip.trace_tracker.slip_estimate import slip_angle, steered_to
from estimators.slip.trace_tracker.templates import Profiles, Templates, shipped_templates
from sensors.messages import RoverView
from sensors.sand.trace_rig import TraceRig
from vehicle.clock import TICK
from vehicle.frames import FloatArray
from vehicle.option import Option

_MARKED: Final = 0.25  # least correlation of lug marks: edges of shadows reach 0.15, faint marks 0.35
_SURE: Final = 0.33  # mean correlation of marks for confirmation; chance does not reach it in
_IMAGES_TO_CONFIRM: Final = 3  # images
_KEPT: Final = 0.32  # least rut score of a tracked trace over the whole view: faint in shade 0.36, sand 0.25
_KEEPING: Final = 0.8  # weight of the old mean correlation of marks in the update with one image
_IMAGES_TO_LOSE: Final = 5  # consecutive
_FOUND: Final = 0.36  # least score of a new trace: sand under moving shadows reaches it once in a hundred images
_IMAGES_TO_FIND: Final = 2  # consecutive
_YOUNG: Final = 20  # pieces near the wheel whose mean slip gives the trace's direction
# Longitudinal slip; it scales the length of the predicted trace. Light rovers on level dry sand have 0.05 to 0.15;
# assumed, as no instrument on board measures it.
_SLIP_RATIO: Final = 0.1
_FOUND_STD: Final = math.radians(4.0)  # of the slip of a new trace


class Pursuit(NamedTuple):
    """State of a tracked trace."""

    marks: float  # correlation of its lug marks, mean over the last images
    images: int  # images in which it was searched for
    missed: int  # consecutive images in which it was not found
    sure: bool  # True: confirmed by its lug marks

    @property
    def visible(self) -> bool:
        """True if it is confirmed and the last image shows it."""
        return self.sure and self.missed == 0

    @property
    def lost(self) -> bool:
        """True if it was missing for too long."""
        return self.missed >= (_IMAGES_TO_LOSE if self.sure else 1)


class TraceMemory(NamedTuple):
    """State of the tracker after a view."""

    tick: int | None  # of the last view
    unused: float  # distance since the start of the newest piece [m]
    turned: float  # yaw over that distance, by the encoders [rad]
    seconds: float  # duration of that distance [s]
    path: Histories | None
    pursuit: Pursuit | None  # state of tracking; None: no trace is tracked
    hints: int  # consecutive images that show a trace
    sun: FloatArray  # (courses, elevations) log likelihood of the sun's direction
    estimate: SlipAngle | None  # the last one


class FTracePlus:
    """Tracker of the left rear wheel's trace; ``init`` and ``step`` are pure."""

    sensor: ClassVar[str] = "trace_camera"
    options: ClassVar[tuple[Option, ...]] = ()

    def __init__(self, rig: TraceRig, templates: Templates | None = None) -> None:
        self._rig = rig
        self._patch = GroundPatch(rig=rig)
        self._wheels = wheel_places(rig.wheels)
        self._templates = shipped_templates() if templates is None else templates

    @classmethod
    def of(cls, context: RoverContext) -> Self:
        """Estimator for the context's camera."""
        return cls(context.rig)

    def init(self) -> TraceMemory:
        """Before the first view."""
        return TraceMemory(None, 0.0, 0.0, 0.0, None, None, 0, unknown_sun(), None)

    def step(self, memory: TraceMemory, view: RoverView) -> tuple[TraceMemory, SlipAngle]:
        """Memory and slip angle; the last estimate is repeated until the rover has moved by a piece."""
        memory = self._wheel_motion(memory, view)
        if memory.estimate is not None and 0.0 <= memory.unused < SHORTEST:
            return memory, memory.estimate
        path = self._path(memory, view)
        memory = memory._replace(unused=0.0, turned=0.0, seconds=0.0)
        ground = Ground(self._rig, channels(self._patch.rectified(view.image)), self._patch.behind, self._patch.bands)
        line = path.together
        known = lit(self._templates, float(line.headings[0]) + float(line.body_slips[:_YOUNG].mean()))
        if memory.pursuit is None:
            memory, path = self._searched(memory, path, ground, known)
        estimate, pursuit = lost_slip(view.tick), memory.pursuit
        if pursuit is not None:
            look = matched(ground, path, (expected(known, memory.sun), self._templates.shaded))
            path, pursuit = look.path, judged(pursuit, look.rut_score, float(look.marks.mean()))
            if pursuit.visible:
                memory = memory._replace(sun=with_sun(memory.sun, look, known))
                estimate = slip_angle(self._rig, path, float(view.steer[self._rig.watched]), view.tick, look.rut_score)
            if pursuit.lost:
                pursuit = None
        path = path.each(lambda one: path_line.with_fronts(one, self._rig))
        return memory._replace(path=path, pursuit=pursuit, estimate=estimate), estimate

    def _wheel_motion(self, memory: TraceMemory, view: RoverView) -> TraceMemory:
        """Memory with the encoders' motion since the last view; a rover that reverses over its trace restarts."""
        if memory.tick is None:
            return memory._replace(tick=view.tick)
        seconds = (view.tick - memory.tick) * TICK
        distance = seconds * self._rig.wheel_radius * float(view.wheel_speeds.mean())
        length = (1.0 - _SLIP_RATIO) * distance
        if memory.unused + length < -SHORTEST:
            return self.init()._replace(tick=view.tick, sun=memory.sun)
        return memory._replace(
            tick=view.tick,
            unused=memory.unused + length,
            turned=memory.turned + (1.0 - _SLIP_RATIO) * seconds * self._yaw_rate(view),
            seconds=memory.seconds + seconds,
        )

    def _searched(
        self, memory: TraceMemory, path: Histories, ground: Ground, known: Profiles
    ) -> tuple[TraceMemory, Histories]:
        """Memory and path after a search for a new trace."""
        profiles = np.concatenate([known[probable(memory.sun)], self._templates.shaded[None]])
        find = best_straight(ground.image, ground.behind, profiles)
        hints = memory.hints + 1 if find.score > _FOUND and find.marks > _MARKED else 0
        if hints < _IMAGES_TO_FIND:
            return memory._replace(hints=hints), path
        line = path.together
        slip = find.slip - line.steered - path_line.bend(line, 0) * self._rig.wheel[0]
        return memory._replace(hints=0, pursuit=begun(find)), histories.with_new_trace(path, slip, _FOUND_STD)

    def _path(self, memory: TraceMemory, view: RoverView) -> Histories:
        """Path states up to the view, by encoders and compass."""
        steer = steered_to(view)
        if memory.path is None:
            return histories.begun(view.heading, steer, view.tick, len(self._patch.bands))
        distance, yaw, seconds = memory.unused, memory.turned, memory.seconds
        return memory.path.each(
            lambda path: with_compass(moved(path, distance, yaw, seconds, steer, view.tick), view.heading)
        )

    def _yaw_rate(self, view: RoverView) -> float:
        """Yaw rate by the encoders, without slip [rad/s]."""
        return wheel_motion(self._wheels, self._rig.wheel_radius * view.wheel_speeds, view.steer).yaw_rate


def begun(find: Find) -> Pursuit:
    """State of a new trace."""
    return Pursuit(find.marks, images=0, missed=0, sure=False)


def judged(pursuit: Pursuit, score: float, marks: float) -> Pursuit:
    """State after an image with the rut score ``score`` and the correlation ``marks`` of lug marks along the line."""
    marks = _KEEPING * pursuit.marks + (1.0 - _KEEPING) * marks
    images = pursuit.images + 1
    return pursuit._replace(
        marks=marks,
        images=images,
        missed=0 if score > _KEPT and marks > _MARKED else pursuit.missed + 1,
        sure=pursuit.sure or (marks > _SURE and images >= _IMAGES_TO_CONFIRM),
    )
