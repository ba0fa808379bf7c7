"""Equations of motion of a rover on sloping ground, as CasADi expressions and functions, and their vectors.

A rigid body moves on a plane with the mean slope of the ground under its wheels. Each wheel also feels the difference
between its own slope and the plane's. Loads follow from the forces in the plane (see ``footprint``). They do not change
with unevenness: rockers are assumed to even it out. Not modelled: moments about the vertical in a contact, and the
inertia of roll and pitch.
"""

from collections.abc import Callable, Iterable, Sequence
from functools import lru_cache
from typing import Any, Final, Generic, NamedTuple, TypeVar

import casadi as ca
import numpy as np
from pydantic import BaseModel

from vehicle.combination.actuators import steer_rate
from vehicle.combination.layout import parts
from vehicle.engine.function_cache import derived_once
from vehicle.frames import FloatArray
from vehicle.rover.description import Footprint, Rover, Soil
from vehicle.rover.terramechanics import (
    GRAVITY,
    RimMotion,
    WheelForce,
    WheelGround,
    WheelState,
    ground_force,
    sinkage_rate,
    slip_rate,
    soil_force,
    spin_up,
)
from vehicle.tyres import Num

V = TypeVar("V")  # a part of a vector: numpy array, SX, or its size


class RoverState(NamedTuple, Generic[V]):
    """State of a rover with n wheels, in the order of its file."""

    x: V  # of R in W [m]
    y: V  # [m]
    psi: V  # [rad]
    v_x: V  # of R's origin along the body, in the plane of the ground [m/s]
    v_y: V  # across, + left [m/s]
    yaw_rate: V  # about the ground's normal [rad/s]
    wheel_speed: V  # (n,) of rotation, + forward [rad/s]
    turn: V  # (n,) angle rolled since the start [rad]
    steer: V  # (n,) + left [rad]
    slip_x: V  # (n,) lagged slip along the wheel, as slip / (1 + size of slip) [-]
    slip_y: V  # (n,) the same across
    sinkage: V  # (n,) [m]


class RoverInput(NamedTuple, Generic[V]):
    """Demands and ground during a step."""

    wheel_speed: V  # (n,) demanded [rad/s]
    steer: V  # (n,) demanded [rad]
    step: V  # length of a step [s]
    slope_x: V  # (n,) of the ground under each wheel, along W's x [-]
    slope_y: V  # (n,) along W's y [-]
    firm: V  # (n,) 1 where the ground does not give way, else 0
    friction: V  # of firm ground [-]


def state_sizes(n: int) -> RoverState[int]:
    """Sizes of the state's parts for n wheels."""
    return RoverState(1, 1, 1, 1, 1, 1, n, n, n, n, n, n)


def input_sizes(n: int) -> RoverInput[int]:
    """Sizes of the input's parts for n wheels."""
    return RoverInput(n, n, 1, n, n, n, 1)


class _ExcessSlope(NamedTuple):
    """Slope of the ground under a wheel beyond that of the plane, along the plane's axes [-]."""

    along: Num
    across: Num


class _Plane(NamedTuple):
    """Plane under a rover; its x axis points forward."""

    e_x: tuple[Num, Num, Num]  # forward, in W
    e_y: tuple[Num, Num, Num]  # to the left, in W
    upright: Num  # z of the normal
    excess: tuple[_ExcessSlope, ...]  # by wheel


class Dynamics(NamedTuple):
    """Result of the equations of motion."""

    rate: RoverState[Num]
    loads: ca.SX  # (n,) [N]


class _Wrench(NamedTuple):
    """Forces on the body along its axes [N], and their moment about R's origin [N m]."""

    X: Num
    Y: Num
    M: Num


