"""Checks of the integrator: its order, difficult cases at the default step, and the effect of half the step."""

from __future__ import annotations

from functools import lru_cache
from typing import Any, Final

import casadi as ca
import numpy as np

from offtrack.studies.validation.check import Check, CheckSection, Plot, Series
from offtrack.studies.validation.simple_drives import along_path, poses_of
from scenarios import courses
from scenarios.assembly.adapters import outlines
from scenarios.results.metrics import rms, true_off_tracking
from scenarios.results.swept_path import swept_path
from vehicle.clock import TICK
from vehicle.combination.chain import derivative, relaxation
from vehicle.combination.description import Vehicle, load_vehicle
from vehicle.combination.functions import sampled_states
from vehicle.combination.layout import Chain, Input, State, input_sizes, parts, state_sizes
from vehicle.combination.plant import Plant, VehicleCommand
from vehicle.engine.integrator import semi_implicit_step
from vehicle.frames import FloatArray, Pose2
from vehicle.surface import Surface

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
    errors = {friction: _errors(_without_sampled_brakes(vehicle), friction) for friction in frictions}
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


def _without_sampled_brakes(vehicle: Vehicle) -> Vehicle:
    """The vehicle with brakes that follow the demand: pressures and ABS are sampled at the moments of the steps."""
    return vehicle.model_copy(update={"brakes": None})


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
    stopping = _default_error(_without_sampled_brakes(vehicle), 8.0, VehicleCommand(0.02, -4.0, ()), 12.0)
    return (
        Check(
            "held by its brakes on a 5 % hill: creep",
            1e3 * _creep(vehicle),
            "mm/s",
            tolerance=1.0,
            source="brakes hold",
        ),
        Check(
            "4 s of wheelspin on friction 0.1: position error",
            1e3 * spinning,
            "mm",
            tolerance=5.0,
            source="the same at a quarter of the step",
        ),
        Check(
            "8 m/s braked to a stop on friction 0.1, wheels locked: position error",
            1e3 * stopping,
            "mm",
            tolerance=10.0,
            source="the same at a quarter of the step",
        ),
    )


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
    chain, step = Chain.of(vehicle), ca.SX.sym("step")
    x, u = ca.SX.sym("x", sum(state_sizes(vehicle))), ca.SX.sym("u", sum(input_sizes(vehicle)))

    def rate(state: ca.SX) -> ca.SX:
        return ca.cse(ca.vertcat(*derivative(chain, *_named(vehicle, state, u))))

    stiff = ca.vertcat(*relaxation(chain, *_named(vehicle, x, u)))
    later = semi_implicit_step(rate, x, step, stiff, sampled_states(vehicle))
    return ca.Function("step", [x, u, step], [ca.cse(later)])


def _named(vehicle: Vehicle, x: ca.SX, u: ca.SX) -> tuple[State[ca.SX], Input[ca.SX]]:
    return State(*parts(x, state_sizes(vehicle))), Input(*parts(u, input_sizes(vehicle)))
