"""Linear lateral motion about straight running: A, B, C, D from the chain's equations.

A straight-running vehicle is its own mirror image, so to first order the two halves of its state do not act on each
other: lateral motion is linear in the flipped coordinates, and straight running is a balance in the kept ones.

A name is a kind and a number: of the unit, or of the axle in the whole vehicle, front to rear from 0.

Trailer actuators are numbered as units are; the input "steer" turns all steered axles of the tractor. The operating
point is straight running at constant speed on level ground.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import lru_cache
from itertools import pairwise
from typing import Any, Final, Literal, NamedTuple, TypeAlias

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike, NDArray

from vehicle.combination.chain import derivative, output
from vehicle.combination.description import GRAVITY, BrakeChannel, Vehicle, brake_channels
from vehicle.combination.layout import Chain, Input, State, input_sizes, parts, state_sizes, wheels
from vehicle.combination.multibody import Speeds, acceleration, along, axes, levers_to, velocity
from vehicle.frames import FloatArray
from vehicle.tyres import Num

_FLIPPED: Final = frozenset(  # parts of the state that change sign in the mirror
    {"y", "psi", "v_y", "yaw_rate", "roll", "roll_spring", "side_force", "hitch_y", "deflection_y", "twin_y", "steer"}
)
SIGNS: Final = State(*(-1 if part in _FLIPPED else 1 for part in State._fields))  # wheels of an axle change places, too
_PER_WHEEL: Final = frozenset({"omega", "deflection_x", "deflection_y", "brake_windup", "twin_x", "twin_y"})
_PER_CHANNEL: Final = frozenset({"brake_pressure", "brake_valve"})
_PER_HITCH: Final = frozenset({"hitch_x", "hitch_y"})
_SINGLE: Final = frozenset({"x", "y", "v_x", "v_y", "acceleration"})


class Coordinate(NamedTuple):
    """Scalar coordinate of the state, ``reading`` @ state; a change by 1 changes the state by ``direction``."""

    name: str
    kind: str  # its part of the state, or "articulation"
    direction: FloatArray  # (n_x,)
    reading: FloatArray  # (n_x,)


def kept(vehicle: Vehicle) -> tuple[Coordinate, ...]:
    """Coordinates that a mirror keeps; for an axle's wheels their mean or half their difference."""
    return tuple(_coordinates(vehicle, +1))


def flipped(vehicle: Vehicle) -> tuple[Coordinate, ...]:
    """Coordinates that a mirror flips; yaw angles as that of the tractor and the articulations."""
    return tuple(_coordinates(vehicle, -1))


def _coordinates(vehicle: Vehicle, sign: int) -> Iterator[Coordinate]:
    sizes = state_sizes(vehicle)
    rows = np.split(np.eye(sum(sizes)), np.cumsum(sizes)[:-1])
    for part, part_rows, own in zip(State._fields, rows, SIGNS, strict=True):
        if part in _PER_WHEEL:
            yield from _per_axle(part, part_rows, sign * own)
        elif part in _PER_CHANNEL:
            channels = brake_channels(vehicle)
            yield from _per_channel(part, part_rows, channels, sign * own)
        elif sign == own:
            yield from _angles(part_rows) if part == "psi" else _plain(part, part_rows)


def _per_axle(part: str, rows: FloatArray, side: int) -> Iterator[Coordinate]:
    """Mean of each axle's two wheels (side +1), or half the left one's excess over the right one (-1)."""
    for k, (left, right) in enumerate(zip(rows[::2], rows[1::2], strict=True)):
        yield Coordinate(f"{part}_{k}", part, left + side * right, 0.5 * (left + side * right))


def _per_channel(part: str, rows: FloatArray, channels: Sequence[BrakeChannel], side: int) -> Iterator[Coordinate]:
    """The same of brake channels with this state; a channel of both sides is its own mirror image."""
    present = [k for k, channel in enumerate(channels) if part == "brake_pressure" or channel.valve is not None]
    row = dict(zip(present, rows, strict=True))
    for k in present:
        mirrored = channels[k].mirrored
        if mirrored == k and side == +1:
            yield Coordinate(f"{part}_{k}", part, row[k], row[k])
        elif mirrored > k:
            sum_ = row[k] + side * row[mirrored]
            yield Coordinate(f"{part}_{k}", part, sum_, 0.5 * sum_)


def _angles(rows: FloatArray) -> Iterator[Coordinate]:
    """Yaw of the whole straight combination, then the articulation of each towed unit, psi ahead less psi."""
    yield Coordinate("psi", "psi", rows.sum(axis=0), rows[0])
    for k in range(1, len(rows)):
        yield Coordinate(f"articulation_{k}", "articulation", -rows[k:].sum(axis=0), rows[k - 1] - rows[k])


