"""Environment: steer a trailer's axles so that its rear follows the path of its hitch.

``offtrack/TrailerSteering-v0``: the plant with slipping tyres, suspension and actuators at 1 ms; steps of 20 ms.

Action, ``Box(-1, 1, (n_steered,))``: demanded angle of each steered axle of the last trailer, front to rear, + left,
as a fraction of its actuator's limit (30 deg for the default vehicle). The actuators add lag and a rate limit.

Observation, ``Box((n_features,))`` in SI units, each clipped to its limit; ``core.features`` lists them:

    off_tracking                m      lateral distance of the hitch path from the follow point, + if the path lies left
    path_direction              rad    of that path there, + left of the trailer's axis
    path_0.25_ahead .. 0.75     m      lateral position of the path, this many follow distances ahead along it
    hitch_v_x, hitch_v_y        m/s    velocity of the hitch along the trailer's axes
    trailer_yaw_rate            rad/s
    age                         s      of the entries above
    usable                      -      1; 0 while the estimator has no health: the entries above then keep their values
    steer_trailer_1 ..          rad    the steered axles' encoders
    steer_tractor               rad
    speed                       m/s    of the tractor
    articulation_1 ..           rad    at each hitch
    yaw_rate_<unit> ..          rad/s  gyros
    follow_distance             m      hitch to follow point

``observation`` selects their source; the environment's spec records it:

    "surrogate"  the first entries are 10 Hz estimates, 0.1 s old, with errors fitted to runs with cameras
                 (``surrogate``); encoders and gyros have constant errors. The default, for training.
    "truth"      all entries are exact and current, encoders and gyros included.
    "estimate"   cameras on the trailer are rendered; a scenario's odometry and buffer work on the images
                 (``camera_observations``). ``sensing`` is the scenario or its name: it gives rig, world, odometry,
                 faults, latency and the combination's own sensors; vehicle, course and ground are the episode's. The
                 episode's seed decides world and noise.
    "camera"     ``Dict(image=Box(0, 255, (2, height, width), uint8), features=Box((n,)))``: the newest images of that
                 scenario's cameras, left and right, grey, reduced by ``image_scale``. The features are the image's age
                 and those from steer_trailer_1 on.

"estimate" and "camera" build a world and open a renderer for every episode of every sub-environment: seconds for a
reset and tens of milliseconds for a frame, one trailer after the other, in the thread that resets and steps; ``close``
releases them. Use few trailers; spawn processes, do not fork them.

Reward of a step: ``rewards.USUAL``, minus the squared off-tracking [m2], a tenth of the follow point's distance to the
outside of the turn [m] and 0.02 of the mean squared steer rate [rad2/s2]; ``rewards.MISHAP`` once at a mishap.
``reward={part: weight}`` replaces it; ``rewards.PARTS`` may be named, as in ``reward={"follow_error": 1.0}``.

Start: straight at the start of a course, rolling at set speed, with the path behind known. With "estimate" the trailer
has driven straight to the start at that speed with cameras on, over a follow distance and 2 m; if there is still no
estimate, the first entries are 0, age is 60 and usable is 0. Course and ``Domain`` (friction, cross-fall, speed, load,
length, lag, sensor error) are drawn from the episode's seed, equally for all observations. ``reset(options={"friction":
0.3, "speed": (2.0, 3.0), "course": "roundabout"})`` sets some of it. In turns the driver uses half of the friction.

End: terminated on jackknifing, rollover, leaving the road or divergence of the physics (``endings``); truncated when
the course is completed, or after 1.5 times its nominal time plus 10 s. With ``road_width`` the road has edges, and it
is left when a body is beyond one (``road_edges``).

Info: ``off_tracking`` [m] and the metrics of a run's ``summary.json`` so far: ``true_rms_m``, ``true_max_m``,
``steer_max_deg``, ``steer_max_rate_deg_s``; ``outside_max_m``, the follow point's largest distance to the outside of a
turn; ``edge_clearance_min_m`` of all bodies where the road has edges; ``outcome`` at the end.
"""

import math
from collections.abc import Mapping, Sequence
from typing import Any, Final

import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

