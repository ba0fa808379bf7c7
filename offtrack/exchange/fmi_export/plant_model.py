"""Content of an FMU: its variables with units and references, what the exporter needs of a plant, and its C files.

The functions of FMI 3 that a plant does not need are written from the standard's own header, so that none is forgotten.
The headers are those that FMPy ships.
"""

import math
import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from importlib import resources
from pathlib import Path
from typing import Any, Final, Literal, NamedTuple

import casadi as ca
from pydantic import BaseModel
from pydantic.fields import FieldInfo

from offtrack.exchange.fmi_import.mapping import Signal
from scenarios.extras import import_extra
from vehicle.engine.native import c_source, numbers_source
from vehicle.engine.program import Entry, TapeProgram

Causality = Literal["parameter", "input", "output"]


@dataclass(frozen=True, slots=True, kw_only=True)
class Variable:
    """A signal as a variable of the FMU."""

    signal: Signal
    causality: Causality
    reference: int  # value reference; 0 is the time
    feed_through: tuple[int, ...] = ()  # of an output: references of the inputs that it depends on at once
    held: bool = False  # an output that begins at its start value, and changes in steps alone
    text: str | None = None  # start of a text; None: a number


@dataclass(frozen=True, slots=True, kw_only=True)
class Interface:
    """All vectors of a plant; an entry's place in its vector decides its value reference."""

    parameters: Sequence[Signal]  # all numbers of the model, with those that are fixed
    fixed: frozenset[int]  # places of parameters that no equation reads: they are no variables
    inputs: Sequence[Signal]
    outputs: Sequence[Signal]
    feed_through: Sequence[Sequence[int]]  # by output, places of inputs

    def variables(self) -> tuple[Variable, ...]:
        """Parameters, inputs and outputs with their references, as the C source counts them."""
        first_input = 1 + len(self.parameters)
        first_output = first_input + len(self.inputs)
        of_causality: Mapping[Causality, Sequence[Signal]]
        of_causality = {"parameter": self.parameters, "input": self.inputs, "output": self.outputs}
        signals = [(causality, one) for causality, of in of_causality.items() for one in of]
        outputs = dict(enumerate(self.feed_through, start=first_output))
        return tuple(
            Variable(
                signal=one,
                causality=causality,
                reference=k,
                feed_through=tuple(first_input + i for i in outputs.get(k, ())),
            )
            for k, (causality, one) in enumerate(signals, start=1)
            if k - 1 not in self.fixed
        )


class BaseUnit(NamedTuple):
    """SI exponents of a unit and its factor: SI value = factor * value."""

    exponents: Mapping[str, int]
    factor: float = 1.0


_ATOMS: Final = {
    "kg": BaseUnit({"kg": 1}),
    "m": BaseUnit({"m": 1}),
    "s": BaseUnit({"s": 1}),
    "rad": BaseUnit({"rad": 1}),
    "N": BaseUnit({"kg": 1, "m": 1, "s": -2}),
    "Pa": BaseUnit({"kg": 1, "m": -1, "s": -2}),
    "W": BaseUnit({"kg": 1, "m": 2, "s": -3}),
    "Hz": BaseUnit({"s": -1}),
    "deg": BaseUnit({"rad": 1}, math.pi / 180.0),
    "1": BaseUnit({}),
}
_ATOM: Final = re.compile(r"([A-Za-z]+|1)(\d?)")
DISPLAY: Final = {"rad": ("deg", 180.0 / math.pi), "m/s": ("km/h", 3.6), "rad/s": ("deg/s", 180.0 / math.pi)}


def base_unit(name: str) -> BaseUnit | None:
    """The unit in SI; None if its exponents depend on another number, as of some soil moduli."""
    over, _, under = name.partition("/")
    factor, exponents = 1.0, dict[str, int]()
    for part, sign in ((over, 1), (under.removeprefix("(").removesuffix(")"), -1)):
        top, _, bottom = part.partition("/")  # m/s2 in rad/(m/s2)
        for words, direction in ((top, sign), (bottom, -sign)):
            for word in words.split():
                atom = _ATOM.fullmatch(word)
                if atom is None or atom[1] not in _ATOMS:
                    return None
                power = direction * int(atom[2] or 1)
                of_atom = _ATOMS[atom[1]]
                factor *= of_atom.factor**power
                for si, exponent in of_atom.exponents.items():
                    exponents[si] = exponents.get(si, 0) + power * exponent
    return BaseUnit({si: exponent for si, exponent in exponents.items() if exponent}, factor)


