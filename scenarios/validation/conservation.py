"""Conservation of energy and momenta of a chain without tyre forces, and the work of gravity on it."""

from __future__ import annotations

from typing import Any, Final, NamedTuple

import casadi as ca
import numpy as np

from scenarios.validation.check import Check
from vehicle.combination.description import Vehicle
from vehicle.combination.multibody import Speeds, Vector, speed_rates

_STEP: Final = 2e-3  # of the classical Runge-Kutta method [s]: its error is of the order of rounding
_FREE: Final = 20.0  # duration of the free motion [s]
_DESCENT: Final = 10.0  # [s]
_SLOPE: Final = np.array([0.5, -0.3])  # gravity along the ground [m/s2]
_MECHANICS: Final = "follows from the mechanics; tolerance: rounding over the steps"


def conservation(vehicle: Vehicle) -> tuple[Check, ...]:
    """Changes of energy and momenta of a chain that tumbles freely without external forces."""
    n = len(vehicle.units)
    model = _without_tyres(vehicle, round(_FREE / _STEP))
    start = np.concatenate([[3.0, -2.0], np.linspace(0.0, 1.0, n), [8.0, 1.5], np.linspace(0.8, -1.1, n)])
    end = np.array(model.step(start, np.zeros(2))).ravel()
    before, after = ([np.array(part).ravel() for part in model.invariants(y)] for y in (start, end))
    bounds = (("energy", 1e-12), ("momentum", 1e-11), ("angular momentum", 3e-10))
    return tuple(
        Check(
            f"{n} units, {_FREE:g} s without forces: relative change of {name}",
            float(np.linalg.norm(b - a) / np.linalg.norm(a)),
            "",
            target=0.0,
            tolerance=bound,
            source=_MECHANICS,
        )
        for (name, bound), a, b in zip(bounds, before, after, strict=True)
    )


def gravity_work(vehicle: Vehicle) -> Check:
    """Energy gained on a uniform slope, compared with the work of gravity on each centre of gravity."""
    model = _without_tyres(vehicle, round(_DESCENT / _STEP))
    start = np.array([0.0, 0.0, 0.0, 0.5, 5.0, 0.0, 0.4, -0.3])  # of two units
    end = np.array(model.step(start, _SLOPE)).ravel()
    gained = float(model.invariants(end)[0] - model.invariants(start)[0])
    displacements = np.array(model.centres(end)) - np.array(model.centres(start))
    work = float(np.array([unit.mass for unit in vehicle.units]) @ (displacements @ _SLOPE))
    return Check(
        name=f"2 units, {_DESCENT:g} s down a slope: energy gained minus work of gravity, relative",
        value=abs(gained / work - 1.0),
        target=0.0,
        tolerance=1e-14,  # a random walk of rounding over 5000 steps
        unit="",
        source=_MECHANICS,
    )


class _Free(NamedTuple):
    """A chain without tyres, as functions of its origin's position, its headings, and their rates, along W."""

    step: Any  # (q, q', gravity) -> (q, q') after many steps
    invariants: Any  # (q, q') -> energy [J], momentum (2,) [N s], angular momentum about W's origin [N m s]
    centres: Any  # q -> (N, 2) of the centres of gravity [m]


def _without_tyres(vehicle: Vehicle, steps: int) -> _Free:
    n = 2 + len(vehicle.units)
    q, rate, gravity = ca.SX.sym("q", n), ca.SX.sym("rate", n), ca.SX.sym("gravity", 2)
    y = ca.vertcat(q, rate)
    f = ca.Function("f", [y, gravity], [ca.vertcat(rate, _accelerations(vehicle, q, rate, gravity))])
    k_1 = f(y, gravity)
    k_2 = f(y + 0.5 * _STEP * k_1, gravity)
    k_3 = f(y + 0.5 * _STEP * k_2, gravity)
    k_4 = f(y + _STEP * k_3, gravity)
    one = ca.Function("one", [y, gravity], [y + _STEP / 6.0 * (k_1 + 2.0 * k_2 + 2.0 * k_3 + k_4)])
    centres = _centres(vehicle, q)
    velocities = [ca.jtimes(centre, q, rate) for centre in centres]
    bodies = list(zip(vehicle.units, centres, velocities, ca.vertsplit(rate[2:]), strict=True))
    energy = sum(0.5 * (b.mass * ca.dot(v, v) + b.yaw_inertia * r**2) for b, _, v, r in bodies)
    momentum = sum(b.mass * v for b, _, v, _ in bodies)
    spin = sum(b.mass * (p[0] * v[1] - p[1] * v[0]) + b.yaw_inertia * r for b, p, v, r in bodies)
    return _Free(
        step=one.fold(steps),
        invariants=ca.Function("invariants", [y], [energy, momentum, spin]),
        centres=ca.Function("centres", [y], [ca.horzcat(*centres).T]),
    )


def _accelerations(vehicle: Vehicle, q: ca.SX, rate: ca.SX, gravity: ca.SX) -> ca.SX:
    """Accelerations of the model, rotated from the tractor's axes to W."""
    psi = ca.vertsplit(q[2:])
    c, s = ca.cos(psi[0]), ca.sin(psi[0])
    v_x, v_y = c * rate[0] + s * rate[1], c * rate[1] - s * rate[0]
    pull = Vector(c * gravity[0] + s * gravity[1], c * gravity[1] - s * gravity[0])
    forces = [Vector(unit.mass * pull.x, unit.mass * pull.y) for unit in vehicle.units]
    rates = speed_rates(vehicle, psi, Speeds(v_x, v_y, ca.vertsplit(rate[2:])), forces, [0.0] * len(forces))
    a_x, a_y = rates.v_x - rate[2] * v_y, rates.v_y + rate[2] * v_x
    return ca.vertcat(c * a_x - s * a_y, s * a_x + c * a_y, *rates.yaw_rate)


def _centres(vehicle: Vehicle, q: ca.SX) -> list[ca.SX]:
    """Positions of the centres of gravity, along W."""
    centres, hitch = [], q[:2]
    for i, unit in enumerate(vehicle.units):
        axis = ca.vertcat(ca.cos(q[2 + i]), ca.sin(q[2 + i]))
        centres.append(hitch + unit.cg_x * axis)
        hitch = hitch + (unit.hitch_x or 0.0) * axis
    return centres
