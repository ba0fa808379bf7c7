"""Random scenarios and studies from the models behind ``offtrack keys``: a new key, part or file needs no line here."""

import math
import types
from collections.abc import Mapping
from dataclasses import replace
from typing import Annotated, Any, Final, Literal, Union, get_args, get_origin

import tomli_w
from annotated_types import MinLen
from hypothesis import strategies as st
from pydantic import BaseModel
from pydantic.fields import FieldInfo

from scenarios import catalogue, part_listing
from scenarios.options.course import COURSES
from scenarios.options.rover_course import ROVER_COURSES
from scenarios.options.scenario import RoverScenario, Scenario, load_any_scenario
from scenarios.options.shipped import scenario_names
from sensors.faults.fault import FAULTS
from tests.fuzz.case import Case
from tests.fuzz.files import settings
from tests.fuzz.mutations import ODD_NUMBERS
from vehicle.combination.description import vehicle_names
from vehicle.foundation.quantity import tables_in
from vehicle.option import Option, declared_options
from vehicle.rover.description import rover_names, soil_names

_TEXTS: Final = (
    *("", "none", "x", "true", "nan", "[", "[/b]", "..:x", "os:system", "json:loads", "a" * 300, "\u202e", "a\nb=2"),
)
_ODD: Final = st.sampled_from([*ODD_NUMBERS, *_TEXTS, "[[1]]", "{a=1}", "[nan,1,1]", "[" * 500])
_CAMERAS: Final = ("viso_ot", "ground_watching", "ground_watching_single")
_SLOW_LAWS: Final = ("mpc",)
_NAMES: Final[Mapping[tuple[type[BaseModel], str], tuple[str, ...]]] = {  # names that a key takes
    **{
        (Scenario, key): tuple(getattr(catalogue, key.upper()))
        for key in ("trailer_steering", "off_tracking", "odometry")
    },
    (Scenario, "sensor"): tuple(catalogue.SENSOR),
    (Scenario, "vehicle"): vehicle_names(),
    (RoverScenario, "slip_estimator"): tuple(catalogue.SLIP_ESTIMATOR),
    (RoverScenario, "sensor"): tuple(catalogue.ROVER_SENSOR),
    (RoverScenario, "driver"): tuple(catalogue.ROVER_DRIVER),
    (RoverScenario, "vehicle"): rover_names(),
}
_NAMES_ANYWHERE: Final[Mapping[str, tuple[str, ...]]] = {
    "soil": (*soil_names(), "none"),
    "kind": (*catalogue.DRIVER, *catalogue.PLANT, *FAULTS),
    "terrain": ("uniform", "ripples", "pebbles", "moon"),
}
_PARTS: Final[Mapping[str, Mapping[str, str]]] = {  # tables of parameters, and the key of the part that takes them
    "steering": {"trailer_steering": "TRAILER_STEERING"},
    "estimator": {"off_tracking": "OFF_TRACKING", "slip_estimator": "SLIP_ESTIMATOR"},
    "driving": {"driver": "ROVER_DRIVER"},
}


def _value(model: type[BaseModel], name: str, field: FieldInfo) -> st.SearchStrategy[str]:
    """Values of a key as TOML or plain text, mostly within its limits."""
    names = _NAMES.get((model, name)) or _NAMES_ANYWHERE.get(name)
    if names and field.annotation is not None and get_origin(field.annotation) is not Literal:
        return st.sampled_from(names)
    return _of_type(field.annotation, Option.of(name, field), field)


def _of_type(annotation: Any, option: Option, field: FieldInfo | None = None) -> st.SearchStrategy[str]:
    origin = get_origin(annotation)
    if origin is Annotated:
        return _of_type(get_args(annotation)[0], option)
    if origin in (Union, types.UnionType):
        return st.one_of(*(_of_type(part, option) for part in get_args(annotation) if part is not types.NoneType))
    if origin is Literal:
        return st.sampled_from([str(choice) for choice in get_args(annotation)])
    if origin is tuple:
        parts = get_args(annotation)
        if parts[-1] is Ellipsis:
            least = next((limit.min_length for limit in field.metadata if isinstance(limit, MinLen)), 0) if field else 0
            return st.lists(_of_type(parts[0], option), min_size=least, max_size=3).map(_list)
        return st.tuples(*(_of_type(part, option) for part in parts)).map(_list)
    if annotation in (bool, int, float):
        return _option(replace(option, default=None, type_without_default=annotation))
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        return _inline(annotation)
    return st.sampled_from(_TEXTS)


def _list(values: Any) -> str:
    return f"[{', '.join(values)}]"


def _inline(model: type[BaseModel]) -> st.SearchStrategy[str]:
    keys = {
        name: _value(model, name, field) if field.is_required() else st.none() | _value(model, name, field)
        for name, field in model.model_fields.items()
        if not tables_in(field.annotation)
    }
    return st.fixed_dictionaries(keys).map(
        lambda table: (
            "{" + ", ".join(f"{key} = {_quoted(value)}" for key, value in table.items() if value is not None) + "}"
        )
    )