def dynamics(
    rover: Rover, footprint: Footprint, soil: Soil | None, s: RoverState[ca.SX], u: RoverInput[ca.SX]
) -> Dynamics:
    """Time derivative of the state, and wheel loads."""
    places = footprint.places
    plane = _plane_under(s.psi, u)
    count = len(rover.wheels)
    wheels = [_wheel(rover, s, k, place) for k, place in enumerate(places)]
    grounds = [WheelGround(soil, u.firm[k], u.friction) for k in range(count)]

    def forces_under(loads: Sequence[Num]) -> list[WheelForce]:
        return [ground_force(rover, *wheel) for wheel in zip(grounds, wheels, loads, strict=True)]

    weight = rover.mass * GRAVITY
    static = _Wrench(weight * plane.e_x[2], weight * plane.e_y[2], 0.0)  # of the ground, without acceleration
    static_loads = _loads(rover, footprint, plane, static)
    loads = _loads(rover, footprint, plane, _wrench(places, s, forces_under(static_loads)))
    forces = forces_under(loads)
    slip_rates = [slip_rate(rover, wheel) for wheel in wheels]
    lifts = (force.lift for force in forces)
    sinkage_rates = [sinkage_rate(rover, *wheel) for wheel in zip(grounds, wheels, loads, lifts, strict=True)]
    rate = _body_rates(rover, plane, s, _with_slopes(places, plane, loads, _wrench(places, s, forces)))
    return Dynamics(
        rate._replace(
            wheel_speed=ca.vertcat(
                *(
                    spin_up(rover, s.wheel_speed[k], u.wheel_speed[k], force.torque, driven=rover.wheels[k].driven)
                    for k, force in enumerate(forces)
                )
            ),
            turn=s.wheel_speed,
            steer=ca.vertcat(*(_steering(rover, k, s.steer[k], u.steer[k]) for k in range(count))),
            slip_x=ca.vertcat(*(x for x, _ in slip_rates)),
            slip_y=ca.vertcat(*(y for _, y in slip_rates)),
            sinkage=ca.vertcat(*sinkage_rates),
        ),
        ca.vertcat(*loads),
    )


def _wheel(rover: Rover, s: RoverState[ca.SX], k: int, place: tuple[Num, Num]) -> WheelState:
    p_x, p_y = place
    v_x, v_y = s.v_x - s.yaw_rate * p_y, s.v_y + s.yaw_rate * p_x
    c, d = ca.cos(s.steer[k]), ca.sin(s.steer[k])
    along, across = v_x * c + v_y * d, v_y * c - v_x * d
    return WheelState(rover.radius * s.wheel_speed[k], along, across, s.slip_x[k], s.slip_y[k], s.sinkage[k])


def _wrench(places: Sequence[tuple[Num, Num]], s: RoverState[ca.SX], forces: Sequence[WheelForce]) -> _Wrench:
    """Sum of the ground's forces on all wheels, in the plane."""
    total = _Wrench(0.0, 0.0, 0.0)
    for k, (force, (p_x, p_y)) in enumerate(zip(forces, places, strict=True)):
        c, d = ca.cos(s.steer[k]), ca.sin(s.steer[k])
        X, Y = force.F_x * c - force.F_y * d, force.F_x * d + force.F_y * c
        total = _Wrench(total.X + X, total.Y + Y, total.M + p_x * Y - p_y * X)
    return total


def _with_slopes(places: Sequence[tuple[Num, Num]], plane: _Plane, loads: Sequence[Num], total: _Wrench) -> _Wrench:
    """The same with the downhill forces on wheels whose ground is steeper than the plane."""
    for load, slope, (p_x, p_y) in zip(loads, plane.excess, places, strict=True):
        X, Y = -load * slope.along, -load * slope.across
        total = _Wrench(total.X + X, total.Y + Y, total.M + p_x * Y - p_y * X)
    return total


def _loads(rover: Rover, footprint: Footprint, plane: _Plane, total: _Wrench) -> list[Num]:
    """Loads [N] that balance the moments of the ground's forces about the mass centre."""
    N = rover.mass * GRAVITY * plane.upright
    return footprint.loads(N, N * rover.cg_x - total.X * rover.cg_height, -total.Y * rover.cg_height)


