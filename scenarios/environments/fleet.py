"""Many vehicles of one build whose numbers and ground may change at any time, each with a row of the state.

A plant batch fixes its vehicles' numbers when it is made. Here they are part of the input, so that an episode with
another load, length or lag begins without anything being made anew.
"""

from __future__ import annotations

from functools import lru_cache
from typing import Any, NamedTuple

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from vehicle.combination.description import Vehicle
from vehicle.combination.functions import place_function, start_function, step_function, wheel_function
from vehicle.combination.kinematics import Places, place_sizes
from vehicle.combination.layout import state_sizes
from vehicle.combination.plant_inputs import Footing, demand_sizes, footing_sizes, spans
from vehicle.combination.symbolic import numbers
from vehicle.combination.wheel_truth import WheelTruth, wheel_truth_sizes
from vehicle.engine.kernels import Engine, Kernel, kernel_for_many, kernel_for_one
from vehicle.frames import FloatArray
from vehicle.sanity import are_sane

Lanes = NDArray[np.intp]  # numbers of vehicles, (k,)
_APEX = 3.0  # radius over which the tip of conical ground is rounded, as on a surface of its own [m]


class Ground(NamedTuple):
    """What k vehicles drive on."""

    friction: FloatArray  # (k,) [-]
    cross_fall: FloatArray  # (k,) falls to the right, or away from the centre where there is one [-]
    centre: FloatArray  # (k, 2) apex of a conical cross-fall [m]; NaN: a plane


class Seen(NamedTuple):
    """Where n vehicles are, how they move, and what of their wheels rewards and ends look at."""

    poses: FloatArray  # (n, N, 3) x [m], y [m], psi [rad] of each unit's frame in W
    velocities: FloatArray  # (n, N, 3) v_x, v_y [m/s] along the unit's axes, yaw rate [rad/s]
    steer: FloatArray  # (n, n_steered) angle of every steered axle, front to rear [rad]
    load_transfer: FloatArray  # (n, N) right less left wheel loads of each unit over their sum [-]


class Fleet:
    """n vehicles stepped together; one fleet per thread."""

    def __init__(self, vehicle: Vehicle, n: int, engine: Engine) -> None:
        """All like ``vehicle`` until they are placed."""
        self.n, self._n_units = n, len(vehicle.units)
        self._advance = kernel(_closed(vehicle, "step"), n, engine)
        self._see = kernel(_closed(vehicle, "see"), n, engine)
        self._start = kernel(_closed(vehicle, "start"), n, engine)
        demands, footing = demand_sizes(vehicle), footing_sizes(vehicle)
        self._n_demands = sum(demands)
        self._footing = Footing(*(_behind(self._n_demands, span) for span in spans(footing)))
        first_number = self._n_demands + sum(footing)
        self._numbers = slice(first_number, None)
        nominal = numbers(vehicle)
        self._u = np.zeros((n, first_number + len(nominal)))
        self._u[:, self._numbers] = nominal
        self._u[:, self._n_demands - 1] = 1.0  # forward
        self._u[:, self._footing.friction] = 1.0
        self._state = np.zeros((n, sum(state_sizes(vehicle))))
        self._start_u = np.zeros((n, 4 + sum(footing) + len(nominal)))
        self._cross_fall, self._centre = np.zeros(n), np.full((n, 2), np.nan)
        self._conical, self._nothing = False, np.empty((n, 0))
        self._in_seen = _SeenSpans.of(vehicle)

    @property
    def finite(self) -> NDArray[np.bool_]:
        """Which vehicles' states are sane, (n,)."""
        return are_sane(self._state)

    def place(self, lanes: Lanes, own: FloatArray, ground: Ground, speeds: FloatArray) -> Seen:
        """Puts these vehicles straight at W's origin, heading along x and rolling freely, and looks at all.

        With numbers (k, n_numbers) of their own, on this ground, at these speeds (k,) [m/s].
        """
        self._u[lanes, self._numbers] = own
        self._u[lanes, self._footing.friction] = ground.friction[:, None]
        self._cross_fall[lanes], self._centre[lanes] = ground.cross_fall, ground.centre
        self._conical = bool(np.isfinite(self._centre[:, 0]).any())
        self._u[lanes, : self._n_demands - 1] = 0.0
        self._u[lanes, self._footing.slope_x] = 0.0
        self._u[lanes, self._footing.slope_y] = np.where(np.isfinite(ground.centre[:, 0]), 0.0, ground.cross_fall)[
            :, None
        ]
        self._start_u[:, 3] = 0.0
        self._start_u[lanes, 3] = speeds
        self._rest(lanes)
        seen = self.see()
        if not self._conical:
            return seen
        self._rest(lanes)  # leaning as the ground does where they stand
        return self.see()

    def step(
        self,
        steer: FloatArray,
        acceleration: FloatArray,
        trailer_steer: FloatArray,
        ticks: int,
        gear: FloatArray | float = 1.0,
    ) -> Seen:
        """Steps all under held demands, and looks: steer (n,) [rad], acceleration (n,) [m/s2], (n, n_steered) [rad].

        ``gear`` (n,): +1 forward, -1 backward; above 0 acceleration drives that way, below 0 it brakes.
        """
        last = self._n_demands - 1
        self._u[:, 0], self._u[:, 1], self._u[:, 2:last], self._u[:, last] = steer, acceleration, trailer_steer, gear
        self._state = self._advance(self._state, self._u, ticks)
        return self.see()

    def alone(self, lane: int) -> tuple[FloatArray, FloatArray, FloatArray]:
        """State, inputs and numbers of one vehicle, as ``vehicle.combination.functions`` takes them."""
        return self._state[lane], self._u[lane, : self._numbers.start], self._u[lane, self._numbers]

    def see(self) -> Seen:
        """Looks at all; those whose state is no number stand at the origin."""
        seen = self._see(self._state, self._u)
        at = self._in_seen
        if self._conical:
            self._lean(seen[:, at.centre_x], seen[:, at.centre_y])
        return Seen(
            poses=seen[:, at.poses].reshape(self.n, self._n_units, 3),
            velocities=seen[:, at.velocities].reshape(self.n, self._n_units, 3),
            steer=seen[:, at.steer],
            load_transfer=seen[:, at.load_transfer],
        )

    def _rest(self, lanes: Lanes) -> None:
        """The state these start from, on the ground that is under them now."""
        self._start_u[:, 4:] = self._u[:, self._n_demands :]
        self._state[lanes] = self._start(self._nothing, self._start_u)[lanes]

    def _lean(self, x: FloatArray, y: FloatArray) -> None:
        """The slope of conical ground under each unit [-]."""
        d_x, d_y = x - self._centre[:, :1], y - self._centre[:, 1:]
        share = -self._cross_fall[:, None] / np.sqrt(d_x * d_x + d_y * d_y + _APEX**2)
        conical = np.isfinite(share)
        np.copyto(self._u[:, self._footing.slope_x], share * d_x, where=conical)
        np.copyto(self._u[:, self._footing.slope_y], share * d_y, where=conical)


