"""Checks of the equations of motion and of their integration.

The equations of Newton and Euler hold for each body, with the hitch forces as unknowns. They use axes of W and numpy,
and share only the data with the model: masses, inertias and positions. Whatever has the same accelerations in all
states and under all forces has the same energy and momenta.

Integration: the order of the method, difficult cases at the default step, and the effect of half the step.
"""

import math
from functools import lru_cache
from typing import Any, Final, NamedTuple

import casadi as ca
import numpy as np

from offtrack.studies.validation.check import Check, CheckSection, Plot, Series
from offtrack.studies.validation.simple_drives import along_path, poses_of
from offtrack.studies.validation.stopping_checks import without_abs
from scenarios import courses
from scenarios.assembly.adapters import outlines
from scenarios.results.metrics import rms, true_off_tracking
from scenarios.results.swept_path import swept_path
from vehicle.clock import TICK
from vehicle.combination.chain import output
from vehicle.combination.description import Vehicle, load_vehicle
from vehicle.combination.functions import compiled, step_in_calls
from vehicle.combination.layout import Input, Output, State, input_sizes, output_sizes, parts, state_sizes
from vehicle.combination.multibody import Speeds, Vector, speed_rates
from vehicle.combination.plant import Plant, VehicleCommand
from vehicle.combination.unit import Unit
from vehicle.frames import FloatArray, Pose2
from vehicle.surface import Surface


class ChainMotion(NamedTuple):
    """State of motion of a chain, along W."""

    psi: FloatArray  # (N,) yaw of each unit [rad]
    velocity: FloatArray  # (2,) of the first unit's origin [m/s]
    yaw_rate: FloatArray  # (N,) [rad/s]


class ChainAccelerations(NamedTuple):
    """Accelerations of a chain, along W."""

    origin: FloatArray  # (2,) of the first unit's origin [m/s2]
    yaw: FloatArray  # (N,) [rad/s2]


def modelled(vehicle: Vehicle, now: ChainMotion, forces: FloatArray, moments: FloatArray) -> ChainAccelerations:
    """Accelerations as from ``newton_euler``, by the model, with vectors rotated between W and the tractor's axes."""
    c, s = math.cos(now.psi[0]), math.sin(now.psi[0])
    R_WT = np.array([[c, -s], [s, c]])
    v_x, v_y = (R_WT.T @ now.velocity).tolist()
    on_units = [Vector(*(R_WT.T @ force).tolist()) for force in forces]
    speeds = Speeds(v_x, v_y, now.yaw_rate.tolist())
    rates = speed_rates(vehicle, now.psi.tolist(), speeds, on_units, moments.tolist())
    turning = now.yaw_rate[0] * np.array([-v_y, v_x])  # due to the rotation of the tractor's axes
    return ChainAccelerations(R_WT @ (np.array([rates.v_x, rates.v_y]) + turning), np.array(rates.yaw_rate))


