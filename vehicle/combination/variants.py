"""Variants of a vehicle: load cases, and changed numbers for the simulated plant.

A vehicle file describes the laden vehicle, and the table ``payload`` of a unit says which part of it is load. Half
laden is the same box at half its density: the load's centre of gravity stays as high, which is on the safe side of a
load that is stacked half as high.

Springs carry the lighter body as air springs with levelling valves do, whose stiffness follows the load: heave and
pitch frequencies stay, and pitch per braking follows the height of the centre of gravity. Suspensions in roll stay as
they are, and so does the roll stiffness behind a gradient that a file gives instead.

A change is one of ``NamedChanges``, or the path of a number in the vehicle file with its new value: ``units.1.mass``,
``units.semitrailer.axles.0.track``, ``tyres.steer.relaxation_length``. Units have an index and a name (spaces become
underscores); axles have an index and the names of their bogie and steer group. A name selects all parts that bear it.
Absolute values are set first, then scales multiply. Loads and brake shares follow from the changed numbers.
"""

import difflib
import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from copy import deepcopy
from typing import Any, Final, TypeAlias

from vehicle.combination.description import Vehicle, vehicle_from
from vehicle.combination.unit import MassProperties, Unit, without
from vehicle.foundation.quantity import Frozen, checked, quantity
from vehicle.foundation.user_file import dotted, nearest

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


def _lightened(unit: Unit, removed: float, key: str) -> Unit:
    """The unit without the share ``removed`` of its payload, which is no part of it any more."""
    assert unit.payload is not None
    if unit.payload.mass >= unit.mass:
        raise ValueError(
            f"{key}.payload.mass = {unit.payload.mass:g} kg must be less than {key}.mass = {unit.mass:g} kg"
        )
    inertia = None if unit.roll is None else unit.roll.inertia
    laden = MassProperties(unit.mass, unit.cg_x, unit.cg_height, unit.yaw_inertia, inertia)
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


Change: TypeAlias = "float | Sequence[float] | Mapping[str, Change]"  # a mapping nests paths
_TEXTS: Final = frozenset({"bogie", "steer_group", "abs_group"})  # names, or None
_IDLE: Final = frozenset({"payload"})  # tables that the plant does not depend on
_Keys: TypeAlias = tuple[str | int, ...]  # of a value in the contents of a vehicle file


class NamedChanges(Frozen):
    """Changes that concern several numbers of a vehicle at once."""

    mass_scale: float = quantity(
        1.0, "-", 0.2, 3.0, "Factor on mass, yaw and roll inertia of every unit; wheels, springs and gradients stay."
    )
    inertia_scale: float = quantity(1.0, "-", 0.1, 5.0, "Further factor on the yaw inertia of every unit.")
    cg_height_scale: float = quantity(1.0, "-", 0.2, 2.0, "Factor on the height of every unit's centre of gravity.")
    cornering_stiffness_scale: float = quantity(
        1.0, "-", 0.2, 3.0, "Factor on the slope of every tyre's lateral force; longitudinal stiffness and peak stay."
    )
    # None: as in the vehicle file
    steer_lag: float | None = quantity(None, "s", 0.0, 5.0, "Lag of the towed units' steering actuators.", above=True)
    steer_lag_scale: float = quantity(1.0, "-", 0.1, 10.0, "Factor on the lag of the towed units' steering actuators.")


def changed_vehicle(vehicle: Vehicle, changes: Mapping[str, Change]) -> Vehicle:
    """The vehicle with these changes, validated as if they stood in its file.

    Raises:
        ValueError: one line naming ``plant.<path>``, and the limit with its unit or the nearest known path.
    """
    values = dict(dotted(changes))
    by_name = {key: value for key, value in values.items() if key in NamedChanges.model_fields}
    by_path = {key: value for key, value in values.items() if key not in by_name}
    try:
        named = checked(NamedChanges, by_name, "plant")
    except ValueError as error:
        raise _plant_error(error, {}) from None
    return _scaled(_with_values(vehicle, named.steer_lag, by_path), named)


def number_paths(vehicle: Vehicle) -> dict[str, Any]:
    """Values of all numbers and flags of the vehicle by path, with indices and with names; None: not in the file."""
    contents = _contents(vehicle)
    return {path: _value_at(contents, keys) for path, keys in _paths(contents)}


def _with_values(vehicle: Vehicle, steer_lag: float | None, by_path: Mapping[str, Any]) -> Vehicle:
    contents = _contents(vehicle)
    if steer_lag is not None:
        for steering in _trailer_steering(vehicle, contents, "steer_lag"):
            steering["lag"] = steer_lag
    known: dict[str, list[_Keys]] = {}
    for path, keys in _paths(contents) if by_path else ():
        known.setdefault(path, []).append(keys)
    renamed: dict[str, str] = {}  # location in an error message to the path as written
    for path, value in by_path.items():
        if path not in known:
            raise ValueError(f"unknown change 'plant.{path}'{_hint(path, known)}")
        for keys in known[path]:
            _value_at(contents, keys[:-1])[keys[-1]] = deepcopy(value)
            renamed |= _locations(keys, path.split("."))
    return _validated(contents, renamed)


