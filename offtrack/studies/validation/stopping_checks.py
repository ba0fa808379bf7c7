"""Checks of brakes and drive: stopping, slip under ABS, folding without it, climbing, and standing where parked."""

import math
from typing import Final, NamedTuple

import numpy as np

from offtrack.studies.standards.braking_and_drive import longitudinal, longitudinal_theory
from offtrack.studies.validation.check import Check, CheckSection, Plot, Series
from vehicle.clock import TICK
from vehicle.combination.description import GRAVITY, Vehicle, load_vehicle, vehicle_names
from vehicle.combination.layout import State, parts, state_sizes, wheels
from vehicle.combination.plant import Plant, VehicleCommand
from vehicle.frames import FloatArray, Pose2
from vehicle.surface import SplitFriction, Surface
from vehicle.tyres import Planar

PERIOD: Final = 10  # of the rows [ticks]
ROW: Final = 0.01  # [s]
_STANDS: Final = 0.05  # [m/s]


class BrakedStop(NamedTuple):
    """A drive under one brake demand, a row every 10 ms."""

    speed: FloatArray  # (n,) [m/s]
    distance: FloatArray  # (n,) [m]
    tread: FloatArray  # (n, n_wheels) speed of every tread [m/s]
    pressure: FloatArray  # (n, n_channels) [-]
    articulation: FloatArray  # (n, N - 1) [rad]
    lateral: FloatArray  # (n,) [m]

    def slips(self, above: float, after: float = 1.0) -> FloatArray:
        """Slips [-], (n, n_wheels), at speeds above a bound [m/s] and ``after`` some seconds."""
        rows = (self.speed > above) & (np.arange(len(self.speed)) * ROW > after)
        slips: FloatArray = 1.0 - self.tread[rows] / self.speed[rows, None]
        return slips

    def deceleration(self, fast: float, slow: float) -> float:
        """Mean deceleration [m/s2] between two speeds [m/s]."""
        first, last = (int(np.argmax(self.speed < bound)) for bound in (fast, slow))
        return float(self.speed[first] - self.speed[last]) / (ROW * (last - first))


def braked(
    vehicle: Vehicle, surface: Surface, speed: float, demand: float, *, steer: float = 0.0, seconds: float = 30.0
) -> BrakedStop:
    """Brake from ``speed`` [m/s] with ``demand`` [m/s2] until it stands, under a fixed steering wheel."""
    plant, layout = Plant(vehicle, surface), wheels(vehicle)
    radii = np.array([wheel.axle.wheel_radius for wheel in layout])
    command = VehicleCommand(steer, -demand, (0.0,) * vehicle.n_by_law)
    state, rows = plant.initial_state(Pose2(0.0, 0.0, 0.0), speed), []
    for _ in range(round(seconds / ROW)):
        s = State(*parts(state, state_sizes(vehicle)))
        rows.append((s.v_x[0], s.x[0], s.omega * radii, s.brake_pressure, s.psi[:-1] - s.psi[1:], s.y[0]))
        if s.v_x[0] < _STANDS:
            break
        state = plant.step(state, command, PERIOD)
    return BrakedStop(*(np.array(column) for column in zip(*rows, strict=True)))


def without_abs(vehicle: Vehicle) -> Vehicle:
    """The vehicle with its ABS switched off."""
    if vehicle.brakes is None:
        return vehicle
    return vehicle.model_copy(update={"brakes": vehicle.brakes.model_copy(update={"abs": False})})


_SPEED: Final = 80.0 / 3.6  # [m/s]
_SLOW: Final = 5.0  # slips are evaluated above it [m/s]
_FULL: Final = 9.0  # demand of a full brake application [m/s2]
_FRICTIONS: Final = (0.8, 0.3, 0.1)
_USED: Final = {0.3: (0.95, 1.03), 0.1: (0.92, 1.03)}  # of the friction by ABS; rolling resistance adds 0.006 g
_TURNS: Final = {  # friction and speed [m/s], lateral acceleration [m/s2] of turns
    "on snow": (0.3, 60.0 / 3.6, 1.5),
    "on a dry road": (0.8, 22.0, 2.0),
}