def newton_euler(
    vehicle: Vehicle, now: ChainMotion, forces: FloatArray, moments: FloatArray
) -> tuple[ChainAccelerations, FloatArray]:
    """Accelerations, and the force (N - 1, 2) at each hitch on the unit behind it [N, along W].

    Forces (N, 2) act at, and moments (N,) about, the centres of gravity [N, N m, along W]. Unknowns are the
    acceleration of every centre of gravity, every yaw acceleration, and the hitch forces H: m a = F + H ahead - H
    behind, I psi'' = M + moments of both, and at each hitch both units accelerate alike.
    """
    units, N = vehicle.units, len(vehicle.units)
    c, s = np.cos(now.psi), np.sin(now.psi)
    e, n = np.column_stack([c, s]), np.column_stack([-s, c])  # along and across each unit
    yaw, hitch, size = 2 * N, 3 * N, 3 * N + 2 * (N - 1)
    K: FloatArray = np.zeros((size, size))
    b: FloatArray = np.zeros(size)
    for i, unit in enumerate(units):
        row = slice(2 * i, 2 * i + 2)
        K[row, row] = unit.mass * np.eye(2)
        K[yaw + i, yaw + i] = unit.yaw_inertia
        b[row], b[yaw + i] = forces[i], moments[i]
    for k in range(N - 1):
        H = slice(hitch + 2 * k, hitch + 2 * k + 2)
        arms = (k, (units[k].hitch_x or 0.0) - units[k].cg_x, +1.0), (k + 1, -units[k + 1].cg_x, -1.0)
        for i, arm, side in arms:  # the hitch force acts backwards on the unit ahead, forwards on the one behind
            row = slice(2 * i, 2 * i + 2)
            K[row, H] += side * np.eye(2)
            K[yaw + i, H] += side * arm * n[i]
            K[H, row] += side * np.eye(2)
            K[H, yaw + i] += side * arm * n[i]
            b[H] += side * arm * now.yaw_rate[i] ** 2 * e[i]
    solution = np.linalg.solve(K, b).astype(np.float64)
    spin, turn = solution[yaw], now.yaw_rate[0]
    origin = solution[:2] - units[0].cg_x * (spin * n[0] - turn**2 * e[0])
    return ChainAccelerations(origin, solution[yaw:hitch]), solution[hitch:].reshape(N - 1, 2)


_STATES: Final = 200  # random states per chain
_RANGES: Final = State(  # half ranges of random states, wider than in any drive
    x=50.0,
    y=50.0,
    psi=3.0,
    v_x=25.0,
    v_y=5.0,
    yaw_rate=1.0,
    heave=0.1,
    pitch=0.1,
    roll=0.2,
    heave_spring=0.5,
    pitch_spring=0.5,
    roll_spring=0.5,
    load_shift=1e4,
    side_force=5e4,
    hitch_x=5e4,
    hitch_y=5e4,
    omega=60.0,
    deflection_x=0.3,
    deflection_y=0.3,
    brake_windup=1.0,
    twin_x=0.3,
    twin_y=0.3,
    steer=0.6,
    acceleration=5.0,
    brake_pressure=1.0,
    brake_valve=1.0,
)


def mechanics(quick: bool) -> CheckSection:
    """Accelerations against those of free bodies, and tyre forces against the friction circle."""
    chains = [_chain(n) for n in (1, 2, 3, 4)]
    return CheckSection(
        title="Mechanics",
        text="Accelerations of chains of random data in random states are compared with the equations of Newton and "
        "Euler for each body, and tyre forces with the friction limit.",
        checks=(*map(_derivation, chains), _friction_circle(chains[-1], 2_000 if quick else 20_000)),
    )


def _chain(n: int) -> Vehicle:
    """Tractor and n - 1 semi-trailers, all but the last with a hitch above its axles, as in a B-double."""
    vehicle = load_vehicle("eu_tractor_semitrailer")
    tractor, trailer = vehicle.units
    lead = trailer.model_copy(update={"hitch_x": -7.4, "hitch_height": 1.15})
    return vehicle.model_copy(update={"units": (tractor, *[lead] * (n - 2), trailer)[:n]})


def _derivation(vehicle: Vehicle) -> Check:
    """Largest difference from the accelerations of Newton and Euler, over the largest acceleration."""
    rng = np.random.default_rng(1)
    return Check(
        f"N = {len(vehicle.units)}, {_STATES} random chains and states: accelerations, relative",
        max(_difference(vehicle, rng) for _ in range(_STATES)),
        tolerance=1e-9,
        source="equations of Newton and Euler for each body, with the hitch forces as unknowns",
    )


