"""Environment: drive a combination forwards through a gate or along a road, or backwards into a bay.

``offtrack/TractorTrailerDriving-v0``: a control step of 20 ms on slipping tyres, forwards and backwards.

Action, ``Box(-1, 1, (2,))``: demanded steer of the tractor over its limit, + left; demanded acceleration over 1 m/s2,
+ forwards. Against the motion it brakes; above 2 m/s (bay), 8 m/s (gate) or the set speed (road) it does not accelerate
further. Below 0.1 m/s the gear follows its sign.

Observation, ``Box((n_features,))`` in SI units, exact (no cameras), each clipped to its limit; ``core.features``
lists them:

    goal_ahead, goal_aside      m      of the goal from the last trailer's end, along and across the trailer
    goal_direction_cos, _sin    -      its direction relative to the trailer's
    articulation_1 ..           rad    at each hitch
    speed                       m/s    of the tractor, backwards below 0
    steer_tractor               rad

On a road, in place of the goal:

    path_offset                 m      of the tractor's guided point from the course's path, + left
    path_direction              rad    of that path relative to the tractor
    path_turn_4 .. 25           rad    by which the path turns in that many metres ahead
    edge_left, edge_right       m      least distance of all bodies from the road's edges
    set_speed                   m/s

Reward of a step: decrease of the distance to the goal [m] (lateral distance counts twice, a radian as 5 m) or to the
road's end, minus 0.001 times the squared action; 100 on arrival, -100 at a mishap. On a road a mishap costs 20, and a
body closer than half a metre to an edge 0.1 for each metre of that.

Start: straight. A bay lies 10 to 25 m behind the end and up to 3 m to the side, a gate 40 to 70 m ahead of it and up to
8 m to the side, both turned by up to 20 deg; there the combination stands. A road is a band of ``road_width`` along one
of the ``courses``, as in ``TrailerSteering``; there it rolls at the set speed, which turns and friction limit.
Friction, cross-fall, load, length and set speed are drawn from ``Domain``.

End: terminated on arrival (within 0.3 m and 5 deg; in a bay slower than 0.3 m/s; at the road's end), jackknifed, rolled
over, more than 50 m (bay) or 100 m (gate) away, over the road's edge; truncated after 90 s (bay), 40 s (gate), or 1.5
times the road's time at set speed and 10 s.

Info: ``distance_m``, ``heading_error_deg``; on a road ``distance_m`` to its end, ``edge_clearance_min_m``,
``true_rms_m`` and ``true_max_m`` of the last trailer's off-tracking; ``outcome`` at the end.
"""

import math
from collections.abc import Mapping, Sequence
from typing import Any, Final, Literal

import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

from controllers.driver import PERIOD
from offtrack.environments.core import Feature, Info, Observation, Result, observation_space, within
from offtrack.environments.drivers import Tracks
from offtrack.environments.observations import HitchPaths
from offtrack.environments.pictures import TopView, axle_angles
from offtrack.environments.rewards import N_DRAWN, Circumstances, Domain, EpisodeOptions, Variation, narrowed
from offtrack.environments.road_edges import RoadEdges
from offtrack.environments.trailer_steering import COURSES, MAX_LENGTH, opened_courses, turning_speed
from offtrack.reports.canvas import Picture
from scenarios.assembly.adapters import outlines
from scenarios.courses import Course, straight
from scenarios.loop.referee import FOLDED, LIFTED
from vehicle.clock import to_ticks
from vehicle.combination.batch import BatchGround, BatchMotion, Lanes, PlantBatch
from vehicle.combination.description import Vehicle, load_vehicle
from vehicle.engine.kernels import Engine
from vehicle.frames import FloatArray

_STEP = to_ticks(PERIOD, "control period")
_MAX_SHIFT_SPEED: Final = 0.1  # gear changes below; a stopped combination rocks back at about this speed [m/s]

Task = Literal["bay", "gate", "road"]

_MAX_ACCELERATION: Final = 1.0  # of the action [m/s2]
_ARRIVED: Final = 100.0  # reward, once


