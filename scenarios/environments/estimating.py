"""What those who steer trailers are given by real sensors: an estimator's estimates, or the cameras' pictures.

Every episode has a world of its own, decided by its seed, and a renderer that draws it: some seconds to begin one, and
tens of milliseconds for every frame, one trailer after the other. That is for a few trailers, to look at what a policy
does with what it really sees. Renderers belong to the thread that resets and steps; a process that has one must not be
forked.
"""

from __future__ import annotations

from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import Any, Final

import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

from scenarios.courses import Course
from scenarios.environments.core import Feature, Features, observation_space, within
from scenarios.environments.hitch_paths import Beside
from scenarios.environments.images import reduced, reduced_shape
from scenarios.environments.knowledge import Start
from scenarios.environments.sensed_trailer import SensedTrailer, Setting, camera_schedule
from scenarios.environments.trailer_features import features, own_features
from scenarios.environments.trailer_view import stereo_view
from scenarios.options.scenario import Scenario
from scenarios.report.canvas import Picture
from vehicle.clock import TICK
from vehicle.combination.batch import BatchMotion, LaneObserver, PlantBatch
from vehicle.combination.description import Vehicle
from vehicle.combination.ground_inputs import SurfaceLookup
from vehicle.combination.truth import Truth
from vehicle.surface import Surface

_SEEDS: Final = 2**31


class _Sensed:
    """n trailers with sensors, whatever is made of these."""

    def __init__(
        self,
        vehicle: Vehicle,
        fleet: PlantBatch,
        courses: Sequence[Course],
        scenario: Scenario,
        step: int,
        *,
        sees: bool,
    ) -> None:
        """With the scenario's sensors, for control steps of so many ticks; nothing is opened before the first begins.

        Raises:
            ValueError: one line, if the scenario's cameras do not keep time with the steps.
        """
        schedule = camera_schedule(scenario)
        for name, ticks in (("1/rig.rate_hz", schedule.period), ("rig.latency", schedule.latency)):
            if ticks % step:
                raise ValueError(
                    f"{name} = {ticks * TICK:g} s must be a multiple of the control step, {step * TICK:g} s"
                )
        self._vehicle, self._fleet, self._courses, self._scenario = vehicle, fleet, courses, scenario
        self._step, self._sees = step, sees
        self._truth = LaneObserver(vehicle, fleet)
        self._tick = np.zeros(fleet.n, dtype=np.intp)  # of each, by the clock of its cameras
        self._worker: ThreadPoolExecutor | None = None
        self._grounds: dict[int, SurfaceLookup] = {}
        self.trailers: dict[int, SensedTrailer] = {}  # by their lanes; those that have not begun yet have none

    def begin(self, start: Start) -> list[int]:
        """Opens the sensors of those that begin; their lanes."""
        lanes: list[int] = start.lanes.tolist()
        for k, lane in enumerate(lanes):
            if lane in self.trailers:
                self.trailers.pop(lane).close()
            course = self._courses[start.course[k]]
            surface = Surface(
                friction=float(start.drawn.friction[k]),
                cross_fall=float(start.drawn.cross_fall[k]),
                centre=course.surface_centre,
            )
            setting = Setting(
                course=course,
                surface=surface,
                follow_distance=float(start.follow_distance[k]),
                signal_noise=float(start.drawn.sensor_error[k]),
                seed=int(start.generators[k].integers(_SEEDS)),
            )
            self._worker = self._worker or ThreadPoolExecutor(max_workers=1, thread_name_prefix="estimator")
            sensed = SensedTrailer(self._scenario, self._vehicle, setting, self._worker, sees=self._sees)
            self.trailers[lane], self._grounds[lane] = sensed, SurfaceLookup(surface, self._vehicle)
            self._tick[lane] = 0
        return lanes

    def step(self) -> list[tuple[SensedTrailer, Truth]]:
        """A control step later: those whose physics holds, and what is so of them."""
        self._tick += self._step
        whole = np.flatnonzero(self._fleet.finite).tolist()
        return [(self.trailers[lane], self.truth(lane)) for lane in whole if lane in self.trailers]

    def truth(self, lane: int) -> Truth:
        """What is so now."""
        return self._truth.truth(lane, self._grounds[lane], int(self._tick[lane]))

    def approach(self, lane: int) -> None:
        """Brings one that stands at its start there with its cameras running."""
        speed = float(self.truth(lane).velocities[0, 0])
        there = self.trailers[lane].approach(
            lambda tick, back: self._truth.truth(lane, self._grounds[lane], tick, back=back), speed
        )
        self._tick[lane] = there

    def close(self) -> None:
        """Closes cameras and the estimators' thread."""
        while self.trailers:
            self.trailers.popitem()[1].close()
        if self._worker is not None:
            self._worker.shutdown(cancel_futures=True)
            self._worker = None