_TYPE: Final = re.compile(r"typedef\s+(fmi3Status|fmi3Instance)\s+(fmi3\w+)TYPE\s*\(([^;]*)\);")
_DEFINED: Final = re.compile(r"^\w[\w \*]*\b(fmi3\w+)\(", re.MULTILINE)
_NAME: Final = re.compile(r"(\w+)(?:\[\])?$")
_COUNT: Final = "nValueReferences"  # a call for no variables is always right
_BEGIN: Final = """\
/* Functions of FMI 3.0 that this FMU does not need, from the types of fmi3FunctionTypes.h. */

#include "instance.h"

#include "fmi3Functions.h"

static fmi3Status refused(fmi3Instance instance, const char *function) {
  model_refuse(instance, "%s is not supported: variables are of types Float64 and String, for co-simulation", function);
  return fmi3Error;
}
"""


def unused_functions(header: str, wrapper: str) -> str:
    """C file with all functions whose types ``header`` defines, but for those that the file ``wrapper`` contains."""
    defined = set(_DEFINED.findall(wrapper))
    functions = [
        _function(result, name, arguments) for result, name, arguments in _TYPE.findall(header) if name not in defined
    ]
    return "\n".join([_BEGIN, *functions])


def _function(result: str, name: str, arguments: str) -> str:
    declared = [" ".join(argument.split()) for argument in arguments.split(",")]
    names = [match[1] for argument in declared if (match := _NAME.search(argument))]
    if result == "fmi3Instance":
        answer, used = "NULL", set[str]()
    elif _COUNT in names:
        answer, used = f'{_COUNT} ? refused(instance, "{name}") : fmi3OK', {"instance", _COUNT}
    else:
        answer, used = f'refused(instance, "{name}")', {"instance"}
    unused = "".join(f"  (void){argument};\n" for argument in names if argument not in used)
    signature = ",\n    ".join(declared)
    return f"{result} {name}(\n    {signature}) {{\n{unused}  return {answer};\n}}\n"


_PARAMETERS: Final = 2  # argument of the programs
_ARGUMENTS: Final = "(long n, long ticks, const double *x, const double *u, const double *c, double *y)"
HEADERS: Final = {
    2: ("fmi2FunctionTypes.h", "fmi2Functions.h", "fmi2TypesPlatform.h"),
    3: ("fmi3FunctionTypes.h", "fmi3Functions.h", "fmi3PlatformTypes.h"),
}
_UNUSED: Final = "fmi3_unused.c"


def c_files(
    prefix: str, plant: str, version: int, programs: Mapping[str, TapeProgram], defined: Mapping[str, object]
) -> dict[str, str]:
    """All source files by name, without ``plant.h`` and ``token.h``.

    ``plant`` names the fixed file of the kind of plant, ``defined`` are macros that it reads.
    """
    return {
        **common_files(version),
        **{name: source_text(name) for name in ("model.c", f"{plant}.c", "model.h")},
        **{f"{name}.c": _program_file(prefix, name, program) for name, program in programs.items()},
        "programs.h": _programs_header(prefix, programs, defined),
    }


def common_files(version: int) -> dict[str, str]:
    """Source files of every FMU of a version of FMI, with the headers of the standard.

    Raises:
        ValueError: one line, if FMPy, which has the headers, is not installed.
    """
    wrapper = f"fmi{version}.c"
    files = {
        **{name: source_text(name) for name in ("instance.c", wrapper, "instance.h", "portable.h")},
        **{name: (headers_folder() / name).read_text(encoding="utf-8") for name in HEADERS[version]},
    }
    if version == 3:
        files[_UNUSED] = unused_functions(files["fmi3FunctionTypes.h"], files[wrapper])
    return files


def headers_folder() -> Path:
    """Folder of FMPy with the header files of the FMI standard.

    Raises:
        ValueError: one line, if FMPy is not installed.
    """
    return Path(import_extra("fmi", "offtrack fmu needs", "fmpy").__file__).parent / "c-code"


def source_text(name: str) -> str:
    """Text of a fixed C file."""
    return (resources.files("offtrack.exchange.fmi_export") / "sources" / name).read_text(encoding="utf-8")


def plant_header(interface: Interface, programs: Mapping[str, TapeProgram], gear: int | None) -> str:
    """``plant.h``: sizes of all vectors, start values and names."""
    step = programs["step"]
    numbers = step.n_numbers + programs["observe"].n_numbers
    lines = [
        f"#define N_PARAMETERS {len(interface.parameters)}",
        f"#define N_INPUTS {len(interface.inputs)}",
        f"#define N_OUTPUTS {len(interface.outputs)}",
        f"#define N_STATES {step.n_state}",
        f"#define N_NUMBERS {numbers + 1}",
        *([] if gear is None else [f"#define GEAR {gear} /* place of this input */"]),
        "#define PARAMETER_STARTS \\\n  " + rows(repr(float(q.start)) for q in interface.parameters),
        "#define INPUT_STARTS \\\n  " + rows(repr(float(q.start)) for q in interface.inputs),
        "#define INPUT_NAMES \\\n  " + rows(f'"{q.name}"' for q in interface.inputs),
    ]
    return "/* Sizes, start values and names of this plant. */\n\n" + "\n".join(lines) + "\n"


