"""Simulated rover: its equations integrated over whole ticks, and its posture on the terrain."""

import math
from dataclasses import dataclass
from functools import lru_cache
from typing import Any, Final

import casadi as ca
import numpy as np
import scipy

from vehicle.clock import TICK
from vehicle.combination.layout import slices
from vehicle.combination.plant import DivergedError
from vehicle.engine.kernels import Engine, kernel_for_one
from vehicle.foundation.plant_like import is_sane
from vehicle.frames import FloatArray, Pose2, cross, transform
from vehicle.rover import equations
from vehicle.rover.command import RoverCommand
from vehicle.rover.description import Rover, Soil
from vehicle.rover.terrain import Terrain
from vehicle.rover.terramechanics import RimMotion, soil_force
from vehicle.rover.truth import RoverTruth

_AT_REST: Final = 1e-6  # below it a velocity is rounding and has no direction [m/s]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Posture:
    """Pose of the body, places and velocities of the wheels."""

    X_WB: FloatArray  # (4, 4)
    wheels: FloatArray  # (n, 3) lowest points in W [m]
    wheel_velocities: FloatArray  # (n, 2) along and across each wheel's heading [m/s]


class Undercarriage:
    """Wheels of a rover as they stand on terrain."""

    def __init__(self, rover: Rover) -> None:
        self._places = rover.wheel_places
        # Weighted sums of the wheels' points, in the order of falling weights, point forward and to the left.
        weights = (self._places / self._places.max(axis=0)).T
        self._order = np.argsort(-weights, axis=1, kind="stable")  # (2, n)
        self._weights = np.take_along_axis(weights, self._order, axis=1)[:, :, None]  # (2, n, 1)

    def posture(self, terrain: Terrain, s: equations.RoverState[FloatArray]) -> Posture:
        """Posture in a state: the body is parallel to the least-squares plane of the wheels' lowest points."""
        p, origin = self._places, np.array([s.x[0], s.y[0]])
        flat = Pose2(float(s.x[0]), float(s.y[0]), float(s.psi[0])).apply(p)
        for _ in range(2):  # an inclined body covers less of the map than a level one
            lowest = _lowest(flat, terrain, s)
            R_WB = self._attitude(lowest)
            flat = p @ R_WB[:2, :2].T + origin
        return Posture(
            X_WB=transform(R_WB, lowest.mean(axis=0)),
            wheels=_lowest(flat, terrain, s),
            wheel_velocities=_wheel_velocities(p, s),
        )

    def _attitude(self, lowest: FloatArray) -> FloatArray:
        """R_WB of the body from the wheels' lowest points in W (n, 3)."""
        forward, leftward = (self._weights * lowest[self._order]).sum(axis=1)
        e_x = forward / math.sqrt(forward @ forward)
        up = cross(e_x, leftward)
        e_z = up / math.sqrt(up @ up)
        return np.column_stack([e_x, cross(e_z, e_x), e_z])


def _lowest(flat: FloatArray, terrain: Terrain, s: equations.RoverState[FloatArray]) -> FloatArray:
    """Lowest points (n, 3) of wheels above these points (n, 2) of the map [m]."""
    points = np.empty((len(flat), 3))
    points[:, :2] = flat
    points[:, 2] = terrain.height(flat[:, 0], flat[:, 1]) - s.sinkage
    return points


def slip_ratios(rim: FloatArray, v_x: FloatArray) -> FloatArray:
    """Slip ratios [-]: (r omega - v_x) / r omega of driving wheels, / v_x of braking ones; 0 at rest.

    Above 1 a driving wheel moves against its rotation.
    """
    over = np.where(rim * (rim - v_x) > 0.0, rim, v_x)
    return np.divide(rim - v_x, over, out=np.zeros_like(rim), where=np.abs(over) > _AT_REST)


def slip_angles(velocities: FloatArray) -> FloatArray:
    """Directions of travel of wheels relative to their headings [rad], from velocities (n, 2); 0 at rest."""
    angles = np.arctan2(velocities[:, 1], velocities[:, 0])
    return np.where(np.hypot(velocities[:, 0], velocities[:, 1]) > _AT_REST, angles, 0.0)


