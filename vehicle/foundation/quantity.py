"""Numbers, words and flags of files, scenarios, parts and commands: default, unit, limits and meaning once; refusals.

A field of a `Frozen` table is declared by `quantity` (a number) or `option` (anything else). Its declaration is read
back as an `Option`: by the listings of keys and parts, by tuning, and by the one writer of refusals. An `Option` can
also be written down by itself, as a parameter of a part of one's own.

The limits of a vehicle's numbers refuse what no vehicle on a road can have: mistakes of unit, sign and decimal point.
Each has its reason, which the refusal shows. Numbers that are possible but contradict one another are warned of in
``vehicle.combination.data_sheet``.
"""

import math
import types
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Annotated, Any, Final, Literal, NamedTuple, TypeAlias, TypeVar, Union, get_args, get_origin

import tomli_w
from pydantic import BaseModel, ConfigDict, Field, ValidationError, model_validator
from pydantic.fields import FieldInfo
from pydantic_core import ErrorDetails

from vehicle.foundation.user_file import nearest, shown

Model = TypeVar("Model", bound=BaseModel)
Parameter: TypeAlias = bool | int | float | str
_NOUNS: Final[Mapping[object, str]] = {
    bool: "true or false",
    int: "a whole number",
    float: "a number",
    str: "a text",
    tuple: "a list",
    dict: "a table",
}
_OF_OPTIONS: Final = (  # pydantic's errors that are about the limits or the type of one value
    *("greater_than", "greater_than_equal", "less_than_equal", "finite_number"),
    *("float_type", "int_type", "bool_type", "string_type", "tuple_type", "dict_type", "literal_error"),
)
_WANTED: Final = {  # by other errors
    "model_type": "must be a table",
    "model_attributes_type": "must be a table",
    "string_pattern_mismatch": "must consist of letters, digits, dots, _ and -",
}


@dataclass(frozen=True, slots=True)
class Option:
    """One parameter of a replaceable part, such as a steering law or an estimator, or one key of a file."""

    name: str
    default: Any  # None: required, or derived by the part; ``default_text`` says which
    meaning: str  # one line
    unit: str = "-"
    low: float = -math.inf
    high: float = math.inf
    tune: tuple[float, float] | None = None  # range that `offtrack tune` searches; None: not tuned
    choices: tuple[str, ...] = ()  # of a text; none: any text
    type_without_default: type[object] = float
    default_text: str = ""
    above: bool = False  # True: ``low`` itself is refused
    why: str = ""  # reason of the limits

    @classmethod
    def of(cls, name: str, field: FieldInfo) -> "Option":
        """The declaration of a table's field."""
        notes = [field, *_notes_in(field.annotation)]
        limits = {type(limit).__name__: limit for note in notes for limit in note.metadata}
        extra: dict[str, Any] = {}
        for note in notes:
            extra |= note.json_schema_extra if isinstance(note.json_schema_extra, dict) else {}
        kind = _core(field.annotation)
        choices = tuple(map(str, get_args(kind))) if get_origin(kind) is Literal else ()
        plain = str if choices else get_origin(kind) or kind
        default = None if field.is_required() else field.get_default(call_default_factory=True)
        return cls(
            name,
            float(default) if plain is float and isinstance(default, int) else default,
            field.description or "",
            low=limits["Gt"].gt if "Gt" in limits else limits["Ge"].ge if "Ge" in limits else -math.inf,
            high=limits["Le"].le if "Le" in limits else math.inf,
            choices=choices,
            type_without_default=plain,
            above="Gt" in limits,
            **{"default_text": "required" if field.is_required() else "", **extra},
        )

    @property
    def kind(self) -> type[object]:
        """Type of the values; a float accepts an integer."""
        fixed = self.default is None or self.type_without_default is not float
        return self.type_without_default if fixed else type(self.default)

    @property
    def limits(self) -> str:
        """Limits with their unit, for messages and help: ``between 0 and 2 rad/m``; empty without limits."""
        unit = "" if self.unit == "-" else f" {self.unit}"
        most = f"{self.high:g}{unit}"
        if self.above:
            return f"above {self.low:g} and at most {most}" if math.isfinite(self.high) else f"above {self.low:g}{unit}"
        if math.isfinite(self.low) and math.isfinite(self.high):
            return f"between {self.low:g} and {most}"
        if math.isfinite(self.low):
            return f"at least {self.low:g}{unit}"
        return f"at most {most}" if math.isfinite(self.high) else ""

    @property
    def range(self) -> str:
        """Limits for a table with a column of units: ``0 .. 2``, ``above 0 .. 2``; empty without limits."""
        if math.isfinite(self.low) and math.isfinite(self.high):
            return f"{'above ' * self.above}{self.low:g} .. {self.high:g}"
        return self.limits

    def check(self, value: object, key: str) -> None:
        """Check type, choices and limits of a value.

        Raises:
            ValueError: one line with key, value, limits and unit.
        """
        if isinstance(value, str) and self._is_of_kind(value):
            accepted = not self.choices or value in self.choices
        elif self._is_of_kind(value) and isinstance(value, int | float):
            least = self.low < value if self.above else self.low <= value
            accepted = least and value <= self.high and -math.inf < value < math.inf  # whole numbers exceed floats
        else:
            accepted = self._is_of_kind(value)
        if not accepted:
            raise ValueError(self.refusal(value, key))

    def refusal(self, value: object, key: str) -> str:
        """One line on a refused value: key, value, unit, what it must be, and why."""
        if self.choices and isinstance(value, str):
            return f"{key} = '{shown(value)}'{nearest(value, self.choices)}"
        if not self._is_of_kind(value):
            noun = ", ".join(self.choices) if self.choices else _NOUNS.get(self.kind, f"of type {self.kind.__name__}")
            joint = " " if not self.limits or self.limits.startswith("between") else ", "
            return f"{key} = {shown(repr(value))} must be {noun}{joint}{self.limits}".rstrip()
        unit = "" if self.unit == "-" else f" {self.unit}"
        why = f": {self.why}" if self.why else ""
        return f"{key} = {shown(str(value))}{unit} must be {self.limits or 'finite'}{why}"

    def _is_of_kind(self, value: object) -> bool:
        accepted = (int, float) if self.kind is float else self.kind
        return isinstance(value, accepted) and not (isinstance(value, bool) and self.kind in (int, float))