from controllers.driver import PERIOD
from offtrack.environments import rewards
from offtrack.environments.camera_observations import CameraObservations
from offtrack.environments.core import Info, Lanes, Observation, Result, is_whole
from offtrack.environments.drivers import Drivers, Tracks
from offtrack.environments.observations import (
    EpisodeStart,
    HitchPaths,
    ObservationKind,
    PathOffset,
    TrueOrSurrogate,
)
from offtrack.environments.pictures import TopView, axle_angles, side_by_side
from offtrack.environments.rewards import (
    N_DRAWN,
    Circumstances,
    Domain,
    Ending,
    EpisodeOptions,
    Moment,
    Reward,
    RunningMetrics,
    Variation,
    narrowed,
)
from offtrack.environments.road_edges import RoadEdges
from offtrack.reports.canvas import Picture
from scenarios.assembly.adapters import course_of, outlines, tractor_guided_at
from scenarios.assembly.surrogate import SurrogateParameters, load_surrogate
from scenarios.courses import Course, Turn, turns
from scenarios.options.course import CourseTable
from scenarios.options.scenario import Scenario, load_scenario, stream
from vehicle.clock import to_ticks
from vehicle.combination.batch import BatchGround, BatchMotion, PlantBatch
from vehicle.combination.description import GRAVITY, Vehicle, load_vehicle
from vehicle.engine.kernels import Engine
from vehicle.foundation.quantity import Frozen, checked, option
from vehicle.frames import FloatArray

_RANDOM = "random-"
_TURNS = 5  # 150 m on average: a minute at 10 km/h
_ENTRY = 10.0  # [m]


class _CourseTable(Frozen):
    """A course by plain values."""

    course: CourseTable = option("Course of the guided point of the tractor.")


def named_course(name: str | Mapping[str, Any], vehicle: Vehicle) -> Course:
    """Course of a scenario (name or file), of a table as in its file, or drawn with seed K.

    ``random-K`` has five smooth turns, ``roundabout-K`` a roundabout of 12.5 to 20 m that is left after 90 to 270 deg.

    Raises:
        ValueError: one line, if there is no such course.
    """
    if isinstance(name, Mapping):
        table = checked(_CourseTable, {"course": dict(name)}, "courses").course
        return course_of(load_scenario("roundabout").model_copy(update={"course": table}), vehicle)
    kind, _, number = name.rpartition("-")
    if kind == "roundabout" and number.isdecimal():
        return named_course(_drawn_roundabout(stream(int(number), "course")), vehicle)
    if not name.startswith(_RANDOM):
        return course_of(load_scenario(name), vehicle)
    if not number.isdecimal():
        raise ValueError(f"course {name}: must be random-K with an integer K")
    rng, tractor = stream(int(number), "course"), vehicle.units[0]
    sequence = [
        Turn(
            direction="left" if rng.random() < 0.5 else "right",
            radius=float(rng.uniform(11.0, 40.0)),
            angle=math.radians(float(rng.uniform(30.0, 150.0))),
            straight=float(rng.uniform(2.0, 20.0)),
        )
        for _ in range(_TURNS)
    ]
    return turns(front_x=tractor.front_x, width=tractor.width, sequence=sequence, entry=_ENTRY)


def _drawn_roundabout(rng: np.random.Generator) -> dict[str, Any]:
    """Table of a roundabout."""
    return {
        "kind": "roundabout",
        "direction": "left" if rng.random() < 0.5 else "right",
        "radius": float(rng.uniform(12.5, 20.0)),
        "turn_deg": float(rng.uniform(90.0, 270.0)),
        "entry": 20.0,
        "exit": 25.0,
    }


COURSES: Final = (
    "roundabout",
    "roundabout-right",
    "figure-of-eight",
    "turn-90",
    "farm-track",
    *(f"random-{k}" for k in range(1, 9)),
)

MAX_LENGTH = 1.5  # of a trailer, relative to its file: the limit of ``Domain``
_STEP = to_ticks(PERIOD, "control period")
_GRIP = 0.5  # fraction of the friction that the driver uses in turns
_TIME_LIMIT, _GRACE = 1.5, 10.0  # as in a scenario: relative to the course at set speed [-], and added [s]


class TrailerSteeringOptions(EpisodeOptions):
    """Options of the environment."""

    parts = rewards.PARTS

    vehicle: str = rewards.DEFAULT_VEHICLE  # name or file; its last unit must have steered axles and a follow point
    courses: Sequence[str | Course | Mapping[str, Any]] = COURSES
    road_width: float | None = None  # between the edges of the road [m]; None: it has none
    observation: ObservationKind = "surrogate"
    domain: Domain = Domain()
    reward: Mapping[Reward, float] | None = None  # None: ``rewards.USUAL``
    endings: Mapping[str, Ending] | None = None
    surrogate: SurrogateParameters | None = None  # None: the shipped one
    # Scenario with rig, faults, world and estimator, for ``estimate`` and ``camera``
    sensing: str | Scenario = "roundabout"
    image_scale: int = 1  # factor that reduces images, for ``camera``
    engine: Engine = "auto"


