"""Checks of brakes and drive: stopping distances, slip under ABS, folding without it, and climbing."""

from __future__ import annotations

import math
from typing import Final

import numpy as np

from scenarios.standards.longitudinal import longitudinal, longitudinal_theory
from scenarios.validation.check import Check, Plot, Section, Series
from scenarios.validation.stops import ROW, Stop, braked, without_abs
from vehicle.combination.description import GRAVITY, Vehicle, load_vehicle
from vehicle.frames import FloatArray
from vehicle.surface import SplitFriction, Surface
from vehicle.tyres import Planar

_SPEED: Final = 80.0 / 3.6  # [m/s]
_SLOW: Final = 5.0  # slips below this speed are not judged [m/s]
_FULL: Final = 9.0  # demand of a full brake application [m/s2]
_FRICTIONS: Final = (0.8, 0.3)
_TURN: Final = 1.5  # lateral acceleration of the turn on snow [m/s2]
_TURN_SPEED: Final = 60.0 / 3.6  # [m/s]


def braking(quick: bool) -> Section:
    """Stops with and without ABS, straight, on split friction and in a turn; climbing and holding."""
    vehicle = load_vehicle("eu_tractor_semitrailer").model_copy(update={"air": None})
    stops = {friction: braked(vehicle, Surface(friction=friction), _SPEED, _FULL) for friction in _FRICTIONS}
    names = ("eu_tractor_semitrailer",) if quick else ("eu_tractor_semitrailer", "a_double", "rigid_truck")
    return Section(
        title="Brakes and drive",
        text="Full brake applications from 80 km/h with ABS, without it, on split friction, and in a turn on snow with "
        "a fixed steering wheel. Grades, speeds and times that the simulation reaches, against quasi-static forces.",
        checks=(
            _locked(vehicle),
            *(_distance(vehicle, friction, stop) for friction, stop in stops.items()),
            *(_slip_band(vehicle, f"friction {friction:g}", stop) for friction, stop in stops.items()),
            _slip_band(vehicle, "friction 0.8 left, 0.2 right", _split(vehicle)),
            *_folding(vehicle),
            *(check for name in names for check in _capability(load_vehicle(name))),
        ),
        plots=(_plot(stops[0.3]),),
    )


def _locked(vehicle: Vehicle) -> Check:
    friction = 0.3
    stop = braked(without_abs(vehicle), Surface(friction=friction), _SPEED, _FULL)
    tyre, load = vehicle.units[0].axles[0].tyre, vehicle.units[0].axles[0].tyre.nominal_load
    force = float(tyre.steady_force(Planar(-1.0, 0.0), load, friction).x)
    return Check(
        "all wheels locked at friction 0.3: deceleration over friction times g",
        stop.deceleration(18.0, 6.0) / (friction * GRAVITY),
        "",
        target=-force / (friction * load),
        tolerance=0.01,
        source="the tyre law's force at a slip of 1, over friction times load",
    )


def _distance(vehicle: Vehicle, friction: float, stop: Stop) -> Check:
    """Distance against that at the largest deceleration once both lags and the filling are over."""
    system, brake = vehicle.brakes, vehicle.units[0].axles[0].brake
    lags = 0.0 if system is None or brake is None else system.lag + brake.lag
    ideal = _SPEED * lags + _SPEED**2 / (2.0 * friction * GRAVITY)
    return Check(
        f"stop from 80 km/h with ABS at friction {friction:g}: distance over v t + v^2 / (2 mu g)",
        float(stop.distance[-1]) / ideal,
        "",
        target=1.0,
        tolerance=0.25 if friction > 0.5 else 0.1,
        source="constant deceleration of mu g behind the lags t of pedal and chambers; ABS uses 0.75 or more of the "
        "friction (UN R13, annex 13, from memory), on dry road the drive axle's torque ends it",
    )


def _slip_band(vehicle: Vehicle, name: str, stop: Stop) -> Check:
    system = vehicle.brakes
    limit = 0.0 if system is None else system.abs_slip + system.abs_slip_speed / _SLOW
    return Check(
        f"ABS, {name}: largest slip of any wheel above 18 km/h",
        float(stop.slips(above=_SLOW, after=0.8).max()),
        "",
        target=0.5 * limit,
        tolerance=0.75 * limit,
        source="the modulators' limit at this speed, and a quarter more for valves and air",
    )


def _split(vehicle: Vehicle) -> Stop:
    """The first second and a half, before the steering wheel would have to turn."""
    line = np.array([[0.0, 0.0], [1.0, 0.0]])
    split = Surface(friction=SplitFriction(left=0.8, right=0.2, line=line))
    return braked(vehicle, split, _SPEED, _FULL, seconds=1.3)


def _folding(vehicle: Vehicle) -> tuple[Check, ...]:
    """Largest articulation in a turn on snow under a fixed steering wheel."""
    steer = vehicle.units[0].steered_axles[0].x * _TURN / _TURN_SPEED**2
    snow = Surface(friction=0.3)
    stops = [braked(v, snow, _TURN_SPEED, _FULL, steer=steer) for v in (vehicle, without_abs(vehicle))]
    angles = [math.degrees(float(np.abs(stop.articulation).max())) for stop in stops]
    return (
        Check(
            "full braking in a turn on snow with ABS: largest articulation",
            angles[0],
            "deg",
            target=0.0,
            tolerance=20.0,
            source="it does not fold",
        ),
        Check(
            "the same without ABS",
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
            "",
            target=1.0,
            tolerance=0.025,
            source="quasi-static forces from the vehicle's data, without slip and driveline lag",
        )
        for name, value in computed.items()
    )


def _plot(stop: Stop) -> Plot:
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
