"""Linear lateral motion about straight running: A, B, C, D from the chain's equations.

To first order it is independent of longitudinal motion (``vehicle.combination.mirror``). Units and trailer
actuators are numbered front to rear from 0; the input "steer" turns all steered axles of the tractor. The operating
point is straight running at constant speed on level ground.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Any, Final, NamedTuple, TypeAlias

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike, NDArray

from vehicle.combination.chain import derivative
from vehicle.combination.description import GRAVITY, Vehicle
from vehicle.combination.lateral_outputs import OutputKind, check_outputs, lateral_outputs
from vehicle.combination.layout import Input, State, input_sizes, parts, state_sizes, wheels
from vehicle.combination.mirror import Coordinate, flipped, kept
from vehicle.frames import FloatArray

_IDLE: Final = ("brake_windup", "brake_pressure", "brake_valve")  # have no effect while no brake is applied
_ITERATIONS: Final = 30  # Newton's method needs two to five
_CONVERGED: Final = 1e-10  # last step over the size of the state
_GIVEN: Final = frozenset({"x", "v_x", *_IDLE})  # position and speed; brakes are not applied
ComplexArray: TypeAlias = NDArray[np.complex128]
_PATH: Final = ("y", "psi")
_YAW_PLANE: Final = ("v_y", "yaw_rate", "articulation")
_ACTUATOR: Final = ("steer",)
_AMPLE_POWER: Final = 1e9  # [W] beyond any vehicle


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class LateralModel:
    """dx/dt = A x + B u, y = C x + D u, with a name for every state, input and output (SI and radians)."""

    states: tuple[str, ...]
    inputs: tuple[str, ...]
    outputs: tuple[str, ...]
    A: FloatArray
    B: FloatArray
    C: FloatArray
    D: FloatArray

    def eigenvalues(self) -> ComplexArray:
        """Eigenvalues [1/s], by real part, the fastest decay first."""
        eigenvalues: ComplexArray = np.sort_complex(np.linalg.eigvals(self.A).astype(np.complex128))
        return eigenvalues

    def response(self, output: str, frequencies: ArrayLike, to: str = "steer") -> ComplexArray:
        """Complex gain of an output over an input at ``frequencies`` [Hz], of their shape."""
        i, j = self.outputs.index(output), self.inputs.index(to)
        s = 2j * np.pi * np.asarray(frequencies, dtype=np.float64)[..., None, None]
        x = np.linalg.solve(s * np.eye(len(self.A)) - self.A, self.B[:, [j]])
        gain: ComplexArray = (self.C[i] @ x)[..., 0] + self.D[i, j]
        return gain

    def steady_gain(self, output: str, to: str = "steer") -> float:
        """Steady-state change of an output over that of an input."""
        return float(self.response(output, 0.0, to).real)


def lateral_model(
    vehicle: Vehicle,
    speed: float,
    *,
    friction: float = 0.8,
    outputs: Sequence[OutputKind] = ("yaw_rate", "lateral_acceleration", "articulation"),
    tyre_dynamics: bool = False,
    actuators: bool = False,
    path: bool = False,
) -> LateralModel:
    """Lateral motion at a constant ``speed`` [m/s] on level ground, without limit of engine power or drag of the air.

    States are v_y [m/s] of To, yaw rates [rad/s] and articulations [rad]. ``path`` adds y [m] of To and psi [rad]
    relative to a straight path. ``actuators`` adds the actuators' angles [rad], whose demands then are the inputs.
    ``tyre_dynamics`` adds wheel spin, tyre deflection, roll and hitch force, which otherwise follow without delay
    (singular perturbation).

    Raises:
        ValueError: if the speed cannot be held, or an output is unknown or needs ``path``.
    """
    check_outputs(outputs, path=path)
    vehicle = _without_drive_limits(vehicle)
    slow = (_PATH if path else ()) + _YAW_PLANE + (_ACTUATOR if actuators else ())
    states = [c for kind in slow for c in flipped(vehicle) if c.kind == kind]
    lags = [c for c in flipped(vehicle) if c.kind not in _PATH + _YAW_PLANE + _ACTUATOR + _IDLE]
    names, full = _linearised(vehicle, speed, friction, states + lags, actuators=actuators)
    model = full if tyre_dynamics else _without_lags(full, len(states))
    rows = [k for kind in outputs for k, name in enumerate(names) if name.rpartition("_")[0] == kind]
    return LateralModel(
        states=tuple(c.name for c in states + (lags if tyre_dynamics else [])),
        inputs=("steer", *(f"trailer_steer_{k}" for k in range(model.B.shape[1] - 1))),
        outputs=tuple(names[row] for row in rows),
        A=model.A,
        B=model.B,
        C=model.C[rows],
        D=model.D[rows],
    )


def _without_drive_limits(vehicle: Vehicle) -> Vehicle:
    """The vehicle at ample power, without governor and drag of the air: its drive force is the rolling resistance."""
    drive = vehicle.drive.model_copy(update={"max_power": _AMPLE_POWER})
    return vehicle.model_copy(update={"drive": drive, "powertrain": None, "air": None})


class _Matrices(NamedTuple):
    A: FloatArray
    B: FloatArray
    C: FloatArray
    D: FloatArray


def _linearised(
    vehicle: Vehicle, speed: float, friction: float, states: Sequence[Coordinate], *, actuators: bool
) -> tuple[tuple[str, ...], _Matrices]:
    """Names of all outputs, and the matrices in these states."""
    x, u = straight_running(vehicle, speed, friction)
    names, jacobians = _jacobians(vehicle)
    F_x, F_u, G_x, G_u = (np.array(jacobian) for jacobian in jacobians(x, u))
    readings, directions = np.stack([c.reading for c in states]), np.column_stack([c.direction for c in states])
    turn = _steering_directions(vehicle, actuators=actuators)
    F_turn, G_turn = (F_u @ turn, G_u @ turn) if actuators else (F_x @ turn, G_x @ turn)
    return names, _Matrices(A=readings @ F_x @ directions, B=readings @ F_turn, C=G_x @ directions, D=G_turn)


def _without_lags(full: _Matrices, n: int) -> _Matrices:
    """Matrices of the first n states; the others are at rest for the given states and inputs."""
    follow_x, follow_u = (np.linalg.solve(full.A[n:, n:], block) for block in (full.A[n:, :n], full.B[n:]))
    return _Matrices(
        A=full.A[:n, :n] - full.A[:n, n:] @ follow_x,
        B=full.B[:n] - full.A[:n, n:] @ follow_u,
        C=full.C[:, :n] - full.C[:, n:] @ follow_x,
        D=full.D - full.C[:, n:] @ follow_u,
    )


def _steering_directions(vehicle: Vehicle, *, actuators: bool) -> FloatArray:
    """Directions of the inputs: of demands in the input vector with ``actuators``, else of angles in the state."""
    sizes: State[int] | Input[int] = input_sizes(vehicle) if actuators else state_sizes(vehicle)
    start = sum(sizes[: sizes._fields.index("steer")])
    directions = np.eye(sum(sizes))[:, start : start + sizes.steer]
    tractor = [
        1.0 / actuator.ratios[0] for actuator in vehicle.units[0].actuators
    ]  # their first axles turn by the demand
    return np.column_stack([directions[:, : len(tractor)] @ tractor, directions[:, len(tractor) :]])


@lru_cache(maxsize=8)
def _jacobians(vehicle: Vehicle) -> tuple[tuple[str, ...], Any]:
    """Names of all outputs; function (state, input) -> Jacobians of rate and outputs, by state and by input."""
    x, u = ca.SX.sym("x", sum(state_sizes(vehicle))), ca.SX.sym("u", sum(input_sizes(vehicle)))
    s, u_parts = State(*parts(x, state_sizes(vehicle))), Input(*parts(u, input_sizes(vehicle)))
    rate = derivative(vehicle, s, u_parts)
    outputs = lateral_outputs(vehicle, s, u_parts, rate)
    f, g = ca.vertcat(*rate), ca.vertcat(*outputs.values())
    return tuple(outputs), ca.Function("jacobians", [x, u], [ca.jacobian(y, by) for y in (f, g) for by in (x, u)])


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
