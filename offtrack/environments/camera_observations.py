"""Observations of trailers through rendered cameras, with the sensors and estimator of a scenario.

Each episode has its own world, which its seed decides, and its own renderer: a reset takes seconds and a frame tens of
milliseconds, one trailer after the other. Use few trailers, to see what a policy does with real sensors. A renderer
belongs to the thread that resets and steps; do not fork a process that has one.
"""

import math
from collections.abc import Callable, Sequence
from concurrent.futures import Executor, ThreadPoolExecutor
from dataclasses import replace
from functools import partial
from typing import Any, Final

import numpy as np
from gymnasium import spaces

from controllers.trailer_steering.policy import AHEAD, estimate_features, signal_features
from offtrack.environments.core import Observation, observation_space, within
from offtrack.environments.observations import EpisodeStart, PathOffset, features, own_features
from offtrack.environments.pictures import ImageObservation, SensedChannel, stereo_view
from offtrack.reports.canvas import Picture
from scenarios.assembly.adapters import check_schedule, rig_schedule, trailer_geometry
from scenarios.assembly.applied_faults import refuse_loop_faults
from scenarios.assembly.trailer_run import opened_sensing, trailer_stream
from scenarios.assembly.trailer_sensors import MountContext, StereoCameras, Views, built_world
from scenarios.courses import Course
from scenarios.loop.trailer_session import OffTrackingEstimate, as_estimate
from scenarios.options.scenario import Scenario, stream
from scenarios.results.trailer_signals import Estimate
from sensors.instruments.combination import CombinationSensors
from sensors.messages import StereoFrame
from vehicle.clock import TICK
from vehicle.combination.batch import BatchMotion, LaneObserver, PlantBatch
from vehicle.combination.description import Vehicle
from vehicle.combination.plant import SurfaceLookup
from vehicle.combination.truth import Truth
from vehicle.foundation.own_parts import close_part
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
            rig=scenario.rig,
            ground_rig=scenario.ground_rig,
            ground=scenario.surface,
            trailer=replace(trailer_geometry(vehicle, unit), follow_distance=follow_distance),
            signals=self._signals,
            stream=own,
        )
        sensing = opened_sensing(scenario, mount)
        self._worker, self._estimator = worker, sensing.estimator
        use_cameras = images and sensing.cameras is None
        source = StereoCameras.of(mount) if use_cameras else sensing
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
        """Features as ``observations.features`` lists them, of the newest estimate with health."""
        values, age = (0.0,) * _N_ESTIMATED, NEVER
        if self._channel.healthy is not None:
            healthy = as_estimate(self._channel.healthy).off_tracking
            values, age = estimate_features(healthy, self._follow_distance), healthy.age(self._tick)
        return np.array([*values, age, float(self._channel.usable), *self._signal_features])

    def own_features(self) -> FloatArray:
        """Features as ``observations.own_features`` lists them: the image's age and the trailer's own sensors."""
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


_SEEDS: Final = 2**31


