"""Environment: drive a combination's rear end forwards to a gate or backwards into a bay.

``offtrack/TractorTrailerDriving-v0``: a control step of 20 ms on slipping tyres, forwards and backwards.

Action, ``Box(-1, 1, (2,))``: demanded steer of the tractor over its limit, + left; demanded acceleration over 1 m/s2,
+ forwards. Against the motion it brakes; above 2 m/s (bay) or 8 m/s (gate) it does not accelerate further. Below
0.1 m/s the gear follows its sign.

Observation, ``Box((n_features,))`` in SI units, exact (no cameras), each clipped to its limit; ``core.features``
lists them:

    goal_ahead, goal_aside      m      of the goal from the last trailer's end, along and across the trailer
    goal_direction_cos, _sin    -      its direction relative to the trailer's
    articulation_1 ..           rad    at each hitch
    speed                       m/s    of the tractor, backwards below 0
    steer_tractor               rad

Reward of a step: decrease of the distance to the goal [m] (lateral distance counts twice, a radian as 5 m), minus 0.001
times the squared action; 100 on arrival, -100 at a mishap.

Start: straight at standstill. A bay lies 10 to 25 m behind the end and up to 3 m to the side, a gate 40 to 70 m ahead
of it and up to 8 m to the side, both turned by up to 20 deg; friction, cross-fall, load and length are
drawn from ``Domain``.

End: terminated on arrival (within 0.3 m and 5 deg; in a bay slower than 0.3 m/s), jackknifed, rolled over, more than
50 m (bay) or 100 m (gate) away; truncated after 90 s (bay) or 40 s (gate).

Info: ``distance_m``, ``heading_error_deg``; ``outcome`` at the end.
"""

import math
from collections.abc import Mapping
from typing import Any, Final, Literal

import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

from controllers.driver import PERIOD
from offtrack.environments.core import EnvironmentOptions, Feature, Info, Observation, Result, observation_space, within
from offtrack.environments.pictures import TopView, axle_angles
from offtrack.environments.rewards import N_DRAWN, Circumstances, Domain, Variation, narrowed
from offtrack.reports.canvas import Picture
from scenarios.assembly.adapters import outlines
from scenarios.courses import straight
from scenarios.loop.referee import FOLDED, LIFTED
from vehicle.clock import to_ticks
from vehicle.combination.batch import BatchGround, BatchMotion, Lanes, PlantBatch
from vehicle.combination.description import Vehicle, load_vehicle
from vehicle.engine.kernels import Engine
from vehicle.frames import FloatArray

_STEP = to_ticks(PERIOD, "control period")
_MAX_SHIFT_SPEED: Final = 0.1  # gear changes below; a stopped combination rocks back at about this speed [m/s]


class SlippingTyreFleet:
    """n combinations on slipping tyres, forwards and backwards, with unsteered trailer axles."""

    def __init__(self, vehicle: Vehicle, n: int, engine: Engine) -> None:
        """All equal to ``vehicle``."""
        self._fleet, self._variation = PlantBatch(vehicle, n, engine), Variation(vehicle)
        self._straight = np.zeros((n, vehicle.n_by_law))
        self._speed = np.zeros(n)

    def place(self, lanes: Lanes, drawn: Circumstances) -> BatchMotion:
        """Place these at W's origin, at standstill."""
        nowhere = np.full((len(lanes), 2), np.nan)
        ground = BatchGround(drawn.friction, drawn.cross_fall, nowhere)
        return self._noted(self._fleet.place(lanes, self._variation.numbers(drawn), ground, np.zeros(len(lanes))))

    def step(self, steer: FloatArray, acceleration: FloatArray) -> BatchMotion:
        """Advance by a control period under constant demands, (n,) [rad] and (n,) [m/s2], + forwards.

        An acceleration against the motion brakes; near standstill the gear changes.
        """
        direction = np.where(np.abs(self._speed) > _MAX_SHIFT_SPEED, self._speed, acceleration)
        gear = np.where(direction < 0.0, -1.0, 1.0)
        return self._noted(self._fleet.step(steer, gear * acceleration, self._straight, _STEP, gear))

    def _noted(self, motion: BatchMotion) -> BatchMotion:
        self._speed = motion.velocities[:, 0, 0]
        return motion


Task = Literal["bay", "gate"]