def braking(quick: bool) -> CheckSection:
    """Stops with and without ABS, straight, on split friction and in a turn; climbing and holding."""
    vehicle = load_vehicle("eu_tractor_semitrailer").model_copy(update={"air": None})
    stops = {friction: braked(vehicle, Surface(friction=friction), _SPEED, _FULL) for friction in _FRICTIONS}
    names = (
        ("eu_tractor_semitrailer", "rigid_truck") if quick else ("eu_tractor_semitrailer", "a_double", "rigid_truck")
    )
    return CheckSection(
        title="Brakes and drive",
        text="Full brake applications from 80 km/h with ABS, without it, on split friction, and in turns with a fixed "
        "steering wheel. Grades, speeds and times that the simulation reaches, against quasi-static forces.",
        checks=(
            *(_locked(vehicle, friction) for friction in _USED),
            *(_distance(vehicle, friction, stop) for friction, stop in stops.items()),
            *(_friction_used(friction, stops[friction]) for friction in _USED),
            *(_slip_band(vehicle, f"friction {friction:g}", stop) for friction, stop in stops.items()),
            _slip_band(vehicle, "friction 0.8 left, 0.2 right", _split(vehicle)),
            *(check for turn in _TURNS for check in _folding(vehicle, turn)),
            *(check for name in names for check in _capability(load_vehicle(name))),
        ),
        plots=(_plot(stops[0.3]),),
    )


def _locked(vehicle: Vehicle, friction: float) -> Check:
    stop = braked(without_abs(vehicle), Surface(friction=friction), _SPEED, _FULL)
    tyre, load = vehicle.units[0].axles[0].tyre, vehicle.units[0].axles[0].tyre.nominal_load
    force = float(tyre.steady_force(Planar(-1.0, 0.0), load, friction).x)
    return Check(
        f"all wheels locked at friction {friction:g}: deceleration over friction times g",
        stop.deceleration(18.0, 6.0) / (friction * GRAVITY),
        target=-force / (friction * load),
        tolerance=0.01,
        source="the tyre law's force at a slip of 1, over friction times load",
    )


def _distance(vehicle: Vehicle, friction: float, stop: BrakedStop) -> Check:
    """Distance against that at the largest deceleration once both lags and the filling are over."""
    system, brake = vehicle.brakes, vehicle.units[0].axles[0].brake
    lags = 0.0 if system is None or brake is None else system.lag + brake.lag
    ideal = _SPEED * lags + _SPEED**2 / (2.0 * friction * GRAVITY)
    return Check(
        f"stop from 80 km/h with ABS at friction {friction:g}: distance over v t + v^2 / (2 mu g)",
        float(stop.distance[-1]) / ideal,
        target=1.0,
        tolerance=0.25 if friction > 0.5 else 0.1,
        source="constant deceleration of mu g behind the lags t of pedal and chambers; ABS uses 0.75 or more of the "
        "friction (UN R13, annex 13, from memory), on dry road the drive axle's torque ends it",
    )


def _friction_used(friction: float, stop: BrakedStop) -> Check:
    least, most = _USED[friction]
    return Check(
        f"ABS, friction {friction:g}: mean deceleration over friction times g",
        stop.deceleration(18.0, _SLOW) / (friction * GRAVITY),
        target=0.5 * (least + most),
        tolerance=0.5 * (most - least),
        source="ABS uses nearly all friction; the rest is lost in ups and downs of the slip",
    )


def _slip_band(vehicle: Vehicle, name: str, stop: BrakedStop) -> Check:
    system = vehicle.brakes
    limit = 0.0 if system is None else system.abs_slip + system.abs_slip_speed / _SLOW
    return Check(
        f"ABS, {name}: largest slip of any wheel above 18 km/h",
        float(stop.slips(above=_SLOW, after=0.8).max()),
        target=0.5 * limit,
        tolerance=0.75 * limit,
        source="the modulators' limit at this speed, and a quarter more for valves and air",
    )


def _split(vehicle: Vehicle) -> BrakedStop:
    """The first second and a half, before the steering wheel would have to turn."""
    line = np.array([[0.0, 0.0], [1.0, 0.0]])
    split = Surface(friction=SplitFriction(left=0.8, right=0.2, line=line))
    return braked(vehicle, split, _SPEED, _FULL, seconds=1.3)


def _folding(vehicle: Vehicle, turn: str) -> tuple[Check, ...]:
    """Largest articulation in a turn under a fixed steering wheel."""
    friction, speed, acceleration = _TURNS[turn]
    steer = vehicle.units[0].steered_axles[0].x * acceleration / speed**2
    surface = Surface(friction=friction)
    stops = [braked(v, surface, speed, _FULL, steer=steer) for v in (vehicle, without_abs(vehicle))]
    angles = [math.degrees(float(np.abs(stop.articulation).max())) for stop in stops]
    return (
        Check(
            f"full braking in a turn {turn} with ABS: largest articulation",
            angles[0],
            "deg",
            tolerance=20.0,
            source="it does not fold",
        ),
        Check(
            f"the same without ABS {turn}",
            angles[1],
            "deg",
            target=30.0,
            tolerance=20.0,
            source="locked wheels have no side force: it folds until it stands",
        ),
    )


