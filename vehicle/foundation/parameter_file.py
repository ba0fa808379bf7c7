"""Parameter files: TOML with sources, libraries of them, and types of numbers with unit and limits.

A number is written plain or as ``{ value = 8000.0, source = "weighed" }``; models see the plain number only.

The limits of a combination's numbers refuse what no vehicle on a road can have: mistakes of unit, sign and decimal
point. Each has its reason, which the error message shows. Numbers that are possible but contradict one another are
warned of in ``vehicle.combination.data_sheet``.
"""

from __future__ import annotations

import difflib
import re
import tomllib
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from importlib import resources
from pathlib import Path
from typing import Annotated, Any, Final, TypeVar

from pydantic import BaseModel, ConfigDict, Field, ValidationError

from vehicle.foundation.user_file import MAX_NESTING, FileKind, FileType, read_text, shown

_LISTED: Final = 20  # words in an error message
_COMPARED: Final = 100  # characters of a word
Model = TypeVar("Model", bound=BaseModel)
_PART: Final = r"""(?:[\w-]++|"[^"\n]*+"|'[^'\n]*+')[ \t]*+"""
_LONG_KEY: Final = re.compile(  # takes tomllib quadratic time
    rf"(?:^|[{{,])[ \t]*+\[{{0,2}}[ \t]*+(?:{_PART}\.[ \t]*+){{{MAX_NESTING}}}", re.MULTILINE
)

_OF_LIMITS: Final = ("greater_than", "greater_than_equal", "less_than", "less_than_equal")  # pydantic's errors
_TOO_DEEP: Final = f"tables and lists must be nested at most {MAX_NESTING} deep"
_TOO_BIG: Final = "an integer must fit into 64 bits"


def read_toml(path: Path, kind: FileType = FileKind.PARAMETERS) -> dict[str, Any]:
    """Contents of a TOML file, sources included.

    Raises:
        ValueError: one line, if the file cannot be read or is not TOML.
    """
    try:
        return parsed_toml(read_text(path, kind))
    except tomllib.TOMLDecodeError as error:
        raise ValueError(f"{path}: not a TOML file: {shown(str(error), 200)}") from error


def parsed_toml(text: str) -> dict[str, Any]:
    """Tables of a TOML text.

    Raises:
        TOMLDecodeError: one line, if it is not TOML, is nested deeper than ``MAX_NESTING``, or has an integer that does
            not fit into 64 bits.
    """
    if _LONG_KEY.search(text):
        raise tomllib.TOMLDecodeError(f"a key has more than {MAX_NESTING} parts")
    try:
        table = tomllib.loads(text)
    except tomllib.TOMLDecodeError:
        raise
    except (RecursionError, ValueError) as error:  # ValueError: an integer of thousands of digits
        raise tomllib.TOMLDecodeError(_TOO_DEEP if isinstance(error, RecursionError) else _TOO_BIG) from None
    _check_tree(table)
    return table


def _check_tree(table: dict[str, Any]) -> None:
    level: list[Any] = [table]
    for _ in range(MAX_NESTING + 1):  # no recursion, which has its own limit
        if any(isinstance(node, int) and not -(2**63) <= node < 2**63 for node in level):
            raise tomllib.TOMLDecodeError(_TOO_BIG)
        level = [child for node in level for child in _children(node)]
    if level:
        raise tomllib.TOMLDecodeError(_TOO_DEEP)


def _children(node: Any) -> Iterable[Any]:
    return node.values() if isinstance(node, dict) else node if isinstance(node, list) else ()


def without_sources(node: Any) -> Any:
    """Copy of the tree with every ``{value, source}`` replaced by its value."""
    if isinstance(node, dict):
        if node.keys() == {"value", "source"}:
            return node["value"]
        return {key: without_sources(child) for key, child in node.items()}
    if isinstance(node, list):
        return [without_sources(child) for child in node]
    return node


def sources(node: Any, key: str = "") -> dict[str, str]:
    """Sources of the numbers that state one, by dotted key."""
    if isinstance(node, dict) and node.keys() == {"value", "source"}:
        return {key: str(node["source"])}
    children = node.items() if isinstance(node, dict) else enumerate(node) if isinstance(node, list) else ()
    by_key: dict[str, str] = {}
    for name, child in children:
        by_key |= sources(child, f"{key}.{name}" if key else str(name))
    return by_key


def checked(model: type[Model], plain: dict[str, Any], file: str, table: str = "") -> Model:
    """Build the model from plain contents, which are the ``table`` of this dotted name in the file.

    Raises:
        ValueError: one line naming file, dotted key, value, limit and unit of the first thing wrong.
    """
    try:
        return model.model_validate(plain)
    except ValidationError as error:
        raise ValueError(f"{file}: {_first_error(model, error, table)}") from error


def nearest(word: str, known: Iterable[str]) -> str:
    """Ending of an error message on an unknown word: the known word most like it, or else known words, not too many."""
    words, word = list(known), word[:_COMPARED]
    close = difflib.get_close_matches(word, words, n=1, cutoff=0.5)
    if close:
        return f"; did you mean '{close[0]}'?"
    if len(words) > _LISTED:
        return f"; most like it: {', '.join(difflib.get_close_matches(word, words, n=3, cutoff=0.0))}"
    return f"; known: {', '.join(words)}"