def quantity(
    default: Any,
    unit: str,
    low: float,
    high: float,
    meaning: str | None = None,
    *,
    above: bool = False,
    tune: tuple[float, float] | None = None,
    why: str | None = None,
    default_text: str | None = None,
) -> Any:
    """Field of a number.

    Args:
        default: number, None, or ``...`` if it must be given.
        unit: as messages show it; "-" for none.
        low: least value; with ``above`` it is refused itself.
        high: largest value.
        meaning: one line.
        above: True if the number must be above ``low``.
        tune: range that `offtrack tune` searches.
        why: reason of the limits, which a refusal shows.
        default_text: what stands in for a default of None.
    """
    notes = {"unit": unit, "tune": tune, "why": why, "default_text": default_text}
    least: dict[str, Any] = {"gt": low} if above else {"ge": low}
    extra: dict[str, Any] = {key: note for key, note in notes.items() if note is not None}
    return Field(default, **least, le=high, description=meaning, json_schema_extra=extra)


def option(meaning: str, default: Any = ...) -> Any:
    """Field of anything else than a number; required if it has no default."""
    return Field(default, description=meaning)


class Frozen(BaseModel):
    """Base of all tables: immutable, validated, unknown keys refused; a boolean or a text is no number."""

    model_config = ConfigDict(defer_build=True, frozen=True, extra="forbid", allow_inf_nan=False, strict=True)

    @model_validator(mode="before")
    @classmethod
    def _with_tuples(cls, table: Any) -> Any:
        """The table of a file with tuples in place of its lists."""
        return {key: _as_tuple(value) for key, value in table.items()} if isinstance(table, dict) else table


def _as_tuple(value: Any) -> Any:
    return tuple(map(_as_tuple, value)) if isinstance(value, list) else value


def check_number(
    key: str, value: float | None, low: float, high: float, unit: str = "-", *, above: bool = False, why: str = ""
) -> None:
    """Refuse a number outside its limits, and one that is not finite; None is accepted.

    Raises:
        ValueError: one line with key, value, limits and unit.
    """
    if value is not None:
        number = value if isinstance(value, int) else float(value)
        Option(key, 0.0, "", unit, low, high, above=above, why=why).check(number, key)


