"""Checks of rearward amplification: the plant against linear theory with the same lags, for every shipped combination.

Open loop: the steer demand is one period of a sine at the frequency of ISO 14791's lane change, as high as linear
theory needs for 0.05 g at the tractor. Both are the ratio of peaks, at the last unit over the first. The linear model
comes from the same equations, so this finds what is not linear and what integration leaves; that the equations are
right is checked by derivations and by an independent multibody model.
"""

from __future__ import annotations

import math
from typing import Final

import numpy as np
from scipy.linalg import expm

from scenarios.standards.motion import amplification
from scenarios.validation.check import Check, Plot, Section, Series
from vehicle.clock import TICK
from vehicle.combination.description import GRAVITY, Vehicle, load_vehicle, vehicle_names
from vehicle.combination.layout import Input, input_sizes, parts
from vehicle.combination.linear import lateral_model, straight_running
from vehicle.combination.plant import Plant, VehicleCommand
from vehicle.frames import FloatArray
from vehicle.surface import Surface

_SPEED: Final = 88.0 / 3.6  # [m/s]
_FREQUENCY: Final = 0.4  # [Hz]
_PEAK: Final = 0.05 * GRAVITY  # [m/s2]
_FRICTION: Final = 0.8  # dry road
_PERIOD: Final = 10  # of the steer programme [ticks]
_DURATION: Final = 10.0  # the last unit has its peaks within 5 s [s]


def rearward_amplification(quick: bool) -> Section:
    """Ratios of the peaks of lateral acceleration, by the plant and by linear theory."""
    names = ("eu_tractor_semitrailer", "a_double") if quick else vehicle_names()
    trains = [vehicle for vehicle in map(load_vehicle, names) if len(vehicle.units) > 1]
    motions = [(vehicle, *accelerations(vehicle)) for vehicle in trains]
    return Section(
        title="Rearward amplification",
        text="One period of steer at 0.4 Hz and 88 km/h, which gives the tractor about 0.05 g. The vehicle's own "
        "tyres, suspensions and actuators, and the linear model of the same vehicle with all its lags.",
        checks=tuple(
            Check(
                f"{vehicle.name}: rearward amplification",
                amplification(of_plant[:, -1], of_plant[:, 0]),
                "",
                target=amplification(linear[:, -1], linear[:, 0]),
                tolerance=0.03 * amplification(linear[:, -1], linear[:, 0]),  # issue 18: 3 %
                source="linear theory with the same lags",
            )
            for vehicle, of_plant, linear in motions
        ),
        plots=(_plot(*motions[0]),),
    )


def accelerations(vehicle: Vehicle) -> tuple[FloatArray, FloatArray]:
    """Lateral accelerations [m/s2] of the units' centres of gravity (n, N): of the plant, and by linear theory."""
    model = lateral_model(vehicle, _SPEED, outputs=("lateral_acceleration",), tyre_dynamics=True, actuators=True)
    amplitude = _PEAK / abs(complex(model.response("lateral_acceleration_0", _FREQUENCY)))
    time = np.arange(0.0, _DURATION, _PERIOD * TICK)
    steer = np.where(time < 1.0 / _FREQUENCY, amplitude * np.sin(2.0 * math.pi * _FREQUENCY * time), 0.0)
    n = len(model.A)
    block = np.zeros((n + 1, n + 1))
    block[:n, :n], block[:n, n] = model.A, model.B[:, 0]
    step = expm(block * (_PERIOD * TICK))  # exact: the demand is constant in between
    x, linear = np.zeros(n), []
    for demand in steer.tolist():
        linear.append(model.C @ x + model.D[:, 0] * demand)
        x = step[:n, :n] @ x + step[:n, n] * demand
    return _of_plant(vehicle, steer), np.array(linear)


def _of_plant(vehicle: Vehicle, steer: FloatArray) -> FloatArray:
    plant = Plant(vehicle, Surface(friction=_FRICTION))
    state, u = straight_running(vehicle, _SPEED, _FRICTION)
    drive = float(Input(*parts(u, input_sizes(vehicle))).acceleration[0])  # that holds the speed
    straight = (0.0,) * sum(len(unit.steered_axles) for unit in vehicle.units[1:])
    seen = []
    for demand in steer.tolist():
        seen.append(plant.observe(state, 0).velocities)
        state = plant.step(state, VehicleCommand(demand, drive, straight), _PERIOD)
    v_x, v_y, yaw_rate = np.moveaxis(np.array(seen), 2, 0)
    at_cg = v_y + np.array([unit.cg_x for unit in vehicle.units]) * yaw_rate
    lateral: FloatArray = np.gradient(at_cg, _PERIOD * TICK, axis=0) + v_x * yaw_rate
    return lateral


def _plot(vehicle: Vehicle, of_plant: FloatArray, linear: FloatArray) -> Plot:
    time: FloatArray = _PERIOD * TICK * np.arange(len(linear), dtype=np.float64)
    series = [
        series
        for k, name in ((0, "first unit"), (-1, "last unit"))
        for series in (
            Series(name, time, of_plant[:, k] / GRAVITY, "model"),
            Series(f"{name}, linear", time, linear[:, k] / GRAVITY, "reference"),
        )
    ]
    return Plot(
        title=f"One period of steer, {vehicle.name}",
        x_label="time [s]",
        y_label="lateral acceleration [g]",
        series=tuple(series),
    )
