"""C files of a plant: its functions as programs, sizes and names, and functions of FMI 3 that it does not need.

They are written from the standard's own header, so that none is forgotten. The headers are those that FMPy ships.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping
from importlib import resources
from pathlib import Path
from typing import Final

from offtrack.exchange.fmi_export.variables import Interface
from scenarios.extras import check_extra
from vehicle.engine.native import c_source, numbers_source
from vehicle.engine.program import Entry, TapeProgram

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


def parameters_read(programs: Mapping[str, TapeProgram]) -> frozenset[int]:
    """Places of the parameters that any program reads."""
    return frozenset(
        node.place
        for program in programs.values()
        for part in program.parts
        for node in part.numbers.nodes
        if isinstance(node, Entry) and node.argument == _PARAMETERS
    )


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
    check_extra("fmi", "offtrack fmu needs", "fmpy")
    import fmpy

    return Path(fmpy.__file__).parent / "c-code"


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
