"""Simplified vehicles and slow drives of the dynamic model, for comparison with theory."""

import math
from collections.abc import Callable, Sequence
from typing import Any, Final

import numpy as np

from controllers.driver import PERIOD, PreviewDriver
from controllers.path import Path
from scenarios.assembly.adapters import tractor_guided_at
from sensors.instruments.navigation import DriverPerception
from vehicle.clock import TICK, to_ticks
from vehicle.combination.description import Vehicle
from vehicle.combination.layout import State, parts, state_sizes, wheels
from vehicle.combination.plant import Plant, VehicleCommand
from vehicle.combination.truth import Truth
from vehicle.combination.unit import Axle, Unit
from vehicle.frames import FloatArray, Pose2
from vehicle.surface import Surface
from vehicle.tyres import Tyre
from vehicle.tyres.laws import LinearTyre

GRIP: Final = Surface(friction=1.5)  # the largest possible: slip should vanish
CREEP: Final = 0.25  # [m/s]; on stiff tyres slip angles are about 1e-6 rad, and grow with the square of speed
_CONTROL: Final = to_ticks(PERIOD, "control period")
_SPEED_GAIN: Final = 1.0  # acceleration demand per speed error [1/s]: aperiodic with any driveline's lag
_SPEED_INTEGRAL: Final = 0.2  # [1/s2]: aperiodic with the gain above
_SLOWING: Final = 5.0  # time to slow down [s]: several time constants of the speed control
_HELD: Final = 100  # control period of the speed [ticks]


def runge_kutta(rate: Callable[[float, Any], Any], t: float, x: Any, h: float) -> Any:
    """State after a step of h from x at t by the classical Runge-Kutta method; for numbers or symbols."""
    k_1 = rate(t, x)
    k_2 = rate(t + 0.5 * h, x + 0.5 * h * k_1)
    k_3 = rate(t + 0.5 * h, x + 0.5 * h * k_2)
    k_4 = rate(t + h, x + h * k_3)
    return x + h / 6.0 * (k_1 + 2.0 * k_2 + 2.0 * k_3 + k_4)


def poses_of(truths: list[Truth]) -> FloatArray:
    """x [m], y [m], psi [rad] of every unit over time, (n, N, 3)."""
    return np.array([now.poses for now in truths])


def along_path(
    vehicle: Vehicle, path: Path, reference: tuple[float, float], speed: float, *, plant: Plant | None = None
) -> list[Truth]:
    """Truth every 20 ms while the driver keeps a point of the tractor, in T [m], on the path to its end.

    The plant has friction ``GRIP`` by default.
    """
    driver = PreviewDriver(tractor_guided_at(vehicle, reference), path, speed)
    perception, memory, plant = DriverPerception(), driver.init(), plant or Plant(vehicle, GRIP)
    start = path.start @ Pose2(*reference, 0.0).inverse()
    state, idle = plant.initial_state(start, speed), (0.0,) * vehicle.n_by_law
    truths: list[Truth] = []
    while memory.station < path.length - 1e-6:
        truths.append(plant.observe(state, len(truths) * _CONTROL))
        memory, demand = driver.step(memory, truths[-1].tick, perception.sample(truths[-1]))
        state = plant.step(state, VehicleCommand(demand.steer, demand.acceleration, idle), _CONTROL)
    return truths


