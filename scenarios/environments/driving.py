"""Driving a combination oneself: its end, forwards to a gate or backwards into a bay.

``offtrack/TractorTrailerDriving-v0``: a control step of 20 ms on slipping tyres, forwards and backwards.

Action, ``Box(-1, 1, (2,))``: demanded steer of the tractor over its limit, + left; demanded acceleration over 1 m/s2,
which points backwards below 0, brakes where it is against the motion, and is not heard beyond 2 m/s (bay) or 8 m/s
(gate) its way. Near standstill, below 0.1 m/s, the gear follows its sign.

Observation, ``Box((n_features,))`` in SI units, exact, as there are no cameras; each cut off at its limit, and
``core.features`` lists them:

    goal_ahead, goal_aside      m      the goal as the last trailer's end sees it
    goal_direction_cos, _sin    -      its direction against the trailer's
    articulation_1 ..           rad    at each hitch
    speed                       m/s    of the tractor, backwards below 0
    steer_tractor               rad

Reward of a step: how much nearer the end has come [m] (beside counts twice, a radian as 5 m), less 0.001 times the
squared action; 100 on arrival, -100 at a mishap.

Start: standing straight. A bay lies 10 to 25 m behind the end and up to 3 m aside, a gate 40 to 70 m ahead of it and up
to 8 m aside, both turned by up to 20 deg; friction, cross-fall, load and length are drawn as ``Domain`` says.

End: terminated on arrival (within 0.3 m and 5 deg; in a bay slower than 0.3 m/s), jackknifed, rolled over, more than
50 m (bay) or 100 m (gate) off; truncated after 90 s (bay) or 40 s (gate).

Info: ``distance_m``, ``heading_error_deg``; ``outcome`` at the end.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Final, Literal, get_args

import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

from controllers.driver import PERIOD
from scenarios.assembly.adapters import outlines
from scenarios.courses import straight
from scenarios.environments.core import Feature, Info, Lanes, Observation, Result, observation_space, within
from scenarios.environments.domain import N_DRAWN, Domain, narrowed
from scenarios.environments.movers import Slipping
from scenarios.environments.picture import Onlooker, axle_angles
from scenarios.loop.referee import FOLDED, LIFTED
from scenarios.report.canvas import Picture
from vehicle.combination.description import Vehicle, load_vehicle
from vehicle.engine.kernels import Engine
from vehicle.frames import FloatArray

Task = Literal["bay", "gate"]

_MAX_ACCELERATION: Final = 1.0  # that the action can ask for [m/s2]
_FASTEST: Final = {"bay": 2.0, "gate": 8.0}  # beyond this more is not heard [m/s]
_TIME: Final = {"bay": 90.0, "gate": 40.0}  # an episode's [s]
_AWAY: Final = {"bay": (-25.0, -10.0), "gate": (40.0, 70.0)}  # of the goal from the end at the start, along x [m]
_BESIDE: Final = {"bay": 3.0, "gate": 8.0}  # at most, to either side [m]
_TURNED: Final = math.radians(20.0)  # of the goal against the combination, at most
_THERE, _ALIGNED, _SLOW = (
    0.3,
    math.radians(5.0),
    0.3,
)  # a bay 3.2 m wide leaves 0.3 m beside a trailer [m], [rad], [m/s]
_LOST: Final = {"bay": 50.0, "gate": 100.0}  # farther off an episode ends [m]
_MISHAP, _ARRIVED = -100.0, 100.0  # rewards, once


@dataclass(frozen=True, kw_only=True)
class TractorTrailerDrivingOptions:
    """What there is to choose when the environment is made."""

    task: Task = "bay"
    vehicle: str = "eu_tractor_semitrailer"
    domain: Domain = field(default_factory=Domain)  # speed, actuator lag and sensor error are of no meaning here
    engine: Engine = "auto"


class TractorTrailerDriving:
    """n episodes of it."""

    control_rate = 1.0 / PERIOD

    def __init__(self, n: int, options: TractorTrailerDrivingOptions) -> None:
        """All at the start until they ``begin``.

        Raises:
            ValueError: one line, if an option does not fit.
        """
        if options.task not in get_args(Task):
            raise ValueError(f"task = '{options.task}' must be one of {', '.join(get_args(Task))}")
        self.n, self._options = n, options
        vehicle = self._vehicle = load_vehicle(options.vehicle)
        if len(vehicle.units) < 2 or vehicle.units[0].steering is None:
            raise ValueError(f"vehicle {vehicle.name}: must be a tractor with steering that tows a trailer")
        self._mover = Slipping(vehicle, n, options.engine)
        self._end = -vehicle.units[-1].rear_x
        self._steer_limit = vehicle.units[0].steering.limit
        self._fastest, self._time = _FASTEST[options.task], _TIME[options.task]
        self.action_space = spaces.Box(-1.0, 1.0, (2,), np.float32)
        self.features = _features(vehicle)
        self.observation_space = observation_space(self.features)
        self._ends = np.full(n, self._end)
        self._goal, self._elapsed = np.zeros((n, 3)), np.zeros(n)
        self._onlooker = Onlooker(outlines(vehicle), [straight(front_x=vehicle.units[0].front_x, length=1.0)])
        self._now = self._mover.step(np.zeros(n), np.zeros(n))
        self._away = self._to_goal()

    def begin(self, lanes: Lanes, generators: list[np.random.Generator], options: Mapping[str, Any]) -> None:
        """New episodes; options are those of ``Domain``."""
        domain = narrowed(self._options.domain, options)
        uniform = np.array([rng.random(N_DRAWN + 3) for rng in generators])
        drawn = domain.drawn(uniform[:, 3:])
        self._ends[lanes] = self._end * drawn.length
        self._now = self._mover.place(lanes, drawn)
        nearest, farthest = _AWAY[self._options.task]
        trailer = self._now.poses[lanes, -1]
        self._goal[lanes, 0] = trailer[:, 0] - self._ends[lanes] + nearest + uniform[:, 0] * (farthest - nearest)
        self._goal[lanes, 1] = (2.0 * uniform[:, 1] - 1.0) * _BESIDE[self._options.task]
        self._goal[lanes, 2] = (2.0 * uniform[:, 2] - 1.0) * _TURNED
        self._elapsed[lanes] = 0.0
        self._away = self._to_goal()

    def step(self, actions: NDArray[np.float32]) -> Result:
        """20 ms of all; the first entry steers the tractor, the second one asks for acceleration."""
        asked = np.minimum(np.maximum(actions.astype(np.float64), -1.0), 1.0)
        room = np.sign(asked[:, 1]) * self._now.speed
        acceleration = np.where(room >= self._fastest, 0.0, _MAX_ACCELERATION * asked[:, 1])
        self._now = self._mover.step(self._steer_limit * asked[:, 0], acceleration)
        self._elapsed += PERIOD
        before, self._away = self._away, self._to_goal()
        return self._judged(before, asked)

    def observe(self) -> Observation:
        """Where the goal is as the trailer's end sees it, and how the combination stands."""
        now, away = self._now, self._away
        psi = now.poses[:, :, 2]
        values = [away[:, :2], np.cos(away[:, 2:]), np.sin(away[:, 2:]), psi[:, :-1] - psi[:, 1:]]
        values += [now.speed[:, None], now.steer[:, None]]
        return within(np.concatenate(values, axis=1), self.observation_space)

    def info(self) -> Info:
        """How far the end is from its goal."""
        away = np.nan_to_num(self._away)
        return {"distance_m": np.hypot(away[:, 0], away[:, 1]), "heading_error_deg": np.degrees(np.abs(away[:, 2]))}

    def picture(self, lane: int) -> Picture:
        """The combination from above."""
        distance = float(np.hypot(*self._away[lane, :2]))
        caption = f"{self._options.task}, {self._elapsed[lane]:.1f} s, {distance:.1f} m to go"
        straight_on = np.zeros(sum(len(unit.steered_axles) for unit in self._vehicle.units))
        straight_on[0] = self._now.steer[lane]
        steer = axle_angles(self._vehicle, straight_on)
        return self._onlooker.picture(lane, self._now.poses[lane], steer, caption, goal=self._goal[lane])

    def close(self) -> None:
        """Nothing is open."""

    def _to_goal(self) -> FloatArray:
        """The goal seen from the trailer's end: ahead and aside [m], and its direction [rad], (n, 3)."""
        x, y, psi = self._now.poses[:, -1].T
        c, s = np.cos(psi), np.sin(psi)
        d_x, d_y = self._goal[:, 0] - x, self._goal[:, 1] - y
        turned = self._goal[:, 2] - psi
        turned = turned - math.tau * np.round(turned / math.tau)
        return np.column_stack([c * d_x + s * d_y + self._ends, c * d_y - s * d_x, turned])

    def _judged(self, before: FloatArray, asked: FloatArray) -> Result:
        now, away = self._now, self._away
        distance = np.hypot(away[:, 0], away[:, 1])
        there = (distance < _THERE) & (np.abs(away[:, 2]) < _ALIGNED)
        arrived = there & (np.abs(now.speed) < _SLOW) if self._options.task == "bay" else there
        outcome = np.full(self.n, "", dtype=object)
        mishaps = {
            "lost": distance > _LOST[self._options.task],
            "jackknifed": (np.abs(np.diff(now.poses[:, :, 2], axis=1)) >= FOLDED).any(axis=1),
            "rolled over": (np.abs(now.load_transfer) >= LIFTED).any(axis=1),
            "diverged": ~np.isfinite(distance),
        }
        failed = np.zeros(self.n, dtype=bool)
        for words, happened in mishaps.items():
            outcome[happened] = words
            failed |= happened
        arrived &= ~failed
        outcome[arrived] = "completed"
        terminated = failed | arrived
        truncated = (self._elapsed >= self._time - 1e-9) & ~terminated
        outcome[truncated] = "timed out"
        nearer = _farness(before) - _farness(away) - 0.001 * np.sum(asked**2, axis=1)
        reward = np.where(np.isfinite(nearer), nearer, 0.0) + _MISHAP * failed + _ARRIVED * arrived
        return Result(reward, terminated, truncated, outcome)


def _farness(away: FloatArray) -> FloatArray:
    """How much there is still to do [m]: beside counts twice, and a radian as five metres."""
    far: FloatArray = np.hypot(away[:, 0], 2.0 * away[:, 1]) + 5.0 * np.abs(away[:, 2])
    return far


def _features(vehicle: Vehicle) -> tuple[Feature, ...]:
    return (
        Feature("goal_ahead", "m", 150.0),
        Feature("goal_aside", "m", 150.0),
        Feature("goal_direction_cos", "-", 1.0),
        Feature("goal_direction_sin", "-", 1.0),
        *(Feature(f"articulation_{k}", "rad", 3.2) for k in range(1, len(vehicle.units))),
        Feature("speed", "m/s", 40.0),
        Feature("steer_tractor", "rad", 1.6),
    )