def checked(
    model: type[Model],
    plain: Mapping[str, Any],
    file: str,
    table: str = "",
    usual: Callable[[], Mapping[str, Any]] = dict,
) -> Model:
    """Build the model from plain contents, which are the ``table`` of this dotted name in the file.

    ``usual`` reads a complete file, whose values are shown for keys that are missing.

    Raises:
        ValueError: one line naming file, dotted key, value, limit and unit of the first thing wrong, or all keys that
            are missing.
    """
    try:
        return model.model_validate(plain)
    except ValidationError as error:
        raise ValueError(f"{file}: {complaint(model, error, table, usual=usual)}") from error


def complaint(
    model: type[BaseModel],
    error: ValidationError,
    table: str = "",
    *,
    known: Sequence[str] = (),
    usual: Callable[[], Mapping[str, Any]] = dict,
) -> str:
    """One line on the first thing wrong with contents: an unknown key, keys that are missing, or a refused value.

    Args:
        model: of the contents.
        error: of its validation.
        table: dotted name under which a file has the contents; empty: they are the whole file.
        known: dotted names of all keys, to find the one that was meant; empty: those of the same table.
        usual: reads a complete file, see `checked`.
    """
    errors = error.errors(include_url=False)
    first = next((one for one in errors if one["type"] == "extra_forbidden"), errors[0])  # a misspelt key also lacks
    place = _place(model, first, table)
    if first["type"] == "extra_forbidden":
        name = ".".join(part for part in place.key.split(".") if not part.isdigit())
        if not known or name in known:
            of = " for this kind" if known else ""
            return f"unknown key '{shown(place.key)}'{of}{nearest(str(first['loc'][-1]), place.siblings)}"
        hint = nearest(name, known)
        return f"unknown key '{shown(place.key)}'{hint}{'' if hint.endswith('?') else '; offtrack keys lists all'}"
    if first["type"] in ("missing", "union_tag_not_found"):
        places = [_place(model, one, table) for one in errors if one["type"] in ("missing", "union_tag_not_found")]
        return _missing(places, usual())
    if first["type"] == "union_tag_invalid":
        kinds = first["ctx"]["expected_tags"].replace("'", "").split(", ")
        return f"{place.key} = '{shown(first['ctx']['tag'])}'{nearest(first['ctx']['tag'], kinds)}"
    if first["type"] == "value_error":
        message = shown(first["msg"].removeprefix("Value error, "), 500)
        return f"{place.key}: {message}" if place.key else message
    if place.option is not None and first["type"] in _OF_OPTIONS:
        return place.option.refusal(first["input"], place.key)
    wanted = _WANTED.get(first["type"], first["msg"].replace("Input should be", "must be"))
    if place.option is None and first["type"].endswith("_type"):  # of a part's parameter, the first of several types
        wanted = "must be a finite number, true, false or text"
    return f"{place.key} = {shown(repr(first['input']))} {shown(wanted, 300)}"


class _Place(NamedTuple):
    """What an error is about."""

    key: str  # dotted, as in a file
    option: Option | None  # None: a table, or a key that the model does not know
    siblings: tuple[str, ...]  # keys of its table

    @property
    def named(self) -> str:
        """The key with its unit."""
        return f"'{self.key}'{'' if self.option is None or self.option.unit == '-' else f' [{self.option.unit}]'}"

    def usual(self, contents: Mapping[str, Any]) -> str:
        """The value of complete contents, for a message."""
        value: Any = contents
        for part in self.key.split("."):
            if isinstance(value, Mapping):
                named = all(isinstance(table, Mapping) for table in value.values())  # the first stands for other names
                value = value.get(part, next(iter(value.values()), None) if named else None)
            else:  # the last one stands for those beyond
                is_list = isinstance(value, list) and value and part.isdigit()
                value = value[min(int(part), len(value) - 1)] if is_list else None
        is_plain = isinstance(value, bool | int | float | str)
        return f" (usual: {tomli_w.dumps({'value': value})[8:].strip()})" if is_plain else ""