def _difference(vehicle: Vehicle, rng: np.random.Generator) -> float:
    """Relative difference of a chain of random masses, inertias and places, from a cart to a laden road train."""
    n = len(vehicle.units)
    vehicle = vehicle.model_copy(update={"units": tuple(_random_unit(unit, rng) for unit in vehicle.units)})
    now = ChainMotion(rng.uniform(-np.pi, np.pi, n), rng.uniform(-10.0, 10.0, 2), rng.uniform(-1.0, 1.0, n))
    forces, moments = rng.uniform(-1e5, 1e5, (n, 2)), rng.uniform(-1e5, 1e5, n)
    model = np.concatenate(modelled(vehicle, now, forces, moments))
    others = np.concatenate(newton_euler(vehicle, now, forces, moments)[0])
    return float(np.abs(model - others).max() / np.abs(model).max())


def _random_unit(unit: Unit, rng: np.random.Generator) -> Unit:
    ranges = {"mass": (500.0, 4e4), "yaw_inertia": (500.0, 5e5), "cg_x": (-8.0, 3.0), "hitch_x": (-12.0, 2.0)}
    return unit.model_copy(update={name: rng.uniform(*limits) for name, limits in ranges.items()})


def _friction_circle(vehicle: Vehicle, count: int) -> Check:
    """Largest excess of a wheel's horizontal force over friction times load, in random states."""
    rng = np.random.default_rng(1)
    outputs = np.array(
        compiled(output, vehicle).map(count)(random_states(vehicle, rng, count), random_inputs(vehicle, rng, count))
    )
    used = Output(*parts(outputs, output_sizes(vehicle))).friction_used
    return Check(
        f"{vehicle.n_wheels} wheels in {count} random states: horizontal force beyond friction times load",
        max(0.0, float(used.max()) - 1.0),
        tolerance=1e-12,
        source="Coulomb's law; tolerance: rounding",
    )


def random_states(vehicle: Vehicle, rng: np.random.Generator, count: int) -> FloatArray:
    """State vectors in columns, (n_state, count), wilder than in any drive."""
    sizes = state_sizes(vehicle)
    return np.concatenate([a * rng.uniform(-1.0, 1.0, (n, count)) for a, n in zip(_RANGES, sizes, strict=True)])


def random_inputs(vehicle: Vehicle, rng: np.random.Generator, count: int) -> FloatArray:
    """Inputs of the chain in columns, (n_input, count)."""
    sizes = input_sizes(vehicle)
    drawn = Input(
        steer=rng.uniform(-0.6, 0.6, (sizes.steer, count)),
        acceleration=rng.uniform(-6.0, 2.0, (1, count)),
        gear=np.where(np.arange(count) % 2, -1.0, 1.0)[None, :],
        friction=rng.uniform(0.05, 1.2, (sizes.friction, count)),
        gravity_x=rng.uniform(-1.0, 1.0, (sizes.gravity_x, count)),
        gravity_y=rng.uniform(-1.0, 1.0, (sizes.gravity_y, count)),
        road=rng.uniform(-0.05, 0.05, (sizes.road, count)),
        wind=rng.uniform(-20.0, 20.0, (sizes.wind, count)),
        drive_torque=rng.uniform(-5e3, 5e3, (sizes.drive_torque, count)),
        brake_torque=rng.uniform(0.0, 1e4, (sizes.brake_torque, count)),
        brake_share=rng.uniform(0.0, 1.0, (sizes.brake_share, count)),
    )
    return np.concatenate(drawn)


_STEPS: Final = (8e-3, 4e-3, 2e-3, 1e-3, 0.5e-3)  # [s]
_FINE: Final = 0.0625e-3  # [s]; its error is 1/64 of the smallest of these
_FINER: Final = 0.25e-3  # [s]; its error is 1/16 of the default's
_ORIGIN: Final = Pose2(0.0, 0.0, 0.0)
_ROUNDABOUT_SPEED: Final = 15.0 / 3.6  # [m/s]
_METHOD: Final = "order of the Rosenbrock method, whatever its approximation of the Jacobian"


