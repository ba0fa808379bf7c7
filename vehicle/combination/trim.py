"""Straight running at constant speed on level ground, as the operating point of linear models."""

from __future__ import annotations

from functools import lru_cache
from typing import Any, Final

import casadi as ca
import numpy as np

from vehicle.combination.chain import derivative
from vehicle.combination.description import GRAVITY, Vehicle
from vehicle.combination.layout import Input, State, input_sizes, parts, state_sizes, wheels
from vehicle.combination.mirror import kept
from vehicle.frames import FloatArray

_ITERATIONS: Final = 30  # Newton's method needs two to five
_CONVERGED: Final = 1e-10  # last step over the size of the state
_GIVEN: Final = frozenset({"x", "v_x", "brake_windup"})  # position and speed; brakes are not applied


def straight_running(vehicle: Vehicle, speed: float, friction: float) -> tuple[FloatArray, FloatArray]:
    """State and input of the straight combination with the drive force that holds its speed.

    Raises:
        ValueError: if ``speed`` [m/s] is not positive, or cannot be held on this ``friction`` [-].
    """
    if not speed > 0.0:
        raise ValueError(f"speed = {speed} m/s must be positive")
    s = State(*(np.zeros(size) for size in state_sizes(vehicle)))
    u = Input(*(np.zeros(size) for size in input_sizes(vehicle)))
    drag = GRAVITY * float(
        np.mean([wheel.axle.tyre.rolling_resistance for wheel in wheels(vehicle)])
    )  # [m/s2], a first guess
    s = s._replace(
        v_x=np.array([speed]),
        omega=np.array([speed / wheel.axle.wheel_radius for wheel in wheels(vehicle)]),
        brake_windup=np.ones(vehicle.n_wheels),  # as in steady rolling
        acceleration=np.array([drag]),
    )
    u = u._replace(gear=np.array([1.0]), friction=np.full(vehicle.n_wheels, friction))
    x = _balanced(vehicle, np.concatenate(s), np.concatenate(u))
    if x is None:
        raise ValueError(f"speed = {speed} m/s cannot be held by {vehicle.name} on a friction of {friction}")
    held = State(*parts(x, state_sizes(vehicle))).acceleration
    return x, np.concatenate(u._replace(acceleration=held))


def _balanced(vehicle: Vehicle, x: FloatArray, u: FloatArray) -> FloatArray | None:
    """State near x in which all mirror-kept coordinates are at rest, by Newton's method; None if there is none."""
    directions, balance = _balance(vehicle)
    for _ in range(_ITERATIONS):
        rates, slopes = (np.array(part) for part in balance(x, u))
        try:
            step = directions @ np.linalg.solve(slopes, rates).ravel()
        except np.linalg.LinAlgError:  # for instance at the limit of the engine's power
            return None
        x = x - step
        if np.abs(step / (1.0 + np.abs(x))).max() < _CONVERGED:
            return x
    return None


@lru_cache(maxsize=8)
def _balance(vehicle: Vehicle) -> tuple[FloatArray, Any]:
    """Directions (n_x, n) free in straight running, and the function of the rates that must vanish and their slopes.

    As the speed is given, its rate must vanish instead of that of the state ``acceleration``.
    """
    free = [c for c in kept(vehicle) if c.kind not in _GIVEN]
    resting = [c for c in kept(vehicle) if c.kind not in _GIVEN - {"v_x"} | {"acceleration"}]
    directions = np.column_stack([c.direction for c in free])
    x, u = ca.SX.sym("x", sum(state_sizes(vehicle))), ca.SX.sym("u", sum(input_sizes(vehicle)))
    rate = derivative(vehicle, State(*parts(x, state_sizes(vehicle))), Input(*parts(u, input_sizes(vehicle))))
    rates = ca.DM(np.stack([c.reading for c in resting])) @ ca.vertcat(*rate)
    return directions, ca.Function("balance", [x, u], [rates, ca.jacobian(rates, x) @ directions])