class TrailerSteering:
    """n episodes."""

    control_rate = 1.0 / PERIOD

    def __init__(self, n: int, options: TrailerSteeringOptions) -> None:
        """Place all at the start of the first course until they ``begin``.

        Raises:
            ValueError: one line, if an option does not fit.
        """
        self.n, self._options = n, options
        vehicle = self._vehicle = load_vehicle(options.vehicle)
        limit, n_steered = _limit(vehicle)
        self._names, courses = opened_courses(options.courses, vehicle)
        self._limit = limit
        self.action_space = spaces.Box(-1.0, 1.0, (n_steered,), np.float32)
        self._reward = rewards.weighted(rewards.USUAL if options.reward is None else options.reward)
        edged = {} if options.road_width is None else {"left the road": rewards.over_the_edge}
        self._endings = {**rewards.ENDINGS, **edged} if options.endings is None else options.endings
        self._variation = Variation(vehicle)
        self._tracks = Tracks(courses)
        self._drivers = Drivers(tractor_guided_at(vehicle, courses[0].reference), self._tracks, n, options.engine)
        self._fleet = PlantBatch(vehicle, n, options.engine)
        longest = narrowed(options.domain, {"length": MAX_LENGTH}).drawn(np.zeros((1, N_DRAWN)))
        self._paths = HitchPaths(n, float(self._variation.follow_distance(longest)[0]))
        self._source = _observation_source(options, vehicle, self._fleet, courses)
        self.features, self.observation_space = self._source.features, self._source.observation_space
        self._n_tractor_axles = len(vehicle.units[0].steered_axles)
        self._n_axles_between = sum(len(unit.steered_axles) for unit in vehicle.units[1:-1])
        self._metrics = RunningMetrics(n)
        self._edges = None if options.road_width is None else RoadEdges(vehicle, self._tracks, options.road_width, n)
        self._clearance = np.full(n, np.inf)  # of a road without edges [m]
        self._length = -(vehicle.units[-1].follow_x or 0.0)
        self._top_view = TopView(outlines(vehicle), courses)
        self._elapsed, self._allowed, self._lengths = np.zeros(n), np.ones(n), np.ones(n)
        self._motion = self._fleet.observe()

    @property
    def hitch_paths(self) -> HitchPaths:
        """Paths of the hitches, for laws that need more of them than the observation has."""
        return self._paths

    def begin(self, lanes: Lanes, generators: list[np.random.Generator], options: Mapping[str, Any]) -> None:
        """Begin episodes; options are those of ``Domain``, and ``course`` by its name or number."""
        given = dict(options)
        course = self._chosen(given.pop("course", None))
        domain = narrowed(self._options.domain, given, ("course",))
        uniform = np.array([rng.random(N_DRAWN + 1) for rng in generators])
        drawn = domain.drawn(uniform[:, 1:])
        drawn_course = (uniform[:, 0] * len(self._names)).astype(np.intp)
        number = drawn_course if course is None else np.full(len(lanes), course)
        speed = turning_speed(drawn, self._tracks.bends[number])
        ground = BatchGround(drawn.friction, drawn.cross_fall, self._tracks.centres[number])
        self._motion = self._fleet.place(lanes, self._variation.numbers(drawn), ground, speed)
        self._drivers.begin(lanes, number, speed)
        follow = self._variation.follow_distance(drawn)
        self._paths.begin(lanes, self._motion.poses[lanes, -1], follow)
        self._lengths[lanes] = self._tracks.lengths[number]
        self._elapsed[lanes], self._allowed[lanes] = 0.0, _TIME_LIMIT * self._tracks.lengths[number] / speed + _GRACE
        self._metrics.begin(lanes)
        if self._edges is not None:
            self._edges.begin(lanes, number, follow - self._length)
        offset = self._paths.step(self._motion.poses[:, -1])
        self._source.begin(EpisodeStart(lanes, generators, number, drawn, follow), self._motion, offset)
        self._top_view.begin(lanes, number)

    def step(self, actions: NDArray[np.float32]) -> Result:
        """Advance all episodes by 20 ms."""
        before = self._motion
        demand = np.zeros((self.n, self._n_axles_between + actions.shape[1]))
        demand[:, self._n_axles_between :] = self._limit * np.minimum(np.maximum(actions, -1.0), 1.0)
        steer, acceleration = self._drivers.step(before.poses[:, 0], before.velocities[:, 0])
        now = self._motion = self._fleet.step(steer, acceleration, demand, _STEP)
        self._elapsed += PERIOD
        offset = self._paths.step(now.poses[:, -1])
        self._source.step(now, offset)
        moment = self._moment(before, now, offset)
        self._metrics.step(moment, self._axles(now))
        return self._result(moment)

    def observe(self) -> Observation:
        """Observation of all episodes."""
        return self._source.observe()

    def info(self) -> Info:
        """Metrics so far."""
        info = self._metrics.info()
        if self._edges is not None:
            info["edge_clearance_min_m"] = self._edges.least.copy()
        return info

    def picture(self, lane: int) -> Picture:
        """The combination on its course from above, next to its camera images."""
        caption = f"{self._names[self._drivers.course[lane]]}, {self._elapsed[lane]:.1f} s, "
        caption += f"off-tracking {self._metrics.newest[lane]:+.2f} m"
        steer = axle_angles(self._vehicle, self._motion.steer[lane])
        plan = self._top_view.picture(lane, self._motion.poses[lane], steer, caption)
        return side_by_side(plan, self._source.view(lane))

    def close(self) -> None:
        """Close cameras."""
        self._source.close()

    def _chosen(self, course: Any) -> int | None:
        """Number of the course that an option selects."""
        if course is None:
            return None
        if isinstance(course, str) and course in self._names:
            return self._names.index(course)
        if is_whole(course) and 0 <= course < len(self._names):
            return int(course)
        shown = course if isinstance(course, str) else repr(course)
        last = len(self._names) - 1
        raise ValueError(f"course = {shown:.80} must be one of {', '.join(self._names)}, or their number 0 .. {last}")

    def _axles(self, motion: BatchMotion) -> FloatArray:
        """Angles of the last trailer's steered axles, (n, n_steered) [rad]."""
        return motion.steer[:, self._n_tractor_axles + self._n_axles_between :]

    def _moment(self, before: BatchMotion, now: BatchMotion, offset: PathOffset) -> Moment:
        edges, speed = self._edges, np.maximum(np.abs(now.velocities[:, -1, 0]), 0.1)
        return Moment(
            off_tracking=offset.offset,
            curvature=now.velocities[:, -1, 2] / speed,
            steer_rate=(self._axles(now) - self._axles(before)) / PERIOD,
            articulation=now.poses[:, :-1, 2] - now.poses[:, 1:, 2],
            load_transfer=now.load_transfer,
            road_offset=self._drivers.state.offset,
            speed=now.velocities[:, 0, 0],
            finite=self._fleet.finite,
            clearance=self._clearance if edges is None else edges.step(self._drivers.course, now.poses),
        )

    def _result(self, moment: Moment) -> Result:
        terminated = np.zeros(self.n, dtype=bool)
        outcome = np.full(self.n, "", dtype=object)
        for name, ending in reversed(tuple(self._endings.items())):
            ended = ending(moment)
            if ended.any():
                outcome[ended] = name
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


