"""Steering a trailer's axles so that its rear follows the path of its hitch, while a driver drives the tractor.

``offtrack/TrailerSteering-v0``: the plant with slipping tyres, suspension and actuators at 1 ms; steps of 20 ms.

Action, ``Box(-1, 1, (n_steered,))``: demanded angle of each steered axle of the last trailer, front to rear, + left,
over the limit of its actuators (30 deg for the usual vehicle). Lag and rate limit are the actuators' own.

Observation, ``Box((n_features,))`` in SI units, each cut off at its limit; ``core.features`` lists them:

    off_tracking                m      path of the hitch beside the follow point, + where the path lies left
    path_direction              rad    of that path there, + left of the trailer's axis
    path_0.25_ahead .. 0.75     m      lateral place of the path so many follow distances farther on along it
    hitch_v_x, hitch_v_y        m/s    velocity of the hitch along the trailer's axes
    trailer_yaw_rate            rad/s
    age                         s      of all of the above
    usable                      -      1; 0 while the estimator is without health and the above stays as it was
    steer_trailer_1 ..          rad    the steered axles' encoders
    steer_tractor               rad
    speed                       m/s    of the tractor
    articulation_1 ..           rad    at each hitch
    yaw_rate_<unit> ..          rad/s  gyros
    follow_distance             m      hitch to follow point

``observation`` says where they come from, and the spec of a made environment says which it was:

    "surrogate"  the first lines are 10 Hz estimates, 0.1 s old, with errors as fitted to runs with cameras
                 (``surrogate``); encoders and gyros have their constant errors. The default, made for training.
    "truth"      all of it is exact and of now, encoders and gyros included.
    "estimate"   cameras on the trailer are rendered, and the odometry and the buffer of a scenario work on the pixels
                 (``estimating``); the combination's own sensors are those of a scenario, too. ``sensing`` names the
                 scenario, or is one: rig, world, odometry, faults and latency are its, vehicle, course and ground the
                 episode's. World and noise follow from the episode's seed.
    "camera"     ``Dict(image=Box(0, 255, (2, height, width), uint8), features=Box((n,)))``: the newest pictures of that
                 scenario's cameras, left and right, grey; ``image_scale`` makes one pixel of so many to a side. The
                 features are the picture's age and those from steer_trailer_1 on.

"estimate" and "camera" build a world and open a renderer for every episode of every sub-environment: seconds for a
reset and tens of milliseconds for a frame, trailer by trailer, in the thread that resets and steps; ``close`` gives
them back. They are for few trailers; processes are to be spawned, not forked.

Reward of a step: ``rewards.USUAL``, minus the squared off-tracking [m2], a tenth of the follow point's distance to the
outside of the turn [m] and 0.02 of the mean squared steer rate [rad2/s2]; ``rewards.MISHAP`` once at a bad end.
``reward={part: weight}`` takes its place.

Start: straight at the start of a course, rolling at set speed, the path behind known. With "estimate" the trailer has
come straight to the start at that speed, cameras running, by a follow distance and 2 m; if nothing could be seen even
so, the first lines are 0, age is 60 and usable is 0. Course and ``Domain`` (friction, cross-fall, speed, load, length,
lag, sensor error) are drawn from the episode's seed, alike for all observations. ``reset(options={"friction": 0.3,
"speed": (2.0, 3.0), "course": "roundabout"})`` gives some of it. In turns the driver keeps to half of the friction.

End: terminated when it has jackknifed, rolled over, left the road or the physics broke (``endings``); truncated when
the course is done, or after one and a half times the time it should take and 10 s.

Info: ``off_tracking`` [m] and the metrics of a run's ``summary.json`` so far: ``true_rms_m``, ``true_max_m``,
``steer_max_deg``, ``steer_max_rate_deg_s``; ``outside_max_m``, the follow point's largest distance to the outside of a
turn; ``outcome`` at the end.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Final

import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

from controllers.driver import PERIOD
from scenarios.assembly.adapters import outlines, tractor_geometry
from scenarios.courses import Course
from scenarios.environments import endings, rewards
from scenarios.environments.core import Info, Lanes, Observation, Result
from scenarios.environments.domain import N_DRAWN, Domain, narrowed
from scenarios.environments.drivers import Drivers
from scenarios.environments.endings import Ending
from scenarios.environments.estimating import Estimated, Pictured
from scenarios.environments.hitch_paths import Beside, HitchPaths
from scenarios.environments.knowledge import Knowing, Knowledge, Start, Told, check_knowledge
from scenarios.environments.moment import Moment
from scenarios.environments.picture import Onlooker, axle_angles, side_by_side
from scenarios.environments.rewards import Reward
from scenarios.environments.road import named_course
from scenarios.environments.running import RunningMetrics
from scenarios.environments.surrogate import SurrogateParameters, load_surrogate
from scenarios.environments.tracks import Tracks
from scenarios.environments.variation import Variation
from scenarios.options.scenario import Scenario, load_scenario
from scenarios.report.canvas import Picture
from vehicle.clock import to_ticks
from vehicle.combination.batch import BatchGround, BatchMotion, PlantBatch
from vehicle.combination.description import GRAVITY, Vehicle, load_vehicle
from vehicle.engine.kernels import Engine
from vehicle.frames import FloatArray

COURSES: Final = (
    "roundabout",
    "roundabout-right",
    "figure-of-eight",
    "turn-90",
    "farm-track",
    *(f"random-{k}" for k in range(1, 9)),
)

_LONGEST = 1.5  # of a trailer, over the file's: the limit of ``Domain``
_STEP = to_ticks(PERIOD, "control period")
_GRIP = 0.5  # share of the friction that a driver takes in turns: the slower he is, the slippier it is
_PATIENCE, _GRACE = 1.5, 10.0  # as in a scenario: time that an episode may take, over that of its course; and [s]


@dataclass(frozen=True, kw_only=True)
class TrailerSteeringOptions:
    """What there is to choose when the environment is made."""

    vehicle: str = "uk_longer_semitrailer"  # name or file; its last unit must have steered axles and a follow point
    courses: Sequence[str | Course] = COURSES
    observation: Knowledge = "surrogate"
    domain: Domain = field(default_factory=Domain)
    reward: Mapping[Reward, float] | None = None  # None: the usual one
    endings: Mapping[str, Ending] | None = None
    surrogate: SurrogateParameters | None = None  # None: the shipped one
    sensing: str | Scenario = "roundabout"  # a scenario, whose rig, faults, world and estimator ``estimate`` has
    image_scale: int = 1  # pixels of a side that become one, for ``camera``
    engine: Engine = "auto"


class TrailerSteering:
    """n episodes of it."""

    control_rate = 1.0 / PERIOD

    def __init__(self, n: int, options: TrailerSteeringOptions) -> None:
        """All at the start of the first course until they ``begin``.

        Raises:
            ValueError: one line, if an option does not fit.
        """
        self.n, self._options = n, options
        vehicle = self._vehicle = load_vehicle(options.vehicle)
        limit, n_steered = _limit(vehicle, options)
        courses = [named_course(c, vehicle) if isinstance(c, str) else c for c in options.courses]
        self._names = tuple(c if isinstance(c, str) else f"course {k}" for k, c in enumerate(options.courses))
        self._limit = limit
        self.action_space = spaces.Box(-1.0, 1.0, (n_steered,), np.float32)
        self._reward = rewards.weighted(rewards.USUAL if options.reward is None else options.reward)
        self._endings = endings.USUAL if options.endings is None else options.endings
        self._variation = Variation(vehicle)
        self._tracks = Tracks(courses)
        self._drivers = Drivers(tractor_geometry(vehicle, courses[0]), self._tracks, n, options.engine)
        self._fleet = PlantBatch(vehicle, n, options.engine)
        longest = narrowed(options.domain, {"length": _LONGEST}).drawn(np.zeros((1, N_DRAWN)))
        self._paths = HitchPaths(n, float(self._variation.follow_distance(longest)[0]))
        self._knowing = _knowing(options, vehicle, self._fleet, courses)
        self.features, self.observation_space = self._knowing.features, self._knowing.observation_space
        self._of_tractor = len(vehicle.units[0].steered_axles)
        self._ahead = sum(len(unit.steered_axles) for unit in vehicle.units[1:-1])
        self._metrics = RunningMetrics(n)
        self._onlooker = Onlooker(outlines(vehicle), courses)
        self._elapsed, self._allowed, self._lengths = np.zeros(n), np.ones(n), np.ones(n)
        self._seen = self._fleet.observe()

    @property
    def hitch_paths(self) -> HitchPaths:
        """The paths of the hitches, for laws that look at more of them than the observation says."""
        return self._paths

    def begin(self, lanes: Lanes, generators: list[np.random.Generator], options: Mapping[str, Any]) -> None:
        """New episodes; options are those of ``Domain``, and ``course`` by its name or number."""
        given = dict(options)
        course = self._chosen(given.pop("course", None))
        domain = narrowed(self._options.domain, given, ("course",))
        uniform = np.array([rng.random(N_DRAWN + 1) for rng in generators])
        drawn = domain.drawn(uniform[:, 1:])
        of = np.full(len(lanes), course) if course is not None else (uniform[:, 0] * len(self._names)).astype(np.intp)
        speed = np.minimum(drawn.speed, np.sqrt(_GRIP * GRAVITY * drawn.friction / (self._tracks.bends[of] + 1e-9)))
        ground = BatchGround(drawn.friction, drawn.cross_fall, self._tracks.centres[of])
        self._seen = self._fleet.place(lanes, self._variation.numbers(drawn), ground, speed)
        self._drivers.begin(lanes, of, speed)
        follow = self._variation.follow_distance(drawn)
        self._paths.begin(lanes, self._seen.poses[lanes, -1], follow)
        self._lengths[lanes] = self._tracks.lengths[of]
        self._elapsed[lanes], self._allowed[lanes] = 0.0, _PATIENCE * self._tracks.lengths[of] / speed + _GRACE
        self._metrics.begin(lanes)
        beside = self._paths.step(self._seen.poses[:, -1])
        self._knowing.begin(Start(lanes, generators, of, drawn, follow), self._seen, beside)
        self._onlooker.begin(lanes, of)

    def step(self, actions: NDArray[np.float32]) -> Result:
        """20 ms of all."""
        before = self._seen
        demand = np.zeros((self.n, self._ahead + actions.shape[1]))
        demand[:, self._ahead :] = self._limit * np.minimum(np.maximum(actions, -1.0), 1.0)
        steer, acceleration = self._drivers.step(before.poses[:, 0], before.velocities[:, 0])
        now = self._seen = self._fleet.step(steer, acceleration, demand, _STEP)
        self._elapsed += PERIOD
        beside = self._paths.step(now.poses[:, -1])
        self._knowing.step(now, beside)
        moment = self._moment(before, now, beside)
        self._metrics.step(moment, self._axles(now))
        return self._judged(moment)

    def observe(self) -> Observation:
        """What is known of all."""
        return self._knowing.observe()

    def info(self) -> Info:
        """Metrics so far, and which course it is."""
        return self._metrics.info()

    def picture(self, lane: int) -> Picture:
        """The combination on its course from above, and what its cameras see beside it."""
        caption = f"{self._names[self._drivers.course[lane]]}, {self._elapsed[lane]:.1f} s, "
        caption += f"off-tracking {self._metrics.newest[lane]:+.2f} m"
        steer = axle_angles(self._vehicle, self._seen.steer[lane])
        plan = self._onlooker.picture(lane, self._seen.poses[lane], steer, caption)
        return side_by_side(plan, self._knowing.view(lane))

    def close(self) -> None:
        """Closes cameras."""
        self._knowing.close()

    def _chosen(self, course: str | int | None) -> int | None:
        """The number of the course that an option asks for."""
        if course is None:
            return None
        if isinstance(course, str):
            if course not in self._names:
                raise ValueError(f"course = {course} is none of {', '.join(self._names)}")
            return self._names.index(course)
        if not 0 <= course < len(self._names):
            raise ValueError(f"course = {course} must be 0 .. {len(self._names) - 1}")
        return course

    def _axles(self, seen: BatchMotion) -> FloatArray:
        """Angles of the last trailer's steered axles (n, n_steered) [rad]."""
        return seen.steer[:, self._of_tractor + self._ahead :]

    def _moment(self, before: BatchMotion, now: BatchMotion, beside: Beside) -> Moment:
        speed = np.maximum(np.abs(now.velocities[:, -1, 0]), 0.1)
        return Moment(
            off_tracking=beside.offset,
            turn=now.velocities[:, -1, 2] / speed,
            steer_rate=(self._axles(now) - self._axles(before)) / PERIOD,
            articulation=now.poses[:, :-1, 2] - now.poses[:, 1:, 2],
            load_transfer=now.load_transfer,
            beside_road=self._drivers.state.offset,
            speed=now.velocities[:, 0, 0],
            finite=self._fleet.finite,
        )

    def _judged(self, moment: Moment) -> Result:
        terminated = np.zeros(self.n, dtype=bool)
        outcome = np.full(self.n, "", dtype=object)
        for words, ending in reversed(tuple(self._endings.items())):
            ended = ending(moment)
            if ended.any():
                outcome[ended] = words
                terminated |= ended
        completed = self._drivers.state.station >= self._lengths
        truncated = completed | (self._elapsed > self._allowed)
        if truncated.any():
            truncated &= ~terminated
            outcome[truncated] = np.where(completed[truncated], "completed", "timed out")
        reward = self._reward(moment)
        if terminated.any():
            reward = np.where(moment.finite, reward, 0.0) + rewards.MISHAP * terminated
        return Result(reward, terminated, truncated, outcome)