class OtherStepPlant(Plant):
    """A plant on level ground of uniform friction with an integration step of ``step`` [s]."""

    def __init__(self, vehicle: Vehicle, friction: float, step: float) -> None:
        super().__init__(vehicle, Surface(friction=friction))
        self._driven, self._friction, self._length = vehicle, friction, step

    def step(self, state: FloatArray, command: VehicleCommand, ticks: int) -> FloatArray:
        """State after whole ticks under a held command; no unit's axles may share an actuator."""
        u = self._input(command)
        steps = _step(self._driven).fold(round(ticks * TICK / self._length))
        return np.array(steps(state, u, self._length)).ravel()

    def _input(self, command: VehicleCommand) -> FloatArray:
        sizes = input_sizes(self._driven)
        on_tractor = sizes.steer - len(command.trailer_steer)
        u = Input(*(np.zeros(size) for size in sizes))._replace(
            steer=np.array([*[command.steer] * on_tractor, *command.trailer_steer]),
            acceleration=np.array([command.acceleration]),
            gear=np.array([command.gear]),
            friction=np.full(sizes.friction, self._friction),
        )
        return np.concatenate(u)


def integration(quick: bool) -> CheckSection:
    """Order, hill hold, wheelspin, a stop on ice, and the roundabout at half the step."""
    vehicle = load_vehicle("eu_tractor_semitrailer")
    frictions = (0.8,) if quick else (0.8, 0.1)
    errors = {friction: _errors(without_abs(vehicle), friction) for friction in frictions}
    dry, steps = errors[0.8], np.array(_STEPS)
    halved = () if quick else _half_step(load_vehicle("uk_longer_semitrailer"))
    return CheckSection(
        title="Integrator",
        text="Braking into a turn with several step sizes. Hill hold, spinning wheels and locked wheels with the "
        "default step of 1 ms. The metrics of a closed-loop roundabout with half of that step.",
        checks=(
            *(check for friction, of_steps in errors.items() for check in _order(friction, of_steps)),
            *_difficult_cases(vehicle),
            *halved,
        ),
        plots=(
            Plot(
                title="Position error after 2 s of braking into a turn from 15 m/s",
                x_label="step [ms]",
                y_label="error [m]",
                series=(
                    Series("model", 1e3 * steps, dry, "model points"),
                    Series("square of the step", 1e3 * steps, dry[-1] * (steps / steps[-1]) ** 2, "reference"),
                ),
                logarithmic=True,
            ),
        ),
    )


def _errors(vehicle: Vehicle, friction: float) -> FloatArray:
    """Position error [m] for each step size."""
    command = VehicleCommand(0.03, -1.5, ())
    exact = _end(vehicle, friction, 15.0, command, 2.0, _FINE)
    return np.array([_distance(_end(vehicle, friction, 15.0, command, 2.0, step), exact) for step in _STEPS])


def _order(friction: float, errors: FloatArray) -> tuple[Check, ...]:
    return (
        Check(
            f"braking into a turn, friction {friction:g}: order of the position error, from 1 ms to 0.5 ms",
            float(np.diff(np.log(errors[-2:]))[0] / np.diff(np.log(_STEPS[-2:]))[0]),
            target=2.0,
            tolerance=0.1,
            source=_METHOD,
        ),
        Check(
            f"braking into a turn, friction {friction:g}: position error at 1 ms",
            1e3 * float(errors[_STEPS.index(TICK)]),
            "mm",
            tolerance=1.0,
            source="the same at a sixteenth of the step; a tenth of what a reference GNSS unit could tell",
        ),
    )


def _end(
    vehicle: Vehicle, friction: float, speed: float, command: VehicleCommand, duration: float, step: float
) -> FloatArray:
    """Poses (N, 3) after a duration [s] under one command."""
    plant = OtherStepPlant(vehicle, friction, step)
    state = plant.step(plant.initial_state(_ORIGIN, speed), command, round(duration / TICK))
    return plant.observe(state, 0).poses


def _distance(poses: FloatArray, others: FloatArray) -> float:
    """Largest distance between corresponding origins of units [m]."""
    return float(np.hypot(*(poses - others)[:, :2].T).max())


