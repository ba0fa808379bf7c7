"""Compiled functions of the trailer model: a prediction step with derivatives, and a step of the tyres alone."""

from __future__ import annotations

from functools import lru_cache
from typing import Final, NamedTuple

import casadi as ca
import numpy as np

from controllers.trailer_steering.mpc.trailer_model import (
    AxleForces,
    Inputs,
    State,
    TrailerModel,
    Travel,
    axle_forces,
    input_sizes,
    rate,
    slip_angle,
    state_sizes,
)
from vehicle.combination.layout import parts
from vehicle.engine.kernels import Kernel, kernel_for_one
from vehicle.frames import FloatArray
from vehicle.integrator import exact_diagonal, semi_implicit_step

STEP: Final = 0.05  # of the prediction [s]; yaw on the tyre carcasses oscillates with about 0.7 s at any speed
TYRE_STEP: Final = 0.02  # of the tyre observer [s]: between two steps of a controller
_NOTHING: Final = np.empty(0)


class Step(NamedTuple):
    """One step of the prediction."""

    state: FloatArray  # (n_x,) at its end
    slip: FloatArray  # (n_steered,) slip angles of the steered axles at its start [rad]
    by_state: FloatArray  # (n_x, n_x) derivative of the state
    by_rate: FloatArray  # (n_x, n_actuators) its derivative by the rates of the demands
    slip_by_state: FloatArray  # (n_steered, n_x) derivative of the slip angles


class Stepper:
    """Prediction steps of one trailer; its memory is shared, so it belongs to one thread."""

    def __init__(self, model: TrailerModel) -> None:
        self._n_x = sum(state_sizes(model))
        self._n_y = self._n_x + model.n_steered
        self._n_by = self._n_x + model.n_actuators
        self._kernel = _prediction(model)

    def __call__(self, state: FloatArray, inputs: FloatArray) -> Step:
        """The step from a state (n_x,) with inputs (n_inputs,)."""
        output, n = self._kernel(state, inputs), self._n_x
        by = output[self._n_y :].reshape(self._n_by, self._n_y).T  # CasADi stores matrices by column
        return Step(output[:n], output[n : self._n_y], by[:n, :n], by[:n, n:], by[n:, :n])


class Tyres(NamedTuple):
    """The tyres after a step."""

    deflection: FloatArray  # (n_axles,)
    moment: float  # of their side forces about the hitch, over the load moment [-]
    by_friction: float  # derivative of the steady moment by the log of the friction [-]


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
    """The tyres ``TYRE_STEP`` later in a measured motion, with actuators at ``steer`` (n_actuators,) [rad]."""
    output = _tyres(model)(deflection, np.array([hitch_direction, yaw_rate, speed, friction, *steer]))
    return Tyres(output[:-2], float(output[-2]), float(output[-1]))


@lru_cache(maxsize=8)
def _prediction(model: TrailerModel) -> Kernel:
    """Function (state, inputs) -> state a step later, slip angles now, and derivatives by state and rates."""
    x, u = ca.SX.sym("x", sum(state_sizes(model))), ca.SX.sym("u", sum(input_sizes(model)))
    s, inputs = State(*parts(x, state_sizes(model))), Inputs(*parts(u, input_sizes(model)))

    def x_rate(state: ca.SX) -> ca.SX:
        return ca.vertcat(*rate(model, State(*parts(state, state_sizes(model))), inputs))

    yaw_relaxation = -exact_diagonal(x_rate(x), x, [(1, 2)])[1]
    after = semi_implicit_step(x_rate, x, STEP, _relaxation(model, s, inputs, yaw_relaxation))
    travel = _travel(s, inputs)
    slips = (slip_angle(axle, travel, s.steer) for axle in model.axles if axle.actuator is not None)
    y = ca.vertcat(after, *slips)
    by = ca.densify(ca.jacobian(y, ca.vertcat(x, inputs.demand_rate)))
    output = ca.cse(ca.densify(ca.vertcat(y, ca.vec(by))))
    return kernel_for_one(ca.Function("prediction", [x, u, ca.SX(0, 1)], [output]), _NOTHING, "auto")


def _relaxation(model: TrailerModel, s: State[ca.SX], inputs: Inputs[ca.SX], yaw: ca.SX) -> ca.SX:
    """Relaxation rate of every state with the others constant [1/s]."""
    forces = axle_forces(model, _travel(s, inputs), s.deflection, s.steer, inputs.friction)
    at_lag = ca.SX.ones(model.n_actuators) / model.actuator_lag
    return ca.vertcat(*State(ca.SX(0.0), yaw, forces.fading, at_lag, ca.SX.zeros(model.n_actuators)))


def _travel(s: State[ca.SX], inputs: Inputs[ca.SX]) -> Travel:
    return Travel(inputs.speed, s.hitch_direction, s.yaw_rate)


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
    output = ca.vertcat(after, now.moment, friction * ca.jacobian(settled.moment, friction))
    return kernel_for_one(
        ca.Function("tyres", [deflection, u, ca.SX(0, 1)], [ca.cse(ca.densify(output))]), _NOTHING, "auto"
    )