def _wheel_velocities(p: FloatArray, s: equations.RoverState[FloatArray]) -> FloatArray:
    v_x, v_y = s.v_x - s.yaw_rate * p[:, 1], s.v_y + s.yaw_rate * p[:, 0]
    c, d = np.cos(s.steer), np.sin(s.steer)
    return np.column_stack([v_x * c + v_y * d, v_y * c - v_x * d])


LONGEST_STEP: Final = 5  # [ticks]; a standing rover rocks on its contacts at some 50 rad/s: a quarter of a radian
_LOOK_EVERY: Final = 0.01  # distance between two looks at uneven ground [m]: a tenth of a wheel's radius
_SETTLING: Final = 2000  # [ticks]; a wheel at 2 cm/s rolls over its whole contact in this time


class RoverPlant:
    """A rover on a terrain, of loose soil or (soil None) of firm ground; one per thread."""

    def __init__(self, rover: Rover, terrain: Terrain, soil: Soil | None, engine: Engine = "auto") -> None:
        self._rover, self._terrain, self._soil, self._engine = rover, terrain, soil, engine
        values = equations.numbers(rover, soil)
        self._advance = kernel_for_one(equations.step_function(rover, soil), values, engine)
        # Loads are seldom asked for, and compiling costs more than it saves.
        self._loads = kernel_for_one(equations.load_function(rover, soil), values, "interpreted")
        self._wheels = rover.wheel_places
        self._undercarriage = Undercarriage(rover)
        self._unsteered = np.array([not wheel.steered for wheel in rover.wheels])
        self._in_state = equations.RoverState(*slices(equations.state_sizes(len(rover.wheels))))
        self._in_input = equations.RoverInput(*slices(equations.input_sizes(len(rover.wheels))))
        self._looked: tuple[Pose2 | None, FloatArray] = (None, np.empty(0))  # the last place, and its input
        self._everywhere = self._look(Pose2(0.0, 0.0, 0.0)) if terrain.is_uniform else None

    def __reduce__(self) -> "tuple[type[RoverPlant], tuple[Rover, Terrain, Soil | None, Engine]]":
        return (RoverPlant, (self._rover, self._terrain, self._soil, self._engine))  # no compiled functions

    def initial_state(self, pose: Pose2, speed: float = 0.0) -> FloatArray:
        """State of a rover that has driven straight on ground as at this pose X_WR until its slip was steady.

        The wheels turn for this speed [m/s]; slip takes its share of it.

        Raises:
            ValueError: if the soil does not carry the rover.
        """
        state = np.zeros(self._in_state.sinkage.stop)
        state[:3] = pose
        state[self._in_state.v_x] = speed
        state[self._in_state.wheel_speed] = speed / self._rover.radius
        u = self._input(state)
        u[self._in_input.wheel_speed] = state[self._in_state.wheel_speed]
        u[self._in_input.step] = LONGEST_STEP * TICK
        if self._soil is not None:
            sunk = [settled_sinkage(self._rover, self._soil, float(load)) for load in self._loads(state, u)]
            state[self._in_state.sinkage] = sunk
        settled = self._advance(state, u, _SETTLING // LONGEST_STEP)
        settled[:3] = pose
        settled[self._in_state.turn] = 0.0
        return settled

    def step(self, state: FloatArray, command: RoverCommand, ticks: int) -> FloatArray:
        """State after whole ticks under a held command, a new array.

        Raises:
            ValueError: if ``ticks`` is below 1, a demand is not finite, or a wheel without steering shall steer.
            DivergedError: if the new state is not finite, or beyond 1e12 in any SI unit.
        """
        if ticks < 1:
            raise ValueError(f"ticks = {ticks} must be at least 1 tick of {TICK * 1e3:g} ms")
        demands = self._demands(command)
        while ticks > 0:
            before_next_look = ticks if self._everywhere is not None else min(ticks, _ticks_to_next_look(state))
            state = self._stepped(state, demands, before_next_look)
            ticks -= before_next_look
        return state

    def observe(self, state: FloatArray, tick: int) -> RoverTruth:
        """Ground truth of this state."""
        rover, s = self._rover, equations.RoverState(*(state[span] for span in self._in_state))
        at = self._undercarriage.posture(self._terrain, s)
        rim = rover.radius * s.wheel_speed
        return RoverTruth(
            tick=tick,
            pose=state[:3].copy(),
            velocity=state[3:6].copy(),
            X_WB=at.X_WB,
            wheel_positions=at.wheels,
            wheel_headings=s.psi + s.steer,
            wheel_velocities=at.wheel_velocities,
            wheel_speeds=s.wheel_speed.copy(),
            wheel_turns=s.turn.copy(),
            steer=s.steer.copy(),
            slip_ratios=slip_ratios(rim, at.wheel_velocities[:, 0]),
            slip_angles=slip_angles(at.wheel_velocities),
            sinkages=s.sinkage.copy(),
            loads=self._loads(state, self._input(state)),
        )

    def entrapped(self, truth: RoverTruth) -> bool:
        """True if a wheel has sunk in beyond the rover's limit."""
        return bool(np.max(truth.sinkages) > self._rover.sinkage_limit)

    def _stepped(self, state: FloatArray, demands: FloatArray, ticks: int) -> FloatArray:
        u = self._input(state)
        steps = -(-ticks // LONGEST_STEP)
        u[: len(demands)] = demands
        u[self._in_input.step] = ticks * TICK / steps
        after = self._advance(state, u, steps)
        if not is_sane(after):
            raise DivergedError(state, u)
        return after

    def _demands(self, command: RoverCommand) -> FloatArray:
        demands = np.array([*command.wheel_speed, *command.steer])
        n = len(self._wheels)
        if demands.shape != (2 * n,) or len(command.steer) != n or not np.isfinite(demands).all():
            raise ValueError(f"{command} must have {n} finite wheel speeds [rad/s] and {n} finite angles [rad]")
        if demands[n:][self._unsteered].any():
            which = "no wheel" if not self._rover.steered else "not all wheels"
            raise ValueError(f"steer = {command.steer} rad must be 0: {self._rover.name} steers {which}")
        return demands

    def _input(self, state: FloatArray) -> FloatArray:
        """Input vector of this place, without demands."""
        if self._everywhere is not None:
            return self._everywhere.copy()
        pose = Pose2(*state[:3].tolist())
        if pose != self._looked[0]:  # a step begins where the last observation was
            self._looked = pose, self._look(pose)
        return self._looked[1].copy()

    def _look(self, pose: Pose2) -> FloatArray:
        """Input vector for a pose; the wheels' places on the map are those of a level rover."""
        u = np.zeros(self._in_input.friction.stop)
        x, y = pose.apply(self._wheels).T
        slope = self._terrain.gradient(x, y)
        u[self._in_input.step] = TICK
        u[self._in_input.slope_x], u[self._in_input.slope_y] = slope[:, 0], slope[:, 1]
        u[self._in_input.friction] = self._terrain.friction
        return u


def _ticks_to_next_look(state: FloatArray) -> int:
    """Number of ticks for which the last look at uneven ground is good enough."""
    speed = max(math.hypot(*state[3:5].tolist()), 0.1)  # a standing rover may start to move [m/s]
    return max(1, int(_LOOK_EVERY / (speed * TICK)))


def settled_sinkage(rover: Rover, soil: Soil, load: float) -> float:
    """Sinkage [m] of a wheel that rolls without slip under a load [N].

    Raises:
        ValueError: if the soil does not carry the load before the wheel is in up to its axle.
    """
    lift = _lift(rover, soil)
    if float(lift(rover.radius)) < load:
        raise ValueError(f"{soil.name} does not carry {load:.1f} N on a wheel of {rover.name}: it sinks to its axle")
    if load <= float(lift(0.0)):
        return 0.0
    return scipy.optimize.brentq(lambda h: float(lift(h)) - load, 0.0, rover.radius, xtol=1e-9)


@lru_cache(maxsize=16)
def _lift(rover: Rover, soil: Soil) -> Any:
    h = ca.SX.sym("h")
    return ca.Function("lift", [h], [soil_force(rover, soil, h, RimMotion(1.0, 0.0)).F_z])
