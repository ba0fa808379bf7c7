"""Holding a path with a skid-steered rover that a slope pulls aside: the speeds of its two sides are the action.

``offtrack/RoverSteering-v0``: wheels on loose soil (or firm ground), a control step of 0.1 s.

Action, ``Box(-1, 1, (2,))``: demanded wheel speed of the left and of the right side, over twice the set speed.

Observation, ``Box((11,))`` in SI units:

    cross_track                 m      R's origin beside the path, + left
    heading_error               rad
    curvature, curvature_ahead  1/m    of the path here and 0.5 m farther on
    slip_angle                  rad    direction of travel against heading, + left
    yaw_rate                    rad/s
    wheel_speed_left, _right    -      rim speeds over the set speed
    inclination_ahead, _left    -      how the body's axes rise
    speed                       m/s    that is set

With ``observation="surrogate"`` the slip angle has the noise of one seen in a wheel's trace, 1.4 deg RMS (Reina 2008);
with ``"truth"`` it is exact.

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
from dataclasses import dataclass, field
from typing import Any, Final, Literal, get_args

import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

from controllers.path import Path, arc, line
from scenarios.canvas import Picture
from scenarios.environments.core import Feature, Info, Lanes, Observation, Result, observation_space, within
from scenarios.environments.domain import Range, drawn_within, narrowed
from scenarios.environments.rover_picture import rover_picture
from vehicle.clock import TICK
from vehicle.engine.kernels import Engine
from vehicle.frames import FloatArray, Pose2, wrap
from vehicle.plant import DivergedError
from vehicle.rover.command import RoverCommand
from vehicle.rover.description import load_rover
from vehicle.rover.plant import RoverPlant
from vehicle.rover.truth import RoverTruth
from vehicle.soil import Soil, load_soil
from vehicle.terrain import Terrain

Knowledge = Literal["surrogate", "truth"]

_STEP: Final = 100  # a control step [ticks]
_PERIOD: Final = _STEP * TICK  # [s]
_ENTRY, _LENGTH = 0.5, 7.0  # straight at the start, and a whole path; the runs of Reina 2008 were of 7 m [m]
_ROOM: Final = 2.0  # wheels may be asked for so many times the set speed to either direction
_BESIDE: Final = 1.0  # farther off its path a rover is lost: nearly two of its lengths [m]
_PREVIEW: Final = 0.5  # ahead on the path: the approach of a driver's law [m]
_PATIENCE: Final = 2.0  # time that an episode may take, over that of its path at set speed
_SLIP_NOISE: Final = math.radians(1.4)  # of a slip angle seen in a wheel's trace, RMS (Reina 2008, conclusion)
_MISHAP: Final = -100.0


@dataclass(frozen=True, slots=True, kw_only=True)
class RoverDomain:
    """What an episode's circumstances are drawn from.

    Raises:
        ValueError: if a range is empty or leaves its limits.
    """

    cross_fall: Range = (-0.12, 0.12)  # rise to the left: up to 7 deg to either side [-]
    grade: Range = (-0.05, 0.05)  # rise ahead [-]
    speed: Range = (0.05, 0.12)  # that the wheels are to turn for [m/s]
    curvature: Range = (-0.25, 0.25)  # of the path behind its straight start [1/m]
    sensor_error: Range = (0.5, 1.5)  # of the surrogate's slip angle, over the usual one [-]

    def __post_init__(self) -> None:
        drawn_within(self, _LIMITS)


_LIMITS: Final = {
    "cross_fall": (-0.4, 0.4),
    "grade": (-0.4, 0.4),
    "speed": (0.01, 1.0),
    "curvature": (-1.0, 1.0),
    "sensor_error": (0.0, 10.0),
}


@dataclass(frozen=True, kw_only=True)
class RoverSteeringOptions:
    """What there is to choose when the environment is made."""

    vehicle: str = "el_dorado_ii_skid"  # name or file of a rover without steered wheels
    soils: tuple[str, ...] = ("toyoura_sand", "beach_sand", "none")  # "none": firm ground
    observation: Knowledge = "surrogate"
    domain: RoverDomain = field(default_factory=RoverDomain)
    engine: Engine = "auto"


@dataclass(slots=True)
class _Episode:
    """What changes in a lane."""

    plant: RoverPlant
    state: FloatArray
    truth: RoverTruth
    path: Path
    speed: float  # [m/s]
    slip_noise: float  # [rad]
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
        if options.observation not in get_args(Knowledge):
            raise ValueError(f"observation = '{options.observation}' must be one of {', '.join(get_args(Knowledge))}")
        if not options.soils:
            raise ValueError("soils is empty: there must be one at least")
        self._soils: list[Soil | None] = [None if name == "none" else load_soil(name) for name in options.soils]
        self.action_space = spaces.Box(-1.0, 1.0, (2,), np.float32)
        self.observation_space = observation_space(_FEATURES)
        self._episodes: list[_Episode] = []
        self.begin(np.arange(n), [np.random.default_rng(k) for k in range(n)], {})

    def begin(self, lanes: Lanes, generators: list[np.random.Generator], options: Mapping[str, Any]) -> None:
        """New episodes; options are those of ``RoverDomain``, and ``soil`` by its name."""
        given = dict(options)
        soil = given.pop("soil", None)
        if soil is not None and soil not in self._options.soils:
            raise ValueError(f"soil = {soil} is none of {', '.join(self._options.soils)}")
        domain = narrowed(self._options.domain, given, ("soil",))
        fresh = not self._episodes
        for lane, rng in zip(lanes.tolist(), generators, strict=True):
            episode = self._begun(rng, domain, soil)
            if fresh:
                self._episodes.append(episode)
            else:
                self._episodes[lane] = episode

    def step(self, actions: NDArray[np.float32]) -> Result:
        """A tenth of a second of all."""
        told = [self._stepped(episode, action) for episode, action in zip(self._episodes, actions, strict=True)]
        reward, ended, cut, outcome = zip(*told, strict=True)
        words = np.empty(self.n, dtype=object)
        words[:] = outcome
        return Result(np.array(reward), np.array(ended), np.array(cut), words)

    def observe(self) -> Observation:
        """What is known of all."""
        return within(np.array([self._seen(episode) for episode in self._episodes]), self.observation_space)

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
        """The rover on its path from above."""
        episode = self._episodes[lane]
        return rover_picture(self._rover, episode.truth, episode.path, episode.elapsed)

    def _begun(self, rng: np.random.Generator, domain: RoverDomain, soil: str | None) -> _Episode:
        uniform = rng.random(len(_LIMITS) + 1)
        ranges = np.array([getattr(domain, name) for name in _LIMITS])
        values = ranges[:, 0] + uniform[1:] * (ranges[:, 1] - ranges[:, 0])
        cross_fall, grade, speed, curvature, sensor_error = values.tolist()
        number = int(uniform[0] * len(self._soils)) if soil is None else self._options.soils.index(soil)
        terrain = Terrain(slope_x=grade, slope_y=cross_fall)
        plant = RoverPlant(self._rover, terrain, self._soils[number], self._options.engine)
        start = Pose2(0.0, 0.0, 0.0)
        state = plant.initial_state(start, speed)
        path = Path(start, (line(_ENTRY), arc(_LENGTH - _ENTRY, curvature)))
        noise = 0.0 if self._options.observation == "truth" else sensor_error * _SLIP_NOISE
        return _Episode(plant, state, plant.observe(state, 0), path, speed, noise, rng)

    def _stepped(self, episode: _Episode, action: NDArray[np.float32]) -> tuple[float, bool, bool, str]:
        """Reward, whether it ended badly, whether it is over, and the outcome in words."""
        if not episode.finite:
            return _MISHAP, True, False, "diverged"
        fastest = _ROOM * episode.speed / self._rover.radius
        left, right = (fastest * max(-1.0, min(1.0, float(a))) for a in action)
        command = RoverCommand(wheel_speed=(left, right, left, right), steer=(0.0, 0.0, 0.0, 0.0))
        episode.elapsed += _PERIOD
        try:
            episode.state = episode.plant.step(episode.state, command, _STEP)
        except DivergedError:
            episode.finite = False
            return _MISHAP, True, False, "diverged"
        before = episode.station
        self._look(episode)
        return self._judged(episode, (episode.station - before) / _PERIOD, (left - right) / fastest)

    def _look(self, episode: _Episode) -> None:
        """Where the rover is now, beside its path, and what is seen of its slip."""
        truth = episode.truth = episode.plant.observe(episode.state, round(episode.elapsed / TICK))
        x, y, _ = truth.pose.tolist()
        episode.station = episode.path.project(x, y, episode.station)
        on = episode.path.pose(episode.station)
        episode.beside = math.cos(on.psi) * (y - on.y) - math.sin(on.psi) * (x - on.x)
        episode.squares += episode.beside**2
        episode.largest = max(episode.largest, abs(episode.beside))
        episode.slip_seen = truth.slip_angle + episode.slip_noise * float(episode.rng.standard_normal())

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
            float(truth.wheel_speeds[[0, 2]].mean()) * self._rover.radius / episode.speed,
            float(truth.wheel_speeds[[1, 3]].mean()) * self._rover.radius / episode.speed,
            float(up[0]),
            float(up[1]),
            episode.speed,
        ]


_FEATURES: Final = (
    Feature("cross_track", "m", 2.0),
    Feature("heading_error", "rad", 3.2),
    Feature("curvature", "1/m", 2.0),
    Feature("curvature_ahead", "1/m", 2.0),
    Feature("slip_angle", "rad", 3.2),
    Feature("yaw_rate", "rad/s", 5.0),
    Feature("wheel_speed_left", "set speed", 10.0),
    Feature("wheel_speed_right", "set speed", 10.0),
    Feature("inclination_ahead", "-", 1.0),
    Feature("inclination_left", "-", 1.0),
    Feature("speed", "m/s", 1.0),
)