def _scaled(vehicle: Vehicle, named: NamedChanges) -> Vehicle:
    contents = _contents(vehicle)
    for unit, table in zip(vehicle.units, contents["units"], strict=True):
        table["mass"] = named.mass_scale * unit.mass
        table["yaw_inertia"] = named.mass_scale * named.inertia_scale * unit.yaw_inertia
        table["cg_height"] = named.cg_height_scale * unit.cg_height
        if unit.roll is not None:
            table["roll"]["inertia"] = named.mass_scale * unit.roll.inertia
        if unit.payload is not None:
            table["payload"]["mass"] = named.mass_scale * unit.payload.mass
            table["payload"]["cg_height"] = named.cg_height_scale * unit.payload.cg_height
        axles = sorted((*unit.axles, *unit.lifted_axles), key=lambda axle: -axle.x)
        for axle, axle_table in zip(axles, table["axles"], strict=True):
            axle_table["tyre"] = axle.tyre.with_cornering_scaled(named.cornering_stiffness_scale)
    if named.steer_lag_scale != 1.0:
        for steering in _trailer_steering(vehicle, contents, "steer_lag_scale"):
            steering["lag"] *= named.steer_lag_scale
    return _validated(contents, {})


def _trailer_steering(vehicle: Vehicle, contents: dict[str, Any], change: str) -> list[dict[str, Any]]:
    tables = [unit["steering"] for unit in contents["units"][1:] if unit["steering"] is not None]
    if not tables:
        raise ValueError(f"plant.{change}: no towed unit of {vehicle.name} is steered")
    return tables


def _contents(vehicle: Vehicle) -> dict[str, Any]:
    """The contents of a file that describes the vehicle, with the data of its tyre in every axle."""
    contents: dict[str, Any] = _with_lists(vehicle.model_dump())
    for unit in contents["units"]:
        lifted = unit.pop("lifted_axles")
        unit["axles"] = sorted([*unit["axles"], *lifted], key=lambda axle: -float(axle["x"]))
    return contents


def _with_lists(node: Any) -> Any:
    if isinstance(node, dict):
        return {key: _with_lists(child) for key, child in node.items()}
    return [_with_lists(child) for child in node] if isinstance(node, tuple) else node


def _validated(contents: dict[str, Any], renamed: Mapping[str, str]) -> Vehicle:
    try:
        return vehicle_from(contents, "plant")
    except ValueError as error:
        raise _plant_error(error, renamed) from None


def _plant_error(error: ValueError, renamed: Mapping[str, str]) -> ValueError:
    location, space, complaint = str(error).removeprefix("plant: ").partition(" ")
    colon = ":" if location.endswith(":") else ""
    location = location.removesuffix(":")
    return ValueError(f"plant.{renamed.get(location, location)}{colon}{space}{complaint}")


def _locations(keys: _Keys, path: Sequence[str]) -> dict[str, str]:
    """Location by indices to the path as written, for the value and for the tables that contain it."""
    return {
        ".".join(str(key) for key in keys[: len(keys) - cut]): ".".join(path[: len(path) - cut])
        for cut in range(len(path) - 1)
    }


def _paths(contents: dict[str, Any]) -> Iterator[tuple[str, _Keys]]:
    """Every path of a value, with the keys that lead to it; a path by name may lead to several values."""
    yield from _paths_below(contents, "", ())
    for i, unit in enumerate(contents["units"]):
        for k, axle in enumerate(unit["axles"]):
            if axle["tyre"]["name"]:
                keys = ("units", i, "axles", k, "tyre")
                yield from _paths_below(axle["tyre"], f"tyres.{axle['tyre']['name']}.", keys)


def _paths_below(node: dict[str, Any] | list[Any], before: str, keys: _Keys) -> Iterator[tuple[str, _Keys]]:
    for key, child in node.items() if isinstance(node, dict) else enumerate(node):
        if key in _IDLE:
            continue
        for name in (key, *_names(child)) if isinstance(node, list) else (key,):
            if isinstance(child, dict | list):
                yield from _paths_below(child, f"{before}{name}.", (*keys, key))
            if not (isinstance(child, dict | str) or key in _TEXTS or _is_tables(child)):
                yield f"{before}{name}", (*keys, key)


def _is_tables(part: Any) -> bool:
    return isinstance(part, list) and any(isinstance(entry, dict) for entry in part)


def _names(part: Any) -> set[str]:
    """Names by which a part of a list is known: of a unit its own, of an axle its bogie's and steer group's."""
    names = (part.get(key) for key in ("name", "bogie", "steer_group")) if isinstance(part, dict) else ()
    return {name.replace(" ", "_") for name in names if name}


def _value_at(contents: dict[str, Any], keys: Iterable[str | int]) -> Any:
    value: Any = contents
    for key in keys:
        value = value[key]
    return value


def _hint(path: str, known: Iterable[str]) -> str:
    everything = [*NamedChanges.model_fields, *known]
    close = difflib.get_close_matches(path, everything, n=1, cutoff=0.5)
    if close:
        return f"; did you mean 'plant.{close[0]}'?"
    return f"; known: {', '.join(NamedChanges.model_fields)}, or the path of a number in the vehicle file"
