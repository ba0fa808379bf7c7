"""Signals of how a combination is loaded: articulation, lateral acceleration, load transfer, friction by axle."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from itertools import pairwise

import numpy as np

from scenarios.results.log import Column, Signal
from vehicle.combination.description import Vehicle
from vehicle.combination.layout import wheels
from vehicle.combination.truth import Truth
from vehicle.frames import FloatArray


def motion_columns(signals: Mapping[str, FloatArray], vehicle: Vehicle) -> Iterator[Column]:
    """Articulations and accelerations from the time and the motions of all units; the rows are evenly spaced."""
    for k, (ahead, unit) in enumerate(pairwise(vehicle.units), start=1):
        meaning = f"yaw of {ahead.name} minus yaw of {unit.name}"
        yield Signal(f"articulation_{k}", "rad", meaning), signals[f"psi_{ahead.name}"] - signals[f"psi_{unit.name}"]
    for unit in vehicle.units:
        meaning = f"{unit.name}: of the centre of gravity along the ground, + left, without gravity"
        forward, left, yaw_rate = (signals[f"{quantity}_{unit.name}"] for quantity in ("v_x", "v_y", "yaw_rate"))
        values = _lateral_acceleration(signals["time"], forward, left, yaw_rate, unit.cg_x)
        yield Signal(f"lateral_acceleration_{unit.name}", "m/s2", meaning), values


def load_columns(truths: Sequence[Truth], vehicle: Vehicle) -> Iterator[Column]:
    """Load transfers and use of friction in some rows."""
    for k, unit in enumerate(vehicle.units):
        meaning = f"{unit.name}: right less left wheel loads over their sum; at 1 or -1 one side carries nothing"
        yield Signal(f"load_transfer_{unit.name}", "-", meaning), [truth.load_transfer[k] for truth in truths]
    yield from _friction_columns(truths, vehicle)


def _lateral_acceleration(
    times: FloatArray, forward: FloatArray, left: FloatArray, yaw_rate: FloatArray, x: float
) -> FloatArray:
    """Of a point (x, 0) of a unit whose origin has these velocities (n,), along the unit's y axis [m/s2]."""
    if len(times) < 2:
        return np.full(len(times), np.nan)
    acceleration: FloatArray = np.gradient(left + x * yaw_rate, times) + forward * yaw_rate
    return acceleration


def _friction_columns(truths: Sequence[Truth], vehicle: Vehicle) -> Iterator[Column]:
    """Share of the friction that each axle uses: of its wheels, in proportion to what they carry."""
    all_wheels = wheels(vehicle)
    loads, used = (
        np.array([getattr(truth, name) for truth in truths]).reshape(-1, len(all_wheels))
        for name in ("wheel_loads", "friction_used")
    )
    for i, unit in enumerate(vehicle.units):
        for k in range(len(unit.axles)):
            rows = [n for n, wheel in enumerate(all_wheels) if (wheel.unit, wheel.axle_in_unit) == (i, k)]
            carried = loads[:, rows].sum(axis=1)
            share = (loads[:, rows] * used[:, rows]).sum(axis=1) / np.maximum(carried, 1e-9)
            meaning = f"{unit.name}, axle {k + 1}: horizontal tyre forces over friction times vertical ones"
            yield Signal(f"friction_used_{unit.name}_{k + 1}", "-", meaning), share