def _quoted(text: str) -> str:
    return text if text[:1] in "[{0123456789-" or text in ("true", "false") else tomli_w.dumps({"a": text})[4:].strip()


def _keys(model: type[BaseModel], prefix: str = "") -> dict[str, st.SearchStrategy[str]]:
    """Values of every key of a table by its dotted name; courses are drawn apart."""
    found: dict[str, st.SearchStrategy[str]] = {}
    for name, field in model.model_fields.items():
        tables = tables_in(field.annotation)
        if name in ("course", "name", "description", *_PARTS) or (name == "kind" and model is RoverScenario):
            continue
        if tables and get_origin(field.annotation) is not tuple:
            for table in tables:
                found |= _keys(table, f"{prefix}{name}.")
        elif get_origin(field.annotation) is not dict:
            found[prefix + name] = _value(model, name, field)
    return found


def _course(table: type[BaseModel]) -> st.SearchStrategy[list[str]]:
    (kind,) = get_args(table.model_fields["kind"].annotation)
    needed: dict[str, st.SearchStrategy[str]] = {}
    optional: dict[str, st.SearchStrategy[str]] = {}
    for name, field in table.model_fields.items():
        if name != "kind":
            (needed if field.is_required() else optional)[f"course.{name}"] = _value(table, name, field)
    chosen = st.fixed_dictionaries(needed, optional=optional)
    return chosen.map(lambda keys: [f"course.kind={kind}", *(f"{key}={value}" for key, value in keys.items())])


def _parameters(chosen: dict[str, str]) -> st.SearchStrategy[list[str]]:
    """Parameters of the parts that a scenario names."""
    tables = []
    for table, parts in _PARTS.items():
        for key, names in parts.items():
            if chosen.get(key) in getattr(catalogue, names):
                part = catalogue.resolve(key, chosen[key], getattr(catalogue, names))
                options = {
                    f"{table}.{option.name}": _option(option) for option in declared_options(part, or_keywords=True)
                }
                tables.append(st.fixed_dictionaries({}, optional=options))
    return st.tuples(*tables).map(lambda drawn: [f"{key}={value}" for one in drawn for key, value in one.items()])


def _option(option: Option) -> st.SearchStrategy[str]:
    if option.choices:
        return st.sampled_from(option.choices)
    if option.kind is bool:
        return st.sampled_from(["true", "false"])
    low = option.low if math.isfinite(option.low) else -1e3
    high = option.high if math.isfinite(option.high) else 1e3
    if option.kind is int:
        return st.integers(int(low), int(high)).map(str)
    near = st.floats(low, low + 0.1 * (high - low)) | st.floats(low, high) | st.sampled_from([float(low), float(high)])
    return near.map(repr)


_OF_TRAILERS, _OF_ROVERS = _keys(Scenario), _keys(RoverScenario)
_COURSES, _ROVER_COURSES = [_course(table) for table in COURSES], [_course(table) for table in ROVER_COURSES]
_FAULTS: Final = st.lists(
    st.tuples(
        st.sampled_from(sorted(FAULTS)),
        st.sampled_from([""] * 9 + [":0.1", ":0.9", ":1", ":3", ":0", ":-1", ":nan", ":1e9", ":0.1,0.2,0.3", ":x"]),
        st.sampled_from(["", "", "@0", "@0.3", "@0.3+0.2", "@1+0.5"] * 2 + ["@-1", "@1e9", "@nan", "@0+0"]),
    ).map("".join),
    min_size=1,
    max_size=3,
).map(";".join)
_OF_TRAILERS["faults"] = _OF_ROVERS["faults"] = _FAULTS


@st.composite
def drawn_settings(draw: st.DrawFn, *, is_rover: bool, cameras: bool) -> list[str]:
    """``KEY=VALUE`` texts: a course, some keys, parameters of the parts, and now and then something odd."""
    keys, courses = (_OF_ROVERS, _ROVER_COURSES) if is_rover else (_OF_TRAILERS, _COURSES)
    chosen: dict[str, str] = {}
    for name in draw(st.lists(st.sampled_from(sorted(keys)), max_size=8, unique=True)):
        chosen[name] = draw(keys[name])
    estimator = "slip_estimator" if is_rover else "off_tracking"
    if not cameras:
        chosen[estimator] = draw(st.sampled_from(["truth"] * 3 + ([] if is_rover else ["kinematic", "surrogate"])))
    if not is_rover and draw(st.booleans()):
        chosen["trailer_steering"] = draw(st.sampled_from(sorted(catalogue.TRAILER_STEERING)))
    if draw(st.booleans()) and "faults" not in chosen:
        chosen["faults"] = draw(_FAULTS)
    pairs = [f"{key}={value}" for key, value in chosen.items()]
    if draw(st.integers(0, 3)):
        pairs = [*draw(st.sampled_from(courses).flatmap(lambda one: one)), *pairs]
    if draw(st.booleans()):
        pairs += draw(_parameters(chosen))
    if draw(st.integers(0, 4)) == 4:
        key = draw(st.sampled_from([*sorted(keys), "course.radius", "plant.units.0.mass", "a.b", "steering.gain", ""]))
        pairs.append(f"{key}={draw(_ODD)}")
    return [pair for pair in pairs if "\0" not in pair]