def _first_error(model: type[BaseModel], error: ValidationError, table: str) -> str:
    errors = error.errors()
    unknown = [one for one in errors if one["type"] == "extra_forbidden"]  # a misspelt key is also a missing one
    first = (unknown or errors)[0]
    key = ".".join(str(part) for part in (*([table] if table else []), *first["loc"]))
    if first["type"] == "extra_forbidden":
        known = _fields_at(model, first["loc"][:-1])
        return f"unknown key '{shown(key)}'{nearest(str(first['loc'][-1]), known)}"
    if first["type"] == "missing":
        return f"key '{key}'{_unit_at(model, first['loc'])} is missing"
    message = shown(first["msg"].removeprefix("Value error, "), 300)
    if first["type"] == "value_error":
        return f"{key}: {message}" if key else message
    limit = message.replace("Input should be", "must be")
    why = _note_at(model, first["loc"], "why") if first["type"] in _OF_LIMITS else ""
    return f"{key} = {shown(repr(first['input']))} {limit}{_unit_at(model, first['loc'])}{f': {why}' if why else ''}"


def _fields_at(model: type[BaseModel], location: tuple[int | str, ...]) -> dict[str, Any]:
    """Fields of the model at the location of an error."""
    for part in location:
        if isinstance(part, str):
            model = _model_in(model.model_fields[part].annotation)
    return dict(model.model_fields)


def _model_in(annotation: Any) -> type[BaseModel]:
    """The model inside ``Model``, ``Model | None`` or ``tuple[Model, ...]``."""
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        return annotation
    return next(_model_in(inner) for inner in annotation.__args__ if inner not in (type(None), Ellipsis))


def _unit_at(model: type[BaseModel], location: tuple[int | str, ...]) -> str:
    unit = _note_at(model, location, "unit")
    return f" [{unit}]" if unit else ""


def _note_at(model: type[BaseModel], location: tuple[int | str, ...], note: str) -> str:
    """Schema extra of a quantity, such as its unit; empty if it has none."""
    *path, name = (part for part in location if isinstance(part, str))  # an entry of a list has the list's notes
    field = _fields_at(model, tuple(path)).get(name)
    extras = [] if field is None else [field.json_schema_extra, *_extras_in(field.annotation)]
    return next((str(extra[note]) for extra in extras if isinstance(extra, dict) and note in extra), "")


def _extras_in(annotation: Any) -> Iterator[Any]:
    """Schema extras of the fields inside ``tuple[Annotated[...], ...]``."""
    for inner in getattr(annotation, "__args__", ()):
        yield from (getattr(entry, "json_schema_extra", None) for entry in getattr(inner, "__metadata__", ()))


@dataclass(frozen=True, slots=True)
class ParameterLibrary:
    """All parameter files of one kind."""

    kind: str  # noun for messages: "vehicle"
    folder: str  # in this package

    def names(self) -> tuple[str, ...]:
        """Names of the files, without suffix."""
        return tuple(sorted(path.stem for path in self._home().glob("*.toml")))

    def file(self, name_or_path: str) -> Path:
        """Path of the file of this name; a path that ends in ``.toml`` is returned as it is.

        Raises:
            ValueError: one line with the nearest known name.
        """
        if name_or_path.endswith(".toml"):
            return Path(name_or_path)
        known = self.names()
        if name_or_path not in known:
            hint = nearest(name_or_path, known)
            raise ValueError(f"unknown {self.kind} '{name_or_path}'{hint} (known: {', '.join(known)}; or a .toml file)")
        return self._home() / f"{name_or_path}.toml"

    def _home(self) -> Path:
        return Path(str(resources.files("vehicle"))) / self.folder


def quantity(
    unit: str,
    *,
    ge: float | None = None,
    gt: float | None = None,
    le: float,
    meaning: str | None = None,
    why: str | None = None,
) -> Any:
    """Pydantic field of a number: its limits, the unit that error messages name, its meaning, reason of the limits."""
    extra: dict[str, Any] = {"unit": unit} | ({} if why is None else {"why": why})
    return Field(ge=ge, gt=gt, le=le, strict=True, allow_inf_nan=False, json_schema_extra=extra, description=meaning)


Mass = Annotated[
    float,
    quantity("kg", ge=100.0, le=2e5, why="a unit weighs 100 kg, a car's trailer, to 200 t, a heavy-haulage module"),
]
Inertia = Annotated[
    float,
    quantity("kg m2", ge=10.0, le=1e7, why="10 is 100 kg with a radius of gyration of 0.3 m, 1e7 is 200 t with 7 m"),
]
Position = Annotated[
    float, quantity("m", ge=-40.0, le=40.0, why="no unit is longer than 40 m; positions are in its own frame")
]
Length = Annotated[float, quantity("m", gt=0.0, le=10.0, why="a length in m, below that of a unit")]
Breadth = Annotated[
    float, quantity("m", ge=0.5, le=8.0, why="road vehicles are 0.5 m to 2.6 m wide, abnormal loads up to 8 m")
]
Height = Annotated[
    float, quantity("m", ge=0.1, le=8.0, why="road vehicles are up to 4.6 m high, abnormal loads up to 8 m")
]
Fraction = Annotated[float, quantity("-", ge=0.0, le=1.0, why="a share is from 0 to 1, not per cent")]
Flag = Annotated[bool, Field(strict=True)]
Lag = Annotated[
    float, quantity("s", gt=0.0, le=5.0, why="a lag is above 0 s; with one of more than 5 s nothing is controlled")
]
Gradient = Annotated[
    float,
    quantity(
        "rad/(m/s2)",
        ge=1e-5,
        le=0.05,
        why="a body tilts by at least 0.006 deg/g, rigid axles on solid tyres, and at 28 deg/g it falls over",
    ),
]
Frequency = Annotated[
    float,
    quantity(
        "Hz",
        ge=0.2,
        le=5.0,
        why="springs of 0.2 Hz give way by 6 m under the weight; 5 Hz is stiffer than tyres without springs, and too "
        "stiff for a step of 1 ms",
    ),
]


class Frozen(BaseModel):
    """Immutable, validated model that accepts no unknown keys."""

    model_config = ConfigDict(frozen=True, extra="forbid")
