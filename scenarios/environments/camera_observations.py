"""Observations of trailers through rendered cameras: an estimator's estimates, or the images themselves.

Each episode has its own world, which its seed decides, and its own renderer: a reset takes seconds and a frame tens of
milliseconds, one trailer after the other. Use few trailers, to see what a policy does with real sensors. A renderer
belongs to the thread that resets and steps; do not fork a process that has one.
"""

from __future__ import annotations

from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import Any, Final

import numpy as np
from gymnasium import spaces

from scenarios.assembly.rig_schedule import check_schedule, rig_schedule
from scenarios.courses import Course
from scenarios.environments.core import Observation, observation_space, within
from scenarios.environments.hitch_paths import PathOffset
from scenarios.environments.images import ImageObservation
from scenarios.environments.observations import EpisodeStart
from scenarios.environments.sensed_trailer import SensedTrailer
from scenarios.environments.trailer_features import features, own_features
from scenarios.environments.trailer_view import stereo_view
from scenarios.options.scenario import Scenario
from scenarios.report.canvas import Picture
from vehicle.combination.batch import BatchMotion, LaneObserver, PlantBatch
from vehicle.combination.description import Vehicle
from vehicle.combination.ground_inputs import SurfaceLookup
from vehicle.combination.truth import Truth
from vehicle.surface import Surface

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