TRAILERS: Final = [name for name in scenario_names() if isinstance(load_any_scenario(name), Scenario)]
ROVERS: Final = [name for name in scenario_names() if name not in TRAILERS]


@st.composite
def scenario_runs(draw: st.DrawFn) -> Case:
    is_rover, cameras = draw(st.integers(0, 3)) == 3, draw(st.integers(0, 39)) == 39
    scenario = draw(st.sampled_from(ROVERS if is_rover else TRAILERS))
    pairs = draw(drawn_settings(is_rover=is_rover, cameras=cameras))
    seed = draw(st.sampled_from(["1", "2", "77", str(2**31), str(2**70)]))
    slow = cameras or any(pair.split("=")[-1] in _SLOW_LAWS for pair in pairs)
    steps = 30 if slow else draw(st.sampled_from([1, 30, 150, 150, 150, 600, 6000]))
    return Case(
        kind=f"scenario: {'rover' if is_rover else 'trailer'}{', cameras' if cameras else ''}",
        command=("run", scenario, *settings(*pairs), "--seed", seed, "--no-video", "--quiet", "--out", "out"),
        steps=steps,
    )


@st.composite
def studies(draw: st.DrawFn) -> Case:
    is_rover = draw(st.integers(0, 3)) == 3
    scenario = draw(st.sampled_from(ROVERS if is_rover else TRAILERS))
    keys = _OF_ROVERS if is_rover else _OF_TRAILERS
    pairs = draw(drawn_settings(is_rover=is_rover, cameras=False) | st.just(["signals.noise=0"]))
    odd_values, odd_rest = draw(st.integers(0, 4)) == 4, draw(st.integers(0, 2)) == 2
    axes = {
        name: draw(st.lists(_ODD if odd_values else keys[name], min_size=0 if odd_rest else 1, max_size=2, unique=True))
        for name in draw(st.lists(st.sampled_from(sorted(keys)), max_size=2, unique=True))
    }
    odd_seeds = ["2-1", "1-100000000", "", "-1", "1,1", "x", "9" * 30, "1-3,2", "1e3", "٣"]
    seeds = draw(st.sampled_from(odd_seeds if odd_rest else ["1", "1,2", "1-2"]))
    kind, tail, steps = "study", ("--quiet", "--out", "out", "--jobs", "1"), 20
    if draw(st.booleans()):
        vary = [word for key, values in axes.items() for word in ("--vary", f"{key}={','.join(values)}")]
        usual = "none,crab" if is_rover else "none,command_steer"
        names = draw(st.sampled_from(["none,none", "", "crab", "x"] if odd_rest else ["none", usual]))
        laws = ("--controllers", names)
        command = ("compare", scenario, *settings(*pairs), *vary, *laws, "--seeds", seeds, *tail)
        return Case(kind=kind, command=command, steps=steps)
    table: dict[str, Any] = {"scenario": scenario, "set": dict(pair.split("=", 1) for pair in pairs), "vary": axes}
    odd_lists: tuple[Any, ...] = ([], [1, 1], [-1], ["x"], 3, [2**63], [1.5], list(range(100_000)))
    table["seeds"] = draw(st.sampled_from(odd_lists if odd_rest else ([1], [1, 2])))
    odd: tuple[dict[str, Any], ...] = ({"scenario": 3}, {"vary": []}, {"vary": {}}, {"set": 1}, {"extra": 1})
    changed = draw(st.sampled_from(odd)) if odd_rest and odd_values else {}
    text = tomli_w.dumps({**table, **changed}).encode()
    return Case(kind=kind, command=("sweep", "study.toml", *tail), files=(("study.toml", text),), steps=steps)


def every_key() -> set[str]:
    return {*_OF_TRAILERS, *_OF_ROVERS}


def keys_of_listing() -> set[str]:
    """Names of all keys that ``offtrack keys`` lists, without those of courses, of lists' tables and of parts."""
    listed = {key.name for name in (None, ROVERS[0]) for key in part_listing.keys(name)}
    apart = ("course.", "steering", "estimator", "driving", "sensing", "name", "description", "kind", "plant.units.")
    return {
        name for name in listed if not name.startswith(apart) and "[]" not in name and not name.endswith("parameters")
    }