def rows(entries: Iterable[str]) -> str:
    """Entries of a C array, some in each line of a macro."""
    values = list(entries)
    return ", \\\n  ".join(", ".join(values[k : k + 8]) for k in range(0, len(values), 8))


def _program_file(prefix: str, name: str, program: TapeProgram) -> str:
    return (
        f'#include "portable.h"\n\n#define LANES 1\n#define run {prefix}_{name}_run\n'
        f"#define derive {prefix}_{name}_derive\n"
        f"HIDDEN void run{_ARGUMENTS};\nHIDDEN void derive(const double *p, double *c);\n\n"
        + c_source(program)
        + numbers_source(program)
    )


def _programs_header(prefix: str, programs: Mapping[str, TapeProgram], defined: Mapping[str, object]) -> str:
    lines = ["/* The functions of this plant; each with its file. */", "", '#include "portable.h"', ""]
    for name, program in programs.items():
        lines += [
            f"#define {name}_run {prefix}_{name}_run",
            f"#define {name}_derive {prefix}_{name}_derive",
            f"#define {name.upper()}_NU {program.n_input}",
            f"#define {name.upper()}_NC {program.n_numbers}",
            f"HIDDEN void {name}_run{_ARGUMENTS};",
            f"HIDDEN void {name}_derive(const double *p, double *c);",
            "",
        ]
    lines += [f"#define {name} {value}" for name, value in defined.items()]
    return "\n".join(lines) + "\n"


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
    stepping: str  # a sentence on the steps of the integration


def interface_of(
    parameters: Sequence[Signal],
    starts: Sequence[Signal],
    inputs: Sequence[Signal],
    outputs: Sequence[Signal],
    observe: Any,
    programs: Mapping[str, TapeProgram],
) -> Interface:
    """Interface of a plant; ``observe`` is its function (state, inputs, parameters) -> outputs."""
    nodes = (node for program in programs.values() for part in program.parts for node in part.numbers.nodes)
    read = {node.place for node in nodes if isinstance(node, Entry) and node.argument == _PARAMETERS}
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


def start_signals(frame: str) -> list[Signal]:
    """Pose and speed at the start, in the order that the C files read them."""
    return [
        Signal("start_x", "m", f"position of {frame} in W at the start"),
        Signal("start_y", "m", f"position of {frame} in W at the start"),
        Signal("start_psi", "rad", "heading at the start, + left"),
        Signal("start_speed", "m/s", "speed at the start, straight ahead and rolling freely"),
    ]


def number_signal(root: BaseModel, path: str, value: float, prefix: str = "") -> Signal:
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
    return Signal(prefix + path, unit, meaning, value, low, high)


def fixed_values(root: BaseModel, unread: Iterable[Signal]) -> list[tuple[str, str]]:
    """Flags and words of a model, and its numbers that no equation reads."""
    return [*_words(root, ""), *((signal.name, f"{signal.start:.10g}") for signal in unread)]


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
    return next(_fields_with_unit(field.annotation), field)


def _fields_with_unit(annotation: Any) -> Iterator[FieldInfo]:
    for extra in getattr(annotation, "__metadata__", ()):
        if isinstance(extra, FieldInfo) and extra.json_schema_extra:
            yield extra
    for inner in getattr(annotation, "__args__", ()):
        yield from _fields_with_unit(inner)


def model_identifier(name: str) -> str:
    """Identifier of a model by its name."""
    return "offtrack_" + re.sub(r"\W", "_", name, flags=re.ASCII)[:_LONGEST_NAME]


@dataclass(frozen=True, slots=True, kw_only=True)
class Exported:
    """An FMU before it is compiled."""

    name: str
    summary: str
    variables: Sequence[Variable]
    sources: Mapping[str, str]  # C files and headers by name, without ``token.h``
    notes: Sequence[str]  # paragraphs of its page
    fixed: Sequence[tuple[str, str]] = ()  # what is fixed at export: path and value
    resources: Mapping[str, bytes] = field(default_factory=dict)
    keeps_state: bool = True  # its state can be taken, serialised and set
    tool_only: bool = False  # it needs another program on the machine
    step: float = 0.01  # a step that suits most uses [s]
    stop: float = 20.0  # an end that suits most uses [s]

    @property
    def identifier(self) -> str:
        """A C name, and the name of the library."""
        return model_identifier(self.name)


def exported_plant(model: PlantModel, version: int) -> Exported:
    """The FMU of a plant."""
    sources = c_files(model_identifier(model.name), model.kind, version, model.programs, model.defined)
    return Exported(
        name=model.name,
        summary=model.summary,
        variables=model.interface.variables(),
        sources={**sources, "plant.h": plant_header(model.interface, model.programs, model.gear)},
        notes=(f"{model.stepping} Inputs hold during a communication step.",),
        fixed=model.fixed,
    )