class Estimated:
    """What an estimator makes of what the cameras see, and the combination's own sensors, as a scenario has them."""

    def __init__(
        self, vehicle: Vehicle, fleet: PlantBatch, courses: Sequence[Course], scenario: Scenario, step: int
    ) -> None:
        """With the sensors and the estimator of a scenario, for control steps of so many ticks.

        Raises:
            ValueError: one line, if the scenario estimates nothing, or does not keep time with the steps.
        """
        told = scenario.off_tracking
        if told in ("truth", "surrogate"):
            raise ValueError(f"sensing: scenario {scenario.name} has off_tracking = {told}; use observation = '{told}'")
        self.features = features(vehicle, len(vehicle.units[-1].steered_axles))
        self.observation_space = observation_space(self.features)
        self._n = fleet.n
        self._sensed = _Sensed(vehicle, fleet, courses, scenario, step, sees=False)

    def begin(self, start: Start, seen: BatchMotion, beside: Beside) -> None:
        """They have come straight to the start, cameras running, so that the way behind is known when it begins."""
        for lane in self._sensed.begin(start):
            self._sensed.approach(lane)
            self._sensed.trailers[lane].look(self._sensed.truth(lane))

    def step(self, seen: BatchMotion, beside: Beside) -> None:
        """A control step later."""
        for trailer, truth in self._sensed.step():
            trailer.look(truth)

    def observe(self) -> Features:
        """As ``features`` lists them."""
        rows = np.zeros((self._n, len(self.features)))
        for lane, trailer in self._sensed.trailers.items():
            rows[lane] = trailer.estimated()
        return within(rows, self.observation_space)

    def view(self, lane: int) -> Picture | None:
        """What the cameras see, with the features that the odometry follows; None where it needs no cameras."""
        trailer = self._sensed.trailers.get(lane)
        return None if trailer is None or trailer.frame is None else stereo_view(trailer.frame, trailer.newest)

    def close(self) -> None:
        """Closes the cameras."""
        self._sensed.close()


class Pictured:
    """What the cameras see: the newest pictures, and the combination's own sensors."""

    features: tuple[Feature, ...]

    def __init__(
        self,
        vehicle: Vehicle,
        fleet: PlantBatch,
        courses: Sequence[Course],
        scenario: Scenario,
        step: int,
        image_scale: int,
    ) -> None:
        """With the cameras of a scenario, pictures reduced by a factor, for control steps of so many ticks.

        Raises:
            ValueError: one line, if pictures can not be reduced so far, or cameras do not keep time with the steps.
        """
        self.features = own_features(vehicle, len(vehicle.units[-1].steered_axles))
        self._numbers = observation_space(self.features)
        self._scale = image_scale
        rig = scenario.rig
        self._shape = reduced_shape((2, rig.height, rig.width), image_scale)
        self.observation_space = spaces.Dict(
            {"image": spaces.Box(0, 255, self._shape, np.uint8), "features": self._numbers}
        )
        self._n = fleet.n
        self._sensed = _Sensed(vehicle, fleet, courses, scenario, step, sees=True)

    def begin(self, start: Start, seen: BatchMotion, beside: Beside) -> None:
        """They begin with a picture of the start."""
        for lane in self._sensed.begin(start):
            self._sensed.trailers[lane].look(self._sensed.truth(lane))

    def step(self, seen: BatchMotion, beside: Beside) -> None:
        """A control step later."""
        for trailer, truth in self._sensed.step():
            trailer.look(truth)

    def observe(self) -> dict[str, NDArray[Any]]:
        """``image`` (n, 2, height, width), left and right, and ``features``."""
        images, rows = np.zeros((self._n, *self._shape), np.uint8), np.zeros((self._n, len(self.features)))
        for lane, trailer in self._sensed.trailers.items():
            rows[lane] = trailer.felt()
            if trailer.frame is not None:
                images[lane] = [reduced(image, self._scale) for image in (trailer.frame.left, trailer.frame.right)]
        return {"image": images, "features": within(rows, self._numbers)}

    def view(self, lane: int) -> Picture | None:
        """The pictures at their full size."""
        trailer = self._sensed.trailers.get(lane)
        return None if trailer is None or trailer.frame is None else stereo_view(trailer.frame, None)

    def close(self) -> None:
        """Closes the cameras."""
        self._sensed.close()
