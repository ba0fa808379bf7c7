"""Environment: keep a skid-steered rover on its path across a slope; the wheel speeds of its sides are the action.

``offtrack/RoverSteering-v0``: wheels on loose soil (or firm ground), a control step of 0.1 s.

Action, ``Box(-1, 1, (2,))``: demanded wheel speeds of the left and the right side, over twice the set speed.

Observation, ``Box((11,))`` in SI units, each clipped to its limit; ``core.features`` lists them:

    cross_track                 m      of R's origin from the path, + left
    heading_error               rad
    curvature, curvature_ahead  1/m    of the path here and 0.5 m ahead
    slip_angle                  rad    direction of travel relative to the heading, + left
    yaw_rate                    rad/s
    wheel_speed_left, _right    -      rim speeds over the set speed
    inclination_ahead, _left    -      rise of the body's axes
    speed                       m/s    set speed

``observation`` selects the source of the slip angle, and the environment's spec records it; the rest is exact:

    "surrogate"  the noise of an estimate from a wheel's trace, 1.4 deg RMS (Reina 2008). The default.
    "truth"      exact.
    "estimate"   the camera behind the left rear wheel images the trace in the sand; the slip estimator of a scenario
                 works on the images: 5 Hz, 0.1 s old, the newest with health; 0 until the trace is about 0.6 m long.
                 ``sensing`` is the scenario or its name: it gives camera, sand, estimator and instruments; rover, path
                 and ground are the episode's. Not on firm ground, which takes no trace.
    "camera"     ``Dict(image=Box(0, 255, (1, height, width), uint8), features=Box((11,)))``: the newest image of that
                 camera, grey, reduced by ``image_scale``. The features are the image's age [s] and the others without
                 the slip angle.

Sand needs no renderer: a reset takes a second and a frame some tens of milliseconds, one rover after the other.

Reward of a step: ``rover_options.USUAL``, minus the squared cross-track error [dm2], 0.1 of the squared relative speed
deficit and 0.01 of the squared difference of the sides' demands; ``rover_options.MISHAP`` once at a mishap.
``reward={part: weight}`` replaces it.

Start: at rest on the path, wheels turning for the set speed; 0.5 m straight, then an arc, 7 m in total. Slopes, speed,
curvature, sensor error and soil are drawn from the episode's seed, or set: ``reset(options={"cross_fall": 0.08})``.

End: terminated when a wheel has sunk in too far, the rover is more than 1 m off the path or the physics diverged;
truncated at the path's end, or after twice its nominal time.

Info: ``cross_track``, ``cross_track_rms_m``, ``cross_track_max_m``, ``slip_angle`` (true); ``outcome`` at the end.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

from controllers.path import Path, arc, line
from offtrack.environments import rover_options
from offtrack.environments.core import Info, Lanes, Observation, Result, observation_space, within
from offtrack.environments.pictures import ImageObservation, rover_picture, side_by_side
from offtrack.environments.rewards import narrowed, weighted
from offtrack.environments.rover_options import (
    FEATURES,
    FIRM,
    IMAGE_FEATURES,
    SLIP,
    RoverDomain,
    RoverMoment,
    RoverSteeringOptions,
    SensedRover,
)
from offtrack.reports.canvas import Picture
from scenarios.results.rover_result import path_coordinates
from sensors.sand.trace_rig import nominal_rig
from vehicle.clock import TICK
from vehicle.combination.plant import DivergedError
from vehicle.frames import FloatArray, Pose2, wrap
from vehicle.rover.command import RoverCommand
from vehicle.rover.description import Soil, load_rover, load_soil
from vehicle.rover.plant import RoverPlant
from vehicle.rover.terrain import Terrain
from vehicle.rover.truth import RoverTruth

_STEP: Final = 100  # a control step [ticks]
_PERIOD: Final = _STEP * TICK  # [s]
_TRACE_STEP: Final = 50  # between two updates of the wheels' trace, as in scenarios [ticks]
_ENTRY, _LENGTH = 0.5, 7.0  # straight at the start, and total; the runs of Reina 2008 were 7 m long [m]
_MAX_WHEEL_SPEED: Final = 2.0  # of the action, over the set speed
_MAX_CROSS_TRACK: Final = 1.0  # nearly two lengths of the rover [m]
_PREVIEW: Final = 0.5  # ahead on the path, as in a driver's law [m]
_TIME_LIMIT: Final = 2.0  # of an episode, relative to its path at set speed
_SLIP_NOISE: Final = math.radians(1.4)  # of a slip angle from a wheel's trace, RMS (Reina 2008, conclusion)
_SEEDS: Final = 2**31


@dataclass(slots=True)
class _Episode:
    """State of an episode."""

    plant: RoverPlant
    state: FloatArray
    truth: RoverTruth
    path: Path
    speed: float  # [m/s]
    slip_noise: float  # [rad]
    sensed: SensedRover | None  # None: no camera
    rng: np.random.Generator
    station: float = 0.0  # [m]
    elapsed: float = 0.0  # [s]
    cross_track: float = 0.0  # + left of the path [m]
    squares: float = 0.0  # sum of its squares [m2]
    largest: float = 0.0  # [m]
    slip_estimate: float = 0.0  # [rad]
    finite: bool = True


class RoverSteering:
    """n episodes, one plant after the other."""

    control_rate = 1.0 / _PERIOD

    def __init__(self, n: int, options: RoverSteeringOptions) -> None:
        """Place all on level ground of the first soil until they ``begin``.

        Raises:
            ValueError: one line, if an option does not fit.
        """
        self.n, self._options = n, options
        self.rover = load_rover(options.vehicle)
        if self.rover.steered:
            raise ValueError(f"rover {self.rover.name} steers its wheels: RoverSteering is for skid-steered ones")
        self._left = self.rover.wheel_places[:, 1] > 0.0
        self._names = options.soil_names()
        self._soils: list[Soil | None] = [None if name == FIRM else load_soil(name) for name in self._names]
        self.action_space = spaces.Box(-1.0, 1.0, (2,), np.float32)
        self._reward = weighted(rover_options.USUAL if options.reward is None else options.reward)
        self._scenario = options.scenario(_STEP)
        self.features = IMAGE_FEATURES if options.observation == "camera" else FEATURES
        self._space = observation_space(self.features)
        self.observation_space: spaces.Space[Any] = self._space
        self._images: ImageObservation | None = None
        if options.observation == "camera":
            camera = nominal_rig(self.rover).camera
            self._images = ImageObservation((1, camera.height, camera.width), options.image_scale, self.features)
            self.observation_space = self._images.space
        level, first = RoverDomain(cross_fall=(0.0, 0.0), grade=(0.0, 0.0)), self._names[0]
        self._episodes = [self._begun(np.random.default_rng(k), level, first, open_sensors=False) for k in range(n)]

    def begin(self, lanes: Lanes, generators: list[np.random.Generator], options: Mapping[str, Any]) -> None:
        """Begin episodes; options are those of ``RoverDomain``, and ``soil`` by its name."""
        given = dict(options)
        soil = given.pop("soil", None)
        if soil is not None and not (isinstance(soil, str) and soil in self._names):
            raise ValueError(f"soil = {soil!r:.80} must be one of {', '.join(self._names)}")
        domain = narrowed(self._options.domain, given, ("soil",))
        for lane, rng in zip(lanes.tolist(), generators, strict=True):
            self._episodes[lane] = self._begun(rng, domain, soil, open_sensors=True)

    def step(self, actions: NDArray[np.float32]) -> Result:
        """Advance all episodes by 0.1 s."""
        before = np.array([episode.station for episode in self._episodes])
        results = [self._stepped(episode, action) for episode, action in zip(self._episodes, actions, strict=True)]
        ended, cut, outcome = zip(*results, strict=True)
        outcomes = np.empty(self.n, dtype=object)
        outcomes[:] = outcome
        with np.errstate(invalid="ignore"):  # where the physics diverged
            reward = self._reward(self._moment(before, np.clip(actions.astype(np.float64), -1.0, 1.0)))
        finite = np.array([episode.finite for episode in self._episodes])
        return Result(
            np.where(finite, reward, 0.0) + rover_options.MISHAP * np.array(ended),
            np.array(ended),
            np.array(cut),
            outcomes,
        )

    def observe(self) -> Observation:
        """Observation of all episodes."""
        rows = np.array([self._features(episode) for episode in self._episodes])
        if self._images is None:
            return within(rows, self._space)
        ages = [0.0 if e.sensed is None else e.sensed.age(e.truth.tick) for e in self._episodes]
        newest = {k: e.sensed.image for k, e in enumerate(self._episodes) if e.sensed is not None}
        images = {lane: (image,) for lane, image in newest.items() if image is not None}
        return self._images.observe(np.column_stack([ages, np.delete(rows, SLIP, axis=1)]), images)

    def info(self) -> Info:
        """Cross-track metrics so far."""
        steps = [max(1, round(e.elapsed / _PERIOD)) for e in self._episodes]
        squares = [e.squares / n for e, n in zip(self._episodes, steps, strict=True)]
        return {
            "cross_track": np.array([e.cross_track for e in self._episodes]),
            "cross_track_rms_m": np.sqrt(squares),
            "cross_track_max_m": np.array([e.largest for e in self._episodes]),
            "slip_angle": np.array([e.truth.slip_angle for e in self._episodes]),
        }

    def picture(self, lane: int) -> Picture:
        """The rover on its path from above, next to its camera image."""
        episode = self._episodes[lane]
        plan = rover_picture(self.rover, episode.truth, episode.path, episode.elapsed)
        return side_by_side(plan, None if episode.sensed is None else episode.sensed.view())

    def close(self) -> None:
        """Nothing is open: sand needs no renderer."""

    def _begun(
        self, rng: np.random.Generator, domain: RoverDomain, soil: str | None, *, open_sensors: bool
    ) -> _Episode:
        uniform = rng.random(6)
        cross_fall, grade, speed, curvature, sensor_error = domain.values(uniform[1:]).tolist()
        number = int(uniform[0] * len(self._soils)) if soil is None else self._names.index(soil)
        terrain = Terrain(slope_x=grade, slope_y=cross_fall)
        plant = RoverPlant(self.rover, terrain, self._soils[number], self._options.engine)
        start = Pose2(0.0, 0.0, 0.0)
        state = plant.initial_state(start, speed)
        path = Path(start, (line(_ENTRY), arc(_LENGTH - _ENTRY, curvature)))
        noise = 0.0 if self._options.observation == "truth" else sensor_error * _SLIP_NOISE
        truth, sensed = plant.observe(state, 0), None
        if self._scenario is not None and open_sensors:
            sensed = SensedRover(
                self._scenario,
                self.rover,
                terrain,
                path,
                seed=int(rng.integers(_SEEDS)),
                signal_noise=sensor_error,
                estimates=self._options.observation == "estimate",
            )
            sensed.drive(truth)
            sensed.look(truth)
        return _Episode(plant, state, truth, path, speed, noise, sensed, rng)

    def _moment(self, before: FloatArray, actions: FloatArray) -> RoverMoment:
        """Moment after a step from the stations ``before`` (n,) [m] with these actions (n, 2)."""
        episodes = self._episodes
        headings = [wrap(float(e.truth.pose[2]) - e.path.pose(e.station).psi) for e in episodes]
        return RoverMoment(
            cross_track=np.array([e.cross_track for e in episodes]),
            heading_error=np.array(headings),
            slip_angle=np.array([e.truth.slip_angle for e in episodes]),
            yaw_rate=np.array([float(e.truth.velocity[2]) for e in episodes]),
            progress=(np.array([e.station for e in episodes]) - before) / _PERIOD,
            speed=np.array([e.speed for e in episodes]),
            demand_left=actions[:, 0],
            demand_right=actions[:, 1],
            sinkage=np.array([float(np.max(e.truth.sinkages)) for e in episodes]),
        )

    def _stepped(self, episode: _Episode, action: NDArray[np.float32]) -> tuple[bool, bool, str]:
        """Terminated, truncated and outcome of a control step."""
        if not episode.finite:
            return True, False, "diverged"
        fastest = _MAX_WHEEL_SPEED * episode.speed / self.rover.radius
        left, right = (fastest * max(-1.0, min(1.0, float(a))) for a in action)
        speeds = tuple(left if is_left else right for is_left in self._left)
        command = RoverCommand(wheel_speed=speeds, steer=(0.0,) * len(speeds))
        try:
            self._drive(episode, command)
        except DivergedError:
            episode.finite = False
            return True, False, "diverged"
        self._look(episode)
        return self._result(episode)

    def _drive(self, episode: _Episode, command: RoverCommand) -> None:
        """Advance the plant by a control step."""
        tick = round(episode.elapsed / TICK)
        episode.elapsed += _PERIOD
        for until in range(tick + _TRACE_STEP, tick + _STEP + 1, _TRACE_STEP):
            episode.state = episode.plant.step(episode.state, command, _TRACE_STEP)
            if episode.sensed is not None:
                episode.sensed.drive(episode.plant.observe(episode.state, until))

    def _look(self, episode: _Episode) -> None:
        """Update truth, cross-track error and slip estimate."""
        truth = episode.truth = episode.plant.observe(episode.state, round(episode.elapsed / TICK))
        episode.station, episode.cross_track = path_coordinates(episode.path, truth, episode.station)
        episode.squares += episode.cross_track**2
        episode.largest = max(episode.largest, abs(episode.cross_track))
        if episode.sensed is None:
            episode.slip_estimate = truth.slip_angle + episode.slip_noise * float(episode.rng.standard_normal())
        else:
            episode.sensed.look(truth)
            episode.slip_estimate = episode.sensed.slip_angle

    def _result(self, episode: _Episode) -> tuple[bool, bool, str]:
        if episode.plant.entrapped(episode.truth):
            return True, False, "entrapped"
        if abs(episode.cross_track) > _MAX_CROSS_TRACK:
            return True, False, "left the path"
        if episode.station >= episode.path.length:
            return False, True, "completed"
        late = episode.elapsed > _TIME_LIMIT * episode.path.length / episode.speed
        return False, late, "timed out" if late else ""

    def _features(self, episode: _Episode) -> list[float]:
        truth, path = episode.truth, episode.path
        psi = float(truth.pose[2])
        on = path.pose(episode.station)
        up = truth.X_WB[2]
        return [
            episode.cross_track,
            wrap(psi - on.psi),
            path.curvature(episode.station),
            path.curvature(episode.station + _PREVIEW),
            episode.slip_estimate,
            float(truth.velocity[2]),
            float(truth.wheel_speeds[self._left].mean()) * self.rover.radius / episode.speed,
            float(truth.wheel_speeds[~self._left].mean()) * self.rover.radius / episode.speed,
            float(up[0]),
            float(up[1]),
            episode.speed,
        ]