_MAX_ACCELERATION: Final = 1.0  # of the action [m/s2]
_MAX_SPEED: Final = {"bay": 2.0, "gate": 8.0}  # no acceleration above [m/s]
_TIME_LIMIT: Final = {"bay": 90.0, "gate": 40.0}  # [s]
_GOAL_X: Final = {"bay": (-25.0, -10.0), "gate": (40.0, 70.0)}  # from the end at the start [m]
_MAX_GOAL_Y: Final = {"bay": 3.0, "gate": 8.0}  # to either side [m]
_MAX_GOAL_PSI: Final = math.radians(20.0)  # relative to the combination
# On arrival: distance [m] (a bay 3.2 m wide leaves 0.3 m on either side), angle [rad], speed [m/s].
_ARRIVAL_DISTANCE, _ARRIVAL_ANGLE, _ARRIVAL_SPEED = 0.3, math.radians(5.0), 0.3
_LOST: Final = {"bay": 50.0, "gate": 100.0}  # greater distances end an episode [m]
_MISHAP, _ARRIVED = -100.0, 100.0  # rewards, once


class TractorTrailerDrivingOptions(EnvironmentOptions):
    """Options of the environment."""

    task: Task = "bay"
    vehicle: str = "eu_tractor_semitrailer"
    domain: Domain = Domain()  # speed, actuator lag and sensor error have no effect
    engine: Engine = "auto"