class _SeenSpans(NamedTuple):
    """Where the parts lie in what is seen."""

    poses: slice
    velocities: slice
    centre_x: slice
    centre_y: slice
    steer: slice
    load_transfer: slice

    @classmethod
    def of(cls, vehicle: Vehicle) -> _SeenSpans:
        there, told = Places(*place_sizes(vehicle)), WheelTruth(*wheel_truth_sizes(vehicle))
        sizes = (there.poses, there.velocities, there.centre_x, there.centre_y, told.steer, told.load_transfer)
        return cls(*spans(sizes))


@lru_cache(maxsize=16)
def _closed(vehicle: Vehicle, what: str) -> Any:
    """A function of state and (input, numbers); cached, as programs are made once for a function."""
    if what == "see":
        return _seen_function(vehicle)
    function = {"step": step_function, "start": start_function}[what](vehicle)
    x, u, own = (ca.SX.sym("v", function.numel_in(k)) for k in range(3))
    return ca.Function(what, [x, ca.vertcat(u, own), ca.SX(0, 1)], [function(x, u, own)])


def _seen_function(vehicle: Vehicle) -> Any:
    """What ``Seen`` and conical ground need of the places and the wheels, and nothing else."""
    where, wheels = place_function(vehicle), wheel_function(vehicle)
    x, u, own = (ca.SX.sym("v", wheels.numel_in(k)) for k in range(3))
    there = Places(*(where(x, ca.SX(0, 1), own)[span] for span in spans(place_sizes(vehicle))))
    told = WheelTruth(*(wheels(x, u, own)[span] for span in spans(wheel_truth_sizes(vehicle))))
    seen = (there.poses, there.velocities, there.centre_x, there.centre_y, told.steer, told.load_transfer)
    return ca.Function("see", [x, ca.vertcat(u, own), ca.SX(0, 1)], [ca.cse(ca.densify(ca.vertcat(*seen)))])


def kernel(function: Any, n: int, engine: Engine) -> Kernel:
    """A function (state, input, nothing) for rows of n; for one row that of a single plant, which is faster then."""
    if n > 1:
        return kernel_for_many(function, np.empty(0), n, engine)
    one = kernel_for_one(function, np.empty(0), engine)
    return lambda x, u, ticks=1: one(x[0], u[0], ticks)[None, :]


def _behind(first: int, span: slice) -> slice:
    return slice(first + span.start, first + span.stop)
