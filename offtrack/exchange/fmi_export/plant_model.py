"""Content of an FMU: what the exporter needs of a plant, and the variables and sources that follow."""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Final

import casadi as ca
from pydantic import BaseModel
from pydantic.fields import FieldInfo

from offtrack.exchange.fmi_export.c_files import c_files, parameters_read, plant_header
from offtrack.exchange.fmi_export.variables import Interface, Quantity, Variable
from vehicle.engine.program import TapeProgram

_LONGEST_NAME: Final = 60


@dataclass(frozen=True, slots=True, kw_only=True)
class PlantModel:
    """A plant as programs with names for their entries."""

    name: str
    summary: str
    kind: str  # name of its fixed C file
    interface: Interface
    programs: Mapping[str, TapeProgram]  # step, observe and what the fixed file calls besides
    defined: Mapping[str, object]  # macros for the fixed file
    gear: int | None  # place of the input that must be 1 or -1
    fixed: Sequence[tuple[str, str]]  # what is fixed at export: path and value
    internal_step: float | None  # of the integration [s]; None: the communication step decides it
    stepping: str  # a sentence on it

    @property
    def identifier(self) -> str:
        """Model identifier: a C name, and the name of the library."""
        return "offtrack_" + re.sub(r"\W", "_", self.name, flags=re.ASCII)[:_LONGEST_NAME]


def interface_of(
    parameters: Sequence[Quantity],
    starts: Sequence[Quantity],
    inputs: Sequence[Quantity],
    outputs: Sequence[Quantity],
    observe: Any,
    programs: Mapping[str, TapeProgram],
) -> Interface:
    """Interface of a plant; ``observe`` is its function (state, inputs, parameters) -> outputs."""
    read = parameters_read(programs)
    pattern = observe.jac_sparsity(0, 1)
    by_output: list[list[int]] = [[] for _ in outputs]
    for row, column in zip(*pattern.get_triplet(), strict=True):
        by_output[row].append(column)
    return Interface(
        parameters=[*parameters, *starts],
        fixed=frozenset(range(len(parameters))) - read,
        inputs=inputs,
        outputs=outputs,
        feed_through=by_output,
    )


def start_quantities(frame: str) -> list[Quantity]:
    """Pose and speed at the start, in the order that the C files read them."""
    return [
        Quantity("start_x", "m", f"position of {frame} in W at the start"),
        Quantity("start_y", "m", f"position of {frame} in W at the start"),
        Quantity("start_psi", "rad", "heading at the start, + left"),
        Quantity("start_speed", "m/s", "speed at the start, straight ahead and rolling freely"),
    ]


def number_quantity(root: BaseModel, path: str, value: float, prefix: str = "") -> Quantity:
    """Parameter for the number at a path of a model, with the unit and limits of its field."""
    owner: Any = root
    info: FieldInfo | None = None
    for key in path.split("."):
        if key.isdigit():
            owner = owner[int(key)]
        else:
            info = _field(type(owner), key) or info
            owner = getattr(owner, key)
    extra = info.json_schema_extra if info is not None and isinstance(info.json_schema_extra, dict) else {}
    unit, low, high = str(extra.get("unit", "-")), None, None
    for limit in info.metadata if info is not None else ():
        low = getattr(limit, "ge", getattr(limit, "gt", low))
        high = getattr(limit, "le", high)
    meaning = (info.description if info is not None else None) or "number of the vehicle file"
    return Quantity(prefix + path, unit, meaning, value, low, high)


def fixed_values(root: BaseModel, unread: Iterable[Quantity]) -> list[tuple[str, str]]:
    """Flags and words of a model, and its numbers that no equation reads."""
    return [*_words(root, ""), *((quantity.name, f"{quantity.start:.10g}") for quantity in unread)]


def vector(n: int) -> Any:
    """Symbols of a vector."""
    return ca.SX.sym("v", n)


def _words(thing: Any, path: str) -> Iterable[tuple[str, str]]:
    if isinstance(thing, BaseModel):
        for key, value in thing:
            yield from _words(value, f"{path}.{key}" if path else key)
    elif isinstance(thing, tuple | list):
        for k, value in enumerate(thing):
            yield from _words(value, f"{path}.{k}")
    elif isinstance(thing, bool | str) and path.rsplit(".", 1)[-1] != "summary":
        yield path, str(thing).lower() if isinstance(thing, bool) else thing


def _field(model: type[BaseModel], key: str) -> FieldInfo | None:
    """The field with unit and limits; of an optional number that of its other type."""
    field = model.model_fields.get(key)
    if field is None or field.json_schema_extra:
        return field
    return next(_quantities(field.annotation), field)


def _quantities(annotation: Any) -> Iterator[FieldInfo]:
    for extra in getattr(annotation, "__metadata__", ()):
        if isinstance(extra, FieldInfo) and extra.json_schema_extra:
            yield extra
    for inner in getattr(annotation, "__args__", ()):
        yield from _quantities(inner)


@dataclass(frozen=True, slots=True, kw_only=True)
class Exported:
    """An FMU before it is compiled."""

    name: str
    identifier: str  # a C name, and the name of the library
    summary: str
    variables: Sequence[Variable]
    sources: Mapping[str, str]  # C files and headers by name, without ``token.h``
    notes: Sequence[str]  # paragraphs of its page
    fixed: Sequence[tuple[str, str]] = ()  # what is fixed at export: path and value
    resources: Mapping[str, bytes] = field(default_factory=dict)
    keeps_state: bool = True  # its state can be taken, serialised and set
    tool_only: bool = False  # it needs another program on the machine
    internal_step: float | None = None  # [s]; None: it is not declared
    step: float = 0.01  # a step that suits most uses [s]
    stop: float = 20.0  # an end that suits most uses [s]


def exported_plant(model: PlantModel, version: int) -> Exported:
    """The FMU of a plant."""
    sources = c_files(model.identifier, model.kind, version, model.programs, model.defined)
    return Exported(
        name=model.name,
        identifier=model.identifier,
        summary=model.summary,
        variables=model.interface.variables(),
        sources={**sources, "plant.h": plant_header(model.interface, model.programs, model.gear)},
        notes=(f"{model.stepping} Communication steps are whole numbers of milliseconds; inputs hold during one.",),
        fixed=model.fixed,
        internal_step=model.internal_step,
    )