def round_circle(
    vehicle: Vehicle,
    radius: float,
    speed: float,
    distance: float,
    *,
    approach: float = 0.0,
    approach_speed_factor: float = 1.0,
    trailer_steer: tuple[float, ...] = (),
    surface: Surface = GRIP,
) -> list[Truth]:
    """Truth every 0.1 s over a ``distance`` [m] on a left-hand circle of the tractor's rear axle.

    The tractor starts on the circle, with the units behind it aligned with the hitch's velocity. The first ``approach``
    [m] are driven ``approach_speed_factor`` times as fast and are not returned.
    """
    plant = Plant(vehicle, surface)
    steer = math.atan(vehicle.units[0].steered_axles[0].x / radius)
    state = _on_circle(plant, vehicle, radius, approach_speed_factor * speed if approach else speed, steer)
    truths: list[Truth] = []
    travelled = -approach
    held = 0.0  # acceleration demand that works against scrubbing tyres, which hold up to their friction [m/s2]
    while travelled < distance:
        now = plant.observe(state, len(truths) * _HELD)
        if travelled >= 0.0:
            truths.append(now)
        v_x = now.velocities[0, 0]
        fast = approach_speed_factor * speed
        wanted = fast if travelled < -_SLOWING * fast else speed
        held += _SPEED_INTEGRAL * (wanted - v_x) * _HELD * TICK
        command = VehicleCommand(steer, _SPEED_GAIN * (wanted - v_x) + held, trailer_steer)
        state = plant.step(state, command, _HELD)
        travelled += v_x * _HELD * TICK
    return truths


def steered(vehicle: Vehicle, demand: Callable[[float], float], speed: float, duration: float) -> list[Truth]:
    """Truth every 20 ms under a steer demand [rad] over time [s], from straight running, on ``GRIP``."""
    plant = Plant(vehicle, GRIP)
    state, idle = plant.initial_state(Pose2(0.0, 0.0, 0.0), speed), (0.0,) * vehicle.n_by_law
    truths: list[Truth] = []
    for tick in range(0, round(duration / TICK) + 1, _CONTROL):
        truths.append(plant.observe(state, tick))
        acceleration = _SPEED_GAIN * (speed - truths[-1].velocities[0, 0])
        state = plant.step(state, VehicleCommand(demand(tick * TICK), acceleration, idle), _CONTROL)
    return truths


def _on_circle(plant: Plant, vehicle: Vehicle, radius: float, speed: float, steer: float) -> FloatArray:
    """State of a tractor that turns with its rear axle on the circle; the towed units do not turn yet."""
    s = State(*parts(plant.initial_state(Pose2(0.0, 0.0, 0.0), speed), state_sizes(vehicle)))
    towed = math.atan((vehicle.units[0].hitch_x or 0.0) / radius)
    hub = np.array([speed * (1.0 - (wheel.y / radius if wheel.unit == 0 else 0.0)) for wheel in wheels(vehicle)])
    radii = np.array([wheel.axle.wheel_radius for wheel in wheels(vehicle)])
    on_tractor = np.array([wheel.unit == 0 for wheel in wheels(vehicle)])
    ahead = np.where(on_tractor, [wheel.axle.x for wheel in wheels(vehicle)], 0.0) / radius * speed
    return np.concatenate(
        s._replace(
            psi=np.array([0.0, *[towed] * (len(vehicle.units) - 1)]),
            yaw_rate=np.array([speed / radius, *[0.0] * (len(vehicle.units) - 1)]),
            steer=np.array([steer, *[0.0] * (len(s.steer) - 1)]),
            omega=np.hypot(hub, ahead) / radii,
        )
    )


_STIFFEST: Final = 60.0  # slip stiffness over load [-]: ten times a truck tyre's, the largest valid value


def on_single_axles(vehicle: Vehicle) -> Vehicle:
    """Replace the unsteered axles of every unit by one in their middle, as in design vehicles and closed forms."""
    return vehicle.model_copy(update={"units": tuple(_on_single_axle(unit) for unit in vehicle.units)})


def gripping(vehicle: Vehicle) -> Vehicle:
    """Replace the tyres by ten times stiffer ones without rolling resistance, which hardly slip."""
    return with_each_tyre(vehicle, _stiff)