class TractorTrailerDrivingOptions(EpisodeOptions):
    """Options of the environment."""

    task: Task = "bay"
    vehicle: str = "eu_tractor_semitrailer"
    courses: Sequence[str | Course | Mapping[str, Any]] = COURSES  # of roads
    road_width: float = 7.0  # [m]
    domain: Domain = Domain()  # actuator lag and sensor error have no effect, nor has speed but on roads
    engine: Engine = "auto"


class Goal:
    """A gate ahead or a bay behind, of n episodes."""

    features = (
        Feature("goal_ahead", "m", 150.0),
        Feature("goal_aside", "m", 150.0),
        Feature("goal_direction_cos", "-", 1.0),
        Feature("goal_direction_sin", "-", 1.0),
    )
    _MAX_SPEED: Final = {"bay": 2.0, "gate": 8.0}  # no acceleration above [m/s]
    _TIME_LIMIT: Final = {"bay": 90.0, "gate": 40.0}  # [s]
    _X: Final = {"bay": (-25.0, -10.0), "gate": (40.0, 70.0)}  # from the end at the start [m]
    _MAX_Y: Final = {"bay": 3.0, "gate": 8.0}  # to either side [m]
    _MAX_PSI: Final = math.radians(20.0)  # relative to the combination
    _LOST: Final = {"bay": 50.0, "gate": 100.0}  # greater distances end an episode [m]
    mishap = -100.0  # reward, once
    # On arrival: distance [m] (a bay 3.2 m wide leaves 0.3 m on either side), angle [rad], speed [m/s].
    _DISTANCE, _ANGLE, _SPEED = 0.3, math.radians(5.0), 0.3

    def __init__(self, n: int, options: TractorTrailerDrivingOptions, vehicle: Vehicle) -> None:
        self._task = options.task
        self._end = -vehicle.units[-1].rear_x
        self.max_speed, self.time = np.full(n, self._MAX_SPEED[self._task]), np.full(n, self._TIME_LIMIT[self._task])
        self.courses = [straight(front_x=vehicle.units[0].front_x, length=1.0)]
        self._ends, self.poses = np.full(n, self._end), np.zeros((n, 3))
        self.relative = np.zeros((n, 3))  # in the frame of the trailer's end: x, y [m] and psi [rad]

    def start(self, lanes: Lanes, uniform: FloatArray, drawn: Circumstances) -> tuple[FloatArray, FloatArray]:
        """At standstill on a plane."""
        return np.zeros(len(lanes)), np.full((len(lanes), 2), np.nan)

    def begin(self, lanes: Lanes, uniform: FloatArray, drawn: Circumstances, now: BatchMotion) -> None:
        """Draw the goals of these episodes from uniform numbers (k, 3)."""
        nearest, farthest = self._X[self._task]
        self._ends[lanes] = self._end * drawn.length
        ends = now.poses[lanes, -1, 0] - self._ends[lanes]
        self.poses[lanes, 0] = ends + nearest + uniform[:, 0] * (farthest - nearest)
        self.poses[lanes, 1] = (2.0 * uniform[:, 1] - 1.0) * self._MAX_Y[self._task]
        self.poses[lanes, 2] = (2.0 * uniform[:, 2] - 1.0) * self._MAX_PSI
        self.step(now)

    def step(self, now: BatchMotion) -> None:
        """Look where the trailers' ends are."""
        x, y, psi = now.poses[:, -1].T
        c, s = np.cos(psi), np.sin(psi)
        d_x, d_y = self.poses[:, 0] - x, self.poses[:, 1] - y
        turned = self.poses[:, 2] - psi
        turned = turned - math.tau * np.rint(turned / math.tau)
        self.relative = np.column_stack([c * d_x + s * d_y + self._ends, c * d_y - s * d_x, turned])

    def values(self, now: BatchMotion) -> list[FloatArray]:
        """Columns of the features."""
        goal = self.relative
        return [goal[:, :2], np.cos(goal[:, 2:]), np.sin(goal[:, 2:])]

    def info(self) -> Info:
        """Distance and heading error of the end from its goal."""
        goal = self.relative
        if not np.isfinite(goal).all():
            goal = np.nan_to_num(goal)
        return {"distance_m": np.hypot(goal[:, 0], goal[:, 1]), "heading_error_deg": np.degrees(np.abs(goal[:, 2]))}

    def cost(self) -> FloatArray:
        """Weighted distance to the goal [m]: lateral distance counts twice, a radian as five metres."""
        goal = self.relative
        cost: FloatArray = np.hypot(goal[:, 0], 2.0 * goal[:, 1]) + 5.0 * np.abs(goal[:, 2])
        return cost

    def ends(self, now: BatchMotion) -> tuple[NDArray[np.bool_], str, NDArray[np.bool_]]:
        """True for those who arrived; name and flags of the mishap."""
        goal = self.relative
        distance = np.hypot(goal[:, 0], goal[:, 1])
        at_goal = (distance < self._DISTANCE) & (np.abs(goal[:, 2]) < self._ANGLE)
        if self._task == "bay":
            at_goal &= np.abs(now.velocities[:, 0, 0]) < self._SPEED
        return at_goal, "lost", distance > self._LOST[self._task]

    def picture(self, lane: int) -> FloatArray | None:
        """Pose of the goal."""
        pose: FloatArray = self.poses[lane]
        return pose


