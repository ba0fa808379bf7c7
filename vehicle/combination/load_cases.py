"""Load cases of a vehicle: unladen, half and fully laden.

A vehicle file describes the laden vehicle, and the table ``payload`` of a unit says which part of it is load. Half
laden is the same box at half its density: the load's centre of gravity stays as high, which is on the safe side of a
load that is stacked half as high.

Springs carry the lighter body as air springs with levelling valves do, whose stiffness follows the load: heave and
pitch frequencies stay, and pitch per braking follows the height of the centre of gravity. Suspensions in roll stay as
they are, and so does the roll stiffness behind a gradient that a file gives instead.
"""

from __future__ import annotations

import math
from typing import Final

from vehicle.combination.description import Vehicle
from vehicle.combination.payload import Body, without
from vehicle.combination.unit import Unit
from vehicle.parameter_file import nearest

FULL: Final = "full"
LOADS: Final = {"unladen": 0.0, "half": 0.5, FULL: 1.0}  # load case and its share of the payload
_HIGHEST: Final = 5.0  # [Hz] roll frequency that the plant's step allows
_LEAST_LEVER: Final = 0.05  # [m] of the centre of gravity above the roll axis


def load_cases(vehicle: Vehicle) -> tuple[str, ...]:
    """Names of the vehicle's load cases; only "full" if no unit has a payload."""
    return tuple(LOADS) if any(unit.payload is not None for unit in vehicle.units) else (FULL,)


def with_load(vehicle: Vehicle, case: str) -> Vehicle:
    """The vehicle in a load case: "unladen", "half" or "full", as its file describes it.

    Raises:
        ValueError: one line, if there is no such case, the vehicle has no payload, or what is left is no body.
    """
    if case not in LOADS:
        raise ValueError(f"load = '{case}' is not a load case{nearest(case, LOADS)}")
    if case == FULL:
        return vehicle
    if load_cases(vehicle) == (FULL,):
        raise ValueError(f"load = {case}: {vehicle.name} has no table 'payload' in any unit, so only load = {FULL}")
    units = tuple(
        unit if unit.payload is None else _lightened(unit, 1.0 - LOADS[case], f"units.{k}")
        for k, unit in enumerate(vehicle.units)
    )
    return vehicle.model_copy(update={"units": units, "summary": f"{vehicle.summary} ({case})".strip()})


def payload_mass(vehicle: Vehicle) -> float:
    """Mass of all payloads in the file [kg]."""
    return sum(unit.payload.mass for unit in vehicle.units if unit.payload is not None)


def _lightened(unit: Unit, removed: float, key: str) -> Unit:
    """The unit without the share ``removed`` of its payload, which is no part of it any more.

    Raises:
        ValueError: one line, if no body is left.
    """
    assert unit.payload is not None
    if unit.payload.mass >= unit.mass:
        raise ValueError(
            f"{key}.payload.mass = {unit.payload.mass:g} kg must be less than {key}.mass = {unit.mass:g} kg"
        )
    inertia = None if unit.roll is None else unit.roll.inertia
    laden = Body(unit.mass, unit.cg_x, unit.cg_height, unit.yaw_inertia, inertia)
    body = without(laden, unit.payload, removed)
    for name, value, measure, change in (
        ("cg_height", body.cg_height, "m", "lower the payload"),
        ("yaw_inertia", body.yaw_inertia, "kg m2", "make the payload shorter, or move it"),
        ("roll.inertia", body.roll_inertia, "kg m2", "make the payload lower or narrower, or move it"),
    ):
        if value is not None and value <= 0.0:
            left = f"leaves {name} = {value:.4g} {measure} of the unit without it, which must be above 0"
            raise ValueError(f"{key}.payload: {left}: {change}")
    changes: dict[str, object] = {
        "mass": body.mass,
        "cg_x": body.cg_x,
        "cg_height": body.cg_height,
        "yaw_inertia": body.yaw_inertia,
        "pitch_gradient": unit.pitch_gradient * body.cg_height / unit.cg_height,
        "payload": None,
    }
    if unit.roll is not None:
        changes["roll"] = unit.roll.model_copy(update={"inertia": body.roll_inertia})
    else:
        gradient, frequency = unit.roll_swing
        lever, was = (max(height - unit.roll_axis_height, _LEAST_LEVER) for height in (body.cg_height, unit.cg_height))
        changes["roll_gradient"] = gradient * (body.mass * lever) / (unit.mass * was)
        changes["roll_frequency"] = min(frequency * math.sqrt(unit.mass / body.mass), _HIGHEST)
    return unit.model_copy(update=changes)
