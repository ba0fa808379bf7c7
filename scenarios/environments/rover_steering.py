"""Holding a path with a skid-steered rover that a slope pulls aside: the speeds of its two sides are the action.

``offtrack/RoverSteering-v0``: wheels on loose soil (or firm ground), a control step of 0.1 s.

Action, ``Box(-1, 1, (2,))``: demanded wheel speed of the left and of the right side, over twice the set speed.

Observation, ``Box((11,))`` in SI units, each cut off at its limit; ``core.features`` lists them:

    cross_track                 m      R's origin beside the path, + left
    heading_error               rad
    curvature, curvature_ahead  1/m    of the path here and 0.5 m farther on
    slip_angle                  rad    direction of travel against heading, + left
    yaw_rate                    rad/s
    wheel_speed_left, _right    -      rim speeds over the set speed
    inclination_ahead, _left    -      how the body's axes rise
    speed                       m/s    that is set

``observation`` says where the slip angle comes from, and the spec of a made environment says which it was; the rest is
exact:

    "surrogate"  it has the noise of one seen in a wheel's trace, 1.4 deg RMS (Reina 2008). The default.
    "truth"      it is exact.
    "estimate"   the camera behind the left rear wheel sees the trace in the sand, and the slip estimator of a scenario
                 works on the pixels: 5 Hz, 0.1 s old, the newest with health; 0 before the trace is some 0.6 m long.
                 ``sensing`` names the scenario, or is one: camera, sand, estimator and instruments are its, rover, path
                 and ground the episode's. Not on firm ground, which takes no trace.
    "camera"     ``Dict(image=Box(0, 255, (1, height, width), uint8), features=Box((11,)))``: the newest picture of that
                 camera, grey; ``image_scale`` makes one pixel of so many to a side. The features are the picture's age
                 [s] and the others without the slip angle.

Sand is drawn without a renderer: a second for a reset and some tens of milliseconds for a frame, rover by rover.

Reward of a step: minus the squared cross-track error [dm2], 0.1 of the squared lack of progress (over the set speed)
and 0.01 of the squared difference of the sides' demands; -100 once at a bad end.

Start: at rest on the path, wheels turning for the set speed; 0.5 m straight, then an arc to 7 m in all. Slopes, speed,
curvature, sensor error and soil are drawn from the episode's seed, or given: ``reset(options={"cross_fall": 0.08})``.

End: terminated when a wheel has sunk in too far, the rover is more than 1 m beside the path or the physics broke;
truncated at the path's end, or after twice the time it should take.

Info: ``cross_track``, ``cross_track_rms_m``, ``cross_track_max_m``, ``slip_angle`` (true); ``outcome`` at the end.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

from controllers.path import Path, arc, line
from scenarios.environments.core import Info, Lanes, Observation, Result, observation_space, within
from scenarios.environments.domain import narrowed
from scenarios.environments.images import reduced, reduced_shape
from scenarios.environments.knowledge import check_knowledge
from scenarios.environments.picture import side_by_side
from scenarios.environments.rover_features import BESIDE_A_PICTURE, FEATURES, SLIP
from scenarios.environments.rover_options import FIRM, LIMITS, RoverDomain, RoverSteeringOptions
from scenarios.environments.rover_picture import rover_picture
from scenarios.environments.sensed_slip import SensedSlip
from scenarios.report.canvas import Picture
from sensors.sand.rig import nominal_rig
from vehicle.clock import TICK
from vehicle.combination.plant import DivergedError
from vehicle.frames import FloatArray, Pose2, wrap
from vehicle.rover.command import RoverCommand
from vehicle.rover.description import load_rover
from vehicle.rover.plant import RoverPlant
from vehicle.rover.soil import Soil, load_soil
from vehicle.rover.terrain import Terrain
from vehicle.rover.truth import RoverTruth

_STEP: Final = 100  # a control step [ticks]
_PERIOD: Final = _STEP * TICK  # [s]
_WAY: Final = 50  # how far the plant goes between two looks at what its wheels leave behind, as in scenarios [ticks]
_ENTRY, _LENGTH = 0.5, 7.0  # straight at the start, and a whole path; the runs of Reina 2008 were of 7 m [m]
_ROOM: Final = 2.0  # wheels may be asked for so many times the set speed to either direction
_BESIDE: Final = 1.0  # farther off its path a rover is lost: nearly two of its lengths [m]
_PREVIEW: Final = 0.5  # ahead on the path: the approach of a driver's law [m]
_PATIENCE: Final = 2.0  # time that an episode may take, over that of its path at set speed
_SLIP_NOISE: Final = math.radians(1.4)  # of a slip angle seen in a wheel's trace, RMS (Reina 2008, conclusion)
_MISHAP: Final = -100.0
_SEEDS: Final = 2**31


@dataclass(slots=True)
class _Episode:
    """What changes in a lane."""

    plant: RoverPlant
    state: FloatArray
    truth: RoverTruth
    path: Path
    speed: float  # [m/s]
    slip_noise: float  # [rad]
    sensed: SensedSlip | None  # None: no camera is looked through
    rng: np.random.Generator
    station: float = 0.0  # [m]
    elapsed: float = 0.0  # [s]
    beside: float = 0.0  # + left of the path [m]
    squares: float = 0.0  # sum of its squares [m2]
    largest: float = 0.0  # [m]
    slip_seen: float = 0.0  # [rad]
    finite: bool = True


class RoverSteering:
    """n episodes of it, one plant after the other."""

    control_rate = 1.0 / _PERIOD

    def __init__(self, n: int, options: RoverSteeringOptions) -> None:
        """On level ground of the first soil until they ``begin``.

        Raises:
            ValueError: one line, if an option does not fit.
        """
        self.n, self._options = n, options
        self._rover = load_rover(options.vehicle)
        if self._rover.steered:
            raise ValueError(f"rover {self._rover.name} steers its wheels: RoverSteering is for skid-steered ones")
        self._left = self._rover.wheel_places[:, 1] > 0.0
        check_knowledge(options.observation)
        self._names = options.soil_names()
        self._soils: list[Soil | None] = [None if name == FIRM else load_soil(name) for name in self._names]
        self.action_space = spaces.Box(-1.0, 1.0, (2,), np.float32)
        self._scenario = options.scenario(_STEP)
        self.features = BESIDE_A_PICTURE if options.observation == "camera" else FEATURES
        self._numbers = observation_space(self.features)
        self.observation_space: spaces.Space[Any] = self._numbers
        if options.observation == "camera":
            camera = nominal_rig(self._rover).camera
            self._shape = reduced_shape((1, camera.height, camera.width), options.image_scale)
            image = spaces.Box(0, 255, self._shape, np.uint8)
            self.observation_space = spaces.Dict({"image": image, "features": self._numbers})
        level, first = RoverDomain(cross_fall=(0.0, 0.0), grade=(0.0, 0.0)), self._names[0]
        self._episodes = [self._begun(np.random.default_rng(k), level, first, looks=False) for k in range(n)]

    def begin(self, lanes: Lanes, generators: list[np.random.Generator], options: Mapping[str, Any]) -> None:
        """New episodes; options are those of ``RoverDomain``, and ``soil`` by its name."""
        given = dict(options)
        soil = given.pop("soil", None)
        if soil is not None and soil not in self._names:
            raise ValueError(f"soil = {soil} is none of {', '.join(self._names)}")
        domain = narrowed(self._options.domain, given, ("soil",))
        for lane, rng in zip(lanes.tolist(), generators, strict=True):
            self._episodes[lane] = self._begun(rng, domain, soil, looks=True)

    def step(self, actions: NDArray[np.float32]) -> Result:
        """A tenth of a second of all."""
        told = [self._stepped(episode, action) for episode, action in zip(self._episodes, actions, strict=True)]
        reward, ended, cut, outcome = zip(*told, strict=True)
        words = np.empty(self.n, dtype=object)
        words[:] = outcome
        return Result(np.array(reward), np.array(ended), np.array(cut), words)

    def observe(self) -> Observation:
        """What is known of all."""
        rows = np.array([self._seen(episode) for episode in self._episodes])
        if self._options.observation != "camera":
            return within(rows, self._numbers)
        ages = [0.0 if e.sensed is None else e.sensed.age(e.truth.tick) for e in self._episodes]
        rows = np.column_stack([ages, np.delete(rows, SLIP, axis=1)])
        images = np.zeros((self.n, *self._shape), np.uint8)
        for lane, episode in enumerate(self._episodes):
            image = None if episode.sensed is None else episode.sensed.image
            if image is not None:
                images[lane] = reduced(image, self._options.image_scale)
        return {"image": images, "features": within(rows, self._numbers)}

    def info(self) -> Info:
        """How well the paths are held so far."""
        steps = [max(1, round(e.elapsed / _PERIOD)) for e in self._episodes]
        squares = [e.squares / n for e, n in zip(self._episodes, steps, strict=True)]
        return {
            "cross_track": np.array([e.beside for e in self._episodes]),
            "cross_track_rms_m": np.sqrt(squares),
            "cross_track_max_m": np.array([e.largest for e in self._episodes]),
            "slip_angle": np.array([e.truth.slip_angle for e in self._episodes]),
        }

    def picture(self, lane: int) -> Picture:
        """The rover on its path from above, and what its camera sees beside it."""
        episode = self._episodes[lane]
        plan = rover_picture(self._rover, episode.truth, episode.path, episode.elapsed)
        return side_by_side(plan, None if episode.sensed is None else episode.sensed.view())

    def close(self) -> None:
        """Nothing is open: the sand is drawn without a renderer."""

    def _begun(self, rng: np.random.Generator, domain: RoverDomain, soil: str | None, *, looks: bool) -> _Episode:
        uniform = rng.random(len(LIMITS) + 1)
        ranges = np.array([getattr(domain, name) for name in LIMITS])
        values = ranges[:, 0] + uniform[1:] * (ranges[:, 1] - ranges[:, 0])
        cross_fall, grade, speed, curvature, sensor_error = values.tolist()
        number = int(uniform[0] * len(self._soils)) if soil is None else self._names.index(soil)
        terrain = Terrain(slope_x=grade, slope_y=cross_fall)
        plant = RoverPlant(self._rover, terrain, self._soils[number], self._options.engine)
        start = Pose2(0.0, 0.0, 0.0)
        state = plant.initial_state(start, speed)
        path = Path(start, (line(_ENTRY), arc(_LENGTH - _ENTRY, curvature)))
        noise = 0.0 if self._options.observation == "truth" else sensor_error * _SLIP_NOISE
        truth, sensed = plant.observe(state, 0), None
        if self._scenario is not None and looks:
            sensed = SensedSlip(
                self._scenario,
                self._rover,
                terrain,
                path,
                seed=int(rng.integers(_SEEDS)),
                signal_noise=sensor_error,
                estimates=self._options.observation == "estimate",
            )
            sensed.drive(truth)
            sensed.look(truth)
        return _Episode(plant, state, truth, path, speed, noise, sensed, rng)

    def _stepped(self, episode: _Episode, action: NDArray[np.float32]) -> tuple[float, bool, bool, str]:
        """Reward, whether it ended badly, whether it is over, and the outcome in words."""
        if not episode.finite:
            return _MISHAP, True, False, "diverged"
        fastest = _ROOM * episode.speed / self._rover.radius
        left, right = (fastest * max(-1.0, min(1.0, float(a))) for a in action)
        speeds = tuple(left if is_left else right for is_left in self._left)
        command = RoverCommand(wheel_speed=speeds, steer=(0.0,) * len(speeds))
        try:
            self._drive(episode, command)
        except DivergedError:
            episode.finite = False
            return _MISHAP, True, False, "diverged"
        before = episode.station
        self._look(episode)
        return self._judged(episode, (episode.station - before) / _PERIOD, (left - right) / fastest)

    def _drive(self, episode: _Episode, command: RoverCommand) -> None:
        """A control step."""
        tick = round(episode.elapsed / TICK)
        episode.elapsed += _PERIOD
        for there in range(tick + _WAY, tick + _STEP + 1, _WAY):
            episode.state = episode.plant.step(episode.state, command, _WAY)
            if episode.sensed is not None:
                episode.sensed.drive(episode.plant.observe(episode.state, there))

    def _look(self, episode: _Episode) -> None:
        """Where the rover is now, beside its path, and what is seen of its slip."""
        truth = episode.truth = episode.plant.observe(episode.state, round(episode.elapsed / TICK))
        x, y, _ = truth.pose.tolist()
        episode.station = episode.path.project(x, y, episode.station)
        on = episode.path.pose(episode.station)
        episode.beside = math.cos(on.psi) * (y - on.y) - math.sin(on.psi) * (x - on.x)
        episode.squares += episode.beside**2
        episode.largest = max(episode.largest, abs(episode.beside))
        if episode.sensed is None:
            episode.slip_seen = truth.slip_angle + episode.slip_noise * float(episode.rng.standard_normal())
        else:
            episode.sensed.look(truth)
            episode.slip_seen = episode.sensed.slip_angle

    def _judged(self, episode: _Episode, progress: float, turn: float) -> tuple[float, bool, bool, str]:
        slow = 1.0 - progress / episode.speed
        reward = -((episode.beside / 0.1) ** 2) - 0.1 * slow**2 - 0.01 * turn**2
        if episode.plant.entrapped(episode.truth):
            return reward + _MISHAP, True, False, "entrapped"
        if abs(episode.beside) > _BESIDE:
            return reward + _MISHAP, True, False, "left the path"
        if episode.station >= episode.path.length:
            return reward, False, True, "completed"
        late = episode.elapsed > _PATIENCE * episode.path.length / episode.speed
        return reward, False, late, "timed out" if late else ""

    def _seen(self, episode: _Episode) -> list[float]:
        truth, path = episode.truth, episode.path
        psi = float(truth.pose[2])
        on = path.pose(episode.station)
        up = truth.X_WB[2]
        return [
            episode.beside,
            wrap(psi - on.psi),
            path.curvature(episode.station),
            path.curvature(episode.station + _PREVIEW),
            episode.slip_seen,
            float(truth.velocity[2]),
            float(truth.wheel_speeds[self._left].mean()) * self._rover.radius / episode.speed,
            float(truth.wheel_speeds[~self._left].mean()) * self._rover.radius / episode.speed,
            float(up[0]),
            float(up[1]),
            episode.speed,
        ]
