"""Signals of how a combination is loaded: articulation, lateral acceleration, load transfer, friction by axle."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from itertools import pairwise

import numpy as np

from scenarios.results.log import Column, Signal
from vehicle.clock import TICK
from vehicle.combination.description import Vehicle
from vehicle.combination.layout import wheels
from vehicle.combination.truth import Truth
from vehicle.frames import FloatArray


def load_columns(truths: Sequence[Truth], vehicle: Vehicle) -> Iterator[Column]:
    """Columns over time; the rows are evenly spaced."""
    units = vehicle.units
    poses, velocities = (
        np.array([getattr(truth, name) for truth in truths]).reshape(-1, len(units), 3)
        for name in ("poses", "velocities")
    )
    for k, (ahead, unit) in enumerate(pairwise(units)):
        meaning = f"yaw of {ahead.name} minus yaw of {unit.name}"
        yield Signal(f"articulation_{k + 1}", "rad", meaning), poses[:, k, 2] - poses[:, k + 1, 2]
    times = np.array([truth.tick for truth in truths]) * TICK
    for k, unit in enumerate(units):
        meaning = f"{unit.name}: of the centre of gravity along the ground, + left, without gravity"
        yield (
            Signal(f"lateral_acceleration_{unit.name}", "m/s2", meaning),
            _lateral_acceleration(times, velocities[:, k], unit.cg_x),
        )
    for k, unit in enumerate(units):
        meaning = f"{unit.name}: right less left wheel loads over their sum; at 1 or -1 one side carries nothing"
        yield Signal(f"load_transfer_{unit.name}", "-", meaning), [truth.load_transfer[k] for truth in truths]
    yield from _friction_columns(truths, vehicle)


def _lateral_acceleration(times: FloatArray, velocities: FloatArray, x: float) -> FloatArray:
    """Of a point (x, 0) of a unit whose origin has these velocities (n, 3), along the unit's y axis [m/s2]."""
    if len(times) < 2:
        return np.full(len(times), np.nan)
    forward, left, yaw_rate = velocities.T
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