def _plain(part: str, rows: FloatArray) -> Iterator[Coordinate]:
    first = 1 if part in _PER_HITCH else 0  # a hitch has the number of the unit behind it
    for k, row in enumerate(rows, start=first):
        yield Coordinate(part if part in _SINGLE else f"{part}_{k}", part, row, row)


OutputKind = Literal[
    "yaw_rate",  # [rad/s]
    "lateral_velocity",  # of each unit's origin, along its y axis [m/s]
    "lateral_acceleration",  # of each centre of gravity, along the unit's y axis [m/s2]
    "articulation",  # of each towed unit: psi of the unit ahead less its own [rad]
    "load_transfer",  # right less left wheel loads of each unit, over their sum [-]
    "axle_position",  # of each axle's middle, to the left of the path [m]
    "follow_position",  # of each follow point, to the left of the path [m]
]
_FROM_PATH: Final = ("axle_position", "follow_position")


def lateral_outputs(vehicle: Vehicle, s: State[ca.SX], u: Input[ca.SX], rate: State[ca.SX]) -> dict[str, Num]:
    """Every output by name; ``rate`` is the derivative of the state. The path is W's x axis."""
    psi, yaw_rate = ca.vertsplit(s.psi), ca.vertsplit(s.yaw_rate)
    e, speeds = axes(psi), Speeds(s.v_x, s.v_y, yaw_rate)
    rates = Speeds(rate.v_x, rate.v_y, ca.vertsplit(rate.yaw_rate))
    units = list(enumerate(vehicle.units))
    axle_places = [(i, axle.x) for i, unit in units for axle in unit.axles]
    transfer = ca.vertsplit(output(Chain.of(vehicle), s, u).lateral_load_transfer)

    def lateral_position(unit: int, x: float) -> ca.SX:
        return s.y + sum(length * ca.sin(psi[k]) for k, length in levers_to(vehicle, unit, x))

    def lateral_velocity(unit: int, x: float) -> Num:
        return along(e[unit], velocity(levers_to(vehicle, unit, x), e, speeds)).y

    def lateral_acceleration(unit: int, x: float) -> Num:
        return along(e[unit], acceleration(levers_to(vehicle, unit, x), e, speeds, rates)).y

    return {
        **{f"yaw_rate_{i}": r for i, r in enumerate(yaw_rate)},
        **{f"lateral_velocity_{i}": lateral_velocity(i, 0.0) for i, _ in units},
        **{f"lateral_acceleration_{i}": lateral_acceleration(i, unit.cg_x) for i, unit in units},
        **{f"articulation_{i}": ahead - own for i, (ahead, own) in enumerate(pairwise(psi), start=1)},
        **{f"load_transfer_{i}": t for i, t in enumerate(transfer)},
        **{f"axle_position_{k}": lateral_position(i, x) for k, (i, x) in enumerate(axle_places)},
        **{
            f"follow_position_{i}": lateral_position(i, unit.follow_x) for i, unit in units if unit.follow_x is not None
        },
    }


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
        return np.sort_complex(np.linalg.eigvals(self.A).astype(np.complex128))

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
        ValueError: if the speed cannot be held, or an output needs ``path``.
    """
    if not path and not set(outputs).isdisjoint(_FROM_PATH):
        raise ValueError(f"outputs {outputs}: those measured from a path need path=True")
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
    # Their first axles turn by the demand
    tractor = [1.0 / actuator.ratios[0] for actuator in vehicle.units[0].driver_actuators]
    return np.column_stack([directions[:, : len(tractor)] @ tractor, directions[:, len(tractor) :]])


@lru_cache(maxsize=8)
def _jacobians(vehicle: Vehicle) -> tuple[tuple[str, ...], Any]:
    """Names of all outputs; function (state, input) -> Jacobians of rate and outputs, by state and by input."""
    x, u = ca.SX.sym("x", sum(state_sizes(vehicle))), ca.SX.sym("u", sum(input_sizes(vehicle)))
    s, u_parts = State(*parts(x, state_sizes(vehicle))), Input(*parts(u, input_sizes(vehicle)))
    rate = derivative(Chain.of(vehicle), s, u_parts)
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
    # [m/s2], a first guess
    drag = GRAVITY * float(np.mean([wheel.axle.tyre.rolling_resistance for wheel in wheels(vehicle)]))
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
    s, u_parts = State(*parts(x, state_sizes(vehicle))), Input(*parts(u, input_sizes(vehicle)))
    rate = derivative(Chain.of(vehicle), s, u_parts)
    rates = ca.DM(np.stack([c.reading for c in resting])) @ ca.vertcat(*rate)
    return directions, ca.Function("balance", [x, u], [rates, ca.jacobian(rates, x) @ directions])