class TractorTrailerDriving:
    """n episodes."""

    control_rate = 1.0 / PERIOD

    def __init__(self, n: int, options: TractorTrailerDrivingOptions) -> None:
        """Place all at the start until they ``begin``.

        Raises:
            ValueError: one line, if an option does not fit.
        """
        self.n, self._options = n, options
        vehicle = self._vehicle = load_vehicle(options.vehicle)
        if len(vehicle.units) < 2 or vehicle.units[0].steering is None:
            raise ValueError(f"vehicle {vehicle.name}: must be a tractor with steering that tows a trailer")
        self._mover = SlippingTyreFleet(vehicle, n, options.engine)
        self._end = -vehicle.units[-1].rear_x
        self._steer_limit = vehicle.units[0].steering.limit
        self._max_speed, self._time = _MAX_SPEED[options.task], _TIME_LIMIT[options.task]
        self.action_space = spaces.Box(-1.0, 1.0, (2,), np.float32)
        self.features = (
            Feature("goal_ahead", "m", 150.0),
            Feature("goal_aside", "m", 150.0),
            Feature("goal_direction_cos", "-", 1.0),
            Feature("goal_direction_sin", "-", 1.0),
            *(Feature(f"articulation_{k}", "rad", 3.2) for k in range(1, len(vehicle.units))),
            Feature("speed", "m/s", 40.0),
            Feature("steer_tractor", "rad", 1.6),
        )
        self.observation_space = observation_space(self.features)
        self._ends = np.full(n, self._end)
        self._goal, self._elapsed = np.zeros((n, 3)), np.zeros(n)
        self._top_view = TopView(outlines(vehicle), [straight(front_x=vehicle.units[0].front_x, length=1.0)])
        self._now = self._mover.step(np.zeros(n), np.zeros(n))
        self._relative_goal = self._to_goal()

    def begin(self, lanes: Lanes, generators: list[np.random.Generator], options: Mapping[str, Any]) -> None:
        """Begin episodes; options are those of ``Domain``."""
        domain = narrowed(self._options.domain, options)
        uniform = np.array([rng.random(N_DRAWN + 3) for rng in generators])
        drawn = domain.drawn(uniform[:, 3:])
        self._ends[lanes] = self._end * drawn.length
        self._now = self._mover.place(lanes, drawn)
        nearest, farthest = _GOAL_X[self._options.task]
        trailer = self._now.poses[lanes, -1]
        self._goal[lanes, 0] = trailer[:, 0] - self._ends[lanes] + nearest + uniform[:, 0] * (farthest - nearest)
        self._goal[lanes, 1] = (2.0 * uniform[:, 1] - 1.0) * _MAX_GOAL_Y[self._options.task]
        self._goal[lanes, 2] = (2.0 * uniform[:, 2] - 1.0) * _MAX_GOAL_PSI
        self._elapsed[lanes] = 0.0
        self._relative_goal = self._to_goal()

    def step(self, actions: NDArray[np.float32]) -> Result:
        """Advance all episodes by 20 ms; the first entry is the steer demand, the second the acceleration."""
        demand = np.minimum(np.maximum(actions.astype(np.float64), -1.0), 1.0)
        along = np.sign(demand[:, 1]) * self._now.velocities[:, 0, 0]
        acceleration = np.where(along >= self._max_speed, 0.0, _MAX_ACCELERATION * demand[:, 1])
        self._now = self._mover.step(self._steer_limit * demand[:, 0], acceleration)
        self._elapsed += PERIOD
        before, self._relative_goal = self._relative_goal, self._to_goal()
        return self._result(before, demand)

    def observe(self) -> Observation:
        """Goal relative to the trailer's end, and state of the combination."""
        now, goal = self._now, self._relative_goal
        psi = now.poses[:, :, 2]
        values = [goal[:, :2], np.cos(goal[:, 2:]), np.sin(goal[:, 2:]), psi[:, :-1] - psi[:, 1:]]
        values += [now.velocities[:, 0, :1], now.steer[:, :1]]
        return within(np.concatenate(values, axis=1), self.observation_space)

    def info(self) -> Info:
        """Distance and heading error of the end from its goal."""
        goal = self._relative_goal
        if not np.isfinite(goal).all():
            goal = np.nan_to_num(goal)
        return {"distance_m": np.hypot(goal[:, 0], goal[:, 1]), "heading_error_deg": np.degrees(np.abs(goal[:, 2]))}

    def picture(self, lane: int) -> Picture:
        """The combination from above."""
        distance = float(np.hypot(*self._relative_goal[lane, :2]))
        caption = f"{self._options.task}, {self._elapsed[lane]:.1f} s, {distance:.1f} m to go"
        straight_on = np.zeros(sum(len(unit.steered_axles) for unit in self._vehicle.units))
        straight_on[0] = self._now.steer[lane, 0]
        steer = axle_angles(self._vehicle, straight_on)
        return self._top_view.picture(lane, self._now.poses[lane], steer, caption, goal=self._goal[lane])

    def close(self) -> None:
        """Nothing is open."""

    def _to_goal(self) -> FloatArray:
        """Goal in the frame of the trailer's end: x, y [m] and psi [rad], (n, 3)."""
        x, y, psi = self._now.poses[:, -1].T
        c, s = np.cos(psi), np.sin(psi)
        d_x, d_y = self._goal[:, 0] - x, self._goal[:, 1] - y
        turned = self._goal[:, 2] - psi
        turned = turned - math.tau * np.rint(turned / math.tau)
        return np.column_stack([c * d_x + s * d_y + self._ends, c * d_y - s * d_x, turned])

    def _result(self, before: FloatArray, demand: FloatArray) -> Result:
        now, goal = self._now, self._relative_goal
        psi = now.poses[:, :, 2]
        distance = np.hypot(goal[:, 0], goal[:, 1])
        at_goal = (distance < _ARRIVAL_DISTANCE) & (np.abs(goal[:, 2]) < _ARRIVAL_ANGLE)
        arrived = (
            at_goal & (np.abs(now.velocities[:, 0, 0]) < _ARRIVAL_SPEED) if self._options.task == "bay" else at_goal
        )
        outcome = np.full(self.n, "", dtype=object)
        mishaps = {
            "lost": distance > _LOST[self._options.task],
            "jackknifed": (np.abs(psi[:, 1:] - psi[:, :-1]) >= FOLDED).any(axis=1),
            "rolled over": (np.abs(now.load_transfer) >= LIFTED).any(axis=1),
            "diverged": ~np.isfinite(distance),
        }
        failed = np.logical_or.reduce(tuple(mishaps.values()))
        for name, happened in mishaps.items() if failed.any() else ():
            outcome[happened] = name
        arrived &= ~failed
        outcome[arrived] = "completed"
        terminated = failed | arrived
        truncated = (self._elapsed >= self._time - 1e-9) & ~terminated
        outcome[truncated] = "timed out"
        nearer = _cost_to_go(before) - _cost_to_go(goal) - 0.001 * (demand * demand).sum(axis=1)
        reward = np.where(np.isfinite(nearer), nearer, 0.0) + _MISHAP * failed + _ARRIVED * arrived
        return Result(reward, terminated, truncated, outcome)


def _cost_to_go(goal: FloatArray) -> FloatArray:
    """Weighted distance to the goal [m]: lateral distance counts twice, a radian as five metres."""
    cost: FloatArray = np.hypot(goal[:, 0], 2.0 * goal[:, 1]) + 5.0 * np.abs(goal[:, 2])
    return cost