def tractor_and_trailer(
    vehicle: Vehicle,
    *,
    length: float,
    hitch_x: float,
    wheelbase: float | None = None,
    rear: float | None = None,
    follow: float | None = None,
    width: float | None = None,
) -> Vehicle:
    """First two units of a vehicle on single axles, with the trailer's axle ``length`` behind the hitch [m].

    Centres of gravity move with the axles. ``rear`` and ``follow`` are the distances of the body's end and the follow
    point behind the hitch [m]. Values that are not given are kept.
    """
    tractor, trailer = on_single_axles(vehicle).units[:2]
    front, *driven = tractor.axles
    if wheelbase is not None:
        moved = wheelbase - front.x
        cg_x = tractor.cg_x * wheelbase / front.x
        tractor = tractor.model_copy(update={"front_x": tractor.front_x + moved, "cg_x": cg_x})
        front = front.model_copy(update={"x": wheelbase})
    tractor = tractor.model_copy(update={"hitch_x": hitch_x, "axles": (front, *driven)})
    trailer = trailer.model_copy(
        update={
            "axles": (trailer.axles[0].model_copy(update={"x": -length}),),
            "cg_x": trailer.cg_x * -length / trailer.axles[0].x,
            "rear_x": trailer.rear_x if rear is None else -rear,
            "follow_x": trailer.follow_x if follow is None else -follow,
            "width": trailer.width if width is None else width,
        }
    )
    return vehicle.model_copy(update={"units": (tractor, trailer)})


def with_steered_trailer(vehicle: Vehicle, distances: Sequence[float], follow: float) -> Vehicle:
    """Steer all axles of the trailer, ``distances`` behind the hitch; the follow point is ``follow`` behind it [m].

    The wheels' axes meet abreast of the point halfway to the follow point: the turning centre of path following.
    """
    tractor, trailer = vehicle.units[:2]
    axle = trailer.axles[-1].model_copy(update={"steered": True, "steer_group": None, "ackermann_x": -0.5 * follow})
    axles = tuple(axle.model_copy(update={"x": -distance}) for distance in distances)
    trailer = trailer.model_copy(update={"axles": axles, "follow_x": -follow})
    return vehicle.model_copy(update={"units": (tractor, trailer)})


def _on_single_axle(unit: Unit) -> Unit:
    fixed = [axle for axle in unit.axles if not axle.steered]
    axles = [axle for axle in unit.axles if axle.steered] + ([_merged(fixed)] if fixed else [])
    return unit.model_copy(update={"axles": tuple(sorted(axles, key=lambda axle: -axle.x)), "lifted_axles": ()})


def _merged(axles: Sequence[Axle]) -> Axle:
    """One axle in the middle of several, which carries their total load."""
    n = len(axles)
    middle = axles[n // 2]
    return middle.model_copy(
        update={
            "x": float(np.mean([axle.x for axle in axles])),
            "driven": any(axle.driven for axle in axles),
            "wheel_inertia": sum(axle.wheel_inertia for axle in axles),
            "tyre": middle.tyre.model_copy(update={"nominal_load": sum(axle.tyre.nominal_load for axle in axles)}),
            "bogie": None,
            "load_share": 1.0,
        }
    )


def _stiff(axle: Axle) -> LinearTyre:
    tyre = axle.tyre
    return linear_tyre(_STIFFEST, tyre.nominal_load, relaxation_length=tyre.relaxation_length, damping=tyre.damping)


def linear_tyre(stiffness: float, load: float, *, relaxation_length: float, damping: float) -> LinearTyre:
    """A linear tyre with a slip stiffness over load [-], without rolling resistance and pneumatic trail."""
    return LinearTyre(
        model="linear",
        cornering_stiffness=stiffness,
        longitudinal_stiffness=stiffness,
        nominal_load=load,
        load_sensitivity=0.0,
        relaxation_length=relaxation_length,
        damping=damping,
        rolling_resistance=0.0,
        pneumatic_trail=0.0,
    )


def with_each_tyre(vehicle: Vehicle, tyre: Callable[[Axle], Tyre]) -> Vehicle:
    """The vehicle with another tyre on every axle."""
    units = tuple(with_tyres(unit, [tyre(axle) for axle in unit.axles]) for unit in vehicle.units)
    return vehicle.model_copy(update={"units": units})


def with_tyres(unit: Unit, tyres: Sequence[Tyre]) -> Unit:
    """The unit with these tyres on its axles, front to rear."""
    axles: tuple[Axle, ...] = tuple(
        axle.model_copy(update={"tyre": tyre}) for axle, tyre in zip(unit.axles, tyres, strict=True)
    )
    return unit.model_copy(update={"axles": axles})
