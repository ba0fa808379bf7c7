"""Trailer of an environment with the sensors, the estimator and the world of a scenario."""

from __future__ import annotations

import math
from collections.abc import Callable
from concurrent.futures import Executor
from dataclasses import replace
from functools import partial
from typing import Final

import numpy as np

from controllers.trailer_steering.policy import AHEAD, estimate_features, signal_features
from scenarios.assembly.adapters import trailer_geometry
from scenarios.assembly.loop_faults import refuse_loop_faults
from scenarios.assembly.mount import MountContext
from scenarios.assembly.rig_schedule import rig_schedule
from scenarios.assembly.sensing import opened_sensing, opened_sensor
from scenarios.assembly.trailer import trailer_stream
from scenarios.assembly.views import Views, built_world
from scenarios.courses import Course
from scenarios.environments.sensed import SensedChannel
from scenarios.loop.pilot import OffTrackingEstimate, as_estimate
from scenarios.options.scenario import Scenario
from scenarios.randomness import stream
from scenarios.results.trailer_signals import Estimate
from sensors.instruments.combination import CombinationSensors
from sensors.messages import StereoFrame
from vehicle.clock import TICK
from vehicle.closing import close_part
from vehicle.combination.description import Vehicle
from vehicle.combination.truth import Truth
from vehicle.frames import FloatArray
from vehicle.surface import Surface

NEVER: Final = 60.0  # age before the first estimate or image: the limit of the observation [s]
_N_ESTIMATED: Final = 5 + len(AHEAD)  # features of an estimate
_MARGIN: Final = 2.0  # buffered path beyond the follow distance: its end is fitted [m]


class SensedTrailer:
    """The last trailer of a vehicle with its sensors; the caller must close it."""

    def __init__(
        self,
        scenario: Scenario,
        vehicle: Vehicle,
        worker: Executor,
        *,
        course: Course,
        surface: Surface,
        follow_distance: float,
        signal_noise: float,
        seed: int,
        images: bool,
    ) -> None:
        """Open the sensors before the first sample.

        Args:
            scenario: gives rig, faults, estimator and world.
            vehicle: the combination.
            worker: executor in which the estimator runs.
            course: of the episode.
            surface: of the episode.
            follow_distance: hitch to follow point [m].
            signal_noise: scale of the errors of the combination's own sensors, relative to the scenario's [-].
            seed: decides world and noise.
            images: True: capture camera images and estimate nothing.

        Raises:
            ValueError: one line, for whatever of the scenario does not fit.
            RendererUnavailableError: one line, if cameras are needed and OpenGL does not work here.
        """
        refuse_loop_faults(scenario.faults, "an episode of an environment")
        unit = len(vehicle.units) - 1
        longer = _with_approach(course, distance_to_fill(follow_distance))
        own = partial(trailer_stream, seed, vehicle, unit)
        self._signals = CombinationSensors(
            vehicle,
            unit,
            rng=stream(seed, f"signals of {vehicle.units[unit].name}"),
            noise=signal_noise * scenario.signals.noise,
        )
        self._views = Views(lambda: built_world(scenario.world, longer, surface, stream(seed, "world")))
        mount = MountContext(
            vehicle=vehicle,
            unit=unit,
            follow_distance=follow_distance,
            surface=surface,
            views=self._views,
            nominal=vehicle,
            schedule=rig_schedule(scenario.rig),
            rng=own("sensor"),
            options=scenario.sensing,
            scenario=scenario,
            trailer=replace(trailer_geometry(vehicle, unit), follow_distance=follow_distance),
            signals=self._signals,
            stream=own,
        )
        sensing = opened_sensing(mount)
        self._worker, self._estimator = worker, sensing.estimator
        use_cameras = images and sensing.cameras is None
        source = opened_sensor("stereo_camera", mount) if use_cameras else sensing
        self._channel: SensedChannel[Truth, StereoFrame, OffTrackingEstimate] = SensedChannel(
            source.sensor,
            source.schedule,
            None if images else sensing.estimator,
            worker,
            image_type=StereoFrame,
            health=lambda estimate: as_estimate(estimate).off_tracking.health,
        )
        self._period = source.schedule.period if use_cameras else sensing.period  # between two images
        self._follow_distance = follow_distance
        self._tick = 0  # of the newest look
        self._signal_features: tuple[float, ...] = ()

    @property
    def frame(self) -> StereoFrame | None:
        """The newest stereo frame."""
        return self._channel.image

    @property
    def newest(self) -> Estimate | None:
        """The estimate delivered last."""
        return None if self._channel.newest is None else as_estimate(self._channel.newest)

    def approach(self, truth_behind: Callable[[int, float], Truth], speed: float) -> int:
        """Drive straight to the start at this speed [m/s] with sensors on, until the path behind it is known.

        ``truth_behind(tick, back)`` is the truth at a tick, at a distance behind the start [m]. The cameras' clock
        begins with it. Returns the tick at which the start is reached; its frame is not captured yet.
        """
        period = self._period
        arrival = period * math.ceil(distance_to_fill(self._follow_distance) / (speed * period * TICK))
        for tick in range(0, arrival, self._channel.schedule.period):
            self._channel.look(truth_behind(tick, speed * (arrival - tick) * TICK))
        return arrival

    def look(self, truth: Truth) -> None:
        """Sample all sensors that are due, and receive the estimates that are due."""
        self._tick = truth.tick
        self._channel.look(truth)
        self._signal_features = signal_features(self._signals.sample(truth), self._follow_distance)

    def features(self) -> FloatArray:
        """Features as ``trailer_features.features`` lists them, of the newest estimate with health."""
        values, age = (0.0,) * _N_ESTIMATED, NEVER
        if self._channel.healthy is not None:
            healthy = as_estimate(self._channel.healthy).off_tracking
            values, age = estimate_features(healthy, self._follow_distance), healthy.age(self._tick)
        return np.array([*values, age, float(self._channel.usable), *self._signal_features])

    def own_features(self) -> FloatArray:
        """Features as ``trailer_features.own_features`` lists them: the image's age and the trailer's own sensors."""
        return np.array([self._channel.image_age(self._tick, without=NEVER), *self._signal_features])

    def close(self) -> None:
        """Close the estimator, once it has finished its last message, and the cameras."""
        self._worker.submit(close_part, self._estimator).result()
        self._views.close()


def distance_to_fill(follow_distance: float) -> float:
    """Distance that a trailer drives until its buffered path reaches back to the follow point [m]."""
    return follow_distance + _MARGIN


def _with_approach(course: Course, distance: float) -> Course:
    """The course with its road extended straight behind the start by a distance [m]."""
    line = course.centreline
    back = line[0] - line[1]
    return replace(course, centreline=np.vstack([line[0] + distance * back / math.hypot(*back.tolist()), line]))