def _limit(vehicle: Vehicle, options: TrailerSteeringOptions) -> tuple[float, int]:
    """Largest angle of the trailer's axles [rad], and how many of them are steered."""
    trailer = vehicle.units[-1]
    if len(vehicle.units) < 2 or trailer.steering is None or trailer.follow_x is None or not trailer.steered_axles:
        raise ValueError(f"vehicle {vehicle.name}: its last unit must be a trailer with steered axles and follow_x [m]")
    if not options.courses:
        raise ValueError("courses is empty: there must be one at least")
    return trailer.steering.limit, len(trailer.steered_axles)


def _knowing(
    options: TrailerSteeringOptions, vehicle: Vehicle, fleet: PlantBatch, courses: Sequence[Course]
) -> Knowing:
    """What makes the observations that the options ask for."""
    check_knowledge(options.observation)
    if options.observation in ("surrogate", "truth"):
        surrogate = options.surrogate or load_surrogate()
        return Told(vehicle, fleet.n, PERIOD, surrogate if options.observation == "surrogate" else None)
    scenario = load_scenario(options.sensing) if isinstance(options.sensing, str) else options.sensing
    if options.observation == "estimate":
        return Estimated(vehicle, fleet, courses, scenario, _STEP)
    return Pictured(vehicle, fleet, courses, scenario, _STEP, options.image_scale)
