"""Model of the predictive controller, and compiled functions that predict with it.

A rigid body with prescribed motion of the hitch. In the moment balance about the hitch are the yaw inertia, the inertia
of the mass in the hitch's lateral acceleration, and the side forces of the axles. Each side force is the deflection of
an elastic carcass under the tyre's own law, as in the plant, at a friction that is an input. An axle has two wheels
with half its static load each. Load transfer, roll and the trailer's effect on the tractor are not modelled.

About the hitch, with the centre of gravity c behind it and a the lateral acceleration of the hitch less gravity's part,

    (I + m c^2) r' = m c a - sum((x_i + t_i) F_i cos(delta_i)) + disturbance,

t_i being the pneumatic trail.
"""

from collections.abc import Iterable
from dataclasses import dataclass
from functools import lru_cache
from typing import Final, Generic, NamedTuple, TypeVar

import casadi as ca
import numpy as np

from controllers.trailer import Combination, TrailerGeometry
from vehicle.combination.layout import parts
from vehicle.combination.loads import static_axle_loads
from vehicle.combination.unit import Unit
from vehicle.engine.integrator import exact_diagonal, semi_implicit_step
from vehicle.engine.kernels import Kernel, kernel_for_one
from vehicle.frames import FloatArray
from vehicle.tyres import Planar, Tyre, carcass, contact, rolling_speed

V = TypeVar("V")

_LEAST_LAG = 0.01  # of an actuator; less is immediate at the model's steps [s]
_LEAST_SPEED = 0.5  # slip is not defined at rest; the law does not steer below it [m/s]


@dataclass(frozen=True, slots=True)
class AxleModel:
    """One axle of the trailer."""

    x: float  # behind the hitch [m]
    load: float  # [N]
    tyre: Tyre
    actuator: int | None  # index; None: fixed
    ratio: float  # its angle over the actuator's [-]


@dataclass(frozen=True, slots=True)
class TrailerModel:
    """Parameters of the trailer."""

    axles: tuple[AxleModel, ...]  # front to rear
    mass_moment: float  # m c [kg m]
    inertia: float  # about the hitch [kg m2]
    n_actuators: int
    actuator_lag: float  # [s]

    @classmethod
    def of(cls, trailer: TrailerGeometry, combination: Combination) -> "TrailerModel":
        """The model of the nominal data sheets."""
        unit = combination.vehicle.units[combination.unit]
        loads = static_axle_loads(combination.vehicle)[combination.unit]
        return cls(
            axles=tuple(_axles(unit, loads, trailer)),
            mass_moment=-unit.mass * unit.cg_x,
            inertia=unit.yaw_inertia + unit.mass * unit.cg_x**2,
            n_actuators=len(trailer.groups),
            actuator_lag=max(trailer.actuator_lag, _LEAST_LAG),
        )

    @property
    def stiffness(self) -> float:
        """Cornering stiffness of the axles over their load, by their moments about the hitch [1/rad]."""
        moments = (float(axle.tyre.stiffness(0.5 * axle.load).y) * axle.load * axle.x for axle in self.axles)
        return sum(moments) / self.load_moment

    @property
    def centre(self) -> float:
        """Mean distance of the axles behind the hitch [m]."""
        return sum(axle.x for axle in self.axles) / len(self.axles)

    @property
    def n_steered(self) -> int:
        """Number of steered axles."""
        return sum(axle.actuator is not None for axle in self.axles)

    @property
    def load_moment(self) -> float:
        """Sum of loads times distances behind the hitch: the unit of moments [N m]."""
        return sum(axle.load * axle.x for axle in self.axles)


def _axles(unit: Unit, loads: Iterable[float], trailer: TrailerGeometry) -> Iterable[AxleModel]:
    actuator = {axle: k for k, group in enumerate(trailer.groups) for axle in group}
    steered = 0
    for axle, load in zip(unit.axles, loads, strict=True):
        if axle.steered:
            yield AxleModel(-axle.x, load, axle.tyre, actuator[steered], trailer.steer_ratios[steered])
            steered += 1
        else:
            yield AxleModel(-axle.x, load, axle.tyre, None, 0.0)


class Travel(NamedTuple):
    """Motion of the trailer over the ground."""

    speed: ca.SX  # of the hitch [m/s]
    hitch_direction: ca.SX  # of the hitch's travel, + left of the trailer's axis [rad]
    yaw_rate: ca.SX  # of the trailer [rad/s]


class AxleForces(NamedTuple):
    """Forces of the tyres."""

    deflection_rate: ca.SX  # (n_axles,) [1/s]
    fading: ca.SX  # (n_axles,) relaxation rate of the deflections [1/s]
    moment: ca.SX  # of all side forces about the hitch, over the load moment, + turning right [-]