def _capability(vehicle: Vehicle) -> tuple[Check, ...]:
    simulated, computed = longitudinal(vehicle).figures, longitudinal_theory(vehicle)
    return tuple(
        Check(
            f"{vehicle.name}: {name.removesuffix('_m_s').replace('_', ' ')}, simulated over computed",
            simulated[name] / value,
            target=1.0,
            tolerance=0.025,
            source="quasi-static forces from the vehicle's data, without slip and driveline lag",
        )
        for name, value in computed.items()
    )


def _plot(stop: BrakedStop) -> Plot:
    time: FloatArray = ROW * np.arange(len(stop.speed), dtype=np.float64)
    return Plot(
        title="Stop with ABS at friction 0.3",
        x_label="time [s]",
        y_label="speed [m/s]",
        series=(
            Series("vehicle", time, stop.speed, "reference"),
            Series("tread of a driven wheel", time, stop.tread[:, 2], "model"),
            Series("tread of a trailer wheel", time, stop.tread[:, 4], "faint"),
        ),
    )


_SLOPE: Final = 0.1  # [-]
_FRICTION: Final = 0.8  # dry road
_BRAKES: Final = -3.0  # demanded: three times what the slope needs [m/s2]
_SETTLING: Final = 5.0  # time in which tyres and bodies take up the slope [s]
_PARKED: Final = 600.0  # [s]
_PLACES: Final = {"on cross-fall": (0.0, _SLOPE), "up-hill": (_SLOPE, 0.0), "down-hill": (-_SLOPE, 0.0)}


def parking(quick: bool) -> CheckSection:
    """Creep of parked vehicles in ten minutes, and the rest after braking to a stop on a hill."""
    names = ("rigid_truck",) if quick else vehicle_names()
    return CheckSection(
        title="Parking",
        text=f"Brakes on, slope of {100 * _SLOPE:g} %, friction {_FRICTION:g}. Tyres deflect within "
        f"{_SETTLING:g} s; from then on nothing may move for ten minutes, for only rolling and sliding relax a tyre.",
        checks=(
            *(
                Check(
                    f"{name} {where}: distance moved in ten minutes",
                    1e3 * creep(load_vehicle(name), grade, cross_fall),
                    "mm",
                    tolerance=1.0,
                    source="a parked vehicle stays",
                )
                for name in names
                for where, (grade, cross_fall) in _PLACES.items()
            ),
            _stop(load_vehicle(names[0])),
        ),
    )


def creep(vehicle: Vehicle, grade: float, cross_fall: float, duration: float = _PARKED) -> float:
    """Largest distance [m] that a unit of the parked vehicle moves in ``duration`` [s], after settling."""
    plant = Plant(vehicle, Surface(friction=_FRICTION, grade=grade, cross_fall=cross_fall))
    start = plant.initial_state(Pose2(0.0, 0.0, 0.0), 0.0)
    return _drift(plant, plant.step(start, _braking(vehicle), round(_SETTLING / TICK)), vehicle, duration)


def _stop(vehicle: Vehicle) -> Check:
    """Braked from 8 m/s to a stop on the hill: the tyres rock, and then nothing is left that pulls or creeps."""
    plant = Plant(vehicle, Surface(friction=_FRICTION, grade=_SLOPE))
    moving = plant.initial_state(Pose2(0.0, 0.0, 0.0), 8.0)
    stopped = plant.step(moving, _braking(vehicle), round((2.0 * _SETTLING) / TICK))
    return Check(
        f"{vehicle.name} braked to a stop up-hill: distance moved in the ten minutes after",
        1e3 * _drift(plant, stopped, vehicle, _PARKED),
        "mm",
        tolerance=1.0,
        source="brakes hold, and no tyre is wound up after a stop",
    )


def _drift(plant: Plant, state: FloatArray, vehicle: Vehicle, duration: float) -> float:
    """Largest distance [m] that a unit moves in ``duration`` [s] under full brakes."""
    later = plant.step(state, _braking(vehicle), round(duration / TICK))
    moved = plant.observe(later, 0).poses - plant.observe(state, 0).poses
    return float(np.hypot(*moved[:, :2].T).max())


def _braking(vehicle: Vehicle) -> VehicleCommand:
    return VehicleCommand(0.0, _BRAKES, (0.0,) * vehicle.n_by_law)