def _body_rates(rover: Rover, plane: _Plane, s: RoverState[ca.SX], total: _Wrench) -> RoverState[Num]:
    """Rates of the body's six states; the rates of the wheels' states are left at 0."""
    e_x, e_y = plane.e_x, plane.e_y
    a_x = total.X / rover.mass - GRAVITY * e_x[2]  # of the centre of gravity
    a_y = total.Y / rover.mass - GRAVITY * e_y[2]
    yaw = (total.M - rover.cg_x * total.Y) / rover.yaw_inertia
    return RoverState(
        x=s.v_x * e_x[0] + s.v_y * e_y[0],
        y=s.v_x * e_x[1] + s.v_y * e_y[1],
        psi=s.yaw_rate * plane.upright / (e_x[0] ** 2 + e_x[1] ** 2),  # rate of e_x about the normal, seen from above
        v_x=a_x + s.yaw_rate * (s.v_y + rover.cg_x * s.yaw_rate),
        v_y=a_y - rover.cg_x * yaw - s.yaw_rate * s.v_x,
        yaw_rate=yaw,
        wheel_speed=0.0,
        turn=0.0,
        steer=0.0,
        slip_x=0.0,
        slip_y=0.0,
        sinkage=0.0,
    )


def _steering(rover: Rover, k: int, angle: Num, demand: Num) -> Num:
    if not rover.wheels[k].steered:
        return 0.0
    return steer_rate(angle, demand, lag=rover.steer_lag, limit=rover.steer_limit, rate_limit=rover.steer_rate_limit)


def _plane_under(psi: Num, u: RoverInput[ca.SX]) -> _Plane:
    """Plane with the mean slope of the ground under the wheels of a rover with heading psi [rad]."""
    c, s = ca.cos(psi), ca.sin(psi)
    n_wheels = u.slope_x.numel()
    g_x, g_y = ca.sum1(u.slope_x) / n_wheels, ca.sum1(u.slope_y) / n_wheels
    rise = g_x * c + g_y * s
    length = ca.sqrt(1.0 + rise**2)
    upright = 1.0 / ca.sqrt(1.0 + g_x**2 + g_y**2)
    e_x = (c / length, s / length, rise / length)
    n = (-g_x * upright, -g_y * upright, upright)
    e_y = (n[1] * e_x[2] - n[2] * e_x[1], n[2] * e_x[0] - n[0] * e_x[2], n[0] * e_x[1] - n[1] * e_x[0])
    excess = [(u.slope_x[k] - g_x, u.slope_y[k] - g_y) for k in range(n_wheels)]
    along_axes = tuple(_ExcessSlope(x * e_x[0] + y * e_x[1], x * e_y[0] + y * e_y[1]) for x, y in excess)
    return _Plane(e_x, e_y, upright, along_axes)


M = TypeVar("M", bound=BaseModel)


def numbers(rover: Rover, soil: Soil | None) -> FloatArray:
    """All physical numbers of a rover and its soil, in the order of the functions' third argument."""
    values = [value for model in (rover, soil) if model is not None for _, value in _numbers(model)]
    return np.array([*values, *rover.footprint[:2]])


def step_function(rover: Rover, soil: Soil | None) -> Any:
    """Function (state, input, numbers) -> state one step later, by the midpoint rule."""
    return _derived("step", _bare_rover(rover), None if soil is None else _bare(soil))


def load_function(rover: Rover, soil: Soil | None) -> Any:
    """Function (state, input, numbers) -> the wheels' loads [N]."""
    return _derived("loads", _bare_rover(rover), None if soil is None else _bare(soil))


def lift_function(rover: Rover, soil: Soil) -> Any:
    """Function (nothing, sinkage, numbers) -> lift [N] of a wheel that rolls without slip at a sinkage [m]."""
    return _derived("lift", _bare_rover(rover), _bare(soil))