class Road:
    """A road with edges, of n episodes."""

    _AHEAD: Final = (4.0, 8.0, 12.0, 18.0, 25.0)  # [m]
    mishap = -20.0  # reward, once: 20 m of road, so that driving on is better than standing for who still learns
    _NEAR, _NEAR_COST = 0.5, 0.1  # distance from the edge [m] below which each metre costs that much a step
    _TIME_LIMIT, _GRACE = 1.5, 10.0  # relative to the road at set speed [-], and added [s]
    features = (
        Feature("path_offset", "m", 10.0),
        Feature("path_direction", "rad", 3.2),
        *(Feature(f"path_turn_{ahead:g}", "rad", 3.2) for ahead in _AHEAD),
        Feature("edge_left", "m", 10.0),
        Feature("edge_right", "m", 10.0),
        Feature("set_speed", "m/s", 40.0),
    )

    def __init__(self, n: int, options: TractorTrailerDrivingOptions, vehicle: Vehicle) -> None:
        _, self.courses = opened_courses(options.courses, vehicle)
        self.tracks, self._variation = Tracks(self.courses), Variation(vehicle)
        self._edges = RoadEdges(vehicle, self.tracks, options.road_width, n)
        nominal = Domain(length=(1.0, 1.0)).drawn(np.zeros((1, N_DRAWN)))
        self._follow = float(self._variation.follow_distance(nominal)[0])
        self._paths = HitchPaths(n, self._follow * MAX_LENGTH)
        self.course, self._station = np.zeros(n, dtype=np.intp), np.zeros((n, 1))
        self.max_speed, self.time, self._offset = np.ones(n), np.ones(n), np.zeros(n)
        self._distance, self._steps, self._squares, self._largest = (np.zeros(n) for _ in range(4))

    def start(self, lanes: Lanes, uniform: FloatArray, drawn: Circumstances) -> tuple[FloatArray, FloatArray]:
        """Draw courses; return the set speeds (k,) [m/s] and the apexes of their ground (k, 2) [m]."""
        number = (uniform[:, 0] * len(self.courses)).astype(np.intp)
        self.course[lanes] = number
        speed = self.max_speed[lanes] = turning_speed(drawn, self.tracks.bends[number])
        self.time[lanes] = self._TIME_LIMIT * self.tracks.lengths[number] / speed + self._GRACE
        self._edges.begin(lanes, number, self._variation.follow_distance(drawn) - self._follow)
        return speed, self.tracks.centres[number]

    def begin(self, lanes: Lanes, uniform: FloatArray, drawn: Circumstances, now: BatchMotion) -> None:
        """Begin at the starts of the roads."""
        self._paths.begin(lanes, now.poses[lanes, -1], self._follow * drawn.length)
        for values in (self._station[:, 0], self._offset, self._steps, self._squares, self._largest):
            values[lanes] = 0.0
        self._distance[lanes] = self.tracks.lengths[self.course[lanes]]

    def step(self, now: BatchMotion) -> None:
        """Look where the tractors and all bodies are."""
        x, y, psi = now.poses[:, 0].T
        x_ref, y_ref = self.tracks.references[self.course].T
        points = x + 1j * y + np.exp(1j * psi) * (x_ref + 1j * y_ref)
        self._station, offset = self.tracks.offsets(self.course, self._station, points[:, None])
        self._offset, self._distance = offset[:, 0], self.tracks.lengths[self.course] - self._station[:, 0]
        self._edges.step(self.course, now.poses)
        behind = np.nan_to_num(self._paths.step(now.poses[:, -1]).offset)
        self._steps += 1.0
        self._squares += behind * behind
        np.fmax(self._largest, np.abs(behind), out=self._largest)

    def values(self, now: BatchMotion) -> list[FloatArray]:
        """Columns of the features."""
        headings = self.tracks.headings(self.course, self._station + np.array([0.0, *self._AHEAD]))
        direction, turns = headings[:, :1] - now.poses[:, 0, 2:], headings[:, 1:] - headings[:, :1]
        return [self._offset[:, None], direction, turns, self._edges.sides, self.max_speed[:, None]]

    def info(self) -> Info:
        """Distance to the end, clearance and off-tracking so far."""
        return {
            "distance_m": np.nan_to_num(self._distance),
            "edge_clearance_min_m": self._edges.least.copy(),
            "true_rms_m": np.sqrt(self._squares / np.maximum(self._steps, 1.0)),
            "true_max_m": self._largest.copy(),
        }

    def cost(self) -> FloatArray:
        """Distance to the road's end [m]."""
        return self._distance

    def near_edge(self) -> FloatArray:
        """Cost of a step for bodies close to an edge of the road."""
        cost: FloatArray = self._NEAR_COST * np.clip(self._NEAR - self._edges.sides.min(axis=1), 0.0, self._NEAR)
        return cost

    def ends(self, now: BatchMotion) -> tuple[NDArray[np.bool_], str, NDArray[np.bool_]]:
        """True for those who arrived; name and flags of the mishap."""
        return self._distance <= 0.0, "left the road", self._edges.sides.min(axis=1) < 0.0

    def picture(self, lane: int) -> FloatArray | None:
        """None: the course is drawn."""
        return None