class State(NamedTuple, Generic[V]):
    """State of the predicted trailer; the field order is the order in the vector."""

    hitch_direction: V  # of the hitch's travel in the trailer's frame, + left [rad]
    yaw_rate: V  # of the trailer [rad/s]
    deflection: V  # (n_axles,) of the tyres: force over load at the nominal load [-]
    steer: V  # (n_actuators,) [rad]
    demand: V  # (n_actuators,) [rad]


class Inputs(NamedTuple, Generic[V]):
    """Inputs, constant over a step; the field order is the order in the vector."""

    demand_rate: V  # (n_actuators,) [rad/s]
    speed: V  # of the hitch [m/s]
    course_rate: V  # of the hitch's travel over ground [rad/s]
    side_pull: V  # additional lateral acceleration of the hitch, by gravity and what is not modelled [m/s2]
    disturbance: V  # yaw moment, over the load moment [-]
    friction: V  # [-]


def state_sizes(model: TrailerModel) -> State[int]:
    """Size of every part of the state."""
    return State(1, 1, len(model.axles), model.n_actuators, model.n_actuators)


def input_sizes(model: TrailerModel) -> Inputs[int]:
    """Size of every part of the inputs."""
    return Inputs(model.n_actuators, 1, 1, 1, 1, 1)


def rate(model: TrailerModel, s: State[ca.SX], u: Inputs[ca.SX]) -> State[ca.SX]:
    """Time derivative of the state."""
    forces = axle_forces(model, Travel(u.speed, s.hitch_direction, s.yaw_rate), s.deflection, s.steer, u.friction)
    pull = u.speed * u.course_rate * ca.cos(s.hitch_direction) + u.side_pull
    moment = model.mass_moment * pull + model.load_moment * (u.disturbance - forces.moment)
    return State(
        hitch_direction=u.course_rate - s.yaw_rate,
        yaw_rate=moment / model.inertia,
        deflection=forces.deflection_rate,
        steer=(s.demand - s.steer) / model.actuator_lag,
        demand=u.demand_rate,
    )


def axle_forces(model: TrailerModel, travel: Travel, deflection: ca.SX, steer: ca.SX, friction: ca.SX) -> AxleForces:
    """Forces of the tyres at a deflection, with the actuators at angles ``steer`` [rad]."""
    rates, fadings, moment = [], [], ca.SX(0.0)
    for k, axle in enumerate(model.axles):
        delta = axle_angle(axle, steer)
        v = _wheel_velocity(axle, travel, delta)
        speed, load = rolling_speed(v.x), 0.5 * axle.load
        sliding = axle.tyre.sliding_rate(0.0, v.y)
        grip = axle.tyre.grip(load, friction, sliding, speed)
        n = Planar(0.0, deflection[k])
        moving = carcass(n, sliding, grip, axle.tyre.damping, v.x)
        force = 2.0 * contact(moving.felt, load, grip).force.y
        moment += (axle.x + grip.trail) * force * ca.cos(delta)
        rates.append(moving.rate.y)
        fadings.append(grip.decays.y)
    return AxleForces(ca.vertcat(*rates), ca.vertcat(*fadings), moment / model.load_moment)


def axle_angle(axle: AxleModel, steer: ca.SX) -> ca.SX:
    """Angle of an axle [rad] with the actuators at ``steer``."""
    return ca.SX(0.0) if axle.actuator is None else axle.ratio * steer[axle.actuator]


def slip_angle(axle: AxleModel, travel: Travel, steer: ca.SX) -> ca.SX:
    """Direction of an axle's travel less its angle [rad], + left."""
    return ca.atan2(_lateral_speed(axle, travel), _forward_speed(travel)) - axle_angle(axle, steer)


def _wheel_velocity(axle: AxleModel, travel: Travel, delta: ca.SX) -> Planar:
    """Velocity [m/s] along and across a wheel."""
    c, s = ca.cos(delta), ca.sin(delta)
    v_x, v_y = _forward_speed(travel), _lateral_speed(axle, travel)
    return Planar(c * v_x + s * v_y, c * v_y - s * v_x)


def _forward_speed(travel: Travel) -> ca.SX:
    return ca.fmax(travel.speed, _LEAST_SPEED) * ca.cos(travel.hitch_direction)


def _lateral_speed(axle: AxleModel, travel: Travel) -> ca.SX:
    return ca.fmax(travel.speed, _LEAST_SPEED) * ca.sin(travel.hitch_direction) - axle.x * travel.yaw_rate


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