def _place(model: type[BaseModel], error: ErrorDetails, table: str) -> _Place:
    tables: tuple[type[BaseModel], ...] = (model,)
    words, siblings = [table] if table else [], tuple[str, ...]()
    option: Option | None = None
    entry: type[object] | None = None  # of a list
    of_several = error["type"].endswith("_type") and error["loc"][-1:] == ("bool",)  # the first of a union's types
    for part in error["loc"][:-1] if of_several else error["loc"]:
        if tables and isinstance(part, str):
            chosen = tuple(one for one in tables if len(tables) > 1 and part in _kinds(one))
            if chosen:
                tables = chosen
                continue
            siblings = tuple(name for one in tables for name in one.model_fields)
            field = next((one.model_fields[part] for one in tables if part in one.model_fields), None)
            option = None if field is None else Option.of(part, field)
            entry = None if field is None else _entry(field.annotation)
            tables = () if field is None else tables_in(field.annotation)
        elif option is not None and not tables:
            option = None if entry is None else replace(option, default=None, type_without_default=entry)
        words.append(str(part))
    if error["type"].startswith("union_tag"):
        words.append("kind")
    return _Place(".".join(words), option, siblings)


def _missing(places: Sequence[_Place], usual: Mapping[str, Any]) -> str:
    """One line on all keys that are missing."""
    if len(places) == 1:
        return f"key {places[0].named} is missing{places[0].usual(usual)}"
    return f"keys are missing: {', '.join(f'{place.named}{place.usual(usual)}' for place in places)}"


def tables_in(annotation: object) -> tuple[type[BaseModel], ...]:
    """All tables in a field's annotation: alone, in a list or as alternatives."""
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        return (annotation,)
    return tuple(table for part in get_args(annotation) for table in tables_in(part))


def _kinds(table: type[BaseModel]) -> tuple[str, ...]:
    """Values of its key ``kind`` by which a table is chosen among others."""
    return get_args(table.model_fields["kind"].annotation) if "kind" in table.model_fields else ()


def _notes_in(annotation: object) -> Iterator[FieldInfo]:
    """Declarations inside ``Annotated[...] | None`` and ``tuple[Annotated[...], ...]``."""
    yield from (note for note in getattr(annotation, "__metadata__", ()) if isinstance(note, FieldInfo))
    for inner in get_args(annotation):
        yield from _notes_in(inner)


def _core(annotation: Any) -> Any:
    """The type inside ``Annotated[...]`` and ``... | None``."""
    if get_origin(annotation) is Annotated:
        return _core(get_args(annotation)[0])
    if get_origin(annotation) in (Union, types.UnionType):
        return _core(next(part for part in get_args(annotation) if part is not types.NoneType))
    return annotation


def _entry(annotation: object) -> type[object] | None:
    """Type of a list's entries; None: it is no list."""
    core = _core(annotation)
    kind = _core(get_args(core)[0]) if get_origin(core) is tuple else None
    return kind if isinstance(kind, type) else None


Mass = Annotated[
    float,
    quantity(..., "kg", 100.0, 2e5, why="a unit weighs 100 kg, a car's trailer, to 200 t, a heavy-haulage module"),
]
Inertia = Annotated[
    float,
    quantity(..., "kg m2", 10.0, 1e7, why="10 is 100 kg with a radius of gyration of 0.3 m, 1e7 is 200 t with 7 m"),
]
Position = Annotated[
    float, quantity(..., "m", -40.0, 40.0, why="no unit is longer than 40 m; positions are in its own frame")
]
Length = Annotated[float, quantity(..., "m", 0.0, 10.0, above=True, why="a length in m, below that of a unit")]
Breadth = Annotated[
    float, quantity(..., "m", 0.5, 8.0, why="road vehicles are 0.5 m to 2.6 m wide, abnormal loads up to 8 m")
]
Height = Annotated[
    float, quantity(..., "m", 0.1, 8.0, why="road vehicles are up to 4.6 m high, abnormal loads up to 8 m")
]
Fraction = Annotated[float, quantity(..., "-", 0.0, 1.0, why="a share is from 0 to 1, not per cent")]
Lag = Annotated[
    float,
    quantity(
        *(..., "s", 0.0, 5.0), above=True, why="a lag is above 0 s; with one of more than 5 s nothing is controlled"
    ),
]
Gradient = Annotated[
    float,
    quantity(
        *(..., "rad/(m/s2)", 1e-5, 0.05),
        why="a body tilts by at least 0.006 deg/g, rigid axles on solid tyres, and at 28 deg/g it falls over",
    ),
]
Frequency = Annotated[
    float,
    quantity(
        *(..., "Hz", 0.2, 5.0),
        why="springs of 0.2 Hz give way by 6 m under the weight; 5 Hz is stiffer than tyres without springs, and too "
        "stiff for a step of 1 ms",
    ),
]