class TractorTrailerDriving:
    """n episodes."""

    control_rate = 1.0 / PERIOD

    def __init__(self, n: int, options: TractorTrailerDrivingOptions) -> None:
        """Place all at the start until they ``begin``.

        Raises:
            ValueError: one line, if an option does not fit.
        """
        self.n, self._options = n, options
        vehicle = self.vehicle = load_vehicle(options.vehicle)
        if len(vehicle.units) < 2 or vehicle.units[0].steering is None:
            raise ValueError(f"vehicle {vehicle.name}: must be a tractor with steering that tows a trailer")
        self._fleet, self._variation = PlantBatch(vehicle, n, options.engine), Variation(vehicle)
        self._straight = np.zeros((n, vehicle.n_by_law))  # of the trailers' axles
        self._steer_limit = vehicle.units[0].steering.limit
        self.action_space = spaces.Box(-1.0, 1.0, (2,), np.float32)
        self.aim: Goal | Road = (Road if options.task == "road" else Goal)(n, options, vehicle)
        self.features = (
            *self.aim.features,
            *(Feature(f"articulation_{k}", "rad", 3.2) for k in range(1, len(vehicle.units))),
            Feature("speed", "m/s", 40.0),
            Feature("steer_tractor", "rad", 1.6),
        )
        self.observation_space = observation_space(self.features)
        self._elapsed, self._cost = np.zeros(n), np.zeros(n)
        self._top_view = TopView(outlines(vehicle), self.aim.courses)
        self.now = self._fleet.step(np.zeros(n), np.zeros(n), self._straight, _STEP, np.ones(n))

    def begin(self, lanes: Lanes, generators: list[np.random.Generator], options: Mapping[str, Any]) -> None:
        """Begin episodes; options are those of ``Domain``."""
        domain = narrowed(self._options.domain, options)
        uniform = np.array([rng.random(N_DRAWN + 3) for rng in generators])
        drawn = domain.drawn(uniform[:, 3:])
        speed, centre = self.aim.start(lanes, uniform, drawn)
        ground = BatchGround(drawn.friction, drawn.cross_fall, centre)
        self.now = self._fleet.place(lanes, self._variation.numbers(drawn), ground, speed)
        self.aim.begin(lanes, uniform, drawn, self.now)
        self._elapsed[lanes], self._cost = 0.0, self.aim.cost()
        if isinstance(self.aim, Road):
            self._top_view.begin(lanes, self.aim.course[lanes])

    def step(self, actions: NDArray[np.float32]) -> Result:
        """Advance all episodes by 20 ms; the first entry is the steer demand, the second the acceleration."""
        demand = np.minimum(np.maximum(actions.astype(np.float64), -1.0), 1.0)
        speed = self.now.velocities[:, 0, 0]
        along = np.sign(demand[:, 1]) * speed
        acceleration = np.where(along >= self.aim.max_speed, 0.0, _MAX_ACCELERATION * demand[:, 1])
        gear = np.where(np.where(np.abs(speed) > _MAX_SHIFT_SPEED, speed, acceleration) < 0.0, -1.0, 1.0)
        steer = self._steer_limit * demand[:, 0]
        self.now = self._fleet.step(steer, gear * acceleration, self._straight, _STEP, gear)
        self._elapsed += PERIOD
        self.aim.step(self.now)
        return self._result(demand)

    def observe(self) -> Observation:
        """Goal or road as the driver sees it, and state of the combination."""
        now, psi = self.now, self.now.poses[:, :, 2]
        values = [*self.aim.values(now), psi[:, :-1] - psi[:, 1:], now.velocities[:, 0, :1], now.steer[:, :1]]
        return within(np.concatenate(values, axis=1), self.observation_space)

    def info(self) -> Info:
        """Metrics so far."""
        return self.aim.info()

    def picture(self, lane: int) -> Picture:
        """The combination from above."""
        distance = float(self.aim.info()["distance_m"][lane])
        caption = f"{self._options.task}, {self._elapsed[lane]:.1f} s, {distance:.1f} m to go"
        straight_on = np.zeros(sum(len(unit.steered_axles) for unit in self.vehicle.units))
        straight_on[0] = self.now.steer[lane, 0]
        steer = axle_angles(self.vehicle, straight_on)
        return self._top_view.picture(lane, self.now.poses[lane], steer, caption, goal=self.aim.picture(lane))

    def close(self) -> None:
        """Nothing is open."""

    def _result(self, demand: FloatArray) -> Result:
        now, psi = self.now, self.now.poses[:, :, 2]
        arrived, missed, lost = self.aim.ends(now)
        before, after = self._cost, self.aim.cost()
        self._cost = after
        outcome = np.full(self.n, "", dtype=object)
        mishaps = {
            missed: lost,
            "jackknifed": (np.abs(psi[:, 1:] - psi[:, :-1]) >= FOLDED).any(axis=1),
            "rolled over": (np.abs(now.load_transfer) >= LIFTED).any(axis=1),
            "diverged": ~np.isfinite(after),
        }
        failed = np.logical_or.reduce(tuple(mishaps.values()))
        for name, happened in mishaps.items() if failed.any() else ():
            outcome[happened] = name
        arrived &= ~failed
        outcome[arrived] = "completed"
        terminated = failed | arrived
        truncated = (self._elapsed >= self.aim.time - 1e-9) & ~terminated
        outcome[truncated] = "timed out"
        nearer = before - after - 0.001 * (demand * demand).sum(axis=1)
        if isinstance(self.aim, Road):
            nearer -= self.aim.near_edge()
        reward = np.where(np.isfinite(nearer), nearer, 0.0) + self.aim.mishap * failed + _ARRIVED * arrived
        return Result(reward, terminated, truncated, outcome)