class CameraObservations:
    """Observations of n trailers with a scenario's sensors: estimates, or reduced camera images."""

    def __init__(
        self,
        vehicle: Vehicle,
        fleet: PlantBatch,
        courses: Sequence[Course],
        scenario: Scenario,
        step: int,
        image_scale: int | None,
    ) -> None:
        """For control steps of ``step`` ticks; sensors open when an episode begins.

        Args:
            vehicle: the combination.
            fleet: the plants of all episodes.
            courses: that episodes take place on.
            scenario: gives rig, world, faults and estimator.
            step: length of a control step [ticks].
            image_scale: factor that reduces images; None: observe estimates.

        Raises:
            ValueError: one line, if the scenario has no estimator for cameras, its cameras are not synchronous with
                the control steps, or the factor does not fit its images.
        """
        source, rig, n_steered = scenario.off_tracking, scenario.rig, len(vehicle.units[-1].steered_axles)
        self._images: ImageObservation | None = None
        if image_scale is not None:
            self.features = own_features(vehicle, n_steered)
            self._images = ImageObservation((2, rig.height, rig.width), image_scale, self.features)
        elif source in ("truth", "surrogate"):
            raise ValueError(
                f"sensing: scenario {scenario.name} has off_tracking = {source}; use observation = '{source}'"
            )
        else:
            self.features = features(vehicle, n_steered)
        check_schedule(rig_schedule(scenario.rig), step, step_name="the control step, ")
        self._space = observation_space(self.features)
        self.observation_space: spaces.Space[Any] = self._images.space if self._images else self._space
        self._vehicle, self._fleet, self._courses, self._scenario = vehicle, fleet, courses, scenario
        self._step, self._truths = step, LaneObserver(vehicle, fleet)
        self._tick = np.zeros(fleet.n, dtype=np.intp)  # of each trailer, by the clock of its cameras
        self._worker: ThreadPoolExecutor | None = None
        self._grounds: dict[int, SurfaceLookup] = {}
        self._trailers: dict[int, SensedTrailer] = {}  # by lane, once begun

    def __getstate__(self) -> dict[str, Any]:
        raise ValueError(
            "an episode with rendered cameras cannot be copied or pickled: do so before the first reset, "
            "or use observation = 'surrogate' or 'truth'"
        )

    def begin(self, start: EpisodeStart, motion: BatchMotion, offset: PathOffset) -> None:
        """Open the sensors of these episodes; an estimator has followed the trailer straight to its start."""
        self._worker = self._worker or ThreadPoolExecutor(max_workers=1, thread_name_prefix="estimator")
        lanes: list[int] = start.lanes.tolist()
        for k, lane in enumerate(lanes):
            if lane in self._trailers:
                self._trailers.pop(lane).close()
            course, drawn = self._courses[start.course[k]], start.drawn
            surface = Surface(
                friction=float(drawn.friction[k]), cross_fall=float(drawn.cross_fall[k]), centre=course.surface_centre
            )
            self._trailers[lane] = SensedTrailer(
                self._scenario,
                self._vehicle,
                self._worker,
                course=course,
                surface=surface,
                follow_distance=float(start.follow_distance[k]),
                signal_noise=float(drawn.sensor_error[k]),
                seed=int(start.generators[k].integers(_SEEDS)),
                images=self._images is not None,
            )
            self._grounds[lane], self._tick[lane] = SurfaceLookup(surface, self._vehicle), 0
        for lane in lanes:
            if self._images is None:
                self._approach(lane)
            self._trailers[lane].look(self._truth(lane, int(self._tick[lane])))

    def step(self, motion: BatchMotion, offset: PathOffset) -> None:
        """Let all trailers whose state is finite look, one control step later."""
        self._tick += self._step
        for lane in np.flatnonzero(self._fleet.finite).tolist():
            if lane in self._trailers:
                self._trailers[lane].look(self._truth(lane, int(self._tick[lane])))

    def observe(self) -> Observation:
        """Features as ``features`` lists them; images (n, 2, height, width), left and right, if observed."""
        rows = np.zeros((self._fleet.n, len(self.features)))
        for lane, trailer in self._trailers.items():
            rows[lane] = trailer.own_features() if self._images else trailer.features()
        if self._images is None:
            return within(rows, self._space)
        frames = {lane: trailer.frame for lane, trailer in self._trailers.items()}
        return self._images.observe(rows, {lane: (f.left, f.right) for lane, f in frames.items() if f is not None})

    def view(self, lane: int) -> Picture | None:
        """Camera images at full size, with the features that an odometry follows; None without cameras."""
        trailer = self._trailers.get(lane)
        return None if trailer is None or trailer.frame is None else stereo_view(trailer.frame, trailer.newest)

    def close(self) -> None:
        """Close cameras and the estimators' thread."""
        while self._trailers:
            self._trailers.popitem()[1].close()
        if self._worker is not None:
            self._worker.shutdown(cancel_futures=True)
            self._worker = None

    def _truth(self, lane: int, tick: int, back: float = 0.0) -> Truth:
        """Ground truth of a trailer, moved back by a distance [m]."""
        return self._truths.truth(lane, self._grounds[lane], tick, back=back)

    def _approach(self, lane: int) -> None:
        speed = float(self._truth(lane, 0).velocities[0, 0])
        self._tick[lane] = self._trailers[lane].approach(lambda tick, back: self._truth(lane, tick, back), speed)