def _difficult_cases(vehicle: Vehicle) -> tuple[Check, ...]:
    spinning = _default_error(vehicle, 0.0, VehicleCommand(0.02, 1.5, ()), 4.0)
    stopping = _default_error(without_abs(vehicle), 8.0, VehicleCommand(0.02, -4.0, ()), 12.0)
    quarter = "the same at a quarter of the step"
    rows = (
        ("held by its brakes on a 5 % hill: creep", _creep(vehicle), "mm/s", 1.0, "brakes hold"),
        ("4 s of wheelspin on friction 0.1: position error", spinning, "mm", 5.0, quarter),
        ("8 m/s braked to a stop on friction 0.1, wheels locked: position error", stopping, "mm", 10.0, quarter),
    )
    return tuple(Check(name, 1e3 * value, unit, tolerance=t, source=source) for name, value, unit, t, source in rows)


def _default_error(vehicle: Vehicle, speed: float, command: VehicleCommand, duration: float) -> float:
    """Position error [m] on ice with the default step."""
    plant = Plant(vehicle, Surface(friction=0.1))
    state = plant.step(plant.initial_state(_ORIGIN, speed), command, round(duration / TICK))
    return _distance(plant.observe(state, 0).poses, _end(vehicle, 0.1, speed, command, duration, _FINER))


def _creep(vehicle: Vehicle) -> float:
    """Mean creep speed [m/s] of a combination braked to a stop on a hill, over 10 s after its rocking has decayed."""
    plant = Plant(vehicle, Surface(friction=0.8, grade=0.05))
    braking = VehicleCommand(0.02, -2.0, ())
    at_rest = plant.step(plant.initial_state(_ORIGIN, 8.0), braking, 10_000)
    later = plant.step(at_rest, braking, 10_000)
    return _distance(plant.observe(later, 0).poses, plant.observe(at_rest, 0).poses) / (10_000 * TICK)


def _half_step(vehicle: Vehicle) -> tuple[Check, ...]:
    """Relative change of the roundabout's metrics when the step is halved."""
    course = courses.roundabout(front_x=vehicle.units[0].front_x, width=vehicle.units[0].width)
    metrics = []
    for step in (TICK, 0.5 * TICK):
        plant = OtherStepPlant(vehicle, 0.8, step)
        poses = poses_of(along_path(vehicle, course.path, course.reference, _ROUNDABOUT_SPEED, plant=plant))
        metrics.append(_metrics(vehicle, poses, course.surface_centre))
    whole, half = metrics
    return tuple(
        Check(
            f"roundabout at 15 km/h, step halved: change of {name}",
            100.0 * (half[name] / whole[name] - 1.0),
            "%",
            tolerance=1.0,
            source="the same run at half the step",
        )
        for name in whole
    )


def _metrics(vehicle: Vehicle, poses: FloatArray, centre: tuple[float, float] | None) -> dict[str, float]:
    swept = swept_path(outlines(vehicle), tuple(np.moveaxis(poses, 1, 0)), centre)
    trailer = vehicle.units[1]
    x, y, psi = poses[:, 1].T
    off_tracking = true_off_tracking(x, y, psi, -(trailer.follow_x or trailer.rear_x))
    return {
        "the swept width": swept.max_width,
        "the inner radius": swept.min_inner_radius,
        "the tail swing": swept.tail_swing,
        "the off-tracking, RMS": rms(off_tracking),
        "the off-tracking, largest": float(np.nanmax(np.abs(off_tracking))),
    }


@lru_cache(maxsize=8)
def _step(vehicle: Vehicle) -> Any:
    """Function (state, chain's input, length of the step [s]) -> state after a step."""
    x, v = ca.SX.sym("x", sum(state_sizes(vehicle))), ca.SX.sym("v", sum(input_sizes(vehicle)) + 1)
    u, none = Input(*parts(v[:-1], input_sizes(vehicle))), ca.SX(0, 1)
    later = step_in_calls(vehicle, x, v, u, none, timed=True).on(x, v, none)
    return ca.Function("step", [x, v[:-1], v[-1]], [ca.cse(later)])
