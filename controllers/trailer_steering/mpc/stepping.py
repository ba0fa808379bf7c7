"""The trailer model as functions that run: a step of its prediction with derivatives, and of its tyres alone."""

from __future__ import annotations

from functools import lru_cache
from typing import Final, NamedTuple

import casadi as ca
import numpy as np

from controllers.trailer_steering.mpc.trailer_model import (
    AxleForces,
    Given,
    State,
    TrailerModel,
    Travel,
    axle_forces,
    given_sizes,
    rate,
    slip_angle,
    state_sizes,
)
from vehicle.combination.layout import parts
from vehicle.engine.kernels import Kernel, kernel_for_one
from vehicle.frames import FloatArray
from vehicle.integrator import exact_diagonal, semi_implicit_step

STEP: Final = 0.05  # of the prediction [s]; yaw on the carcasses of the tyres swings with some 0.7 s at any speed
TYRE_STEP: Final = 0.02  # of the tyres followed beside it [s]: between two steps of a controller
_NOTHING: Final = np.empty(0)


class Step(NamedTuple):
    """One step of the prediction."""

    state: FloatArray  # (n_x,) at its end
    slip: FloatArray  # (n_steered,) slip angles of the steered axles at its start [rad]
    by_state: FloatArray  # (n_x, n_x) derivative of the state
    by_rate: FloatArray  # (n_x, n_actuators) its derivative by the rates of the demands
    slip_by_state: FloatArray  # (n_steered, n_x) derivative of the slip angles


class Stepper:
    """Steps of one trailer's prediction, in memory that is shared: for one thread."""

    def __init__(self, model: TrailerModel) -> None:
        self._n_x = sum(state_sizes(model))
        self._n_y = self._n_x + model.n_steered
        self._n_by = self._n_x + model.n_actuators
        self._kernel = _prediction(model)

    def __call__(self, state: FloatArray, given: FloatArray) -> Step:
        """The step from a state (n_x,) with what is given (n_given,)."""
        told, n = self._kernel(state, given), self._n_x
        by = told[self._n_y :].reshape(self._n_by, self._n_y).T  # CasADi's matrices run down their columns
        return Step(told[:n], told[n : self._n_y], by[:n, :n], by[:n, n:], by[n:, :n])


class Tyres(NamedTuple):
    """The tyres after a step."""

    deflection: FloatArray  # (n_axles,)
    moment: float  # of their side forces about the hitch, over the load moment [-]
    by_friction: float  # what that would change by per log of the friction if the slip were steady [-]


def rolled_on(
    model: TrailerModel,
    deflection: FloatArray,
    steer: FloatArray,
    *,
    hitch_direction: float,
    yaw_rate: float,
    speed: float,
    friction: float,
) -> Tyres:
    """The tyres ``TYRE_STEP`` later on a measured way, the actuators at angles ``steer`` (n_actuators,) [rad]."""
    told = _tyres(model)(deflection, np.array([hitch_direction, yaw_rate, speed, friction, *steer]))
    return Tyres(told[:-2], float(told[-2]), float(told[-1]))


@lru_cache(maxsize=8)
def _prediction(model: TrailerModel) -> Kernel:
    """Function (state, given) -> state a step later, slip angles now, and derivatives by state and rates."""
    x, u = ca.SX.sym("x", sum(state_sizes(model))), ca.SX.sym("u", sum(given_sizes(model)))
    s, given = State(*parts(x, state_sizes(model))), Given(*parts(u, given_sizes(model)))

    def x_rate(state: ca.SX) -> ca.SX:
        return ca.vertcat(*rate(model, State(*parts(state, state_sizes(model))), given))

    yaw_relaxation = -exact_diagonal(x_rate(x), x, [(1, 2)])[1]
    after = semi_implicit_step(x_rate, x, STEP, _relaxation(model, s, given, yaw_relaxation))
    travel = _travel(s, given)
    slips = (slip_angle(axle, travel, s.steer) for axle in model.axles if axle.actuator is not None)
    y = ca.vertcat(after, *slips)
    by = ca.densify(ca.jacobian(y, ca.vertcat(x, given.demand_rate)))
    told = ca.cse(ca.densify(ca.vertcat(y, ca.vec(by))))
    return kernel_for_one(ca.Function("prediction", [x, u, ca.SX(0, 1)], [told]), _NOTHING, "auto")


def _relaxation(model: TrailerModel, s: State[ca.SX], given: Given[ca.SX], yaw: ca.SX) -> ca.SX:
    """How fast every state relaxes when the others hold [1/s]."""
    forces = axle_forces(model, _travel(s, given), s.deflection, s.steer, given.friction)
    at_lag = ca.SX.ones(model.n_actuators) / model.actuator_lag
    return ca.vertcat(*State(ca.SX(0.0), yaw, forces.fading, at_lag, ca.SX.zeros(model.n_actuators)))


def _travel(s: State[ca.SX], given: Given[ca.SX]) -> Travel:
    return Travel(given.speed, s.hitch_direction, s.yaw_rate)


@lru_cache(maxsize=8)
def _tyres(model: TrailerModel) -> Kernel:
    """Function (deflections, (hitch direction, yaw rate, speed, friction, steer)) -> ``Tyres``."""
    deflection, u = ca.SX.sym("n", len(model.axles)), ca.SX.sym("u", 4 + model.n_actuators)
    hitch_direction, yaw_rate, speed, friction, steer = parts(u, (1, 1, 1, 1, model.n_actuators))
    travel = Travel(speed, hitch_direction, yaw_rate)

    def forces(n: ca.SX) -> AxleForces:
        return axle_forces(model, travel, n, steer, friction)

    after = semi_implicit_step(lambda n: forces(n).deflection_rate, deflection, TYRE_STEP, forces(deflection).fading)
    now = forces(after)
    settled = forces(after + now.deflection_rate / now.fading)
    told = ca.vertcat(after, now.moment, friction * ca.jacobian(settled.moment, friction))
    return kernel_for_one(
        ca.Function("tyres", [deflection, u, ca.SX(0, 1)], [ca.cse(ca.densify(told))]), _NOTHING, "auto"
    )
