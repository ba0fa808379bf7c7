"""Listings of replaceable parts and of scenario keys, generated from the catalogue and the models."""

import inspect
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace
from typing import Final, get_args, get_origin

from pydantic import BaseModel

from scenarios import catalogue
from scenarios.options.course import COURSES
from scenarios.options.rover_course import ROVER_COURSES
from scenarios.options.scenario import Scenario, load_any_scenario
from scenarios.options.shipped import scenario_names
from vehicle.combination.description import load_vehicle, vehicle_names
from vehicle.foundation.quantity import tables_in
from vehicle.foundation.user_file import nearest
from vehicle.option import Option, declared_options
from vehicle.rover.description import load_rover, load_soil, rover_names, soil_names

Kind = Callable[[str], Iterator["Part"]]  # lists the parts of the kind of that name
_PARAMETERS_OF: Final[Mapping[str, tuple[str, ...]]] = {  # keys of the parts that own these parameter tables
    "steering": ("trailer_steering",),
    "estimator": ("off_tracking", "slip_estimator"),
}
_TYPES: Final[Mapping[type[object], str]] = {
    bool: "true, false",
    str: "text",
    int: "whole number",
    float: "number",
    dict: "table",
    tuple: "list",
}


@dataclass(frozen=True, slots=True, kw_only=True)
class Key:
    """A scenario key, or a parameter of a part."""

    name: str
    default: str
    unit: str
    range: str
    meaning: str


@dataclass(frozen=True, slots=True, kw_only=True)
class Part:
    """A replaceable part."""

    kind: str
    name: str
    meaning: str
    parameters: tuple[Key, ...] = ()


def parts(kind: str | None = None) -> list[Part]:
    """All parts, or those of one kind.

    Raises:
        ValueError: one line, if there is no such kind.
    """
    if kind is not None and kind not in KINDS:
        raise ValueError(f"unknown kind of parts '{kind}'{nearest(kind, tuple(KINDS))}")
    return [part for name in ([kind] if kind else KINDS) for part in KINDS[name](name)]


def keys(scenario: str | None = None, settings: tuple[str, ...] = ()) -> list[Key]:
    """All keys of a scenario with its values; by default those of trailer scenarios with their defaults.

    Raises:
        ValueError: one line, if there is no such scenario.
    """
    loaded = None if scenario is None else load_any_scenario(scenario, settings)
    return list(_keys_of(Scenario if loaded is None else type(loaded), loaded))


def _keys_of(model: type[BaseModel], values: BaseModel | None = None, prefix: str = "") -> Iterator[Key]:
    for name, field in model.model_fields.items():
        value = getattr(values, name) if values is not None else None
        tables = (type(value),) if isinstance(value, BaseModel) else tables_in(field.annotation)
        is_list = get_origin(field.annotation) is tuple
        if name in _PARAMETERS_OF and values is not None:
            yield from _parameters(name, values)
        elif not tables or is_list:
            yield _key(Option.of(prefix + name, field), value)
        if name == "plant":
            yield Key(
                name=f"{prefix}plant.units.UNIT.NUMBER",
                default="as in the vehicle file",
                unit="-",
                range="number",
                meaning="Any number of the vehicle file by its path; changes the simulated vehicle only.",
            )
        for table in tables:
            yield from _keys_of(table, value if isinstance(value, table) else None, f"{prefix}{name}{'[]' * is_list}.")


def _parameters(table: str, values: BaseModel) -> Iterator[Key]:
    """Parameters of the part that a scenario names, as ``table.name``."""
    key = next(key for key in _PARAMETERS_OF[table] if hasattr(values, key))
    if getattr(values, key) == "viso_ot":  # its parameters are the table of that name
        return
    given = getattr(values, table)
    names = catalogue.SLIP_ESTIMATOR if key == "slip_estimator" else getattr(catalogue, key.upper())
    for option in declared_options(catalogue.resolve(key, getattr(values, key), names), or_keywords=True):
        yield replace(_key(option, given.get(option.name)), name=f"{table}.{option.name}")


def _key(option: Option, value: object = None) -> Key:
    """The listed form of a key, with its default or the value that a scenario has."""
    default = option.default_text or _text(option.default) if value is None else _text(value)
    ranges = option.range if option.kind is not tuple else ""
    return Key(
        name=option.name,
        default=default,
        unit=option.unit,
        range=", ".join(option.choices) or ranges or _TYPES.get(option.kind, ""),
        meaning=option.meaning,
    )


def _text(value: object) -> str:
    if value is None:
        return "none"
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, tuple):
        return "[" + ", ".join(_text(item) for item in value) + "]"
    if isinstance(value, BaseModel):
        return _text(value.model_dump(exclude_none=True))
    if isinstance(value, float):
        return f"{value:g}"
    return str(value) or '""'


def _of_catalogue(table: catalogue.Catalogue) -> Kind:
    """Parts that are classes: first line of the docstring and declared options."""

    def listed(kind: str) -> Iterator[Part]:
        for name in table:
            part = catalogue.resolve(kind, name, table)
            yield Part(
                kind=kind, name=name, meaning=_first_line(part), parameters=tuple(map(_key, declared_options(part)))
            )

    return listed


def _first_line(part: object) -> str:
    return (inspect.getdoc(part) or "").partition("\n")[0]


def _courses(tables: tuple[type[BaseModel], ...]) -> Kind:
    def listed(kind: str) -> Iterator[Part]:
        for table in tables:
            (name,) = get_args(table.model_fields["kind"].annotation)
            parameters = tuple(key for key in _keys_of(table) if key.name != "kind")
            yield Part(kind=kind, name=name, meaning=_first_line(table), parameters=parameters)

    return listed


def _files(names: Callable[[], tuple[str, ...]], described: Callable[[str], str]) -> Kind:
    return lambda kind: (Part(kind=kind, name=name, meaning=described(name)) for name in names())


KINDS: Final[Mapping[str, Kind]] = {
    "trailer_steering": _of_catalogue(catalogue.TRAILER_STEERING),
    "off_tracking": _of_catalogue(catalogue.OFF_TRACKING),
    "odometry": _of_catalogue(catalogue.ODOMETRY),
    "sensor": _of_catalogue(catalogue.SENSOR),
    "driver": _of_catalogue(catalogue.DRIVER),
    "plant": _of_catalogue(catalogue.PLANT),
    "slip_estimator": _of_catalogue(catalogue.SLIP_ESTIMATOR),
    "rover_sensor": _of_catalogue(catalogue.ROVER_SENSOR),
    "rover_driver": _of_catalogue(catalogue.ROVER_DRIVER),
    "fault": _of_catalogue(catalogue.FAULT),
    "course": _courses(COURSES),
    "rover_course": _courses(ROVER_COURSES),
    "vehicle": _files(vehicle_names, lambda name: load_vehicle(name).summary),
    "rover": _files(rover_names, lambda name: load_rover(name).summary),
    "soil": _files(soil_names, lambda name: load_soil(name).summary),
    "scenario": _files(scenario_names, lambda name: load_any_scenario(name).description),
}
