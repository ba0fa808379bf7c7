"""Slip from the curved trace behind the wheel, tracked from picture to picture.

Where FTrace (Reina 2008) fits a straight line to edges of one picture, this follows the whole rut, its lug marks and
both its walls along the way that the wheel went: slip of the last seconds is drawn in the sand. After Reina et al.
(2008), "Vision-based estimation of slip angle for mobile robots and planetary rovers", in what is estimated; the means
are this project's own.
"""

from __future__ import annotations

import math
from typing import Final, NamedTuple

import numpy as np

from estimators.estimates import SlipAngle
from estimators.trace_tracker import histories, path_line
from estimators.trace_tracker.acquisition import best_straight
from estimators.trace_tracker.channels import channels
from estimators.trace_tracker.following import Ground, Look, looked, with_sun
from estimators.trace_tracker.ground_patch import GroundPatch
from estimators.trace_tracker.histories import Histories
from estimators.trace_tracker.path_state import SHORTEST, moved, with_compass
from estimators.trace_tracker.slip_estimate import lost, slip_angle, steered_to, yaw_rate
from estimators.trace_tracker.sun_belief import expected, lit, probable, unknown_sun
from estimators.trace_tracker.templates import Profiles, Templates, shipped_templates
from sensors.messages import RoverView
from sensors.trace_rig import TraceRig
from vehicle.clock import TICK
from vehicle.frames import FloatArray
from vehicle.rover.command import REAR_LEFT

_FOUND: Final = 0.33  # mean correlation of a rut found: sand alone reaches this once in some hundred pictures
_KEPT: Final = 0.28  # of one that is followed over all of the view: faint ones in shade have 0.33, sand 0.2
_PICTURES_TO_FIND: Final = 2  # running
_PICTURES_TO_LOSE: Final = 5  # running
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
    sun: FloatArray  # log likelihood of suns
    following: bool
    running: int  # pictures running that say the opposite
    estimate: SlipAngle | None  # the last one


class FTracePlus:
    """Tracker of the left rear wheel's trace; ``init`` and ``step`` are pure."""

    def __init__(self, rig: TraceRig, templates: Templates | None = None) -> None:
        self._rig = rig
        self._patch = GroundPatch(rig=rig)
        self._templates = shipped_templates() if templates is None else templates

    def init(self) -> TraceMemory:
        """Before the first view."""
        return TraceMemory(None, 0.0, 0.0, 0.0, None, unknown_sun(), following=False, running=0, estimate=None)

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
        if not memory.following:
            memory, path = self._searched(memory, path, ground, known)
        score = 0.0
        if memory.following:
            look = looked(ground, path, (expected(known, memory.sun), self._templates.shaded))
            memory, path, score = _judged(memory, look, known), look.path, _presence(look)
        steer = float(view.steer[REAR_LEFT])
        estimate = slip_angle(self._rig, path, steer, view.tick, score) if score > 0.0 else lost(view.tick)
        path = path.each(lambda one: path_line.with_fronts(one, self._rig))
        return memory._replace(path=path, estimate=estimate), estimate

    def _rolled(self, memory: TraceMemory, view: RoverView) -> TraceMemory:
        """With what the encoders counted since the last view; a rover that backs over its trace begins anew."""
        if memory.tick is None:
            return memory._replace(tick=view.tick)
        seconds = (view.tick - memory.tick) * TICK
        rolled = seconds * self._rig.wheel_radius * float(view.wheel_speeds.mean())
        length = (1.0 - _SLIP_RATIO) * rolled
        if memory.unused + length < -SHORTEST:
            return self.init()._replace(tick=view.tick, sun=memory.sun)
        return memory._replace(
            tick=view.tick,
            unused=memory.unused + length,
            turned=memory.turned + (1.0 - _SLIP_RATIO) * seconds * yaw_rate(self._rig, view),
            seconds=memory.seconds + seconds,
        )

    def _searched(
        self, memory: TraceMemory, path: Histories, ground: Ground, known: Profiles
    ) -> tuple[TraceMemory, Histories]:
        """After a search for a trace from scratch."""
        told = np.concatenate([known[probable(memory.sun)], self._templates.shaded[None]])
        find = best_straight(ground.image, ground.behind, told)
        running = memory.running + 1 if find.score > _FOUND else 0
        if running < _PICTURES_TO_FIND:
            return memory._replace(running=running), path
        line = path.together
        slip = find.slip - line.steered - path_line.bend(line, 0) * self._rig.wheel[0]
        # One picture in which it is not seen along its history tells it from what only looked like one.
        doubtful = _PICTURES_TO_LOSE - 1
        return memory._replace(following=True, running=doubtful), histories.found(path, slip, _FOUND_STD)

    def _path(self, memory: TraceMemory, view: RoverView) -> Histories:
        """The history up to the view, by encoders and compass."""
        steer = steered_to(view)
        if memory.path is None:
            return histories.begun(view.heading, steer, view.tick, len(self._patch.bands))
        way, yaw, seconds = memory.unused, memory.turned, memory.seconds
        return memory.path.each(
            lambda path: with_compass(moved(path, way, yaw, seconds, steer, view.tick), view.heading)
        )


def _judged(memory: TraceMemory, look: Look, known: Profiles) -> TraceMemory:
    """Follows on, or gives up when a trace was not seen several times running."""
    if _presence(look) > 0.0:
        return memory._replace(sun=with_sun(memory.sun, look, known), running=0)
    lose = memory.running + 1 >= _PICTURES_TO_LOSE
    return memory._replace(following=not lose, running=0 if lose else memory.running + 1)


def _presence(look: Look) -> float:
    """How well a trace is seen; 0 if it is not."""
    score = float(look.scores.mean())
    return score if score > _KEPT else 0.0
