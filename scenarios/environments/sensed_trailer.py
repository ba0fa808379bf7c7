"""A trailer of an environment with the sensors, the estimator and the world of a scenario."""

from __future__ import annotations

import math
from collections.abc import Callable
from concurrent.futures import Executor
from dataclasses import dataclass, replace
from functools import partial
from typing import Final

import numpy as np

from controllers.trailer_steering.policy import AHEAD, estimate_features, signal_features
from estimators.estimates import Health, OffTracking
from scenarios.assembly.adapters import trailer_geometry
from scenarios.assembly.mount import MountContext
from scenarios.assembly.sensing import opened_sensing, opened_sensor
from scenarios.assembly.trailer import trailer_stream
from scenarios.assembly.views import Views, built_world
from scenarios.courses import Course
from scenarios.loop.channel import Channel
from scenarios.loop.combination import OffTrackingEstimate, as_estimate
from scenarios.loop.stopwatch import Stopwatch
from scenarios.options.scenario import Scenario
from scenarios.randomness import stream
from scenarios.results.trailer_signals import Estimate
from sensors.instruments.combination import CombinationSensors
from sensors.messages import StereoFrame
from sensors.sensor import Message
from vehicle.clock import TICK, Schedule
from vehicle.combination.description import Vehicle
from vehicle.combination.truth import Truth
from vehicle.frames import FloatArray
from vehicle.surface import Surface

NEVER: Final = 60.0  # age of what has not come yet: the most that an observation can say [s]
_N_SEEN: Final = 5 + len(AHEAD)  # features of an estimate
_MORE: Final = 2.0  # way that fills a buffer, beyond the follow distance: its path's end is fitted [m]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Setting:
    """Where and on what an episode takes place."""

    course: Course
    surface: Surface
    follow_distance: float  # [m]
    signal_noise: float  # errors of the combination's own sensors, over those of the scenario [-]
    seed: int  # decides world and noise


class SensedTrailer:
    """The last trailer of a vehicle, sensed; whoever opens one has to close it."""

    def __init__(self, scenario: Scenario, vehicle: Vehicle, setting: Setting, worker: Executor, *, sees: bool) -> None:
        """Before the first sample.

        Args:
            scenario: whose rig, faults, estimator and world.
            vehicle: the combination.
            setting: of the episode.
            worker: what estimates are worked out in, one after the other.
            sees: have cameras, whether they are estimated from or not.

        Raises:
            ValueError: one line, for whatever of the scenario does not fit.
            RendererUnavailableError: one line, if cameras are needed and OpenGL does not work here.
        """
        unit, seed = len(vehicle.units) - 1, setting.seed
        course, surface = _with_approach(setting.course, distance_to_fill(setting.follow_distance)), setting.surface
        own, noise = partial(trailer_stream, seed, vehicle, unit), setting.signal_noise * scenario.signals.noise
        self._signals = CombinationSensors(
            vehicle, unit, rng=stream(seed, f"signals of {vehicle.units[unit].name}"), noise=noise
        )
        self._views = Views(lambda: built_world(scenario.world, course, surface, stream(seed, "world")))
        mount = MountContext(
            vehicle=vehicle,
            unit=unit,
            follow_distance=setting.follow_distance,
            surface=surface,
            views=self._views,
            nominal=vehicle,
            schedule=camera_schedule(scenario),
            rng=own("sensor"),
            options=scenario.sensing,
            scenario=scenario,
            trailer=replace(trailer_geometry(vehicle, unit), follow_distance=setting.follow_distance),
            signals=self._signals,
            stream=own,
        )
        sensing = opened_sensing(mount)
        sensor, schedule = sensing.sensor, sensing.schedule
        if sees and sensing.cameras is None:
            opened = opened_sensor("stereo_camera", mount)
            sensor, schedule = opened.sensor, opened.schedule
        self._channel: Channel[Truth, Message, OffTrackingEstimate] = Channel(
            sensor, schedule, None if sees else sensing.estimator, worker, Stopwatch()
        )
        self._follow = setting.follow_distance
        self._tick = 0  # of the newest look
        self._good: OffTracking | None = None  # the newest estimate with health
        self._felt: tuple[float, ...] = ()
        self.frame: StereoFrame | None = None  # the newest

    @property
    def newest(self) -> Estimate | None:
        """The estimate delivered last."""
        return None if self._channel.newest is None else as_estimate(self._channel.newest)

    def approach(self, standing: Callable[[int, float], Truth], speed: float) -> int:
        """Comes straight to the start at this speed [m/s], looking, until the way behind it is known.

        ``standing(tick, back)`` is the truth at a tick so far behind the start [m]. The cameras' clock begins with it;
        returned is the tick at which the start is reached, whose frame is not taken yet.
        """
        period = self._channel.schedule.period
        arrival = period * math.ceil(distance_to_fill(self._follow) / (speed * period * TICK))
        for tick in range(0, arrival, period):
            self._sample(standing(tick, speed * (arrival - tick) * TICK))
        return arrival

    def look(self, truth: Truth) -> None:
        """A control step: sample what is due, receive the estimates that are due by now."""
        self._tick = truth.tick
        self._sample(truth)
        self._felt = signal_features(self._signals.sample(truth), self._follow)

    def estimated(self) -> FloatArray:
        """As ``trailer_features.features`` lists it, of the newest estimate with health."""
        newest = self.newest
        usable = newest is not None and newest.off_tracking.health is not Health.LOST
        if self._good is None:
            told, age = (0.0,) * _N_SEEN, NEVER
        else:
            told, age = estimate_features(self._good, self._follow), self._good.age(self._tick)
        return np.array([*told, age, float(usable), *self._felt])

    def felt(self) -> FloatArray:
        """As ``trailer_features.own_features`` lists it: the age of the picture, and the combination's own sensors."""
        age = NEVER if self.frame is None else (self._tick - self.frame.tick) * TICK
        return np.array([age, *self._felt])

    def close(self) -> None:
        """Close the cameras."""
        self._views.close()

    def _sample(self, truth: Truth) -> None:
        message = self._channel.sample(truth, truth.tick)
        if isinstance(message, StereoFrame):
            self.frame = message
        known = len(self._channel.delivered)
        self._channel.deliver(truth.tick)
        for delivered in self._channel.delivered[known:]:
            off_tracking = as_estimate(delivered).off_tracking
            if off_tracking.health is not Health.LOST:
                self._good = off_tracking


def distance_to_fill(follow_distance: float) -> float:
    """How far a trailer drives until its buffer reaches back to the follow point [m]."""
    return follow_distance + _MORE


def camera_schedule(scenario: Scenario) -> Schedule:
    """When pictures are taken, and how long estimates take.

    Raises:
        ValueError: one line, if a period is no whole number of ticks.
    """
    return Schedule.at_rate(scenario.rig.rate_hz, latency=scenario.rig.latency, name="rig.rate_hz")


def _with_approach(course: Course, way: float) -> Course:
    """The course with a road that begins so much farther behind its start [m]."""
    line = course.centreline
    back = line[0] - line[1]
    return replace(course, centreline=np.vstack([line[0] + way * back / math.hypot(*back.tolist()), line]))
