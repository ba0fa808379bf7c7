"""Functions of FMI 3 that an exported FMU does not need, as C: importers look all of them up.

They are written from the standard's own header, so that none is forgotten.
"""

from __future__ import annotations

import re
from typing import Final

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
