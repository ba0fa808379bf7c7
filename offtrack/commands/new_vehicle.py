"""`offtrack vehicle new`: a commented file of a vehicle, made from one that exists."""

import copy
import tomllib
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any, Final

import tomli_w
from pydantic import BaseModel

from offtrack.commands.console import PlainConsole
from scenarios.results.run_directory import check_new_file, replaced
from vehicle.combination.description import Vehicle, load_vehicle, vehicle_file, vehicle_from
from vehicle.combination.unit import AxleBrake
from vehicle.foundation.quantity import Option, tables_in
from vehicle.foundation.user_file import read_toml, without_sources
from vehicle.tyres.laws import tyre_law

_SPACING: Final = 1.31  # of the axles of a group [m]: usual for tridems
_MOST: Final = 10  # axles of a unit


def write_new_vehicle(name: str, like: str, axles: str | None, out: Path | None) -> None:
    """Write ``NAME.toml``, a vehicle like another one, each number with its unit, limits and usual value.

    ``axles`` are the numbers of axles of the units, front to rear: "2,3".

    Raises:
        ValueError: one line, if the name or a number is not valid, or the file exists.
    """
    load_vehicle(like)  # refuses an unknown one
    path = out or Path(f"{name}.toml")
    if not name.replace("_", "").replace("-", "").isalnum() or path.suffix != ".toml":
        raise ValueError(f"vehicle new {name}: a name has letters, digits, _ and -, and its file ends in .toml")
    check_new_file(path)
    table = copy.deepcopy(read_toml(vehicle_file(like)))
    table |= {"name": name, "summary": f"like {like}: replace what is different"}
    if axles is not None:
        _set_axles(table["units"], axles)
    head = f"# A vehicle like {like}. Each number has its unit, its limits and where its usual value comes from.\n"
    head += "# Positions along x are from the unit's origin, + forward; a towed unit's origin is its front hitch.\n"
    text = head + "\n".join(_lines(table, Vehicle)) + "\n"
    made = vehicle_from(without_sources(tomllib.loads(text)), str(path))
    replaced(path, text)
    console = PlainConsole()
    for line in (f"Vehicle: {path}", f"Its sheet: offtrack vehicle {path}"):
        console.print(line, soft_wrap=True)
    law = "" if made.n_by_law else " --set trailer_steering=none"
    drive = f"offtrack run roundabout --set vehicle={path} --set off_tracking=truth{law}"
    console.print(f"Drive it:  {drive}", soft_wrap=True)


def _set_axles(units: list[dict[str, Any]], axles: str) -> None:
    """Give each unit a number of axles; those of its rear group are alike, about the same middle."""
    counts = [text.strip() for text in axles.split(",")]
    if len(counts) != len(units) or not all(one.isdecimal() and 1 <= int(one) <= _MOST for one in counts):
        raise ValueError(f"--axles {axles}: expected {len(units)} numbers from 1 to {_MOST}, one for each unit")
    for k, (unit, count) in enumerate(zip(units, map(int, counts), strict=True)):
        present = unit["axles"]
        if count == len(present):
            continue
        first, group = (present[:1], present[1:]) if k == 0 else ([], present)
        if count <= len(first):
            raise ValueError(f"--axles {axles}: the first unit needs two axles or more to stand on")
        number = count - len(first)
        middle = sum(_plain(axle["x"]) for axle in group) / len(group)
        offsets = [_SPACING * (0.5 * (number - 1) - n) for n in range(number)]
        copies = [copy.deepcopy(group[min(n, len(group) - 1)]) for n in range(number)]
        for axle, offset in zip(copies, offsets, strict=True):
            axle["x"] = round(middle + offset, 3)
        unit["axles"] = [*first, *copies]


def _plain(number: Any) -> float:
    return float(number["value"] if isinstance(number, Mapping) else number)


def _lines(table: Mapping[str, Any], model: type[BaseModel] | None, place: str = "") -> Iterator[str]:
    """The table as TOML: its values with comments, then the tables in it."""
    inner = {key: value for key, value in table.items() if _is_table(value)}
    for key, value in table.items():
        if key not in inner:
            source = str(value["source"]) if isinstance(value, Mapping) else ""
            number = tomli_w.dumps({key: value["value"] if isinstance(value, Mapping) else value}).strip()
            yield "  # ".join(filter(None, (number, _comment(key, model, source))))
    for key, value in inner.items():
        own = _model_of(key, value, model, place)
        for one in value if isinstance(value, list) else [value]:
            bare = isinstance(value, Mapping) and all(map(_is_table, one.values()))  # tables of tables have no head
            if not bare:
                yield f"\n[[{place}{key}]]" if isinstance(value, list) else f"\n[{place}{key}]"
            yield from _lines(one, own, f"{place}{key}.")


def _is_table(value: object) -> bool:
    if isinstance(value, Mapping):
        return value.keys() != {"value", "source"}
    return isinstance(value, list) and bool(value) and all(isinstance(one, Mapping) for one in value)


def _model_of(key: str, value: Any, model: type[BaseModel] | None, place: str) -> type[BaseModel] | None:
    """Model of a table in another one; tyres and axles' brakes stand apart from the axles that name them."""
    if place == "tyres.":
        law: Any = tyre_law(value.get("model") or value.get("law"))
        return law if isinstance(law, type) and issubclass(law, BaseModel) else None
    if place == "axle_brakes.":
        return AxleBrake
    field = model.model_fields.get(key) if model else None
    return next(iter(tables_in(field.annotation)), None) if field else None


def _comment(key: str, model: type[BaseModel] | None, source: str) -> str:
    """Unit and limits of a key, and the source of its value."""
    field = model.model_fields.get(key) if model else None
    option = Option.of(key, field) if field else None
    unit = f"[{option.unit}]" if option and option.kind in (int, float) else ""
    limits = option.range if option else ""
    return ", ".join(filter(None, (unit, limits, f"usual: {source}" if source else "")))