@lru_cache(maxsize=32)
def _derived(name: str, rover: Rover, soil: Soil | None) -> Any:
    return derived_once(f"{__name__}.{name}", (rover, soil), lambda: _DERIVATIONS[name](_symbols(rover, soil)))


class _Symbols(NamedTuple):
    """Arguments of the functions, and the rover and soil whose numbers are among them."""

    rover: Rover
    footprint: Footprint
    soil: Soil | None
    x: ca.SX
    u: ca.SX
    numbers: ca.SX

    @property
    def input(self) -> RoverInput[ca.SX]:
        """The input by its parts."""
        return RoverInput(*parts(self.u, input_sizes(len(self.rover.wheels))))

    def dynamics(self, x: ca.SX) -> Dynamics:
        """Dynamics in a state, under the input."""
        state = RoverState(*parts(x, state_sizes(len(self.rover.wheels))))
        return dynamics(self.rover, self.footprint, self.soil, state, self.input)


def _symbols(rover: Rover, soil: Soil | None) -> _Symbols:
    symbols: list[ca.SX] = []
    rover = _symbolic(rover, symbols)
    soil = None if soil is None else _symbolic(soil, symbols)
    symbols += [ca.SX.sym("half_length"), ca.SX.sym("half_width")]
    return _Symbols(
        rover,
        rover.footprint._replace(half_length=symbols[-2], half_width=symbols[-1]),
        soil,
        x=ca.SX.sym("x", sum(state_sizes(len(rover.wheels)))),
        u=ca.SX.sym("u", sum(input_sizes(len(rover.wheels)))),
        numbers=ca.vertcat(*symbols),
    )


def _step(of: _Symbols) -> Any:
    duration = of.input.step
    midway = of.dynamics(of.x + 0.5 * duration * ca.vertcat(*of.dynamics(of.x).rate))
    after = of.x + duration * ca.vertcat(*midway.rate)
    return ca.Function("step", [of.x, of.u, of.numbers], [ca.cse(ca.densify(after))])


def _load(of: _Symbols) -> Any:
    return ca.Function("loads", [of.x, of.u, of.numbers], [ca.cse(ca.densify(of.dynamics(of.x).loads))])


def _lift(of: _Symbols) -> Any:
    assert of.soil is not None
    h = ca.SX.sym("h")
    lift = soil_force(of.rover, of.soil, h, RimMotion(1.0, 0.0)).F_z
    return ca.Function("lift", [ca.SX(0, 1), h, of.numbers], [ca.cse(ca.densify(lift))])


_DERIVATIONS: Final[dict[str, Callable[[_Symbols], Any]]] = {"step": _step, "loads": _load, "lift": _lift}


def _numbers(model: BaseModel) -> Iterable[tuple[str, float]]:
    return ((name, value) for name, value in model if isinstance(value, float))


def _bare(model: M) -> M:
    """The model without numbers and names: equal for all models with the same equations."""
    zeros = {name: 0.0 for name, _ in _numbers(model)}
    return type(model).model_construct(**{**dict(model), **zeros, "name": "", "summary": ""})


def _bare_rover(rover: Rover) -> Rover:
    """The same for a rover; the proportions of its wheel places stay."""
    shares = zip(rover.wheels, rover.footprint.along, rover.footprint.across, strict=True)
    wheels = tuple(wheel.model_copy(update={"name": "", "x": x, "y": y}) for wheel, x, y in shares)
    return _bare(rover).model_copy(update={"wheels": wheels})


def _symbolic(model: M, symbols: list[ca.SX]) -> M:
    """The model with a symbol in place of each number; the symbols are appended to the list."""
    own = {name: ca.SX.sym(name) for name, _ in _numbers(model)}
    symbols.extend(own.values())
    return type(model).model_construct(**{**dict(model), **own})
