"""Slip from the curved trace behind the wheel, tracked from picture to picture.

Where FTrace (Reina 2008) fits a straight line to edges of one picture, this follows the whole rut, its lug marks and
both its walls along the way that the wheel went: slip of the last seconds is drawn in the sand. After Reina et al.
(2008), "Vision-based estimation of slip angle for mobile robots and planetary rovers", in what is estimated; the means
are this project's own.
"""

from __future__ import annotations

import math
from typing import ClassVar, Final, NamedTuple, Self

import numpy as np

from estimators.context import RoverContext
from estimators.estimates import SlipAngle, lost_slip
from estimators.slip.rover_odometry import rolled, wheel_places
from estimators.slip.trace_tracker import histories, path_line
from estimators.slip.trace_tracker.acquisition import best_straight
from estimators.slip.trace_tracker.channels import channels
from estimators.slip.trace_tracker.following import Ground, looked, with_sun
from estimators.slip.trace_tracker.ground_patch import GroundPatch
from estimators.slip.trace_tracker.histories import Histories
from estimators.slip.trace_tracker.path_state import SHORTEST, moved, with_compass
from estimators.slip.trace_tracker.pursuit import MARKED, Pursuit, begun, judged
from estimators.slip.trace_tracker.slip_estimate import slip_angle, steered_to
from estimators.slip.trace_tracker.sun_belief import expected, lit, probable, unknown_sun
from estimators.slip.trace_tracker.templates import Profiles, Templates, shipped_templates
from sensors.messages import RoverView
from sensors.sand.trace_rig import TraceRig
from vehicle.clock import TICK
from vehicle.frames import FloatArray
from vehicle.option import Option

_FOUND: Final = 0.36  # likeness of a rut found: sand under moving shadows reaches this once in a hundred pictures
_PICTURES_TO_FIND: Final = 2  # running
_YOUNG: Final = 20  # pieces whose slip says how the trace near the wheel runs
# By which a wheel turns farther than it goes; it stretches the history that is looked for. Light rovers on level dry
# sand have 0.05 to 0.15; assumed, as no instrument on board tells it.
_SLIP_RATIO: Final = 0.1
_FOUND_STD: Final = math.radians(4.0)  # of the slip of a trace just found


class TraceMemory(NamedTuple):
    """What is carried from one view to the next."""

    tick: int | None  # of the last view
    unused: float  # way gone since the newest piece began [m]
    turned: float  # by the encoders on that way [rad]
    seconds: float  # on that way
    path: Histories | None
    pursuit: Pursuit | None  # of the trace along the path; None: none is followed
    hints: int  # pictures running that show one
    sun: FloatArray  # log likelihood of suns
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
        """Memory and slip angle; until a picture shows something new it is that of the last one."""
        memory = self._rolled(memory, view)
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
            look = looked(ground, path, (expected(known, memory.sun), self._templates.shaded))
            path, pursuit = look.path, judged(pursuit, look.likeness, float(look.marks.mean()))
            if pursuit.seen:
                memory = memory._replace(sun=with_sun(memory.sun, look, known))
                estimate = slip_angle(self._rig, path, float(view.steer[self._rig.watched]), view.tick, look.likeness)
            if pursuit.lost:
                pursuit = None
        path = path.each(lambda one: path_line.with_fronts(one, self._rig))
        return memory._replace(path=path, pursuit=pursuit, estimate=estimate), estimate

    def _rolled(self, memory: TraceMemory, view: RoverView) -> TraceMemory:
        """With what the encoders counted since the last view; a rover that backs over its trace begins anew."""
        if memory.tick is None:
            return memory._replace(tick=view.tick)
        seconds = (view.tick - memory.tick) * TICK
        way = seconds * self._rig.wheel_radius * float(view.wheel_speeds.mean())
        length = (1.0 - _SLIP_RATIO) * way
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
        """After a search for a trace from scratch."""
        told = np.concatenate([known[probable(memory.sun)], self._templates.shaded[None]])
        find = best_straight(ground.image, ground.behind, told)
        hints = memory.hints + 1 if find.score > _FOUND and find.marks > MARKED else 0
        if hints < _PICTURES_TO_FIND:
            return memory._replace(hints=hints), path
        line = path.together
        slip = find.slip - line.steered - path_line.bend(line, 0) * self._rig.wheel[0]
        return memory._replace(hints=0, pursuit=begun(find)), histories.found(path, slip, _FOUND_STD)

    def _path(self, memory: TraceMemory, view: RoverView) -> Histories:
        """The history up to the view, by encoders and compass."""
        steer = steered_to(view)
        if memory.path is None:
            return histories.begun(view.heading, steer, view.tick, len(self._patch.bands))
        way, yaw, seconds = memory.unused, memory.turned, memory.seconds
        return memory.path.each(
            lambda path: with_compass(moved(path, way, yaw, seconds, steer, view.tick), view.heading)
        )

    def _yaw_rate(self, view: RoverView) -> float:
        """By the encoders, of wheels that do not slip [rad/s]."""
        return rolled(self._wheels, self._rig.wheel_radius * view.wheel_speeds, view.steer).yaw_rate