def turning_speed(drawn: Circumstances, bends: FloatArray) -> FloatArray:
    """Set speeds (k,) [m/s]: as drawn, or lower where the sharpest curvature (k,) [1/m] needs half of the friction."""
    return np.minimum(drawn.speed, np.sqrt(_GRIP * GRAVITY * drawn.friction / (bends + 1e-9)))


def opened_courses(
    named: Sequence[str | Course | Mapping[str, Any]], vehicle: Vehicle
) -> tuple[tuple[str, ...], list[Course]]:
    """Names and courses of the options of an environment.

    Raises:
        ValueError: one line, if there is none, or one does not fit.
    """
    if not named:
        raise ValueError("courses is empty: it must have at least one")
    courses = [course if isinstance(course, Course) else named_course(course, vehicle) for course in named]
    names = tuple(course if isinstance(course, str) else f"course {k}" for k, course in enumerate(named))
    for name, course in zip(names, courses, strict=True):
        if course.relief is not None or course.friction is not None:
            raise ValueError(
                f"course {name}: its file has heights, banks or frictions: an environment has a plane or cone "
                "of one friction; set course.heights = false, or leave these columns out"
            )
    return names, courses


def _limit(vehicle: Vehicle) -> tuple[float, int]:
    """Largest angle of the trailer's axles [rad], and the number of steered ones."""
    trailer = vehicle.units[-1]
    if len(vehicle.units) < 2 or trailer.steering is None or trailer.follow_x is None or not trailer.steered_axles:
        raise ValueError(f"vehicle {vehicle.name}: its last unit must be a trailer with steered axles and follow_x [m]")
    return trailer.steering.limit, len(trailer.steered_axles)


def _observation_source(
    options: TrailerSteeringOptions, vehicle: Vehicle, fleet: PlantBatch, courses: Sequence[Course]
) -> TrueOrSurrogate | CameraObservations:
    """Source of the observations that the options select."""
    if options.observation in ("surrogate", "truth"):
        surrogate = options.surrogate or load_surrogate()
        return TrueOrSurrogate(vehicle, fleet.n, PERIOD, surrogate if options.observation == "surrogate" else None)
    scenario = load_scenario(options.sensing) if isinstance(options.sensing, str) else options.sensing
    image_scale = options.image_scale if options.observation == "camera" else None
    return CameraObservations(vehicle, fleet, courses, scenario, _STEP, image_scale)
