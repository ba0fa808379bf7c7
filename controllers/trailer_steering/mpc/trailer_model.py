"""Model of the predictive controller: a trailer led at its hitch, on tyres that slip.

A rigid body with prescribed motion of the hitch. In the moment balance about the hitch are the yaw inertia, the inertia
of the mass in the hitch's lateral acceleration, and the side forces of the axles. Each side force is the deflection of
an elastic carcass under the tyre's own law, as in the plant, at a friction that is an input. An axle has two wheels
with half its static load each. Load transfer, roll and the trailer's effect on the tractor are not modelled.

About the hitch, with the centre of gravity c behind it and a the lateral acceleration of the hitch less gravity's part,

    (I + m c^2) r' = m c a - sum((x_i + t_i) F_i cos(delta_i)) + disturbance,

t_i being the pneumatic trail.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Generic, NamedTuple, TypeVar

import casadi as ca

from controllers.trailer import Combination, TrailerGeometry
from vehicle.combination.loads import static_axle_loads
from vehicle.combination.unit import Unit
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
    def of(cls, trailer: TrailerGeometry, combination: Combination) -> TrailerModel:
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
        moving = carcass(n, sliding, grip.decay, axle.tyre.damping, v.x)
        force = 2.0 * contact(moving.felt, load, grip).force.y
        moment += (axle.x + grip.trail) * force * ca.cos(delta)
        rates.append(moving.rate.y)
        fadings.append(grip.decay)
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
